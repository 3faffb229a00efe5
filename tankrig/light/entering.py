"""The projector's light as it comes through the wall x = 0: soft edges, halo, black level, a lens that is wide.

All of it is sums of sharp beams from pinholes, which every model knows already. Soft edges are copies of the beams,
moved along y; along z, where the camera looks through all of a beam, and where edges are not seen along y too, they are
made as much wider as keeps the variance of their light. A wide lens is a sum of pinholes on its disc, each with its
beams moved so that all meet at the distance of focus.
"""

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from tankrig.scene import Beam, Scene
from tankrig.scene.optics import NO_HALO, PINHOLE, SHARP

Array = NDArray[np.float64]

FEWEST_COPIES, MOST_COPIES = 12, 24
"""Of a beam with soft edges, where edges are seen; with half as many, rows of pixels at edges were .7 % off."""
SMOOTH = 2.0
"""Of a pixel's longer side: standard deviation of a halo from which on its light has no edges that are seen."""
WIDE = 1.0 / 16.0
"""Of the wall's width: standard deviation of a halo from which on it is drawn on cells of the wall."""
CELL = 1.2
"""Of a wide halo's standard deviation: width of those cells."""
MOST_LEVELS = 3
"""Heights that a wide halo is drawn at."""
COARSE_CELL, MOST_COARSE_LEVELS = 2.0, 2
"""The same for light that is scattered more than once: a halo is a few per cent of it."""


def is_plain(scene: Scene) -> bool:
    """Whether the light is what the beams say: sharp, and dark beside them."""
    light = scene.projector
    soft = light.blur.sigma_mm > 0.0 or light.halo.share > 0.0 or light.black_level > 0.0
    return not soft and (light.wide_lens.diameter_mm == 0.0 or light.kind == "collimated")


def edged_and_smooth(scene: Scene, fine: bool = True) -> tuple[Scene, Scene | None]:
    """The scene with the light that has edges, and with that which is smooth over some pixels; None where it has none.

    Smooth are a wide halo and a dark picture's light.

    Parameters
    ----------
    scene
        Any scene.
    fine
        As for `entering`, of a wide halo.

    Examples
    --------
    >>> from tankrig.scene import Camera, Medium, Projector, Tank
    >>> from tankrig.scene.optics import Halo
    >>> light = Projector("collimated", (Beam((-2.0, 2.0), (58.0, 62.0)),), halo=Halo(0.02, 20.0))
    >>> scene = Scene(Tank(), Medium(0.0, 0.01, 0.0), light, Camera("orthographic", (80, 120), 2.0))
    >>> edged, smooth = edged_and_smooth(scene)
    >>> [round(sum(beam.power for beam in entering(one, True).projector.beams), 2) for one in (edged, smooth)]
    [15.68, 0.32]
    """
    light, (_, width, height) = scene.projector, scene.tank.size_mm
    wide = light.halo.share > 0.0 and light.halo.sigma_mm >= SMOOTH * max(scene.camera.sides_mm)
    if not wide and light.black_level == 0.0:
        return scene, None
    beams, smooth = light.beams, []
    if wide:
        beams = tuple(replace(beam, irradiance=(1.0 - light.halo.share) * beam.irradiance) for beam in beams)
        smooth = in_halo(scene, light.halo.share, fine)
    if light.black_level > 0.0:
        smooth.append(Beam((-0.5 * width, 0.5 * width), (0.0, height), light.black_level))
    halo = NO_HALO if wide else light.halo
    edged = replace(light, beams=beams, halo=halo, black_level=0.0)
    rest = replace(light, beams=tuple(smooth), halo=NO_HALO, black_level=0.0, blur=SHARP, wide_lens=PINHOLE)
    return replace(scene, projector=edged), replace(scene, projector=rest)


def entering(scene: Scene, fine: bool) -> Scene:
    """The scene with sharp beams that together are its light, but for a wide lens, see `through_lens`.

    Parameters
    ----------
    scene
        Any scene; it comes back as it is where its light has no blur, halo or black level.
    fine
        Whether edges are seen: then they are as smooth as pixels resolve. Else beams as much wider keep the variance of
        their light, and a wide halo is drawn on coarse cells: light scattered more than once can tell no more.

    Examples
    --------
    >>> from tankrig.scene import Camera, Medium, Projector, Tank
    >>> from tankrig.scene.optics import Halo
    >>> light = Projector("collimated", (Beam((-2.0, 2.0), (58.0, 62.0)),), halo=Halo(0.02, 20.0))
    >>> scene = Scene(Tank(), Medium(0.0, 0.01, 0.0), light, Camera("orthographic", (80, 120), 2.0))
    >>> round(sum(beam.power for beam in entering(scene, False).projector.beams), 2)  # a little falls beside the wall
    16.0
    """
    light, tank = scene.projector, scene.tank
    if light.blur.sigma_mm == 0.0 and light.halo.share == 0.0 and light.black_level == 0.0:
        return scene
    _, width, height = tank.size_mm
    share = light.halo.share
    pixel = scene.camera.sides_mm[0] if fine else math.inf
    beams = _spread(light.beams, 1.0 - share, light.blur.sigma_mm, pixel, (width, height))
    if share > 0.0:
        beams += in_halo(scene, share, fine)
    if light.black_level > 0.0:
        beams.append(Beam((-0.5 * width, 0.5 * width), (0.0, height), light.black_level))
    return replace(scene, projector=replace(light, beams=tuple(beams), blur=SHARP, halo=NO_HALO, black_level=0.0))


