"""Frames that designed pictures save, on random liquids: `python tests/designed_pictures.py OUT.jsonl --liquids 60`.

For each liquid, what a fit is expected to know (σa, σs and g together, gain unknown) after `FRAMES` frames of the best
of a beam, three beams, stripes and a sheet, or the best pair of them; and with how many frames designed pictures are
expected to tell as much. The design knows the liquid as a few frames of the sheet leave it known, and not better: it is
made for a liquid that is off by a draw from that posterior, and judged by the true one. Each liquid is a line of OUT,
and what is there is not computed again; `--show` prints medians.

`--heights 3` has cells in three sheets. `--phase` has liquids of Reynolds and McCormick's phase functions, whose two
parameters are fitted. `--doses` has half of the frames at each of two doses, three times apart, the fixed pictures the
best of all pairs of plans, and says what two doses are worth beside one.
"""

import argparse
import json
import math
import time
from collections.abc import Callable
from itertools import combinations, product
from pathlib import Path

import numpy as np

from tankrig.advice.cells import CellLight, cell_light, even_cells
from tankrig.advice.design import Prospect, designed
from tankrig.bench import Bench
from tankrig.estimation.phase_families import Family, reynolds_mccormick
from tankrig.pattern.wall import Wall
from tankrig.scene import Camera, Medium, Tank
from tankrig.scene.phase_functions import ReynoldsMcCormick

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
DENSER = 3.0
"""The second dose over the first."""
ALPHA = (0.2, 1.5)
"""Of liquids with another phase function; Henyey–Greenstein's is 0.5."""
MOST, HALVINGS = 16.0, 5
"""Ratio of frames that is looked for at most, and steps."""
WORST = np.array([0.5, 0.2, 0.1])
"""By which such a guess is off at most: σa and σs of themselves, g."""


def liquids(count: int, family: Family | None) -> list[Medium]:
    """Random ones, thin to thick."""
    chance, alphas = np.random.default_rng(23), np.random.default_rng(24)
    found = []
    for _ in range(count):
        sigma_s = float(np.exp(chance.uniform(np.log(0.002), np.log(0.06))))
        absorbed = float(np.exp(chance.uniform(np.log(0.002), np.log(0.1))))
        g = float(chance.uniform(0.0, 0.9))
        phase = ReynoldsMcCormick(max(g, 0.1), float(alphas.uniform(*ALPHA))) if family else None
        found.append(
            Medium(sigma_s * absorbed, sigma_s, phase=phase) if phase else Medium(sigma_s * absorbed, sigma_s, g)
        )
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
    sigma_a, sigma_s = (scale[:2] * (1.0 + draw[:2])).tolist()
    if medium.phase is not None:
        return Medium(sigma_a, sigma_s, phase=medium.phase)  # its place in the family is given to the design
    return Medium(sigma_a, sigma_s, float(np.clip(medium.g + draw[2], -0.5, 0.95)))


def denser(medium: Medium) -> Medium:
    """At the second dose."""
    sigma_a, sigma_s = DENSER * medium.sigma_a, DENSER * medium.sigma_s
    return Medium(sigma_a, sigma_s, phase=medium.phase) if medium.phase else Medium(sigma_a, sigma_s, medium.g)


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


def frames_saved(needed: Callable[[float], float], target: float) -> tuple[float, float]:
    """Nats per coefficient gained with equal frames, and the ratio of frames for equal knowledge.

    Parameters
    ----------
    needed
        Nats, of so many frames of designed pictures.
    target
        Nats of the fixed ones.
    """

    def gained(ratio: float) -> float:
        return (target - needed(FRAMES / ratio)) / 3.0

    first = gained(1.0)
    low, high = (1.0, MOST) if first > 0.0 else (1.0 / MOST, 1.0)
    for _ in range(HALVINGS):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if gained(middle) > 0.0 else (low, middle)
    return first, math.sqrt(low * high)


