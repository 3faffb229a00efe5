"""Searches from anywhere in the allowed range: whether they end at one optimum."""

from typing import Any

import numpy as np

from tankrig.benchmark_estimates.records import Records
from tankrig.benchmark_estimates.scenes import LIQUIDS, NOISE, STRIPES, other_paths
from tankrig.benchmark_estimates.section import Cell, Section
from tankrig.estimation.fitting import Problem, polish, search
from tankrig.estimation.models import models_of
from tankrig.estimation.observation import observe
from tankrig.estimation.parameters import Range, to_coordinates, to_medium
from tankrig.estimation.projection import Scaling
from tankrig.image.prepare import Prepared

SAME = 0.99
"""Share of the searches that shall end at the best optimum found."""


def starts_section(records: Records, prepared: Prepared, liquids: tuple[str, ...], starts: int) -> Section:
    """One start for each search, where `estimate` uses the best of nine."""
    found = [
        records.numbers(
            f"starts/{name}-{gain}-{starts}",
            lambda name=name, gain=gain: _started(records, prepared, name, gain, starts),
        )  # type: ignore[misc]
        for name in liquids
        for gain in ("known", "free")
    ]
    rows = tuple(
        (Cell(one["liquid"]), Cell(one["gain"]), Cell(f"{100 * one['same']:.1f} %", one["same"] >= SAME),
         Cell(str(one["failed"]), one["failed"] == 0), Cell(f"{one['evaluations']:.0f}"))
        for one in found
    )  # fmt: skip
    return Section(
        "Random starts",
        f"{starts} searches from media drawn evenly over the prepared model's whole range of log σs, logit ϖ and atanh g, one start "
        "each (`estimate` itself looks at nine media first and goes on from the best for each of three g). The same optimum: "
        "within a tenth of the stated standard deviation in cost, χ²/2 within 1 of the best.",
        ("liquid", "gain", "same optimum", "NaN or failed", "images per search"),
        rows,
        f"At least {100 * min(one['same'] for one in found):.1f} % reach the best optimum.",
        found,
    )


def _started(records: Records, prepared: Prepared, name: str, gain: str, starts: int) -> dict[str, Any]:
    from dataclasses import replace

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
    problem = Problem(forward, models.slopes, observation, scaling, error, reach)
    random = np.random.default_rng(2)
    ends, failed = [], 0
    for _ in range(starts):
        start = to_medium(random.uniform(reach.low, reach.high))
        end = polish(problem, to_coordinates(search(problem, [start], lambda _: None)[0]))
        failed += not np.isfinite([end.cost, *end.coordinates]).all()
        ends.append(end.cost)
    same = float(np.mean(np.array(ends) < min(ends) + 1.0))
    return {"liquid": name, "gain": gain, "same": same, "failed": failed, "evaluations": asked / starts}
