"""A simulated bench with ink in its tank: the scene that is really there, for the Monte Carlo to look at."""

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from tankrig.geometry.pose import rotation_vector
from tankrig.pattern import Pattern
from tankrig.scene.description import Beam, Camera, Medium, Projector, Scene, Tank
from tankrig.scene.optics import ALL_BLACK, Face, Faces

from .bench_optics import FINER, illumination, pinholes, thrown
from .bench_truth import TANK_MM, Array, TrueBench, TrueOptics

CELL_MM, _SAMPLES = 1.0, 4
"""Side of the cells in which the wall is lit evenly, and samples along it."""
_FAINT, EVENLY, _WIDER = 1e-3, 0.03, 8
"""Cells fainter than this share of the brightest are put together, so many to a side: light of a halo, which is spread
over the whole wall. It was left out, and with it .7 to 1.3 % of the light of three rays. So are cells whose brightest
is brighter than the faintest by so much of itself: a white picture had 18,000, which took 57 CPU s instead of 11."""


def true_scene(bench: TrueBench, pattern: Pattern, medium: Medium, binning: int = 1) -> Scene:
    """What the camera of a bench looks at.

    The light on the wall is followed by the bench's own optics, not by `tankrig.scene.projection`. Not in it are
    how the level surface leans from the tank's floor (it moves sight by 0.02 mm), and what the wall reflects, which is
    the same share of all light to 0.1 %.

    Parameters
    ----------
    bench
        Its truth.
    pattern
        On the projector.
    medium
        In the tank.
    binning
        Side, in pixels, of the blocks that the camera's pixels are put together to.
    """
    projector = Projector("pinhole", _beams(bench, pattern), _vector(bench.projector.centre_mm))
    faces = Faces(**{name: Face("glass") for name in bench.stray.glass}, floor=Face("diffuse", bench.stray.floor))
    tank = Tank(
        (TANK_MM[0], TANK_MM[1], bench.level_mm), "fresnel", bench.water_index, "glass", bench.pane_mm,
        bench.pane_index, ALL_BLACK if faces.dark else faces,
    )  # fmt: skip
    return Scene(tank, medium, projector, _camera(bench.camera).binned(binning))


def through_lens(bench: TrueBench, scene: Scene) -> list[Scene]:
    """The scene by each of the pinholes that the projector's lens is made of; what the camera sees is their mean."""
    _, width, level = scene.tank.size_mm
    found = []
    for place, move in pinholes(bench):
        beams = []
        for beam in scene.projector.beams:
            y_mm, z_mm = np.clip(beam.y_mm + move[0], -width / 2, width / 2), np.clip(beam.z_mm + move[1], 0.0, level)
            if np.ptp(y_mm) > 0.0 and np.ptp(z_mm) > 0.0:
                beams.append(Beam((y_mm[0].item(), y_mm[1].item()), (z_mm[0].item(), z_mm[1].item()), beam.irradiance))
        light = replace(scene.projector, beams=tuple(beams), position_mm=_vector(place))
        found.append(replace(scene, projector=light))
    return found


def _beams(bench: TrueBench, pattern: Pattern) -> tuple[Beam, ...]:
    """Small rectangles of the wall, each evenly lit; W/mm² by white paper's radiance π · `TrueBench.full`."""
    import cv2

    u, v, strength = _lit_wall(bench, CELL_MM)
    rows, columns = (n // _SAMPLES for n in strength.shape)
    light = cv2.remap(thrown(bench, pattern), u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
    cells = (light * strength).reshape(rows, _SAMPLES, columns, _SAMPLES).mean(axis=(1, 3)) * np.pi * bench.full
    y, z = np.linspace(-TANK_MM[1] / 2, TANK_MM[1] / 2, columns + 1), np.linspace(0.0, bench.level_mm, rows + 1)
    down, across = (np.append(np.arange(0, n, _WIDER), n) for n in cells.shape)
    sizes = np.diff(down), np.diff(across)

    def by_blocks(what: np.ufunc, of: Array) -> Array:
        return np.asarray(what.reduceat(what.reduceat(of, down[:-1]), across[:-1], axis=1))

    most, least = by_blocks(np.maximum, cells), by_blocks(np.minimum, cells)
    even = np.repeat(np.repeat(most - least <= EVENLY * most, sizes[0], axis=0), sizes[1], axis=1)
    together = np.where(even | (cells < _FAINT * cells.max()), cells, 0.0)
    wide = by_blocks(np.add, together) / np.outer(*sizes)
    return (*_rectangles(cells - together, y, z), *_rectangles(wide, y[across], z[down]))


def _rectangles(light: Array, y: Array, z: Array) -> Iterator[Beam]:
    """Those between edges that are lit, W/mm²."""
    for row, column in np.argwhere(light > 0.0).tolist():
        yield Beam((y[column], y[column + 1]), (z[row], z[row + 1]), float(light[row, column]))


@lru_cache(maxsize=2)
def _lit_wall(bench: TrueBench, cell_mm: float) -> tuple[NDArray[np.float32], NDArray[np.float32], Array]:
    """Place in `thrown` that lights each sample of the cells that fill the wall, and how strongly white does.

    Exactly on a grid of nodes, between them by cubic splines (error below 1e-3 pixels).
    """
    from scipy.interpolate import RectBivariateSpline

    width, level = TANK_MM[1], bench.level_mm
    y, z = np.linspace(-width / 2, width / 2, 41), np.linspace(0.0, level, 31)
    points = np.stack([np.zeros((z.size, y.size)), *np.meshgrid(y, z)], axis=-1)
    pixels, strength = illumination(bench, points, np.eye(3)[1:], filled=True)
    samples = [round(length / cell_mm) * _SAMPLES for length in (level, width)]
    fine_z, fine_y = (
        low + (np.arange(n) + 0.5) * length / n
        for n, length, low in zip(samples, (level, width), (0.0, -width / 2), strict=True)
    )
    u, v, lit = (RectBivariateSpline(z, y, one)(fine_z, fine_y) for one in (*np.moveaxis(pixels, -1, 0), strength))
    where = [((one + 0.5) * FINER - 0.5).astype(np.float32) for one in (u, v)]
    return where[0], where[1], np.asarray(lit)


def _camera(optics: TrueOptics) -> Camera:
    (a, b, c), (d, e, f), (g, h, i) = optics.matrix.tolist()
    return Camera(
        "calibrated",
        optics.shape,
        position_mm=_vector(optics.centre_mm),
        matrix=((a, b, c), (d, e, f), (g, h, i)),
        distortion=tuple(optics.distortion.tolist()),
        rotation=rotation_vector(optics.rotation),
    )


def _vector(of: Array) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in of)
    return x, y, z