def in_halo(scene: Scene, share: float, fine: bool) -> list[Beam]:
    """A share of the light as the projector's halo spreads it, in sharp beams; 1 is all light.

    Parameters
    ----------
    scene
        Gives beams, and the width of halo and blur; how much light it says that the halo takes does not matter.
    share
        Of the light.
    fine
        As for `entering`.
    """
    light, (_, width, height) = scene.projector, scene.tank.size_mm
    sigma_mm = math.hypot(light.halo.sigma_mm, light.blur.sigma_mm)
    if light.halo.sigma_mm < WIDE * width:
        pixel = scene.camera.sides_mm[0] if fine else math.inf
        return _spread(light.beams, share, sigma_mm, pixel, (width, height))
    return _on_cells(light.beams, share, sigma_mm, (width, height), fine)


def through_lens(scene: Scene, fine: bool, seen_mm: float | None = None) -> list[tuple[float, Scene]]:
    """Scenes with a pinhole each, and their shares: their sum is the light through the projector's wide lens.

    Parameters
    ----------
    scene
        Any scene; where its lens is no wider than a pinhole, the only one.
    fine
        As for `entering`.
    seen_mm
        Width of what is seen where edges are; None: a pixel's side down.

    Examples
    --------
    >>> from tankrig.scene import Camera, Medium, Projector, Tank
    >>> from tankrig.scene.optics import WideLens
    >>> beams = (Beam((-2.0, 2.0), (58.0, 62.0)),)
    >>> light = Projector("pinhole", beams, (-400.0, 0.0, 60.0), wide_lens=WideLens(16.0, 100.0))
    >>> scene = Scene(Tank(), Medium(0.0, 0.01, 0.0), light, Camera("orthographic", (80, 120), 2.0))
    >>> [(round(share, 9), one.projector.beams[0].y_mm) for share, one in through_lens(scene, False)]
    [(0.5, (-2.8, 1.2)), (0.5, (-1.2, 2.8))]
    """
    light, lens = scene.projector, scene.projector.wide_lens
    if lens.diameter_mm == 0.0 or light.kind == "collimated" or light.position_mm is None:
        return [(1.0, scene)]
    index, wall_mm, wall_index = scene.tank.entry_bends
    radius, focus = 0.5 * lens.diameter_mm, lens.focus_mm / index
    at_wall = focus / (focus - light.position_mm[0] - wall_mm + wall_mm / wall_index)  # of a move on the lens
    _, width, height = scene.tank.size_mm
    found = []
    seen_mm = math.inf if not fine else scene.camera.sides_mm[0] if seen_mm is None else seen_mm
    for share, along_y, along_z in _disc(radius, radius * at_wall, seen_mm):
        place = (light.position_mm[0], light.position_mm[1] + along_y, light.position_mm[2] + along_z)
        moved = [_moved(beam, along_y * at_wall, along_z * at_wall, (width, height)) for beam in light.beams]
        beams = tuple(beam for beam in moved if beam is not None)
        if beams:
            pinhole = replace(light, position_mm=place, beams=beams, wide_lens=PINHOLE)
            found.append((share, replace(scene, projector=pinhole)))
    return found


def _disc(radius: float, at_wall_mm: float, seen_mm: float) -> list[tuple[float, float, float]]:
    """Shares of an even disc, and where they are: Gauss–Chebyshev along y, and one step up or down along z by turns."""
    count = 2 if seen_mm == math.inf else int(np.clip(math.ceil(4.0 * at_wall_mm / seen_mm), 4, 10)) // 2 * 2
    angles = np.arange(1, count + 1) * math.pi / (count + 1)
    shares, across = np.sin(angles) ** 2 * 2.0 / (count + 1), np.cos(angles)[::-1]
    up = np.sqrt(1.0 - across**2) / math.sqrt(3.0) * (-1.0) ** np.arange(count) if count > 2 else np.zeros(count)
    return [
        (float(share), float(radius * y), float(radius * z)) for share, y, z in zip(shares, across, up, strict=True)
    ]


