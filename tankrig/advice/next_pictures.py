"""The next pictures for a rig: designed by what is known of the liquid, compared with the usual ones, as a sequence."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from tankrig.advice.cells import CellLight, cell_light, designing_camera, parts_of, pattern_light
from tankrig.advice.design import LIMIT_S, Design, Prospect, Wanted, designed
from tankrig.advice.expected import Expected, Known, Shot
from tankrig.bench import Bench
from tankrig.errors import SequenceError
from tankrig.extras import needing_extra
from tankrig.pattern.kinds import Cells
from tankrig.scene import Camera, Medium
from tankrig.sequence.until import Until

Array = NDArray[np.float64]

MOST_SHEETS, MOST_CELLS = 3, 40
UNSURE = (0.1, 0.1, 0.05)
"""Standard deviations of σa and σs (relative) and of g from which on a design looks at both sides of a value."""
DENSITY_STEP, ASYMMETRY_STEP, CLEAREST = 1.1, 0.05, 1e-3
"""Grid of liquids that pictures are designed for: factor between one σ and the next, step in g, least σa over σs."""
FURTHEST = (0.5, 0.3, 0.15)
"""The farthest from a value that it looks, in the same units."""


@dataclass(frozen=True)
class NextPictures:
    """Pictures that were designed, beside the usual ones.

    Parameters
    ----------
    design
        The pictures, and what a fit of them is expected to state.
    frames
        Of each.
    usual
        What it would state with the same number of frames of usual pictures, by name: one, or a pair of them where
        several were designed.
    bits
        Information that they add beyond the best of these.
    best
        Its name.
    now
        What a fit states without them; None where nothing was photographed before.
    """

    design: Design
    frames: int
    usual: Mapping[str, Expected]
    bits: float
    best: str
    now: Expected | None = None

    @property
    def total(self) -> int:
        """Frames of all pictures."""
        return self.frames * len(self.design.pictures)


def usual_pictures(cells: Cells) -> dict[str, Array]:
    """What people show, drawn with cells: (cells,) parts of the light by name."""
    count = len(cells.light[0])
    across = np.arange(count)
    width = max(1, round(8.0 / cells.cell_mm))
    middle = [(count - width) // 2, count // 6, count - count // 6 - width]
    beam = (across >= middle[0]) & (across < middle[0] + width)
    three = np.any([(across >= one) & (across < one + width) for one in middle], axis=0)
    stripes = across // width % 2 == 1
    rows = {"beam": beam, "three beams": three, "stripes": stripes, "sheet": across >= 0}
    return {name: np.tile(row.astype(float), len(cells.z_mm)) for name, row in rows.items()}


def thought_possible(liquid: Medium, sd: Sequence[float]) -> list[Medium]:
    """A liquid, and both sides of each of its values that is not known well.

    Another phase function than Henyey–Greenstein's is taken for what it is.

    Parameters
    ----------
    liquid
        As it was fitted.
    sd
        Standard deviations of σa, σs and g.

    Examples
    --------
    >>> [round(one.g, 2) for one in thought_possible(Medium(0.001, 0.02, 0.7), (1e-5, 1e-4, 0.06))]
    [0.7, 0.64, 0.76]
    """
    found = [liquid]
    values, scale = np.array([liquid.sigma_a, liquid.sigma_s, liquid.g]), (liquid.sigma_a, liquid.sigma_s, 1.0)
    for k, (one, size) in enumerate(zip(sd, scale, strict=False)):
        if one > UNSURE[k] * size and (k < 2 or liquid.phase is None):
            step = min(one, FURTHEST[k] * size)
            for side in (-step, step):
                moved = values.copy()
                moved[k] += side
                sigma_a, sigma_s, g = moved[0], moved[1], np.clip(moved[2], -0.9, 0.95)
                found.append(Medium(float(sigma_a), float(sigma_s), float(g), liquid.phase))
    return found


def nearby(liquid: Medium) -> Medium:
    """A liquid of a coarse grid, as good to design for: what is kept of it serves the next fit's liquid, too.

    Examples
    --------
    >>> nearby(Medium(0.00101, 0.0203, 0.71)) == nearby(Medium(0.00103, 0.0206, 0.69))
    True
    """
    if liquid.phase is not None:
        return liquid
    step = math.log(DENSITY_STEP)

    def rounded(value: float) -> float:
        return round(math.exp(round(math.log(value) / step) * step), 9)

    sigma_s = rounded(max(liquid.sigma_s, 1e-6))
    g = round(min(round(liquid.g / ASYMMETRY_STEP) * ASYMMETRY_STEP, 0.95), 6)
    return Medium(rounded(max(liquid.sigma_a, CLEAREST * sigma_s)), sigma_s, g)


def _sideways(liquid: Medium) -> float:
    """σs p(90°), which is what brightness goes by."""
    return liquid.sigma_s * float(liquid.phase_function.at(0.0))


def next_pictures(
    known: Known,
    dose_ml: float,
    sd: Sequence[float],
    bench: Bench,
    camera: Camera,
    cells: Cells,
    pictures: int = 2,
    frames: int = 4,
    wanted: Wanted = "all",
    saturation: float | None = None,
    limit_s: float = LIMIT_S,
    progress: Callable[[float], object] = lambda _: None,
    taken: Sequence[Shot] = (),
) -> NextPictures:
    """Pictures from whose frames a fit is expected to learn most about the liquid of a dose.

    Parameters
    ----------
    known
        Ink, and camera: the noise is of a pixel of `camera`.
    dose_ml
        Ink in the tank.
    sd
        Standard deviations of the liquid's σa, σs and g as they are known; empty: take it for what it is.
    bench
        Of the rig.
    camera
        As fits see its pictures.
    cells
        Where light may be; its parts do not matter.
    pictures, frames
        How many, and of each.
    wanted
        What is to be known.
    saturation
        Counts, in the unit of gain · radiance, at which the camera is full.
    limit_s
        Seconds that the design may take, once the cells' light is there.
    progress
        Called with the share of the work on the cells' light that is done.
    taken
        Photographs of this liquid by `camera` that will be fitted with the pictures. None: theirs are fitted by
        themselves, so that what was photographed before says where the liquid is, and not how well it is known.

    Raises
    ------
    SceneError
        When the cells light nothing of the tank.
    SequenceError
        With more sheets or cells than are computed, or where the projector lights none.
    """
    _require_designable(cells, bench)
    smaller, by = designing_camera(camera)
    liquid = known.liquid(dose_ml)
    liquids = list(dict.fromkeys(nearby(one) for one in thought_possible(liquid, sd)))
    gain = known.gain * _sideways(liquid) / _sideways(liquids[0])
    lights, photographed = _light_in(liquids, known, bench, smaller, cells, taken, progress)
    brightest = gain * float(lights[0].images.sum(axis=0).max())
    noise = _noise_up_to(brightest, known, by)
    prospects = [
        Prospect(light, gain, noise, known.model_error, known.offset_free, saturation=saturation) for light in lights
    ]
    for number, shown in enumerate(photographed):
        for shot, (radiance, slopes) in zip(taken, shown, strict=True):
            used = np.ones(smaller.shape, bool) if shot.used is None else _whole(shot.used, by)
            prospects[number] = prospects[number].with_photograph(radiance, slopes, used, shot.frames)
    plans = _usual_plans(cells, pictures)

    def worth(light: Array) -> float:
        each = frames * pictures / len(light)
        return float(np.mean([one.value(light, each, wanted) for one in prospects]))

    values = {name: worth(light) for name, light in plans.items()}
    order = sorted(plans, key=lambda name: values[name])
    shape = pictures, plans["sheet"].size
    starts = [np.resize(plans[name], shape) for name in order]
    design = designed(prospects, starts, frames, wanted, limit_s)
    expected = {name: prospects[0].expected(plans[name], frames * pictures / len(plans[name])) for name in order}
    bits = (values[order[0]] - worth(design.light)) / math.log(2.0)
    now = prospects[0].expected(np.zeros((0, shape[1])), frames) if taken else None
    return NextPictures(design, frames, expected, bits, order[0], now)


def _require_designable(cells: Cells, bench: Bench) -> None:
    """Refuse more sheets or cells than are computed, and sheets that the projector does not light."""
    if len(cells.z_mm) > MOST_SHEETS or len(cells.light[0]) > MOST_CELLS:
        raise SequenceError(
            f"{len(cells.z_mm)} sheets of {len(cells.light[0])} cells are more than the {MOST_SHEETS} of {MOST_CELLS} "
            "that pictures are designed with; give fewer"
        )
    low_mm, high_mm = sorted(bench.wall.y_mm)
    if cells.y_mm[0] < low_mm or cells.y_mm[1] > high_mm:
        raise SequenceError(
            f"y_mm = {list(cells.y_mm)} reaches beyond what the projector lights, y = {low_mm:g}…{high_mm:g} mm; give "
            "narrower sheets"
        )


def _light_in(
    liquids: Sequence[Medium], known: Known, bench: Bench, camera: Camera, cells: Cells, taken: Sequence[Shot],
    progress: Callable[[float], object],
) -> tuple[list[CellLight], list[list[tuple[Array, Array]]]]:  # fmt: skip
    """Light of the cells in each liquid, and of each photograph that was taken, with its derivatives."""
    each = 1.0 / (parts_of(cells).size + len(taken)) / len(liquids)
    lights: list[CellLight] = []
    photographed: list[list[tuple[Array, Array]]] = []
    for number, one in enumerate(liquids):

        def share(done: float, number: int = number) -> None:
            progress(number / len(liquids) + done * each * parts_of(cells).size)

        lights.append(cell_light(cells, bench, camera, one, share, known.family))
        photographed.append([])
        for place, shot in enumerate(taken):
            photographed[-1].append(pattern_light(shot.scene, camera, one, known.family))
            progress((number + 1) / len(liquids) - (len(taken) - 1 - place) * each)
    return lights, photographed


def _noise_up_to(brightest: float, known: Known, by: int) -> Callable[[Array], Array]:
    """From the mean of a frame to its variance, where `by` × `by` pixels are put together to one."""
    dark, bright = known.noise(np.array([0.0, brightest])) / by**2

    def noise(image: Array) -> Array:
        return np.asarray(dark + (bright - dark) / brightest * image)  # a straight line in the brightness

    return noise


def _usual_plans(cells: Cells, pictures: int) -> dict[str, Array]:
    """Usual pictures by name, one or, where several are designed, a pair of them too: (pictures, cells) of each."""
    usual = usual_pictures(cells)
    plans = {name: one[None] for name, one in usual.items()}
    if pictures > 1:
        plans |= {f"{one} + {other}": np.stack([usual[one], usual[other]]) for one, other in combinations(usual, 2)}
    return plans


def _whole(used: NDArray[np.bool_], by: int) -> NDArray[np.bool_]:
    """Whether all of the `by` × `by` pixels are used that are put together to one."""
    rows, columns = (side // by for side in used.shape)
    return np.asarray(used[: rows * by, : columns * by].reshape(rows, by, columns, by).all(axis=(1, 3)))


def table_of(cells: Cells) -> dict[str, object]:
    """A picture as a pattern of a sequence file."""
    sheets, light = [list(z_mm) for z_mm in cells.z_mm], [list(row) for row in cells.light]
    return {"kind": "cells", "y_mm": list(cells.y_mm), "z_mm": sheets, "light": light}


def as_sequence(found: NextPictures, total_ul: float, exposure_ms: float, until: Until | None = None) -> str:
    """A sequence file that shows the pictures at a dose, and a dark frame.

    Parameters
    ----------
    found
        What was designed.
    total_ul
        Ink in the tank; what it holds already is not dosed again.
    exposure_ms
        Of the frames.
    until
        Once that is known no more frames are taken.

    Examples
    --------
    >>> import tomllib
    >>> from tankrig.sequence.loading import sequence_from_table
    >>> lit = Cells((-60.0, 60.0), ((58.0, 62.0),), ((1.0, 0.0, 0.5),))
    >>> design = Design((lit,), np.ones((1, 3)), Expected(np.eye(3), {}), 0.3)
    >>> text = as_sequence(NextPictures(design, 4, {}, 0.3, "sheet"), 400.0, 50.0, Until(sigma_s="1 %"))
    >>> sequence = sequence_from_table(tomllib.loads(text), "text")
    >>> sequence.patterns["designed-1"] == lit, sequence.frames, str(sequence.tasks[-1].action.until)
    (True, 8, 'σs known to 1 %')
    """
    with needing_extra("writing a sequence file"):
        import tomlkit

    names = [f"designed-{number}" for number in range(1, len(found.design.pictures) + 1)]
    wish = {} if until is None else {"until": {key: one for key, one in vars(until).items() if one is not None}}
    steps: list[dict[str, object]] = [
        {"do": "dose", "total_ul": total_ul},
        {"do": "mix", "pattern": names[0]},
        {"do": "capture", "pattern": "dark", "frames": found.frames},
        *({"do": "capture", "pattern": name, "frames": found.frames, **wish} for name in names),
    ]
    patterns = {name: table_of(one) for name, one in zip(names, found.design.pictures, strict=True)}
    return tomlkit.dumps({"name": "designed", "exposure_ms": exposure_ms, "patterns": patterns, "steps": steps})
