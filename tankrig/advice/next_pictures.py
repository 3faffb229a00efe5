"""The next pictures for a rig: designed by what is known of the liquid, compared with the usual ones, as a sequence."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from tankrig.advice.cells import cell_light, designing_camera
from tankrig.advice.design import LIMIT_S, Design, Prospect, Wanted, designed
from tankrig.advice.expected import Expected, Known
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
        What it would state with the same number of frames of usual pictures, by name.
    bits
        Information that they add beyond the best of these.
    best
        Its name.
    """

    design: Design
    frames: int
    usual: Mapping[str, Expected]
    bits: float
    best: str

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
) -> NextPictures:
    """Pictures from whose frames alone a fit is expected to learn most about the liquid of a dose.

    What has been photographed says where the liquid is and not how well it is known: each run is fitted by itself.

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

    Raises
    ------
    SceneError
        When the cells light nothing of the tank.
    SequenceError
        With more sheets or cells than are computed.
    """
    if len(cells.z_mm) > MOST_SHEETS or len(cells.light[0]) > MOST_CELLS:
        raise SequenceError(
            f"{len(cells.z_mm)} sheets of {len(cells.light[0])} cells are more than the {MOST_SHEETS} of {MOST_CELLS} "
            "that pictures are designed with; give fewer"
        )
    smaller, by = designing_camera(camera)
    liquids = thought_possible(known.liquid(dose_ml), sd)
    lights = []
    for number, liquid in enumerate(liquids):

        def share(done: float, number: int = number) -> None:
            progress((number + done) / len(liquids))

        lights.append(cell_light(cells, bench, smaller, liquid, share, known.family))
    brightest = known.gain * float(lights[0].images.sum(axis=0).max())
    dark, bright = known.noise(np.array([0.0, brightest])) / by**2

    def noise(image: Array) -> Array:
        return np.asarray(dark + (bright - dark) / brightest * image)  # a straight line in the brightness

    prospects = [
        Prospect(light, known.gain, noise, known.model_error, known.offset_free, saturation=saturation)
        for light in lights
    ]
    usual = usual_pictures(cells)
    plans = {name: one[None] for name, one in usual.items()}
    plans |= {f"{one} + {other}": np.stack([usual[one], usual[other]]) for one, other in combinations(usual, 2)}

    def worth(light: Array) -> float:
        each = frames * pictures / len(light)
        return float(np.mean([one.value(light, each, wanted) for one in prospects]))

    values = {name: worth(light) for name, light in plans.items()}
    order = sorted(plans, key=lambda name: values[name])
    shape = pictures, usual["sheet"].size
    starts = [np.resize(plans[name], shape) for name in order if len(plans[name]) <= pictures]
    design = designed(prospects, starts, frames, wanted, limit_s)
    expected = {name: prospects[0].expected(plans[name], frames * pictures / len(plans[name])) for name in order}
    bits = (values[order[0]] - worth(design.light)) / math.log(2.0)
    return NextPictures(design, frames, expected, bits, order[0])


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
    patterns = {
        name: {"kind": "cells", "y_mm": list(one.y_mm), "z_mm": [list(z_mm) for z_mm in one.z_mm],
               "light": [list(row) for row in one.light]}
        for name, one in zip(names, found.design.pictures, strict=True)
    }  # fmt: skip
    return tomlkit.dumps({"name": "designed", "exposure_ms": exposure_ms, "patterns": patterns, "steps": steps})
