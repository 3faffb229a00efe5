"""The live fit: newest first, never in the run's way, and gone when the program that started it is."""

import os
import queue
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import psutil
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from tankrig.bench import Bench
from tankrig.devices import CameraSettings, Delivered, Frame
from tankrig.errors import ImageError
from tankrig.estimation import series_forward
from tankrig.image.prepare import Prepared
from tankrig.light.prepared.about import box_for
from tankrig.light.prepared.box import Box
from tankrig.light.tank import tank_image
from tankrig.live import fits, worker
from tankrig.live import preparing as preparing_module
from tankrig.live.exposures import Exposures, Photograph
from tankrig.live.fits import fit_dose_prepared
from tankrig.live.live_fit import LiveFit
from tankrig.live.photograph_plan import PhotographPlan
from tankrig.live.preparing import LOOK, Preparation, Preparing
from tankrig.live.results import FIRST_LOOK, DoseFit, FailedFit, Fit, SeriesFit, SingleScattering, diluted, to_fields
from tankrig.pattern import Pattern
from tankrig.pattern.kinds import Sheet
from tankrig.pattern.wall import Wall
from tankrig.run.conditions import Conditions
from tankrig.run.folder import create_run
from tankrig.run.journal import Event, Moment
from tankrig.run.reading import open_run
from tankrig.run.writer import RunWriter
from tankrig.scene.description import Beam, Camera, Medium, Projector, Scene, Tank
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


def test_photographs_are_the_mean_less_the_dark_with_the_noise_that_frames_differ_by() -> None:
    """A wrong noise would make every error bar wrong, and a dark that stays in looks like scattered light."""
    exposures = Exposures(plan())
    rng = np.random.default_rng(0)
    exposures.take(dosed(100.0), None)
    for _ in range(2):
        exposures.take(frame(PATTERNS["dark"], 1), rng.normal(100.0, 3.0, (40, 60)).round().astype(np.uint16))
    light = np.linspace(50.0, 5000.0, 2400).reshape(40, 60)
    for _ in range(8):
        assert exposures.take(frame(PATTERNS["sheet"], 2), rng.poisson(100.0 + light).astype(np.uint16))
    (one,) = exposures.photographs()
    assert (one.pattern, one.dose_ml, one.frames, one.offset) == ("sheet", 0.1, 8, 0.0)
    assert one.dose_sd_ml == pytest.approx(0.002 / np.sqrt(12.0))
    off = (one.image - light / 10.0) / one.noise
    assert off.std() == pytest.approx(1.0, abs=0.15)
    exposures.take(dosed(200.0), None)
    assert exposures.photographs(1) == []
    assert exposures.dose_ml == 0.2


