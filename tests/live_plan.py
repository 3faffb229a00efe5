"""A run of two doses as a live fit hears of it: its plan, its events, and frames of ink that is known."""

from functools import cache

import numpy as np

from tankrig.bench import Bench
from tankrig.light.tank import tank_image
from tankrig.live.exposures import Exposures
from tankrig.live.photograph_plan import PhotographPlan
from tankrig.pattern import Pattern
from tankrig.pattern.kinds import Sheet
from tankrig.pattern.wall import Wall
from tankrig.run.journal import Event, Moment
from tankrig.scene.description import Camera, Medium, Tank
from tankrig.sequence import Capture, Sequence, Series

BENCH = Bench(
    Tank(), Wall((30, 40), (-80.0, 80.0), (0.0, 120.0)), "collimated", Camera("orthographic", (40, 60), pixel_mm=4.0)
)
SEQUENCE = Sequence(
    "two doses",
    (Series((100.0, 200.0), (Capture("dark", 2), Capture("sheet", 3))),),
    {"sheet": Sheet((-40.0, 40.0), (56.0, 64.0))},
    exposure_ms=10.0,
)
PATTERNS = SEQUENCE.drawn(BENCH.wall)
INK = Medium(0.004, 0.08, 0.6)


def plan() -> PhotographPlan:
    return PhotographPlan.of(BENCH, SEQUENCE, list(PATTERNS.values()))


def event(kind: str, **fields: object) -> Event:
    return Event(0, kind, Moment.now(), fields)


def dosed(volume_ul: float) -> Event:
    return event(
        "dose_done", delivered_ul=volume_ul, delivered_low_ul=volume_ul - 1, delivered_high_ul=volume_ul + 1
    )  # fmt: skip


def frame(pattern: Pattern, step: int) -> Event:
    return event("frame", pattern_hash=pattern.hash, step=step)


@cache
def counts_of(dose_ml: float) -> np.ndarray:
    """What a pixel counts in the mean."""
    scene = BENCH.scene(PATTERNS["sheet"], Medium(INK.sigma_a * dose_ml, INK.sigma_s * dose_ml, INK.g))
    radiance = sum(tank_image(scene, seed=5, batches=4).orders.values())
    return 100.0 + 20_000.0 * radiance / radiance.max()


def photographed(dose_ml: float, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).poisson(counts_of(dose_ml)).astype(np.uint16)


def seen_at(volume_ul: float) -> Exposures:
    exposures = Exposures(plan())
    exposures.take(dosed(volume_ul), None)
    exposures.take(frame(PATTERNS["sheet"], 2), np.full((40, 60), 500, np.uint16))
    return exposures