def _moved(beam: Beam, along_y: float, along_z: float, wall: tuple[float, float]) -> Beam | None:
    """What of a moved beam still falls on the wall."""
    y_low, y_high = np.clip((np.array(beam.y_mm) + along_y).round(9), -0.5 * wall[0], 0.5 * wall[0]).tolist()
    z_low, z_high = np.clip((np.array(beam.z_mm) + along_z).round(9), 0.0, wall[1]).tolist()
    return Beam((y_low, y_high), (z_low, z_high), beam.irradiance) if y_high > y_low and z_high > z_low else None


def _spread(
    beams: tuple[Beam, ...], share: float, sigma_mm: float, pixel_mm: float, wall: tuple[float, float]
) -> list[Beam]:
    """A share of beams' light, blurred: copies along y, made higher along z; made wider where edges are not seen."""
    seen = pixel_mm < math.inf and sigma_mm > 0.0
    count = int(np.clip(math.ceil(6.0 * sigma_mm / pixel_mm), FEWEST_COPIES, MOST_COPIES)) if seen else 1
    moves = sigma_mm * np.array(_even_steps(count)) if seen else np.zeros(1)
    found = []
    for beam in beams:
        higher, taller = _widened(beam.z_mm, sigma_mm)
        wider, longer = (beam.y_mm, 1.0) if seen else _widened(beam.y_mm, sigma_mm)
        dimmed = share * beam.irradiance / (taller * longer * count)
        soft = replace(beam, y_mm=wider, z_mm=higher, irradiance=dimmed)
        found += [_moved(soft, float(by), 0.0, wall) for by in moves]
    return [beam for beam in found if beam is not None]


def _widened(lit: tuple[float, float], sigma_mm: float) -> tuple[tuple[float, float], float]:
    """An interval whose even light has the variance of another's that is blurred, and how many times as wide it is."""
    width, middle = lit[1] - lit[0], 0.5 * (lit[0] + lit[1])
    wider = math.sqrt(width**2 + 12.0 * sigma_mm**2)
    return (middle - 0.5 * wider, middle + 0.5 * wider), wider / width


@lru_cache(maxsize=32)
def _even_steps(count: int) -> tuple[float, ...]:
    """Middles of so many equal parts of a normal distribution, scaled to its variance."""
    from scipy.special import ndtri

    edges = ndtri(np.arange(1, count) / count)
    density = np.concatenate([[0.0], np.exp(-0.5 * edges**2) / math.sqrt(2.0 * math.pi), [0.0]])
    middles = -count * np.diff(density)
    middles = 0.5 * (middles - middles[::-1])
    return tuple((middles / math.sqrt(float(np.mean(middles**2)))).tolist())


def _on_cells(
    beams: tuple[Beam, ...], share: float, sigma_mm: float, wall: tuple[float, float], fine: bool
) -> list[Beam]:
    """A share of beams' light, spread so widely that even cells of the wall tell it."""
    cell, most = (CELL, MOST_LEVELS) if fine else (COARSE_CELL, MOST_COARSE_LEVELS)
    across = np.linspace(-0.5 * wall[0], 0.5 * wall[0], 1 + math.ceil(wall[0] / (cell * sigma_mm)))
    levels = np.linspace(0.0, wall[1], 1 + min(most, math.ceil(wall[1] / (cell * sigma_mm))))
    across, levels = across.round(9).clip(-0.5 * wall[0], 0.5 * wall[0]), levels.round(9).clip(0.0, wall[1])
    cells = np.zeros((levels.size - 1, across.size - 1))
    for beam in beams:
        by_z, by_y = _fallen(levels, beam.z_mm, sigma_mm), _fallen(across, beam.y_mm, sigma_mm)
        cells += share * beam.irradiance * by_z[:, None] * by_y
    return [
        Beam(
            (across[j].item(), across[j + 1].item()),
            (levels[i].item(), levels[i + 1].item()),
            float(f"{cells[i, j]:.9g}"),  # so that mirror images stay such
        )
        for i, j in np.ndindex(cells.shape)
    ]


def _fallen(edges: Array, lit: tuple[float, float], sigma_mm: float) -> Array:
    """Mean over cells of even light of an interval, blurred."""
    from scipy.special import ndtr

    def area(x: Array) -> Array:
        """∫ Φ(x/σ) dx."""
        z = x / sigma_mm
        return np.asarray(x * ndtr(z) + sigma_mm * np.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi))

    total = area(edges - lit[0]) - area(edges - lit[1])
    return np.diff(total) / np.diff(edges)
