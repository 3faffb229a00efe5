"""Frames that designed pictures save, on random liquids: `python tests/designed_pictures.py OUT.jsonl --liquids 60`.

For each liquid, what a fit is expected to know (σa, σs and g together, gain unknown) after `FRAMES` frames of the best
of a beam, three beams, stripes and a sheet, or the best pair of them; and with how many frames designed pictures are
expected to tell as much. The design knows the liquid as a few frames of the sheet leave it known, and not better: it is
made for a liquid that is off by a draw from that posterior, and judged by the true one. Each liquid is a line of OUT,
and what is there is not computed again; `--show` prints medians.
"""

import argparse
import json
import math
import time
from itertools import combinations
from pathlib import Path

import numpy as np

from tankrig.advice.cells import CellLight, cell_light, even_cells
from tankrig.advice.design import Prospect, designed
from tankrig.bench import Bench
from tankrig.pattern.wall import Wall
from tankrig.scene import Camera, Medium, Tank

BENCH = Bench(
    Tank((240.0, 160.0, 120.0)), Wall((120, 160), (-80.0, 80.0), (0.0, 120.0)), "collimated",
    Camera("orthographic", (40, 60), 4.0),
)  # fmt: skip
Y_MM, ACROSS = (-60.0, 60.0), 15
ONE, THREE = ((58.0, 62.0),), ((28.0, 32.0), (58.0, 62.0), (88.0, 92.0))
FRAMES = 8.0
READ, SHOT = 0.001, 0.005
"""Noise of a bin of 4 mm in one frame: standard deviations in the dark, and at the sheet's brightest by photons."""
ERRORS = (0.0, 0.001)
"""Of the model that is fitted, relative L2."""
GUESSED = 1.0
"""Frames of the sheet after which pictures are designed."""
MOST, HALVINGS = 16.0, 5
"""Ratio of frames that is looked for at most, and steps."""
WORST = np.array([0.5, 0.2, 0.1])
"""By which such a guess is off at most: σa and σs of themselves, g."""


def liquids(count: int) -> list[Medium]:
    """Random ones, thin to thick."""
    chance = np.random.default_rng(23)
    found = []
    for _ in range(count):
        sigma_s = float(np.exp(chance.uniform(np.log(0.002), np.log(0.06))))
        absorbed = float(np.exp(chance.uniform(np.log(0.002), np.log(0.1))))
        found.append(Medium(sigma_s * absorbed, sigma_s, float(chance.uniform(0.0, 0.9))))
    return found


def fixed(sheets: int) -> dict[str, np.ndarray]:
    """Cells of the usual pictures, in every sheet alike."""
    across = np.arange(ACROSS)
    rows = {
        "beam": across == ACROSS // 2, "three beams": np.isin(across, (2, 7, 12)), "stripes": across % 2 == 1,
        "sheet": across >= 0,
    }  # fmt: skip
    return {name: np.tile(row.astype(float), sheets) for name, row in rows.items()}


def prospect(light: CellLight, error: float, peak: float) -> Prospect:
    """In units of the sheet's brightest, which nearly fills the camera."""
    return Prospect(light, 1.0 / peak, lambda image: READ**2 + SHOT**2 * np.maximum(image, 0.0), error, saturation=1.1)


def off_by_a_guess(truth: Prospect, medium: Medium, sheet: np.ndarray, chance: np.random.Generator) -> Medium:
    """What the first frames of a sheet may have one believe."""
    known = truth.expected(sheet[None], GUESSED)
    scale = np.array([medium.sigma_a, medium.sigma_s, 1.0])
    draw = np.clip(chance.multivariate_normal(np.zeros(3), known.covariance) / scale, -WORST, WORST)
    sigma_a, sigma_s = scale[:2] * (1.0 + draw[:2])
    return Medium(float(sigma_a), float(sigma_s), float(np.clip(medium.g + draw[2], -0.5, 0.95)))


def plans_of(heights: int) -> dict[str, np.ndarray]:
    """The usual pictures, in all sheets and in each by itself, and all pairs of them; each (pictures, cells)."""
    sheets = len(THREE) if heights > 1 else 1
    pictures = fixed(sheets)
    if heights > 1:
        one = np.arange(sheets * ACROSS) // ACROSS
        pictures |= {f"{name} at {z}": lit * (one == z) for name, lit in fixed(sheets).items() for z in range(sheets)}
    pairs = {f"{one} + {other}": np.array([pictures[one], pictures[other]]) for one, other in combinations(pictures, 2)}
    return {name: lit[None] for name, lit in pictures.items()} | pairs