def test_the_newest_dose_is_fitted_first_and_the_series_only_over_doses_that_are_over(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A fit that falls behind must catch up with what a person is looking at, not work off old frames."""
    asked: list[tuple[str, object]] = []

    def fit_dose(photographs: list[Photograph], *_: object) -> DoseFit:
        asked.append(("dose", photographs[0].dose_ml))
        return DoseFit(photographs[0].dose_ml, INK)

    def fit_all(photographs: list[Photograph], *_: object) -> SeriesFit:
        asked.append(("series", tuple(one.dose_ml for one in photographs)))
        return SeriesFit((), INK, INK)

    monkeypatch.setattr(worker, "fit_dose", fit_dose)
    monkeypatch.setattr(worker, "fit_all", fit_all)
    exposures, fitter = Exposures(plan()), worker.Fitter()
    pixels = np.full((40, 60), 500, np.uint16)
    for volume_ul in (100.0, 200.0):
        exposures.take(dosed(volume_ul), None)
        exposures.take(frame(PATTERNS["sheet"], 2), pixels)
    while fitter.next(exposures, last=False):
        pass
    assert asked == [("dose", 0.2), ("dose", 0.1)]
    while fitter.next(exposures, last=True):
        pass
    assert asked[2:] == [("series", (0.1, 0.2))]


def test_a_fit_that_fails_says_which_frames_it_has_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """A step that waits for the fit of its last frame would else wait for its whole time limit."""

    def refused(*_: object) -> DoseFit:
        raise ImageError("too dark")

    monkeypatch.setattr(worker, "fit_dose", refused)
    exposures = Exposures(plan())
    exposures.take(dosed(100.0), None)
    seen = frame(PATTERNS["sheet"], 2)
    exposures.take(event("frame", **seen.fields, index=7), np.full((40, 60), 500, np.uint16))
    fit = worker.Fitter().next(exposures, last=True)
    assert fit == FailedFit(0.1, "too dark", 7)
    assert to_fields(fit)["newest"] == 7


def test_a_run_that_goes_on_is_not_fitted_again_where_it_was_fitted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Resuming a long run would else begin with minutes of fits that stand in its journal already."""
    starts: list[tuple[float, Medium | None]] = []

    def fit_dose(photographs: list[Photograph], start: Medium | None, *_: object) -> DoseFit:
        starts.append((photographs[0].dose_ml, start))
        return DoseFit(photographs[0].dose_ml, INK)

    monkeypatch.setattr(worker, "fit_dose", fit_dose)
    found = DoseFit(0.1, Medium(0.001, 0.02, 0.5), frames=1)
    exposures, fitter = Exposures(plan()), worker.Fitter([found, FailedFit(0.1, "too dark")])
    for volume_ul in (100.0, 200.0):
        exposures.take(dosed(volume_ul), None)
        exposures.take(frame(PATTERNS["sheet"], 2), np.full((40, 60), 500, np.uint16))
    while fitter.next(exposures, last=False):
        pass
    assert starts == [(0.2, Medium(0.002, 0.04, 0.5))]


def shared_by(process: psutil.Process) -> list[Path]:
    """Shared memory that a process has in use."""
    return [Path(one.path) for one in process.memory_maps() if one.path.startswith("/dev/shm/psm_")]


def test_frames_become_coefficients_in_another_process_that_ends_and_leaves_nothing() -> None:
    """The whole way: shared memory, spawned process, results, an orderly end."""
    results: list[Fit] = []
    with LiveFit(plan(), results.append) as fit:
        assert fit.pid is not None
        process = psutil.Process(fit.pid)
        assert until(lambda: bool(shared_by(process)))
        shared = shared_by(process)
        fit.see(dosed(100.0), None)
        for _ in range(2):
            fit.see(frame(PATTERNS["dark"], 1), np.full((40, 60), 100, np.uint16))
        for seed in range(3):
            fit.see(frame(PATTERNS["sheet"], 2), photographed(0.1, seed))
        fit.see(event("step", state="done", step=len(SEQUENCE.tasks) - 1), None)
        deadline = time.monotonic() + 200.0
        while not fit.finished and time.monotonic() < deadline:
            time.sleep(0.05)
        assert fit.finished
        assert process.is_running() is False or process.status() == psutil.STATUS_ZOMBIE or process.wait(30) == 0
    last = results[-1]
    assert isinstance(last, DoseFit)
    assert last.frames == 3
    assert last.medium.sigma_s == pytest.approx(0.1 * INK.sigma_s, rel=0.1)
    assert last.medium.g == pytest.approx(INK.g, abs=0.1)
    assert last.single is not None
    assert not [path for path in shared if path.exists()]


def test_a_last_frame_that_comes_while_the_fit_looks_is_looked_at_again() -> None:
    """Else the run would wait for fits, some minutes, that nobody makes any more."""
    news = threading.Event()

    class LastFrame(threading.Event):
        def is_set(self) -> bool:
            before = super().is_set()
            self.set()  # by the run, right after the fit has read it
            news.set()
            return before

    memory = SharedMemory(create=True, size=plan().size * 8)
    try:
        shared: Any = SimpleNamespace(news=news, last=LastFrame(), lock=threading.Lock(), plan=plan())
        news.set()
        exposures, last = worker.newest(shared, memory)
        assert exposures is not None
        assert last or news.is_set()
    finally:
        memory.close()
        memory.unlink()


def test_a_fit_that_is_busy_neither_holds_the_run_up_nor_loses_what_happened_meanwhile() -> None:
    """The dispatcher calls `see`: a stuck fit must not stop the run, and no frame may count at another dose."""
    with looked_into() as (fit, given):
        fit.see(dosed(100.0), None)
        fit.see(frame(PATTERNS["sheet"], 2), photographed(0.1, 0))
        assert until(lambda: given.exposures.frames == 1)
        later = photographed(0.2, 0)
        with given.shared.lock:  # as a worker that was stopped in the middle of a copy would hold it
            began = time.monotonic()
            fit.see(dosed(200.0), None)
            fit.see(frame(PATTERNS["sheet"], 5), later)
            assert time.monotonic() - began < 0.05
            time.sleep(1.0)
            assert given.exposures.frames == 1
        assert until(lambda: given.exposures.frames == 2)
        assert [(one.dose_ml, one.frames) for one in given.exposures.photographs()] == [(0.1, 1), (0.2, 1)]


def until(true: Callable[[], bool], timeout_s: float = 20.0) -> bool:
    deadline = time.monotonic() + timeout_s
    while not true() and time.monotonic() < deadline:
        time.sleep(0.01)
    return true()


class Looking:
    """In place of the process that fits: it fits nothing, and a test looks at what it is given."""

    pid, exitcode = None, 0

    def __init__(self, args: tuple[worker.Shared], **_: object) -> None:
        (self.shared,) = args
        self.memory = SharedMemory(self.shared.memory)

    @property
    def numbers(self) -> np.ndarray:
        """A copy of the shared sums, whoever writes to them now."""
        return np.ndarray((self.shared.plan.size,), np.float64, self.memory.buf).copy()

    @property
    def exposures(self) -> Exposures:
        """What those sums are of."""
        return Exposures(self.shared.plan, self.numbers)

    def start(self) -> None: ...

    def join(self, _: float) -> None: ...

    def is_alive(self) -> bool:
        return False


@contextmanager
def looked_into(*words: Any, **named: Any) -> Iterator[tuple[LiveFit, Looking]]:
    """A live fit, and what stands in for its process."""
    begun: list[Looking] = []

    def begin(**about: Any) -> Looking:
        begun.append(Looking(**about))
        return begun[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("multiprocessing.context.SpawnContext.Process", staticmethod(begin))
        with LiveFit(plan(), lambda _: None, *words, **named) as fit:
            yield fit, begun[0]
    begun[0].memory.close()


HAPPENING = st.one_of(
    st.tuples(st.just("dose"), st.sampled_from([50.0, 100.0, 150.0, 200.0])),
    st.tuples(st.sampled_from(["sheet", "dark"]), st.booleans()),
    st.tuples(st.just("busy"), st.floats(0.0, 0.25)),
)


@example([step for volume in (50.0, 150.0, 100.0, 200.0) for step in (("sheet", False), ("dose", volume))]
         + [("sheet", False)], False)  # fmt: skip
@given(st.lists(HAPPENING, min_size=1, max_size=40), st.booleans())
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_however_slow_the_fit_every_event_is_taken_in_in_order_and_each_frame_at_its_dose(
    tmp_path_factory: pytest.TempPathFactory, happening: list, labelled: bool
) -> None:
    """The sums are those of a fit that is never late: nothing is dropped, swapped or counted at another dose."""
    path = tmp_path_factory.mktemp("live") / "run"
    create_run(path, (40, 60), "uint16", 4, {}, list(PATTERNS.values()))
    rng, told = np.random.default_rng(0), []
    sums, held_ul = np.zeros(plan().size), 0.0
    prompt = Exposures(plan(), sums)
    with RunWriter(path, lambda event, pixels: told.append((event, pixels))) as writer:
        for kind, value in happening:
            if kind == "dose":
                held_ul = value
                writer.put("dose_done", **dosed(value).fields)
            elif kind != "busy":
                pixels = rng.integers(0, 4000, (40, 60)).astype(np.uint16)
                then = Conditions(Delivered(held_ul, max(0.0, held_ul - 1), held_ul + 1), CameraSettings(10.0))
                writer.put_frame(Frame(pixels, 1, 1, 1, 1), 2, PATTERNS[kind].hash, **then.line() if labelled else {})
        writer.flush()
    for one, pixels in told:
        prompt.take(one, pixels)
    troubles: list[str] = []
    with looked_into(replace(open_run(path), journal=()), troubles.append) as (fit, given):
        waiting = iter(told)
        for kind, value in happening:
            if kind == "busy":
                given.shared.lock.acquire()
                threading.Timer(value, given.shared.lock.release).start()
            else:
                one, pixels = next(waiting)
                preview = value if one.kind == "frame" else True  # the dispatcher has let half of the pixels go
                fit.see(one, pixels if preview else None)
                assert one.kind != "frame" or pixels is not None
        fit.see(event("step", step=len(SEQUENCE.tasks) - 1, state="done"), None)
        assert until(given.shared.last.is_set), "the last event is taken in last"
        # There is room for four doses: frames at a fifth are counted as not seen, taken in late or not.
        np.testing.assert_array_equal(given.numbers, sums)
    assert prompt.not_seen > 0 or troubles == []


def test_a_frame_that_cannot_be_read_back_is_counted_and_said_and_the_others_are_fitted(tmp_path: Path) -> None:
    """A fit that quietly lacks frames is surer of itself than a person would be who knew."""
    path = tmp_path / "run"
    create_run(path, (40, 60), "uint16", 4, {}, list(PATTERNS.values()))
    events: list[Event] = []
    with RunWriter(path, lambda event, _: events.append(event)) as writer:
        for _ in range(3):
            writer.put_frame(Frame(photographed(0.1, 0), 1, 1, 1, 1), 2, PATTERNS["sheet"].hash, **dosed(100.0).fields)
        writer.flush()
    (path / "frames" / "c.1.0.0").unlink()
    troubles: list[str] = []
    with looked_into(replace(open_run(path), journal=()), troubles.append) as (fit, given):
        for one in events:
            fit.see(one, None)
        assert until(lambda: given.exposures.frames + given.exposures.not_seen == 3)
        assert (given.exposures.not_seen, given.exposures.newest) == (1, 2)
    (trouble,) = troubles
    assert "the live fit goes on without frame 1:" in trouble
    assert "is missing" in trouble


def test_frames_that_cannot_be_read_back_are_told_together(tmp_path: Path) -> None:
    """On a slow disk it may be thirty a second: a log of thousands of lines tells a person nothing."""
    path = tmp_path / "run"
    create_run(path, (40, 60), "uint16", 4, {}, list(PATTERNS.values()))
    events: list[Event] = []
    with RunWriter(path, lambda event, _: events.append(event)) as writer:
        for _ in range(9):
            writer.put_frame(Frame(photographed(0.1, 0), 1, 1, 1, 1), 2, PATTERNS["sheet"].hash, **dosed(100.0).fields)
        writer.flush()
    shutil.rmtree(path / "frames")
    last = event("step", step=len(plan().settings) - 1, state="done")
    troubles: list[str] = []
    empty = replace(open_run(path), journal=())
    with looked_into(empty, troubles.append, clock=lambda: 8.0 * given.exposures.not_seen) as (fit, given):
        for one in (*events, last):
            fit.see(one, None)
        assert until(given.shared.last.is_set)
    assert [trouble.split(": ")[0] for trouble in troubles] == [
        "the live fit goes on without frame 0",
        "the live fit goes on without 4 more frames, the last of them frame 4",
        "the live fit goes on without 4 more frames, the last of them frame 8",
    ]


class Ready:
    """Stands in for preparing: models are there, or not yet."""

    def __init__(self) -> None:
        self.there = False
        self.all_models: list[object] = []

    def box(self, liquid: Medium) -> Box:
        return box_for(liquid)

    def want(self, *_: object) -> None: ...

    def models(self, scenes: list[Scene], _box: Box) -> list[object] | None:
        return [object()] * len(scenes) if self.there else None

    def under_way(self, *_: object) -> bool:
        return True


def test_a_dose_waits_for_its_models_then_each_frame_is_fitted_and_the_last_fit_is_whole(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A window and the journal need single scattering too, which takes longer than a frame may."""
    liquid = Medium(0.0004, 0.008, 0.6)
    quick, single = DoseFit(0.1, liquid, model="prepared"), SingleScattering(0.008, 1.0)
    monkeypatch.setattr(worker, "fit_dose_prepared", lambda *_: quick)
    monkeypatch.setattr(worker, "with_single", lambda fit, _: replace(fit, single=single))
    earlier = DoseFit(0.1, liquid, frames=1)
    ready = Ready()
    fitter, exposures = worker.Fitter([earlier], ready, plan()), Exposures(plan())  # type: ignore[arg-type]
    exposures.take(dosed(100.0), None)
    for index in (3, 4):
        seen = frame(PATTERNS["sheet"], 2)
        exposures.take(event("frame", **seen.fields, index=index), np.full((40, 60), 500, np.uint16))
    assert fitter.next(exposures, last=True) is None
    assert fitter.waiting
    ready.there = True
    fit = fitter.next(exposures, last=True)
    assert isinstance(fit, DoseFit)
    assert (fit.passing, fit.newest, fit.single) == (True, 4, None)
    recorded, whole = fitter.finish(), fitter.finish()
    assert isinstance(recorded, DoseFit)
    assert isinstance(whole, DoseFit)
    assert (recorded.passing, recorded.newest, recorded.single) == (False, 4, None)  # nobody waits for the rest
    assert (whole.passing, whole.newest, whole.single) == (False, 4, single)
    assert fitter.next(exposures, last=True) is None


class Boxes(Ready):
    """Stands in for preparing: says what was wanted, first things first, and hands out models of chosen boxes."""

    def __init__(self) -> None:
        super().__init__()
        self.wanted: list[Box] = []
        self.ready: set[Box] = set()

    def want(self, scenes: list[Scene], box: Box) -> None:
        assert list(scenes)
        self.wanted = [box, *(one for one in self.wanted if one != box)]

    def models(self, scenes: list[Scene], box: Box) -> list[object] | None:
        return [box] * len(scenes) if box in self.ready else None


def seen_at(volume_ul: float) -> Exposures:
    exposures = Exposures(plan())
    exposures.take(dosed(volume_ul), None)
    exposures.take(frame(PATTERNS["sheet"], 2), np.full((40, 60), 500, np.uint16))
    return exposures


def test_a_first_look_tells_which_models_the_first_dose_needs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without it the first dose on a bench was searched for by the tank model, for six minutes."""
    looked, liquid = Medium(0.0003, 0.009, 0.5), Medium(0.0004, 0.008, 0.6)
    asked: list[Box] = []

    def fit(photographs: list[Photograph], models: list[Box], _start: Medium, *_: object) -> DoseFit:
        asked.append(models[0])
        return DoseFit(photographs[0].dose_ml, looked if models[0] == LOOK else liquid, model="prepared")

    monkeypatch.setattr(worker, "fit_dose_prepared", fit)
    boxes, exposures = Boxes(), seen_at(100.0)
    fitter = worker.Fitter((), boxes, plan())  # type: ignore[arg-type]
    assert boxes.wanted == [LOOK]  # before there is any frame
    assert fitter.next(exposures, last=False) is None
    assert fitter.waiting
    boxes.ready.add(LOOK)
    told = fitter.next(exposures, last=False)  # a person sees about what it is while models are prepared
    assert isinstance(told, DoseFit)
    assert (told.medium, told.model, told.passing, told.newest) == (looked, FIRST_LOOK, True, -1)
    assert fitter.next(exposures, last=False) is None  # once
    assert (fitter.waiting, fitter.unfinished) == (True, False)
    assert boxes.wanted[0] == box_for(looked)
    boxes.ready.add(box_for(looked))
    found = fitter.next(exposures, last=False)
    assert isinstance(found, DoseFit)
    assert (found.medium, found.passing) == (liquid, True)
    assert asked == [LOOK, box_for(looked)]
    assert set(boxes.wanted[:2]) == {box_for(liquid), box_for(diluted(liquid, 0.1, 0.2))}


def test_models_are_prepared_by_a_picture_of_ink_that_still_mixes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ink mixes for minutes, in which nothing was prepared as there was no frame: the first fit came later."""
    looked = Medium(0.0003, 0.009, 0.5)
    images: list[np.ndarray] = []

    def fit(photographs: list[Photograph], *_: object) -> DoseFit:
        (one,) = photographs
        images.append(one.image)
        return DoseFit(one.dose_ml, looked, model="prepared")

    monkeypatch.setattr(worker, "fit_dose_prepared", fit)
    boxes, exposures = Boxes(), Exposures(plan())
    exposures.take(dosed(100.0), None)
    fitter = worker.Fitter((), boxes, plan())  # type: ignore[arg-type]
    boxes.ready.add(LOOK)
    conditions = Conditions(Delivered(100.0, 99.0, 101.0), CameraSettings(10.0))
    assert not exposures.watch(PATTERNS["dark"], np.full((40, 60), 9, np.uint16), conditions)
    assert fitter.next(exposures, last=False) is None
    assert boxes.wanted == [LOOK]
    assert exposures.watch(PATTERNS["sheet"], np.full((40, 60), 500, np.uint16), conditions)
    assert not exposures.watch(PATTERNS["sheet"], np.full((40, 60), 600, np.uint16), conditions)  # nothing to wake for
    for _ in range(2):
        assert fitter.next(exposures, last=False) is None
        assert not fitter.waiting  # a run that ends here has nothing to wait for
    assert [float(image[0, 0]) for image in images] == [60.0]  # the newest, once; counts per ms
    assert set(boxes.wanted[:2]) == {box_for(looked), box_for(diluted(looked, 0.1, 0.2))}
    exposures.take(frame(PATTERNS["sheet"], 2), np.full((40, 60), 700, np.uint16))
    assert exposures.while_mixing is None
    assert exposures.photographs()[0].frames == 1


def test_a_picture_of_mixing_ink_that_cannot_be_read_does_not_end_the_run(caplog: pytest.LogCaptureFixture) -> None:
    """It is shown to the live fit in the run's own thread: what it raises there would stop the experiment."""
    conditions = Conditions(Delivered(100.0, 99.0, 101.0), CameraSettings(10.0))
    with LiveFit(plan(), lambda _: None) as fit:
        fit.watch(PATTERNS["sheet"], np.zeros((7, 5), np.uint16), conditions)
        assert "could not look at ink that mixes" in caplog.text
        assert fit.pid is not None


class ByPattern(Boxes):
    """Models are ready by pattern."""

    def __init__(self) -> None:
        super().__init__()
        self.ready_scenes: list[Scene] = []

    def models(self, scenes: list[Scene], box: Box) -> list[object] | None:
        return [box] * len(scenes) if box in self.ready or set(scenes) <= set(self.ready_scenes) else None


def test_a_dose_is_fitted_by_the_patterns_whose_models_are_ready(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a bench the first fit of a dose came when the models of all its patterns were there, twice as late."""
    fitted: list[tuple[str, ...]] = []

    def fit(photographs: list[Photograph], _models: list[Box], start: Medium, *_: object) -> DoseFit:
        fitted.append(tuple(one.pattern for one in photographs))
        return DoseFit(0.1, start, frames=sum(one.frames for one in photographs), patterns=fitted[-1], model="prepared")

    monkeypatch.setattr(worker, "fit_dose_prepared", fit)
    two = Pattern("bar", np.roll(PATTERNS["sheet"].pixels, 3, axis=1))
    planned = PhotographPlan.of(BENCH, SEQUENCE, [*PATTERNS.values(), two])
    exposures = Exposures(planned)
    exposures.take(dosed(100.0), None)
    for pattern in (PATTERNS["sheet"], two):
        exposures.take(frame(pattern, 2), np.full((40, 60), 500, np.uint16))
    models = ByPattern()
    earlier = DoseFit(0.05, Medium(0.0002, 0.004, 0.6), frames=1)
    fitter = worker.Fitter([earlier], models, planned)  # type: ignore[arg-type]
    assert fitter.next(exposures, last=False) is None
    first, second = exposures.photographs(0)
    models.ready_scenes = [first.scene]
    some = fitter.next(exposures, last=False)
    assert isinstance(some, DoseFit)
    assert (some.patterns, some.passing, fitter.waiting) == ((first.pattern,), False, True)  # it is recorded
    assert models.wanted[0] == box_for(some.medium)
    assert fitter.next(exposures, last=False) is None  # once
    assert fitter.unfinished is False
    models.ready_scenes = [first.scene, second.scene]
    assert isinstance(fitter.next(exposures, last=False), DoseFit)
    assert fitted == [(first.pattern,), (first.pattern, second.pattern)]


def test_a_series_waits_for_the_models_of_doses_that_were_fitted_before(monkeypatch: pytest.MonkeyPatch) -> None:
    """A run that went on did not ask for them, and fitted its series by light paths: 40 minutes on a bench of glass."""
    monkeypatch.setattr(worker, "fit_all", lambda *_: SeriesFit((), INK, INK))
    doses_ml, exposures, boxes = (0.1, 0.25), Exposures(plan()), Boxes()
    for dose_ml in doses_ml:
        exposures.take(dosed(1000.0 * dose_ml), None)
        exposures.take(frame(PATTERNS["sheet"], 2), np.full((40, 60), 500, np.uint16))
    before = [DoseFit(dose_ml, diluted(INK, 1.0, dose_ml), frames=1) for dose_ml in doses_ml]
    fitter = worker.Fitter(before, boxes, plan())  # type: ignore[arg-type]
    wanted = [box_for(fit.medium) for fit in before]
    for ready in ([], wanted[:1]):
        boxes.ready = set(ready)
        assert fitter.next(exposures, last=True) is None
        assert fitter.waiting
    assert set(wanted) <= set(boxes.wanted)
    boxes.ready = set(wanted)
    assert isinstance(fitter.next(exposures, last=True), SeriesFit)


def test_all_doses_to_come_are_prepared_for_and_the_next_one_first() -> None:
    """On a bench the last dose's models were begun when its frames were in, and a person waited for minutes."""
    liquid = Medium(0.0004, 0.008, 0.6)
    three = replace(plan(), doses_ml=(0.1, 0.25, 1.0))
    boxes = Boxes()
    worker.Fitter([DoseFit(0.1, liquid, frames=1)], boxes, three)  # type: ignore[arg-type]
    assert boxes.wanted == [box_for(diluted(liquid, 0.1, dose_ml)) for dose_ml in three.doses_ml]


def test_the_thinnest_dose_is_looked_at_first_where_nothing_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    """A first look is good in thin ink; by one in thick ink a refit prepared models of the wrong media."""
    looked = Medium(0.0003, 0.009, 0.5)
    seen: list[float] = []

    def fit(photographs: list[Photograph], _models: list[Box], _start: Medium, *_: object) -> DoseFit:
        seen.append(photographs[0].dose_ml)
        return DoseFit(photographs[0].dose_ml, looked, model="prepared")

    monkeypatch.setattr(worker, "fit_dose_prepared", fit)
    boxes, exposures = Boxes(), seen_at(100.0)
    exposures.take(dosed(200.0), None)
    exposures.take(frame(PATTERNS["sheet"], 2), np.full((40, 60), 900, np.uint16))
    fitter = worker.Fitter((), boxes, plan())  # type: ignore[arg-type]
    boxes.ready.add(LOOK)
    fitter.next(exposures, last=True)
    assert seen == [0.1]
    assert boxes.wanted[0] == box_for(looked)


def test_models_of_the_ink_expected_come_first_and_a_look_corrects_a_wrong_word(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What a bottle says must not keep a dose from being fitted, nor be believed."""
    stated, true = Medium(0.004, 0.1, 0.6), Medium(0.0004, 0.02, 0.6)
    found_in: list[Box] = []

    def fit(photographs: list[Photograph], models: list[Box], _start: Medium, *_: object) -> DoseFit | None:
        found_in.append(models[0])
        right = models[0].sigma_t[0] < true.sigma_t < models[0].sigma_t[1]
        return DoseFit(photographs[0].dose_ml, true, model="prepared") if right else None

    monkeypatch.setattr(worker, "fit_dose_prepared", fit)
    expected = replace(plan(), ink=stated)
    boxes, exposures = Boxes(), seen_at(100.0)
    fitter = worker.Fitter((), boxes, expected)  # type: ignore[arg-type]
    first, second = (box_for(diluted(stated, 1.0, dose_ml)) for dose_ml in (0.1, 0.2))
    assert boxes.wanted == [first, second, LOOK]
    boxes.ready |= {first, LOOK, box_for(true)}
    found = fitter.next(exposures, last=False)
    assert isinstance(found, DoseFit)
    assert found.medium == true
    assert found_in == [first, LOOK, box_for(true)]


def test_the_time_that_models_still_take_is_told_by_those_that_are_done(monkeypatch: pytest.MonkeyPatch) -> None:
    """A person who sees 40 s left waits; one who sees nothing ends the run."""
    now_s, told, go_on = [0.0], queue.Queue[None](), queue.Queue[float]()

    def prepare(_scene: Scene, _tolerance: float, progress: Callable[[float], None], *_: object, **__: object) -> str:
        while (share := go_on.get(timeout=10)) < 1.0:
            progress(share)
            told.put(None)
        return "model"

    monkeypatch.setattr(preparing_module, "prepare", prepare)
    preparing = Preparing(lambda _: told.put(None), lambda: now_s[0])
    scenes = [
        replace(scene, medium=Medium(0.0, 0.01 * (1 + k), 0.5))
        for k, scene in enumerate([plan().scenes[PATTERNS["sheet"].hash]] * 3)
    ]
    preparing.want(scenes, box_for(LIQUID))
    go_on.put(0.0)
    told.get(timeout=10)
    assert preparing.left == Preparation(3, None)  # nothing tells yet
    now_s[0] = 10.0
    go_on.put(0.25)
    told.get(timeout=10)
    assert preparing.left.seconds_left == pytest.approx(0.75 * 40.0 + 2 * 40.0)
    now_s[0] = 20.0
    go_on.put(1.0)
    told.get(timeout=10)
    assert preparing.left == Preparation(2, pytest.approx(40.0))
    for _ in range(2):
        go_on.put(1.0)
        told.get(timeout=10)
    assert preparing.left == Preparation(0, 0.0)
    preparing.close()


def test_frames_of_ink_that_had_not_mixed_are_left_out_and_a_flickering_lamp_is_not() -> None:
    """A plume in the first frames would bend every later estimate of the dose."""
    exposures, (rows, columns) = Exposures(plan()), np.mgrid[:40, :60]
    tank = 3000.0 * np.exp(-columns / 30.0)
    plume = 1500.0 * np.exp(-((columns - 20.0) ** 2 + (rows - 20.0) ** 2) / 100.0)
    exposures.take(dosed(100.0), None)
    rng, settling = np.random.default_rng(2), []
    for strength, lamp in ((1.0, 1.0), (0.5, 1.0), (0.0, 1.0), (0.0, 1.03), (0.0, 0.98)):
        exposures.take(frame(PATTERNS["sheet"], 2), rng.poisson(lamp * (tank + strength * plume)).astype(np.uint16))
        settling.append(exposures.settling(0))
    assert settling == [False, True, True, False, False]
    assert (exposures.left_out(0), exposures.photographs(0)[0].frames) == (2, 3)


@pytest.fixture(scope="module")
def prepared(tmp_path_factory: pytest.TempPathFactory) -> tuple[Scene, Prepared]:
    """A model of a small tank, prepared by the thread that a run has for it."""
    tank = Tank((80.0, 60.0, 40.0))
    light = Projector("collimated", (Beam((-20.0, 20.0), (18.0, 22.0)),))
    scene = Scene(tank, Medium(0.001, 0.02, 0.5), light, Camera("orthographic", (15, 20), 4.0))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TANKRIG_CACHE", str(tmp_path_factory.mktemp("cache")))
        done = threading.Event()
        preparing = Preparing(lambda _: done.set())
        box = preparing.box(LIQUID)
        preparing.want([scene], box)
        assert done.wait(120.0)
        models = preparing.models([scene], box)
        preparing.close()
    assert models is not None
    return scene, models[0]


LIQUID = Medium(0.001, 0.02, 0.55)


def test_the_prepared_fit_finds_the_liquid_with_errors_that_hold_and_says_when_it_is_elsewhere(
    prepared: tuple[Scene, Prepared],
) -> None:
    """Digits that the next frame doesn't repeat, or a liquid held at the edge of what was prepared, would mislead."""
    scene, model = prepared
    truth = tank_image(replace(scene, medium=LIQUID), seed=7, batches=16)
    radiance = np.sum(list(truth.orders.values()), axis=0)
    noise = np.full(radiance.shape, 0.002 * 5e5 * radiance.max())
    off = []
    for seed in range(20):
        image = 5e5 * radiance + np.random.default_rng(seed).normal(0.0, noise)
        photograph = Photograph("sheet", 0.1, 0.0, scene, image, noise, 0.0, 4)
        found = fit_dose_prepared([photograph] * 2, [model] * 2, Medium(0.0015, 0.018, 0.6))
        assert found is not None
        values = np.array([found.medium.sigma_a, found.medium.sigma_s, found.medium.g])
        off.append((values - [LIQUID.sigma_a, LIQUID.sigma_s, LIQUID.g]) / np.array(found.sd))
    assert np.abs(np.mean(off, axis=0)).max() < 2.0
    assert 0.05 < np.std(off, axis=0).min() <= np.std(off, axis=0).max() < 1.5
    elsewhere = tank_image(replace(scene, medium=Medium(0.001, 0.04, 0.55)), seed=7, batches=4)
    image = 5e5 * np.sum(list(elsewhere.orders.values()), axis=0)
    assert fit_dose_prepared([replace(photograph, image=image)], [model], LIQUID) is None


def test_a_series_that_steps_beyond_its_models_does_not_follow_light_paths(
    prepared: tuple[Scene, Prepared], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A step of its search without absorption, which no prepared model holds, took minutes on a bench."""
    scene, model = prepared
    followed: list[Medium] = []
    monkeypatch.setattr(series_forward, "tank_model", lambda *_: followed.append)
    answer = fits.nearly_within([model])(scene, 2, 0)
    clear, dense = Medium(0.0, 0.021, 0.55), Medium(0.001, 0.027, 0.66)
    for beyond in (clear, dense):
        assert not model.box.holds(beyond)
        image = model.predict(model.box.nearest(beyond))
        assert np.allclose(answer(beyond).image, image)
    assert followed == []
    answer(Medium(0.001, 0.2, 0.0))  # far from all that it was prepared for
    assert len(followed) == 1


def test_a_series_that_ends_beyond_its_models_is_as_right_as_one_within(prepared: tuple[Scene, Prepared]) -> None:
    """Ink thinner than models are prepared for was shown as at their edge, by 16 % too bright: nothing came out."""
    scene, model = prepared
    ink, photographs = Medium(0.001, 0.02, 0.55), []
    for dose_ml in (0.65, 1.0, 1.1):
        medium = Medium(dose_ml * ink.sigma_a, dose_ml * ink.sigma_s, ink.g)
        assert model.box.holds(medium) == (dose_ml > 0.8)
        radiance = tank_image(replace(scene, medium=medium), seed=5, batches=8).image
        noise = np.full(radiance.shape, 0.003 * 5e5 * radiance.max())
        image = 5e5 * radiance + np.random.default_rng(1).normal(0.0, noise)
        photographs.append(Photograph("sheet", dose_ml, 0.0, scene, image, noise, 0.0, 4))
    found = fits.fit_all(photographs, ink, [model])
    off = np.array([found.ink.sigma_s - ink.sigma_s, found.ink.g - ink.g]) / np.array(found.sd)[1:3]
    assert np.abs(off).max() < 3.0
    assert found.ink.sigma_s == pytest.approx(ink.sigma_s, rel=0.02)


PARENT = """
import sys, time
from tests_live_plan import plan
from tankrig.live.live_fit import LiveFit
if __name__ == "__main__":
    fit = LiveFit(plan(), lambda _: None)
    print(fit.pid, flush=True)
    time.sleep(600)
"""


def test_a_killed_program_takes_the_fit_and_its_memory_along(tmp_path: Path) -> None:
    """A fit that outlived its program would eat a core, and the shared memory would stay until the next boot."""
    source = Path(__file__).read_text(encoding="utf-8")
    (tmp_path / "tests_live_plan.py").write_text(source, encoding="utf-8")
    (tmp_path / "parent.py").write_text(PARENT, encoding="utf-8")
    parent = subprocess.Popen([sys.executable, str(tmp_path / "parent.py")], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    child = psutil.Process(int(parent.stdout.readline()))
    deadline = time.monotonic() + 60.0
    while child.nice() == psutil.Process().nice() < 19 and time.monotonic() < deadline:
        time.sleep(0.05)  # until it works: it makes itself nice first, where nobody has made it as nice as can be
    assert until(lambda: bool(shared_by(child)))
    shared = shared_by(child)
    assert all(path.exists() for path in shared)
    os.kill(parent.pid, signal.SIGKILL)
    parent.wait(10)
    parent.stdout.close()
    psutil.wait_procs([child], timeout=2.0)
    assert not child.is_running() or child.status() == psutil.STATUS_ZOMBIE
    deadline = time.monotonic() + 2.0
    while any(path.exists() for path in shared) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not [path for path in shared if path.exists()]
