"""Sheets of light that a run has separated by waves, as the window shows them: what waves tell, and no model."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tankrig.scene.description import Camera, Tank
from ui.window import progress

if TYPE_CHECKING:
    from tankrig.live.results import DoseFit
    from tankrig.live.separated import Told
    from tankrig.separation import Separation

Image = NDArray[np.float32]
WithSd = tuple[float, float]

CELL_MM = 2.0
"""Sides of the cells in which order 1 is put into the tank."""


@dataclass(frozen=True)
class SheetKey:
    """Names a sheet of a run: the ink in the tank, and the middle of the sheet's height."""

    dose_ml: float
    height_mm: float


@dataclass(frozen=True)
class Basis:
    """What a separation rests on: while this is the same, so is all that it tells.

    Parameters
    ----------
    frames
        Name of its frames by their contents.
    fit
        σa, σs, g and the gain of its dose's fit; None where the dose is not fitted.
    """

    frames: str
    fit: tuple[float, ...] | None


@dataclass(frozen=True, eq=False)
class SeparatedSheet:
    """One sheet at one dose: pictures in counts per ms, and the numbers of `tankrig separate`.

    Parameters
    ----------
    key, basis
        Which, and of what.
    sheet
        (rows, columns) under the whole sheet.
    modulated, even
        (rows, columns) light that follows the wave and light that has forgotten it, by period in mm, the finest first.
    order_1
        (rows, columns) order 1, NaN where it cannot be told; None with fewer than two periods.
    in_tank
        (cells along y, cells along x) of `CELL_MM`: order 1, or where there is none what follows the finest wave, at
        the places of the sheet that the camera saw it at; NaN where it cannot be told.
    tank, camera
        Where the pixels lie.
    follow
        Part of the sheet's light that follows each wave, by period in mm.
    part, sigma_t, over_fit
        Part of the light that is order 1, σt by its decay (1/mm), and order 1 over the fitted liquid's; each with its
        standard deviation, None where it cannot be told.
    doubts
        Sentences.
    """

    key: SheetKey
    basis: Basis
    sheet: Image
    modulated: Mapping[float, Image]
    even: Mapping[float, Image]
    order_1: Image | None
    in_tank: Image
    tank: Tank
    camera: Camera
    follow: Mapping[float, float]
    part: WithSd | None
    sigma_t: WithSd | None
    over_fit: WithSd | None
    doubts: tuple[str, ...]


def separate(
    path: Path, known: Mapping[SheetKey, Basis], fits: "tuple[DoseFit, ...] | None" = None, keep: bool = False
) -> tuple[SeparatedSheet, ...]:
    """Separate the sheets that a run has recorded whole, but for those that are known.

    Parameters
    ----------
    path
        Of the run, which may still go on.
    known
        On what the sheets rest that need not be separated again.
    fits
        To compare order 1 with; None for those that the run has recorded.
    keep
        Whether the arrays are stored with the run, as `tankrig separate` does.

    Raises
    ------
    ImageError, StoreError
        When the run separates nothing, no sheet is whole, or a frame cannot be read.
    """
    from tankrig.live.recorded import fits_that_hold
    from tankrig.live.results import fits_in
    from tankrig.live.separated import told_of
    from tankrig.run.derived import write_derived
    from tankrig.run.reading import open_run
    from tankrig.separation import separations_of_run

    run = open_run(path)
    doses = fits_in([event.fields for event in fits_that_hold(run)])[0] if fits is None else fits
    by_dose = {round(one.dose_ml, 6): one for one in doses}
    separations = separations_of_run(run)
    found = []
    for number, one in enumerate(separations):
        progress.done(number / len(separations))
        fit = by_dose.get(round(one.dose_ml, 6))
        key, basis = SheetKey(one.dose_ml, 0.5 * sum(one.z_mm)), Basis(one.frames, _liquid(fit))
        if known.get(key) == basis:
            continue
        told = told_of(one, fit)
        if keep:
            name = f"separation-{one.dose_ml:g}ml-z{key.height_mm:g}mm"
            write_derived(path, name, one.arrays(), one.frames, **told.row)
        found.append(_separated(key, basis, one, told))
    return tuple(found)


def _liquid(fit: "DoseFit | None") -> tuple[float, ...] | None:
    return None if fit is None else (fit.medium.sigma_a, fit.medium.sigma_s, fit.medium.g, fit.gain)


def _separated(key: SheetKey, basis: Basis, one: "Separation", told: "Told") -> SeparatedSheet:
    order_1 = one.order_one.image if one.order_one is not None else None
    finest = next(iter(one.waves.values()))
    return SeparatedSheet(
        key, basis, one.sheet.astype(np.float32),
        {period_mm: waves.modulated.astype(np.float32) for period_mm, waves in one.waves.items()},
        {period_mm: waves.even.astype(np.float32) for period_mm, waves in one.waves.items()},
        None if order_1 is None else order_1.astype(np.float32),
        _in_tank(one, key.height_mm, finest.modulated if order_1 is None else order_1),
        one.bench.tank, one.camera, told.follow, told.order_1, told.sigma_t,
        None if told.over_fit is None else (told.over_fit.ratio, told.over_fit.sd), told.doubts,
    )  # fmt: skip


def _in_tank(one: "Separation", height_mm: float, image: NDArray[np.float64]) -> Image:
    """A picture of a sheet where it lies in the tank: the camera sees low sheets smaller, and bent by the surface."""
    import cv2

    from tankrig.scene.outline import in_picture
    from tankrig.separation.expected import sheet_scene
    from tankrig.separation.transfer import LIQUID

    scene = sheet_scene(next(iter(one.transfers)).wave, one.bench, one.camera, LIQUID) if one.transfers else None
    length, width, _ = one.bench.tank.size_mm
    x = (np.arange(max(1, int(length / CELL_MM))) + 0.5) * CELL_MM
    y = (np.arange(max(1, int(width / CELL_MM))) + 0.5) * CELL_MM - 0.5 * width
    if scene is None:
        return np.full((y.size, x.size), np.nan, np.float32)
    points = np.stack([*np.meshgrid(x, y), np.full((y.size, x.size), height_mm)], axis=-1)
    at = in_picture(scene, points)
    tall, wide = one.camera.sides_mm
    columns, rows = at[..., 0] / wide - 0.5, (at[..., 1] + 0.5 * width) / tall - 0.5
    moved: Image = cv2.remap(
        image.astype(np.float32), columns.astype(np.float32), rows.astype(np.float32), cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT, borderValue=float("nan"),
    )  # fmt: skip
    return moved
