"""Light of cells, each lit by itself: any picture made of them is a sum, and so are its derivatives."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tankrig.advice.ranking import answer_by_paths
from tankrig.bench import Bench
from tankrig.errors import SceneError, SequenceError
from tankrig.estimation.differences import values_of
from tankrig.estimation.phase_families import Family
from tankrig.estimation.phase_result import coefficients_by
from tankrig.image.bins import Seen
from tankrig.light.prepared.cache import Place
from tankrig.pattern.kinds import Cells, draw
from tankrig.scene import Camera, Medium, Scene
from tankrig.scene.optics import Blur

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

BATCHES, MOST_BATCHES = 4, 24
"""Lattices of light paths for each cell's light, and where that leaves more noise than `QUIET`, at most."""
QUIET = 0.012
"""Relative noise of a cell's image: that of its derivatives is some three times as much, and passes for information."""
SLOPE_BLUR_MM = 4.0
"""Over which derivatives of orders ≥ 3 are averaged: their noise would pass for information."""
ACROSS, SHEET_MM = 24, 4.0
"""Cells of a sheet, and its thickness, where nothing else is said."""
MOST_PIXELS = 3000
"""Most pixels of the pictures that are designed with; the camera's are binned until there are no more."""


@dataclass(frozen=True, eq=False)
class CellLight:
    """What a camera sees of each cell that is fully lit in a liquid.

    Parameters
    ----------
    cells
        Where they are; all of them lit.
    scene
        Of all of them, with the liquid and the camera.
    images
        (cells, rows, columns) radiance, the first sheet's cells first.
    slopes
        (cells, k, rows, columns) derivatives by σa, σs and g, or by σa, σs and the coordinates of `family`.
    used
        (rows, columns) pixels that a fit could look at, whichever cells are lit.
    family
        Of the phase functions that will be fitted, and of the liquid's; None: Henyey–Greenstein.
    """

    cells: Cells
    scene: Scene
    images: Array
    slopes: Array
    used: Mask
    family: Family | None = None

    @cached_property
    def of_coefficients(self) -> Array:
        """(3, k) derivatives of σa, σs and the mean cosine by the values that `slopes` are by."""
        if self.family is None:
            return np.eye(3)
        return coefficients_by(self.family, self.family.coordinates(self.scene.medium.phase_function))

    def picture(self, light: Array) -> tuple[Array, Array]:
        """(rows, columns) image and (k, rows, columns) slopes of cells lit in parts, (cells,)."""
        return np.tensordot(light, self.images, 1), np.tensordot(light, self.slopes, 1)


def even_cells(y_mm: tuple[float, float], z_mm: Sequence[tuple[float, float]], count: int) -> Cells:
    """So many cells in each sheet, all of them lit."""
    return Cells(y_mm, tuple(z_mm), tuple((1.0,) * count for _ in z_mm))


def cells_in(
    size_mm: tuple[float, float, float],
    heights_mm: Sequence[float] = (),
    sheet_mm: float = SHEET_MM,
    y_mm: tuple[float, float] | None = None,
    count: int = ACROSS,
) -> Cells:
    """Cells in a tank, as pictures are designed with where a person says nothing else.

    Parameters
    ----------
    size_mm
        Of the tank.
    heights_mm
        Middles of the sheets; empty: half the tank's height.
    sheet_mm
        Their thickness.
    y_mm
        (low, high) of them; None: three quarters of the tank's width.
    count
        Of cells in each.

    Raises
    ------
    SequenceError
        When sheets overlap, or reach out of the tank.

    Examples
    --------
    >>> cells_in((240.0, 160.0, 120.0), count=6).z_mm, cells_in((240.0, 160.0, 120.0), count=6).y_mm
    (((58.0, 62.0),), (-60.0, 60.0))
    """
    half = 0.5 * sheet_mm
    middles = sorted(heights_mm) or [0.5 * size_mm[2]]
    outside = [one for one in middles if not half <= one <= size_mm[2] - half]
    if outside:
        raise SequenceError(
            f"a sheet {sheet_mm:g} mm thick at a height of {outside[0]:g} mm is not in the tank, which is "
            f"{size_mm[2]:g} mm high; give another height"
        )
    across = y_mm or (-0.375 * size_mm[1], 0.375 * size_mm[1])
    return even_cells(across, [(one - half, one + half) for one in middles], count)


