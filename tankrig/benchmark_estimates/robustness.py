"""What spoils photographs: how much each adds to the error of σs, or whether the verdict says so."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tankrig.benchmark_estimates.records import Records
from tankrig.benchmark_estimates.scenes import LIQUIDS, NOISE, STRIPES, other_paths
from tankrig.benchmark_estimates.section import Cell, Section
from tankrig.estimation.estimate import estimate
from tankrig.estimation.set_up import moved
from tankrig.image.prepare import Prepared

Array = NDArray[np.float64]

ADDED = 0.01
"""Relative error of σs that each may add."""
FLAGS = ("holds structure", "not as described", "left out", "neither", ", not")
"""Words of a verdict that warns."""
OFF = {"z_mm": 0.5, "y_mm": 0.5}


def robustness_section(records: Records, prepared: Prepared, liquids: tuple[str, ...], draws: int) -> Section:
    """Outliers, saturation, ambient light, a misaligned beam."""
    found = []
    for name in liquids:
        found += records.numbers(f"robustness/{name}-{draws}", partial(_spoilt, records, prepared, name, draws))
    about = (
        "Stripes, images along light paths that the fit doesn't follow, 0.2 % noise, gain and offset free, "
        f"prepared model, {draws} draws each. The error of σs is its root mean square. Bound: 1 % more than "
        "without the fault, or a verdict that says so every time."
    )
    worst = max(found, key=lambda one: one["added"])
    return Section(
        "Robustness",
        about,
        ("liquid", "fault", "σs off, clean", "σs off, with it", "added", "g off", "flagged", "verdict of the first"),
        tuple(_row(one) for one in found),
        f"At most {100 * worst['added']:+.2f} % ({worst['liquid']}, {worst['what']}).",
        found,
    )


def _row(one: dict[str, Any]) -> tuple[Cell, ...]:
    return (
        Cell(one["liquid"]), Cell(one["what"]),
        Cell(f"{100 * one['clean']:.3f} %"), Cell(f"{100 * one['spoilt']:.3f} %"),
        Cell(f"{100 * one['added']:+.3f} %", one["added"] <= ADDED or one["flagged"] == 1.0),
        Cell(f"{one['g']:.4f}"), Cell(f"{100 * one['flagged']:.0f} %"), Cell(one["verdict"]),
    )  # fmt: skip


def _spoilt(records: Records, prepared: Prepared, name: str, draws: int) -> list[dict[str, Any]]:
    scene = replace(STRIPES, medium=LIQUIDS[name])
    images = {"": other_paths(records, f"{name}-straight", scene)}
    for term, off in OFF.items():
        images[term] = other_paths(records, f"{name}-{term}", moved(scene, {term: off}))
    faults: dict[str, tuple[str, Callable[[Array, np.random.Generator], Array], dict[str, Any]]] = {
        "none": ("", _nothing, {}),
        "2 % outlier pixels": ("", _outliers, {}),
        "3 % saturated pixels": ("", _saturated, {}),
        "ambient light, 5 % of the peak": ("", _ambient, {}),
        "light 0.5 mm too high, nuisance on": ("z_mm", _nothing, {"nuisance": OFF}),
        "light 0.5 mm aside, nuisance on": ("y_mm", _nothing, {"nuisance": OFF}),
        "light 0.5 mm aside, nuisance off": ("y_mm", _nothing, {}),
        "aligned, nuisance on": ("", _nothing, {"nuisance": OFF}),
    }
    found: list[dict[str, Any]] = []
    for what, (term, spoil, asked) in faults.items():
        image = images[term]
        noise = NOISE * float(image.max())
        off_s, off_g, flagged, verdicts = [], [], [], []
        for seed in range(draws):
            random = np.random.default_rng(seed)
            noisy = spoil(image + random.normal(0.0, noise, image.shape), random)
            fit = estimate(noisy, STRIPES, noise=noise, model=prepared, **asked)
            off_s.append(fit.medium.sigma_s / scene.medium.sigma_s - 1.0)
            off_g.append(fit.medium.g - scene.medium.g)
            flagged.append(any(word in fit.verdict for word in FLAGS))
            verdicts.append(fit.verdict)
        spoilt = float(np.sqrt(np.mean(np.square(off_s))))
        clean = found[0]["spoilt"] if found else spoilt
        found.append({
            "liquid": name, "what": what, "clean": clean, "spoilt": spoilt, "added": spoilt - clean,
            "g": float(np.sqrt(np.mean(np.square(off_g)))), "flagged": float(np.mean(flagged)), "verdict": verdicts[0],
        })  # fmt: skip
    return found


def _nothing(image: Array, _: np.random.Generator) -> Array:
    return image


def _outliers(image: Array, random: np.random.Generator) -> Array:
    """Bubbles and dust: pixels of any brightness."""
    spoilt = image.copy()
    where = random.choice(image.size, round(0.02 * image.size), replace=False)
    spoilt.flat[where] = random.uniform(0.0, 1.5 * image.max(), where.size)
    return spoilt


def _saturated(image: Array, _: np.random.Generator) -> Array:
    return np.minimum(image, np.quantile(image, 0.97))


def _ambient(image: Array, _: np.random.Generator) -> Array:
    spoilt: Array = image + 0.05 * image.max()
    return spoilt
