"""How a run ends when anything goes wrong: the doser is stopped first, and nothing that went wrong skips the rest."""

import threading
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import tankrig
from tankrig import DeviceError, SequenceError, StoreError
from tankrig.run import start
from tankrig.run.event_dispatcher import EventDispatcher
from tankrig.run.journal import Event, Moment
from tankrig.run.start import new_run, resumed_run
from tankrig.run.state import FinishReason, RunState
from tankrig.run.writer import RunWriter
from tankrig.sequence import Capture, Dose, Sequence

from .memory_rig import memory_rig

STEPS = Sequence("one", (Dose(20.0), Capture("full", frames=2)), exposure_ms=1.0)
ERRORS = [
    DeviceError("camera in memory: unplugged"),
    StoreError("run: the disk is full"),
    RuntimeError("a bug"),
    OSError(5, "Input/output error"),
    KeyboardInterrupt(),
    SystemExit(3),
]
ERROR = st.one_of(st.none(), st.sampled_from(ERRORS))
CLEAN_UP = ("doser.stop", "projector.show", "doser.close", "projector.close", "camera.close", "writer.finish")


class Failing:
    """Devices that note what is asked of them, and raise as told once they have done it."""

    def __init__(self, rig, fails: dict[str, BaseException | None]) -> None:
        self.asked: list[str] = []
        self._fails = fails
        for name in CLEAN_UP[:-1]:
            device, _, call = name.partition(".")

            setattr(getattr(rig, device), call, self.noting(getattr(getattr(rig, device), call), name))

    def noting(self, real: Callable[..., object], name: str) -> Callable[..., object]:
        def called(*given: object, **named: object) -> object:
            self.asked.append(name)
            found = real(*given, **named)
            fault = self._fails.get(name)
            if fault is not None and (name != "projector.show" or given[0].name == "dark"):  # type: ignore[attr-defined]
                raise fault
            return found

        return called


@given(
    st.fixed_dictionaries(dict.fromkeys(CLEAN_UP, ERROR)),
    st.fixed_dictionaries({"camera.capture": ERROR, "listener": ERROR, "before_end": ERROR}),
)
@settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_whatever_a_step_of_the_clean_up_or_a_callback_raises_the_others_still_happen(
    tmp_path_factory: pytest.TempPathFactory, cleaning: dict, before: dict
) -> None:
    """A device left open, a doser not stopped or a run without an end is worse than the error that came first."""
    folder = tmp_path_factory.mktemp("run")
    rig = memory_rig(folder)
    real = rig.camera.capture

    def capture(after_ns: int, timeout_s: float) -> object:
        if before["camera.capture"] is not None:
            raise before["camera.capture"]
        return real(after_ns, timeout_s)

    rig.camera.capture = capture
    runner = new_run(STEPS, rig, folder / "run")
    devices = Failing(rig, cleaning)
    heard: list[str] = []

    def failing(*_: object) -> None:
        if before["listener"] is not None:
            raise before["listener"]

    def ready() -> bool:
        if before["before_end"] is not None:
            raise before["before_end"]
        return True

    runner.listen(failing)
    runner.listen(lambda event, _: heard.append(event.kind))
    runner.before_end.append(ready)
    outcome, raised = None, None
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(RunWriter, "finish", devices.noting(RunWriter.finish, "writer.finish"))
        try:
            outcome = runner.run()
        except BaseException as error:
            raised = error
    went_well = before["camera.capture"] is None and not isinstance(
        before["before_end"], KeyboardInterrupt | SystemExit
    )
    asked = devices.asked[devices.asked.index("projector.show") + 1 :]  # what follows the step's own showing
    assert {"projector.show", "doser.close", "projector.close", "camera.close", "writer.finish"} <= set(asked)
    if not went_well:
        assert asked[0] == "doser.stop"
    assert asked.index("doser.close") < asked.index("projector.close")
    assert rig.projector.closed
    assert rig.doser.stopped
    assert runner.state is RunState.FINISHED
    assert heard[-1] == "end"
    run = tankrig.open_run(folder / "run")
    assert run.end is not None
    assert run.end["reason"] == ("completed" if went_well else "failed")
    first = before["camera.capture"] or (before["before_end"] if not went_well else None)
    if first is not None:
        assert str(first) in run.end["message"]
        assert (raised if raised is not None else outcome.error) is first
    elif any(cleaning[name] for name in CLEAN_UP if name != "doser.stop"):
        assert raised is not None or outcome.reason is FinishReason.FAILED
    else:
        assert outcome.reason is FinishReason.COMPLETED
    assert resumed_or_over(folder, went_well)