def parts_of(cells: Cells) -> Array:
    """(cells,) parts of the light, the first sheet's cells first."""
    return np.array(cells.light).ravel()


def with_parts(cells: Cells, light: Array) -> Cells:
    """The same cells with other parts of the light."""
    rows = np.clip(light, 0.0, 1.0).reshape(len(cells.z_mm), -1).round(4)
    return replace(cells, light=tuple(tuple(row) for row in rows.tolist()))


def designing_camera(camera: Camera) -> tuple[Camera, int]:
    """A camera with its pixels put together to `MOST_PIXELS` at most, and how many along a side that are."""
    by = 1
    while (camera.shape[0] // by) * (camera.shape[1] // by) > MOST_PIXELS:
        by += 1
    return (camera if by == 1 else camera.binned(by)), by


def cell_light(
    cells: Cells, bench: Bench, camera: Camera, medium: Medium, progress: Callable[[float], object] = lambda _: None,
    family: Family | None = None,
) -> CellLight:  # fmt: skip
    """Light of each cell by itself, computed once for a liquid and kept on disk.

    Parameters
    ----------
    cells
        Where they are; their light does not matter.
    bench
        Of the rig.
    camera
        As pictures are designed with, see `designing_camera`.
    medium
        The liquid.
    progress
        Called with the share of the work that is done, 0 … 1.
    family
        Of the phase functions that will be fitted, with the liquid's among them; None: Henyey–Greenstein.

    Raises
    ------
    SceneError
        When the cells light nothing of the tank, or the liquid's phase function is of no family that will be fitted.
    """
    if family is None and medium.phase is not None:
        raise SceneError(
            f'the liquid has a phase of kind "{medium.phase.kind}", and nothing says which family of phase functions '
            "will be fitted"
        )
    count = len(cells.z_mm) * len(cells.light[0])
    seen = replace(bench, camera=camera)
    whole = seen.scene(draw(with_parts(cells, np.ones(count)), bench.wall, "cells"), medium)
    place = Place.of(
        "cells", replace(whole, source=""), bench.wall, cells.y_mm, cells.z_mm, count, BATCHES, QUIET,
        *_fitted(medium, family),
    )  # fmt: skip
    known = place.kept(place.model)
    if known is None:
        images, slopes = _computed(cells, seen, medium, count, progress, family)
        place.require_room(8 * (images.size + slopes.size))
        place.keep(place.model, {"images": images, "slopes": slopes})
    else:
        images, slopes = (np.asarray(known[name], float) for name in ("images", "slopes"))
    progress(1.0)
    used = _used(cells, seen, medium, count)
    return CellLight(with_parts(cells, np.ones(count)), whole, images, slopes, used, family)


def _computed(
    cells: Cells, bench: Bench, medium: Medium, count: int, progress: Callable[[float], object], family: Family | None
) -> tuple[Array, Array]:
    images = np.zeros((count, *bench.camera.shape))
    slopes = np.zeros((count, values_of(medium, family).size, *bench.camera.shape))
    across = len(cells.light[0])
    mirrored = _mirrored(bench, cells)
    twins = [sheet * across + across - 1 - place for sheet, place in (divmod(one, across) for one in range(count))]
    followed = [number for number, twin in enumerate(twins) if not (mirrored and twin < number)]
    for number, twin in enumerate(twins):
        if number not in followed:
            images[number], slopes[number] = images[twin][::-1], slopes[twin][:, ::-1]
        else:
            lit = with_parts(cells, (np.arange(count) == number).astype(float))
            scene = _ideal(bench.scene(draw(lit, bench.wall, "cell"), medium))
            images[number], slopes[number] = _followed(scene, number, family)
            progress((followed.index(number) + 1) / len(followed))
    return images, slopes


def pattern_light(scene: Scene, camera: Camera, medium: Medium, family: Family | None = None) -> tuple[Array, Array]:
    """What a camera sees of another picture's light in a liquid, computed once and kept on disk.

    Parameters
    ----------
    scene
        Of the picture; its camera and its medium mean nothing.
    camera, medium, family
        As those of `cell_light`.

    Returns
    -------
    (rows, columns) image, and (k, rows, columns) its derivatives, as those of `CellLight`
    """
    seen = _ideal(replace(scene, camera=camera, medium=medium, source=""))
    place = Place.of("light of a pattern", seen, BATCHES, QUIET, *_fitted(medium, family))
    known = place.kept(place.model)
    if known is None:
        image, slopes = _followed(seen, 0, family)
        place.require_room(8 * (image.size + slopes.size))
        place.keep(place.model, {"image": image, "slopes": slopes})
        return image, slopes
    return np.asarray(known["image"], float), np.asarray(known["slopes"], float)


def _fitted(medium: Medium, family: Family | None) -> tuple[object, ...]:
    """What tells light of one family of phase functions from that of another."""
    return () if family is None else (family.name, *values_of(medium, family).tolist())


def _followed(scene: Scene, seed: int, family: Family | None) -> tuple[Array, Array]:
    """Image and slopes of one cell's light, by as many light paths as it needs."""
    from tankrig.light.tangent import tank_tangent

    if family is not None:
        return answer_by_paths(family)(scene, scene.medium)
    found = tank_tangent(scene, BATCHES, seed, blur_mm=SLOPE_BLUR_MM)
    image, stderr = found.prediction.image, found.prediction.stderr
    noise = 0.0 if stderr is None else float(np.linalg.norm(stderr) / np.linalg.norm(image))
    if noise > QUIET:
        batches = min(MOST_BATCHES, math.ceil(BATCHES * (noise / QUIET) ** 2))
        found = tank_tangent(scene, batches, seed, blur_mm=SLOPE_BLUR_MM)
    return np.asarray(found.prediction.image, float), found.slopes


def _mirrored(bench: Bench, cells: Cells) -> bool:
    """Whether light at −y makes the mirror image of that at y."""
    straight = bench.light == "collimated" or (
        bench.light == "pinhole" and bench.light_position_mm is not None and bench.light_position_mm[1] == 0.0
    )
    camera = bench.camera
    above = camera.kind == "orthographic" or (
        camera.kind == "pinhole" and camera.position_mm is not None and camera.position_mm[1] == 0.0
    )
    rows = camera.shape[0] * camera.sides_mm[0]
    return (
        straight and above and bench.wall.y_mm[0] == -bench.wall.y_mm[1] and cells.y_mm[0] == -cells.y_mm[1]
        and abs(rows - bench.tank.size_mm[1]) < 1e-9
    )  # fmt: skip


def _ideal(scene: Scene) -> Scene:
    """Without blur: what it changes is beside edges, and those pixels do not count."""
    return replace(
        scene, camera=replace(scene.camera, blur=Blur()), projector=replace(scene.projector, blur=Blur())
    )  # fmt: skip


def _used(cells: Cells, bench: Bench, medium: Medium, count: int) -> Mask:
    """Pixels that no edge between cells blurs, whichever are lit: each may differ from its neighbours."""
    across = len(cells.light[0])
    found = np.ones(bench.camera.shape, bool)
    for first in (0, 1):
        lit = (np.arange(count) + np.arange(count) // across) % 2 == first
        if lit.any():
            found &= Seen.of(bench.scene(draw(with_parts(cells, lit.astype(float)), bench.wall, "cells"), medium)).sharp
    return found