def worth(light: Prospect, pictures: np.ndarray, frames: float) -> float:
    """Nats, of so many frames in all."""
    return light.value(pictures, frames / len(pictures), "all")


class Designs:
    """One or two pictures for a liquid that is believed, with any number of frames; what was found is gone on from."""

    def __init__(self, believed: Prospect, plans: dict[str, np.ndarray]) -> None:
        self.believed, self.seconds = believed, []
        order = sorted(plans.values(), key=lambda one: worth(believed, one, FRAMES))
        self.starts = {count: [one for one in order if len(one) == count][:4] for count in (1, 2)}

    def best(self, frames: float) -> np.ndarray:
        made = []
        for count, begin in self.starts.items():
            began = time.process_time()
            found = designed([self.believed], begin, frames / count, limit_s=60.0)
            self.seconds.append(time.process_time() - began)
            self.starts[count] = [found.light, *begin[:3]]
            made.append(found.light)
        return min(made, key=lambda one: worth(self.believed, one, frames))


def frames_saved(truth: Prospect, designs: Designs, target: float) -> tuple[float, float]:
    """Nats per coefficient gained with equal frames, and the ratio of frames for equal knowledge."""

    def gained(ratio: float) -> float:
        frames = FRAMES / ratio
        return (target - worth(truth, designs.best(frames), frames)) / 3.0

    first = gained(1.0)
    low, high = (1.0, MOST) if first > 0.0 else (1.0 / MOST, 1.0)
    for _ in range(HALVINGS):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if gained(middle) > 0.0 else (low, middle)
    return first, math.sqrt(low * high)


def compared(medium: Medium, number: int, heights: int) -> dict:
    """One line."""
    cells = even_cells(Y_MM, THREE if heights > 1 else ONE, ACROSS)
    light = cell_light(cells, BENCH, BENCH.camera, medium)
    plans, peak = plans_of(heights), float(light.images.sum(axis=0).max())
    row: dict = {"number": number, "heights": heights, "medium": medium.coefficients, "errors": {}}
    first = prospect(light, max(ERRORS), peak)
    guess = off_by_a_guess(first, medium, plans["sheet"][0], np.random.default_rng([number, heights]))
    guessed = cell_light(cells, BENCH, BENCH.camera, guess)
    for error in ERRORS:
        truth, believed = prospect(light, error, peak), prospect(guessed, error, peak)
        values = {name: worth(truth, plan, FRAMES) for name, plan in plans.items()}
        best = min(values, key=lambda name: values[name])
        designs = Designs(believed, plans)
        gained, ratio = frames_saved(truth, designs, values[best])
        row["errors"][f"{error:g}"] = {
            "best": best, "gained": gained, "ratio": ratio,
            "seconds": float(np.median(designs.seconds)), "sheet": values["sheet"] - values[best],
        }  # fmt: skip
    return row


def show(rows: list[dict]) -> None:
    """Medians."""
    for heights in sorted({row["heights"] for row in rows}):
        here = [row for row in rows if row["heights"] == heights]
        for error in here[0]["errors"]:
            found = [row["errors"][error] for row in here]
            ratio, sd = ([one[name] for one in found] for name in ("ratio", "gained"))
            quarters = np.quantile(ratio, [0.1, 0.25, 0.5, 0.75, 0.9]).round(2).tolist()
            best = [one["best"] for one in found]
            most = sorted({*best}, key=best.count, reverse=True)[:3]
            print(
                f"{heights} sheets, model's error {100 * float(error):g} %, {len(found)} liquids: frames saved × "
                f"{quarters} (10, 25, 50, 75, 90 %), errors of equal frames {np.exp(-np.median(sd)):.3f}, design "
                f"{np.median([one['seconds'] for one in found]):.2f} CPU s; best fixed "
                + ", ".join(f"{name} {best.count(name)}" for name in most)
            )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--liquids", type=int, default=60)
    parser.add_argument("--heights", type=int, choices=(1, 3), default=1)
    parser.add_argument("--show", action="store_true")
    parser.add_argument("--most", type=int, default=1000, help="liquids that this call computes")
    options = parser.parse_args()
    rows = [json.loads(line) for line in options.out.read_text().splitlines()] if options.out.exists() else []
    if not options.show:
        done = {(row["number"], row["heights"]) for row in rows}
        left = [one for one in enumerate(liquids(options.liquids)) if (one[0], options.heights) not in done]
        for number, medium in left[: options.most]:
            rows.append(compared(medium, number, options.heights))
            with options.out.open("a") as file:
                file.write(json.dumps(rows[-1]) + "\n")
    show(rows)


if __name__ == "__main__":
    main()