def resumed_or_over(folder: Path, over: bool) -> bool:
    """Nobody holds the run or its ledger any more: it goes on, or says that it is complete."""
    rig = memory_rig(folder)
    if over:
        with pytest.raises(StoreError, match="has come to its end"):
            resumed_run(folder / "run", rig)
        return True
    return resumed_run(folder / "run", rig).run().reason is FinishReason.COMPLETED


def test_an_end_that_cannot_be_trimmed_is_written_all_the_same(tmp_path: Path, monkeypatch) -> None:
    runner = new_run(STEPS, memory_rig(tmp_path), tmp_path / "run")

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("tankrig.run.writer.resize_frames", full)
    outcome = runner.run()
    assert "could not trim the finished run" in str(outcome.error)
    assert tankrig.open_run(tmp_path / "run").end is not None
    assert len(tankrig.open_run(tmp_path / "run").frames) == 2


@pytest.mark.parametrize("error", ERRORS)
def test_a_run_that_never_began_lets_go_and_says_why(tmp_path: Path, error: BaseException) -> None:
    """A fit that cannot begin must not leave a folder that nobody understands, and that is locked."""
    rig = memory_rig(tmp_path)
    runner = new_run(STEPS, rig, tmp_path / "run")
    runner.give_up(error)
    runner.give_up(RuntimeError("again"))
    assert rig.projector.closed
    assert "stop" in rig.doser.log
    run = tankrig.open_run(tmp_path / "run")
    assert [event.kind for event in run.journal] == ["end"]
    assert str(error) in run.end["message"]
    with pytest.raises(SequenceError, match="has done its work"):
        runner.run()
    assert resumed_run(tmp_path / "run", memory_rig(tmp_path)).run().reason is FinishReason.COMPLETED


def test_an_abort_before_the_beginning_is_given_up_too(tmp_path: Path) -> None:
    rig = memory_rig(tmp_path)
    runner = new_run(STEPS, rig, tmp_path / "run")
    runner.abort()
    runner.give_up()
    assert (runner.state, rig.projector.closed) == (RunState.FINISHED, True)


@pytest.mark.parametrize("fails", ["create_run", "copy_to", "RunWriter", "Runner"])
@pytest.mark.parametrize("error", [StoreError("full"), OSError(28, "full"), RuntimeError("a bug"), KeyboardInterrupt()])
def test_a_run_that_cannot_be_made_leaves_nothing(tmp_path, monkeypatch, fails: str, error: BaseException) -> None:
    """An empty run in the list of runs is a riddle to whoever finds it a month later."""

    def failing(*_: object, **__: object) -> None:
        raise error

    rig = memory_rig(tmp_path)
    if fails == "create_run":
        monkeypatch.setattr("tankrig.run.folder.disk.rename", failing)
    elif fails == "copy_to":
        rig.calibrations["camera"] = type("Made", (), {"hash": "abc"})  # type: ignore[index]
        monkeypatch.setattr(start, "copy_to", failing)
    else:
        monkeypatch.setattr(start, fails, failing)
    before = {path.name for path in tmp_path.iterdir()} | {"tank.ledger"}
    with pytest.raises(type(error)):
        new_run(STEPS, rig, tmp_path / "run")
    assert {path.name for path in tmp_path.iterdir()} == before
    assert rig.projector.closed
    assert rig.doser.count_ul == 0


@given(st.lists(st.sampled_from([None, *ERRORS]), min_size=1, max_size=8), st.integers(1, 60))
@settings(max_examples=50, deadline=None)
def test_every_listener_that_does_not_fail_hears_every_event_in_order(failures: list, count: int) -> None:
    """One listener's failure, of whatever kind, must not make another one deaf."""
    before = set(threading.enumerate())
    dispatcher = EventDispatcher()
    heard: list[list[int]] = []

    def listener(failure: BaseException | None, mine: list[int]):
        def listen(event: Event, _: object) -> None:
            mine.append(event.seq)
            if failure is not None:
                raise failure

        return listen

    for failure in failures:
        heard.append([])
        dispatcher.listen(listener(failure, heard[-1]))
    for seq in range(count):
        dispatcher.dispatch(Event(seq, "note", Moment("", 0, ""), {}), None)
    dispatcher.close()
    for failure, mine in zip(failures, heard, strict=True):
        assert mine == ([0] if failure is not None else list(range(count)))
    assert set(threading.enumerate()) <= before
