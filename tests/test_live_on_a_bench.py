"""When the doses of a calibrated bench are fitted: `pytest -m long -s tests/test_live_on_a_bench.py` prints it."""

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import psutil
import pytest

from drivers.simulated.bench_ink import true_scene
from drivers.simulated.bench_truth import TrueBench, random_bench
from tankrig.bench import Bench
from tankrig.geometry.pose import rotation_vector
from tankrig.image.predict import predict
from tankrig.live.live_fit import LiveFit
from tankrig.live.photograph_plan import PhotographPlan
from tankrig.live.results import DoseFit, Fit, SeriesFit, diluted
from tankrig.pattern import Pattern
from tankrig.pattern.kinds import Rays, Stripes
from tankrig.pattern.wall import Wall
from tankrig.run.journal import Event, Moment
from tankrig.scene import Medium, Projector
from tankrig.sequence import Capture, Sequence, Series

pytestmark = [pytest.mark.long, pytest.mark.timeout(3600)]

LIGHT_MM = (58.0, 62.0)
PATTERNS = {"rays": Rays((-30.0, 0.0, 30.0), LIGHT_MM), "stripes": Stripes(16.0, 0.5, (-50.0, 50.0), LIGHT_MM)}
INK = Medium(2e-4, 0.02, 0.7)
DOSES_UL = (100.0, 250.0, 1000.0)
SETTING_UP_S, MIXING_S = 60.0, 60.0
FRAMES = 3


def event(kind: str, **fields: object) -> Event:
    return Event(0, kind, Moment.now(), fields)


def test_doses_are_fitted_while_a_person_doses_and_all_are_soon_after_the_last_frame(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A person waits for numbers before the next dose, and for all of them before going home."""
    monkeypatch.setenv("TANKRIG_CACHE", str(tmp_path))
    truth = random_bench(7, (540, 960), (384, 512))
    scene = true_scene(truth, Pattern("blank", np.full((384, 512), 255, np.uint8)), INK)
    projector = projector_of(truth)
    wall = Wall((384, 512), (-97.5, 97.5), (-16.0, 130.0), gamma=2.2)
    bench = Bench(scene.tank, wall, "calibrated", scene.camera, projector=projector)
    captures = (Capture("dark", 2), *(Capture(name, FRAMES) for name in PATTERNS))
    sequence = Sequence("figures", (Series(DOSES_UL, captures),), PATTERNS, exposure_ms=10.0)
    drawn = sequence.drawn(bench.wall)
    plan = PhotographPlan.of(bench, sequence, list(drawn.values()))
    rng = np.random.default_rng(0)
    pictures = {
        (dose_ul, name): picture(plan, pattern, diluted(INK, 1.0, dose_ul / 1000.0))
        for dose_ul in DOSES_UL for name, pattern in drawn.items()
    }  # fmt: skip
    counts_per_radiance = 10_000.0 / max(one.max() for one in pictures.values())
    found: list[tuple[float, float, Fit]] = []
    over_s: dict[float, tuple[float, float]] = {}
    index, step = 0, 0
    process: list[psutil.Process] = []

    def cpu_s() -> float:
        took = process[0].cpu_times()
        return float(took.user + took.system)

    with LiveFit(plan, lambda fit: found.append((time.monotonic(), cpu_s(), fit))) as live:
        process.append(psutil.Process(live.pid))
        time.sleep(SETTING_UP_S)
        for dose_ul in DOSES_UL:
            step += 1
            time.sleep(MIXING_S)
            live.see(
                event("dose_done", delivered_ul=dose_ul, delivered_low_ul=dose_ul, delivered_high_ul=dose_ul), None
            )
            for name, pattern in drawn.items():
                for _ in range(2 if name == "dark" else FRAMES):
                    pixels = rng.poisson(100.0 + counts_per_radiance * pictures[dose_ul, name]).astype(np.uint16)
                    live.see(event("frame", pattern_hash=pattern.hash, step=step, index=index), pixels)
                    index += 1
                step += 1
            over_s[dose_ul / 1000.0] = time.monotonic(), cpu_s()
        live.see(event("step", state="done", step=len(plan.settings) - 1), None)
        while not live.finished:
            time.sleep(0.1)
            assert time.monotonic() < over_s[DOSES_UL[-1] / 1000.0][0] + 1800.0
    last_s, last_cpu_s = over_s[DOSES_UL[-1] / 1000.0]
    for dose_ml, (at_s, at_cpu_s) in over_s.items():
        fits = [(at, cpu, fit) for at, cpu, fit in found if isinstance(fit, DoseFit) and fit.dose_ml == dose_ml]
        assert fits, f"{dose_ml} ml was not fitted"
        fit, true = fits[-1][2], diluted(INK, 1.0, dose_ml)
        off = f"σs {fit.medium.sigma_s / true.sigma_s - 1.0:+.2%}, g {fit.medium.g - true.g:+.4f}"
        first, whole = fits[0], fits[-1]
        print(f"\n{dose_ml:g} ml: fitted {first[0] - at_s:.1f} s after its last frame, whole {whole[0] - at_s:.1f} s "
              f"({first[1] - at_cpu_s:.1f} and {whole[1] - at_cpu_s:.1f} s of its CPU); models off by "
              f"{fit.model_error or 0.0:.2%}; {off}")  # fmt: skip
        assert fit.model == "prepared"
        assert fit.medium.sigma_s == pytest.approx(true.sigma_s, rel=0.03)
    print(f"all fits {found[-1][0] - last_s:.1f} s after the last frame ({found[-1][1] - last_cpu_s:.1f} s of CPU)")
    assert isinstance(found[-1][2], SeriesFit)


def projector_of(truth: TrueBench) -> Projector:
    """As a calibration without any error would find it; its light is even, as nobody asks how bright pictures are."""
    optics = truth.projector
    (a, b, c), (d, e, f), (g, h, i) = optics.matrix.tolist()
    x, y, z = optics.centre_mm.tolist()
    return Projector(
        "calibrated", (), (x, y, z), ((a, b, c), (d, e, f), (g, h, i)), tuple(optics.distortion.tolist()),
        rotation_vector(optics.rotation), (384, 512), gamma=truth.gamma,
    )  # fmt: skip


def picture(plan: PhotographPlan, pattern: Pattern, liquid: Medium) -> np.ndarray:
    """(rows, columns) radiance of the camera's pixels, even within the bins that are fitted."""
    if not pattern.pixels.any():
        return np.zeros(plan.bench.camera.shape)
    scene = replace(plan.scenes[pattern.hash], medium=liquid)
    even = np.kron(predict(scene, tolerance=0.003).image, np.ones((plan.bins.by, plan.bins.along)))
    rows, columns = plan.bench.camera.shape
    return np.pad(even, ((0, rows - even.shape[0]), (0, columns - even.shape[1])), mode="edge")
