"""The live fit's process: never in the run's way, and gone when the program that started it is."""

import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import psutil
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from tankrig.devices import CameraSettings, Delivered, Frame
from tankrig.live import worker
from tankrig.live.exposures import Exposures
from tankrig.live.live_fit import LiveFit
from tankrig.live.results import DoseFit, Fit
from tankrig.run.conditions import Conditions
from tankrig.run.folder import create_run
from tankrig.run.journal import Event
from tankrig.run.reading import open_run
from tankrig.run.writer import RunWriter
from tests import live_plan
from tests.live_plan import INK, PATTERNS, SEQUENCE, dosed, event, frame, photographed, plan


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


def test_a_picture_of_mixing_ink_that_cannot_be_read_does_not_end_the_run(caplog: pytest.LogCaptureFixture) -> None:
    """It is shown to the live fit in the run's own thread: what it raises there would stop the experiment."""
    conditions = Conditions(Delivered(100.0, 99.0, 101.0), CameraSettings(10.0))
    with LiveFit(plan(), lambda _: None) as fit:
        fit.watch(PATTERNS["sheet"], np.zeros((7, 5), np.uint16), conditions)
        assert "could not look at ink that mixes" in caplog.text
        assert fit.pid is not None


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
    source = Path(live_plan.__file__).read_text(encoding="utf-8")
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
