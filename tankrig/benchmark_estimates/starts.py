"""Searches from anywhere in the allowed range: whether they end at one optimum."""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from tankrig.benchmark_estimates.records import Records
from tankrig.benchmark_estimates.scenes import LIQUIDS, NOISE, STRIPES, other_paths
from tankrig.benchmark_estimates.section import Cell, Section
from tankrig.estimation.coordinates import Range, to_coordinates, to_medium
from tankrig.estimation.forward import models_of
from tankrig.estimation.observation import observe
from tankrig.estimation.optimiser import polish
from tankrig.estimation.parameters import MediumBlock
from tankrig.estimation.problem import Problem
from tankrig.estimation.scaling import Scaling
from tankrig.estimation.search import first_guess, search
from tankrig.estimation.shots import Shot
from tankrig.image.prepare import Prepared
from tankrig.scene import Medium

SAME_SD = 0.5
"""Stated standard deviations within which two ends are one optimum."""
SAME = 0.99
"""Share of the searches that shall end at the best optimum found."""


def starts_section(records: Records, prepared: Prepared, liquids: tuple[str, ...], starts: int) -> Section:
    """One random start for each search, where `estimate` goes on from the best of nine media."""
    found = [
        records.numbers(f"starts/{name}-{gain}-{starts}", partial(_started, records, prepared, name, gain, starts))
        for name in liquids
        for gain in ("known", "free")
    ]
    rows = tuple(
        (
            Cell(one["liquid"]), Cell(one["gain"]), Cell(f"{100 * one['alone']:.1f} %"),
            Cell(f"{100 * one['same']:.1f} %", one["same"] >= SAME), Cell(str(one["failed"]), one["failed"] == 0),
            Cell(f"{one['evaluations']:.0f}"),
        )
        for one in found
    )  # fmt: skip
    about = (
        f"{starts} searches from media drawn evenly over the prepared model's whole range of log σs, logit ϖ "
        "and atanh g. The same optimum: every coefficient within half a stated standard deviation of the best "
        "end's. Alone: from that one start. As in estimate: what ended at an edge of the range, or leaves twice "
        "what noise does, goes on from the media that `estimate` looks at first."
    )
    return Section(
        "Random starts",
        about,
        ("liquid", "gain", "alone", "as in estimate", "NaN or failed", "images per search"),
        rows,
        f"At least {100 * min(one['same'] for one in found):.1f} % reach the best optimum.",
        found,
    )


def _started(records: Records, prepared: Prepared, name: str, gain: str, starts: int) -> dict[str, Any]:
    image = other_paths(records, f"{name}-straight", replace(STRIPES, medium=LIQUIDS[name]))
    noise = NOISE * float(image.max())
    observation = observe(image + np.random.default_rng(1).normal(0.0, noise, image.shape), image.shape, noise)
    models = models_of(STRIPES, prepared, None)
    reach = models.range or Range.of_tank(max(STRIPES.tank.size_mm))
    scaling = Scaling(1.0, 0.0) if gain == "known" else Scaling(None, None)
    assert models.slopes is not None
    asked = 0

    def forward(medium: Any) -> Any:
        nonlocal asked
        asked += 1
        return models.coarse(medium).image

    error = prepared.error_at(LIQUIDS[name]) * image
    shot = Shot(observation, STRIPES, models)
    problem = Problem((shot.view(forward, models.slopes, error),), (MediumBlock(reach),), scaling)
    random = np.random.default_rng(2)
    looks = [look.coordinates for part in first_guess(problem, shot.length_mm) for look in part]
    costs, found = [], []
    for _ in range(starts):
        start = random.uniform(reach.low, reach.high)
        ends = [search(problem, [start, *others], _silently)[0] for others in ((), looks)]
        polished = [polish(problem, end) for end in ends]
        costs.append([end.cost for end in polished])
        found.append([to_medium(end.coordinates).coefficients for end in polished])
    failed = int((~np.isfinite(costs)).sum())
    values = np.array(found)
    best = np.unravel_index(np.argmin(costs), (starts, 2))
    at = to_coordinates(Medium(*values[best]))
    spread = problem.at(at).sensitivity.covariance([observation.noise], [problem.views[0].error])
    alone, same = (np.abs(values - values[best]) < SAME_SD * np.sqrt(np.diag(spread))).all(axis=2).mean(axis=0)
    return {
        "liquid": name, "gain": gain, "alone": float(alone), "same": float(same), "failed": failed,
        "evaluations": asked / (2 * starts),
    }  # fmt: skip


def _silently(_: str) -> None:
    pass