def compared(medium: Medium, number: int, heights: int, family: Family | None) -> dict:
    """One line."""
    cells = even_cells(Y_MM, THREE if heights > 1 else ONE, ACROSS)
    light = cell_light(cells, BENCH, BENCH.camera, medium, family=family)
    plans, peak = plans_of(heights), float(light.images.sum(axis=0).max())
    row = begun(number, heights, medium)
    first = prospect(light, max(ERRORS), peak)
    guess = off_by_a_guess(first, medium, plans["sheet"][0], np.random.default_rng([number, heights]))
    guessed = cell_light(cells, BENCH, BENCH.camera, guess, family=family)
    for error in ERRORS:
        truth, believed = prospect(light, error, peak), prospect(guessed, error, peak)
        values = {name: worth(truth, plan, FRAMES) for name, plan in plans.items()}
        best = min(values, key=lambda name: values[name])
        designs = Designs(believed, plans)

        def needed(frames: float, truth: Prospect = truth, designs: Designs = designs) -> float:
            return worth(truth, designs.best(frames), frames)

        gained, ratio = frames_saved(needed, values[best])
        row["errors"][f"{error:g}"] = {
            "best": best, "gained": gained, "ratio": ratio,
            "seconds": float(np.median(designs.seconds)), "sheet": values["sheet"] - values[best],
        }  # fmt: skip
    return row


def begun(number: int, heights: int, medium: Medium) -> dict:
    """The beginning of a line."""
    return {"number": number, "heights": heights, "medium": medium.coefficients, "errors": {}}


def compared_doses(medium: Medium, number: int) -> dict:
    """One line, of two doses."""
    cells, plans = even_cells(Y_MM, ONE, ACROSS), plans_of(1)
    row, media = begun(number, 1, medium), (medium, denser(medium))
    lights = [cell_light(cells, BENCH, BENCH.camera, one) for one in media]
    peak = max(float(light.images.sum(axis=0).max()) for light in lights)
    chance = np.random.default_rng([number, 1])
    guess = off_by_a_guess(prospect(lights[0], max(ERRORS), peak), medium, plans["sheet"][0], chance)
    guessed = [cell_light(cells, BENCH, BENCH.camera, one) for one in (guess, denser(guess))]
    for error in ERRORS:

        def both(seen: list[CellLight], thin: np.ndarray, dense: np.ndarray, frames: float, error: float) -> float:
            first = prospect(seen[0], error, peak).with_pictures(thin, 0.5 * frames / len(thin))
            return worth(first.at_dose(seen[1], 1.0 / DENSER), dense, 0.5 * frames)

        values = {
            f"{one}, {other}": both(lights, plans[one], plans[other], FRAMES, error)
            for one, other in product(plans, plans)
        }  # fmt: skip
        best = min(values, key=lambda name: values[name])
        single = min(worth(prospect(light, error, peak), plan, FRAMES) for light in lights for plan in plans.values())
        first, seconds = Designs(prospect(guessed[0], error, peak), plans), []

        def needed(frames: float, error: float = error, first: Designs = first, seconds: list = seconds) -> float:
            thin = first.best(0.5 * frames)
            known = first.believed.with_pictures(thin, 0.5 * frames / len(thin)).at_dose(guessed[1], 1.0 / DENSER)
            second = Designs(known, plans)
            dense = second.best(0.5 * frames)
            seconds.extend(second.seconds)
            return both(lights, thin, dense, frames, error)

        gained, ratio = frames_saved(needed, values[best])
        row["errors"][f"{error:g}"] = {
            "best": best, "gained": gained, "ratio": ratio, "seconds": float(np.median(seconds)),
            "one dose": (single - values[best]) / 3.0,
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
            if "one dose" in found[0]:
                worse = np.exp(np.median([one["one dose"] for one in found]))
                print(f"  errors of the best fixed pictures at one dose over those at two, median: {worse:.2f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--liquids", type=int, default=60)
    parser.add_argument("--heights", type=int, choices=(1, 3), default=1)
    kinds = parser.add_mutually_exclusive_group()
    kinds.add_argument("--phase", action="store_true")
    kinds.add_argument("--doses", action="store_true")
    parser.add_argument("--show", action="store_true")
    parser.add_argument("--most", type=int, default=1000, help="liquids that this call computes")
    options = parser.parse_args()
    rows = [json.loads(line) for line in options.out.read_text().splitlines()] if options.out.exists() else []
    if not options.show:
        done = {(row["number"], row["heights"]) for row in rows}
        family = reynolds_mccormick() if options.phase else None
        left = [one for one in enumerate(liquids(options.liquids, family)) if (one[0], options.heights) not in done]
        for number, medium in left[: options.most]:
            if options.doses:
                rows.append(compared_doses(medium, number))
            else:
                rows.append(compared(medium, number, options.heights, family))
            with options.out.open("a") as file:
                file.write(json.dumps(rows[-1]) + "\n")
    show(rows)


if __name__ == "__main__":
    main()
