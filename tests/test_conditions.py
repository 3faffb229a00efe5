"""A frame says what was true when it was exposed: the ink in the tank then, and the exposure that the camera had."""

import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import tankrig
from tankrig.devices import CameraSettings, Delivered, Frame
from tankrig.errors import UndecidedError
from tankrig.live.brackets import merged_of_run
from tankrig.live.exposures import Exposures, exposures_of
from tankrig.live.photograph_plan import PhotographPlan
from tankrig.live.recorded import fits_that_hold
from tankrig.report.settings import settings_of
from tankrig.run.conditions import Conditions, clamped, spanning, with_conditions
from tankrig.run.export import export_netcdf
from tankrig.run.journal import Event, Moment
from tankrig.run.start import new_run, resumed_run
from tankrig.run.state import FinishReason
from tankrig.run.writer import RunWriter
from tankrig.sequence import Capture, Dose, Mix, Note, Sequence, Series, Wait

from .memory_rig import BENCH, memory_rig

VOLUMES_UL = st.floats(0.0, 2000.0)
HELD = st.tuples(VOLUMES_UL, st.floats(0.0, 20.0), st.floats(0.0, 20.0)).map(
    lambda one: Delivered(one[0], max(0.0, one[0] - one[1]), one[0] + one[2])
)
SET = st.builds(CameraSettings, st.floats(0.1, 1000.0), st.floats(0.5, 8.0))
HISTORY = st.lists(
    st.one_of(
        st.tuples(st.just("session"), HELD),
        st.tuples(st.just("dose_done"), HELD),
        st.tuples(st.just("camera"), SET),
        st.tuples(st.just("other"), st.sampled_from(["step", "dose_intent", "note", "gap", "fit"])),
        st.tuples(st.just("frame"), st.none()),
    ),
    max_size=40,
)


def tank_keys(held: Delivered) -> dict[str, float]:
    return {"delivered_ul": held.volume_ul, "delivered_low_ul": held.low_ul, "delivered_high_ul": held.high_ul}


@dataclass
class Told:
    """A journal as it is written, with what was really true at each of its frames."""

    labelled: bool
    lines: list[Event] = field(default_factory=list)
    truth: list[Conditions] = field(default_factory=list)

    def tell(self, kind: str, **fields: object) -> None:
        event = Event(len(self.lines), kind, Moment("", 0, ""), fields)
        self.lines.append(Event.parse(event.line()))  # as it is read back from the disk

    def of(self, history: list[tuple[str, object]]) -> "Told":
        now = Conditions(Delivered(0.0, 0.0, 0.0), None)
        for kind, what in history:
            if kind in ("session", "dose_done"):
                assert isinstance(what, Delivered)
                now = Conditions(what, now.camera)
                self.tell(kind, **tank_keys(what))
            elif kind == "camera":
                assert isinstance(what, CameraSettings)
                now = Conditions(now.tank, what)
                asked = {"exposure_ms": 1e4, "gain": 1.0}
                self.tell("note", text="camera", asked=asked, exposure_ms=what.exposure_ms, gain=what.gain)
            elif kind == "other":
                self.tell(str(what), total_ul=99.0, text="camera?", exposure_ms=7.0)
            else:
                self.tell("frame", index=len(self.truth), **(now.line() if self.labelled else {}))
                self.truth.append(now)
        return self


@given(HISTORY)
@settings(max_examples=300, deadline=None)
def test_frames_of_earlier_versions_are_labelled_by_the_lines_before_them(history: list[tuple[str, object]]) -> None:
    """Runs of years ago must not be fitted at a dose that another run put in, or with an exposure only asked for."""
    told = Told(labelled=False).of(history)
    found = [then for event, then in with_conditions(told.lines) if event.kind == "frame"]
    assert found == told.truth


@given(HISTORY, st.randoms(use_true_random=False))
@settings(max_examples=300, deadline=None)
def test_a_frame_keeps_its_dose_and_exposure_whatever_other_lines_are_lost(history, lost) -> None:
    """A dose line that is damaged, or an event that never arrived, must not move frames to another dose."""
    told = Told(labelled=True).of(history)
    left = [event for event in told.lines if event.kind == "frame" or lost.random() < 0.5]
    found = [then for event, then in with_conditions(left) if event.kind == "frame"]
    assert [one.tank for one in found] == [one.tank for one in told.truth]
    known = [(one, true) for one, true in zip(found, told.truth, strict=True) if true.camera is not None]
    assert all(one.camera == true.camera for one, true in known)


@given(HELD, HELD, st.floats(0.0, 1.0))
@settings(max_examples=300, deadline=None)
def test_bounds_hold_for_a_frame_that_was_exposed_while_ink_moved(before, after, when) -> None:
    """Ink that goes in during an exposure was between what the tank held before and after."""
    held = spanning(before, after)
    for name in ("low_ul", "volume_ul", "high_ul"):
        true_ul = getattr(before, name) + when * (getattr(after, name) - getattr(before, name))
        assert held.low_ul - 1e-9 <= true_ul <= held.high_ul + 1e-9
    assert held.low_ul <= held.volume_ul <= held.high_ul


ONE_DOSE = Sequence("one", (Capture("full"), Dose(10.0), Capture("full"), Wait(0.0), Capture("dark")), exposure_ms=1.0)


def fill(folder: Path, name: str, total_ul: float) -> None:
    """Another run that doses."""
    assert new_run(Sequence(name, (Dose(total_ul),)), memory_rig(folder), folder / name).run().error is None


def test_a_run_that_begins_in_a_tank_with_ink_labels_its_frames_with_it(tmp_path: Path) -> None:
    fill(tmp_path, "before", 100.0)
    steps = Sequence("more", (Capture("full"), Dose(150.0), Capture("full")), exposure_ms=1.0)
    assert new_run(steps, memory_rig(tmp_path), tmp_path / "run").run().error is None
    run = tankrig.open_run(tmp_path / "run")
    assert run.frames.delivered_ul.values.tolist() == [100.0, 150.0]
    assert [event["delivered_ul"] for event in run.events("frame")] == [100.0, 150.0]
    assert run.tank == Delivered(150.0, 150.0, 150.0)
    assert [one.dose_ml for one in exposures_of(run).photographs()] == [0.1, 0.15]


def test_frames_after_another_run_has_dosed_are_labelled_with_what_the_tank_holds_now(tmp_path: Path) -> None:
    rig = memory_rig(tmp_path)
    runner = new_run(ONE_DOSE, rig, tmp_path / "run")
    real = rig.camera.capture

    def unplugged(after_ns: int, timeout_s: float) -> Frame:
        if rig.projector.log[-1] == "show dark":
            raise tankrig.DeviceError("camera in memory: unplugged")
        return real(after_ns, timeout_s)

    rig.camera.capture = unplugged
    assert runner.run().reason is FinishReason.FAILED
    fill(tmp_path, "between", 300.0)
    try:
        again = resumed_run(tmp_path / "run", memory_rig(tmp_path))
    except UndecidedError:  # what another run has put in may be a question for a person
        again = resumed_run(tmp_path / "run", memory_rig(tmp_path), 300.0)
    assert again.run().error is None
    run = tankrig.open_run(tmp_path / "run")
    assert run.frames.delivered_ul.values.tolist() == [0.0, 10.0, 300.0]


def test_a_dose_by_somebody_else_within_a_step_gives_bounds_that_hold(tmp_path: Path) -> None:
    """The runner never doses while it photographs; should anybody, the frame must not be sure of its dose."""
    rig = memory_rig(tmp_path)
    runner = new_run(Sequence("x", (Capture("full", frames=3),), exposure_ms=1.0), rig, tmp_path / "run")
    real = rig.camera.capture

    def dosed(after_ns: int, timeout_s: float) -> Frame:
        frame = real(after_ns, timeout_s)
        if frame.sequence == 1:
            runner.doser.dose_to(40.0)
        return frame

    rig.camera.capture = dosed
    assert runner.run().error is None
    frames = tankrig.open_run(tmp_path / "run").frames
    bounds = list(zip(frames.delivered_low_ul.values.tolist(), frames.delivered_high_ul.values.tolist(), strict=True))
    assert bounds == [(0.0, 0.0), (0.0, 40.0), (40.0, 40.0)]


def clamping(rig, most_ms: float) -> None:
    real = rig.camera.configure
    rig.camera.configure = lambda asked: real(CameraSettings(min(asked.exposure_ms, most_ms), asked.gain))


def test_a_camera_that_clamps_is_told_of_once_and_its_exposure_is_the_one_it_had(tmp_path: Path) -> None:
    """1000 ms asked and 100 answered: a fit with what was asked for is off by ten."""
    rig = memory_rig(tmp_path)
    clamping(rig, 100.0)
    captures = (Capture("full"), Capture("dark"), Capture("full", exposure_ms=20.0), Capture("full"))
    runner = new_run(
        Sequence("long", (Dose(10.0), Mix(at_least_s=0.0, every_s=0.0), *captures), exposure_ms=1000.0), rig,
        tmp_path / "run",
    )  # fmt: skip
    assert runner.run().error is None
    run = tankrig.open_run(tmp_path / "run")
    assert run.frames.exposure_ms.values.tolist() == [100.0, 100.0, 20.0, 100.0]
    assert run.frames.gain.values.tolist() == [1.0] * 4
    (warning,) = (event for event in run.events("note") if event.get("warning"))
    assert "camera in memory: was asked for 1000 ms at gain 1 and has set 100 ms at gain 1" in warning["text"]
    assert ("exposure", "20 ms at gain 1, 100 ms at gain 1") in settings_of(run)[0]
    export_netcdf(run, tmp_path / "frames.nc")
    import xarray

    with xarray.open_dataset(tmp_path / "frames.nc", engine="h5netcdf") as found:
        assert found.exposure_ms.values.tolist() == [100.0, 100.0, 20.0, 100.0]
        assert found.exposure_ms.attrs["units"] == "ms"
        assert found.delivered_ul.values.tolist() == [10.0] * 4


@given(SET, st.floats(-0.05, 0.05), st.floats(-0.05, 0.05))
@settings(max_examples=300, deadline=None)
def test_what_counts_as_clamped_is_more_than_a_hundredth_of_either(asked, longer, louder) -> None:
    """Cameras round to their lines and steps; a line for each would be read by nobody."""
    actual = CameraSettings(asked.exposure_ms * (1.0 + longer), asked.gain * (1.0 + louder))
    if max(abs(longer), abs(louder)) > 0.0101:
        assert clamped(asked, actual)
    if max(abs(longer), abs(louder)) < 0.0099:
        assert not clamped(asked, actual)


SWEPT = Sequence("swept", (Series((10.0, 20.0), (Capture("dark"), Capture("full", frames=2))),), exposure_ms=50.0)


def as_earlier_versions_wrote_it(new: Path, old: Path) -> tankrig.Run:
    """The same run by a tankrig whose frames' lines said neither dose nor exposure."""
    from tankrig.run.folder import create_run

    run = tankrig.open_run(new)
    create_run(old, run.frames.shape[1:], run.frames.dtype, len(run.frames), run.settings, list(run.patterns.values()))
    frames = iter(run.frames.values)
    with RunWriter(old) as writer:
        for event in run.journal:
            if event.kind == "frame":
                times = (event["exposure_start_ns"], event["device_ns"], event["host_ns"], event["sequence"])
                writer.put_frame(Frame(next(frames), *times), event["step"], event["pattern_hash"])
            else:
                writer.put(event.kind, **event.fields)  # type: ignore[arg-type]
        writer.flush()
    return tankrig.open_run(old)


@pytest.fixture
def both(tmp_path: Path) -> tuple[tankrig.Run, tankrig.Run]:
    """A run in a tank with ink, by a camera that clamps to a tenth of what is asked for; and as it was once written."""
    fill(tmp_path, "before", 5.0)
    rig = memory_rig(tmp_path)
    clamping(rig, 5.0)
    assert new_run(SWEPT, rig, tmp_path / "new").run().error is None
    return tankrig.open_run(tmp_path / "new"), as_earlier_versions_wrote_it(tmp_path / "new", tmp_path / "old")


def test_runs_of_earlier_versions_have_the_same_labels_and_are_fitted_alike(both) -> None:
    new, old = both
    assert "delivered_ul" not in json.dumps([dict(event.fields) for event in old.events("frame")])
    for name in ("delivered_ul", "delivered_low_ul", "delivered_high_ul", "exposure_ms", "gain"):
        np.testing.assert_array_equal(new.frames[name], old.frames[name])
    assert old.frames.delivered_ul.values.tolist() == [10.0] * 3 + [20.0] * 3
    assert set(old.frames.exposure_ms.values.tolist()) == {5.0}
    for one, other in zip(exposures_of(new).photographs(), exposures_of(old).photographs(), strict=True):
        assert one.dose_ml == other.dose_ml
        np.testing.assert_array_equal(one.image, other.image)
    light = new.frames.values[1:3].mean(axis=0) - new.frames.values[0]
    photograph = exposures_of(old).photographs()[0]
    np.testing.assert_allclose(photograph.image, light / 5.0, rtol=1e-12)


def test_fits_that_took_the_exposure_asked_for_are_made_anew(both) -> None:
    """A report must not repeat what an earlier version has fitted with a tenth of the exposure."""
    new, old = both
    fit = {"fit": "dose", "dose_ml": 0.01, "frames": 2}
    for run in both:
        with RunWriter(run.path) as writer:
            writer.put("fit", **fit)
            writer.flush()
    new, old = (tankrig.open_run(run.path) for run in both)
    assert [dict(one.fields) for one in fits_that_hold(new)] == [fit]
    assert fits_that_hold(old) == ()


def test_brackets_are_merged_by_the_exposures_that_frames_had(both, monkeypatch) -> None:
    seen: list[CameraSettings] = []
    monkeypatch.setattr("tankrig.live.brackets.merge", lambda frames, _: seen.extend(one for _, one in frames))
    real = PhotographPlan.of_run.__func__  # type: ignore[attr-defined]

    class Calibrated:
        radiometry = object()

        def __init__(self, plan: PhotographPlan) -> None:
            self.settings = plan.settings

    monkeypatch.setattr(PhotographPlan, "of_run", classmethod(lambda cls, run: Calibrated(real(cls, run))))
    for run in both:
        merged_of_run(run, "full", 10.0)
    assert seen == [CameraSettings(5.0)] * 4


DOSES = st.lists(st.sampled_from([0.0, 50.0, 100.0, 150.0, 300.0]), min_size=1, max_size=30)


@given(DOSES, st.integers(0, 3))
@settings(max_examples=200, deadline=None)
def test_each_frame_counts_at_its_own_dose_in_whatever_order_doses_come(doses_ul: list[float], planned: int) -> None:
    """Tanks are filled anew, other runs dose between: no frame may count at a dose that was not its own."""
    steps = (*(Dose(100.0 * (number + 1)) for number in range(planned)), Capture("full"))
    sequence = Sequence("x", steps, exposure_ms=1.0)
    patterns = sequence.drawn(BENCH.wall)
    exposures = Exposures(PhotographPlan.of(BENCH, sequence, list(patterns.values())))
    pixels = np.random.default_rng(0).integers(90, 110, BENCH.camera.shape).astype(np.uint16)
    room, held, unseen = exposures.plan.doses, {}, 0
    for number, dose_ul in enumerate(doses_ul):
        then = Conditions(Delivered(dose_ul, dose_ul, dose_ul), CameraSettings(1.0))
        fields = {"index": number, "pattern_hash": patterns["full"].hash, "step": planned, **then.line()}
        if dose_ul in held or len(held) < room:
            held[dose_ul] = held.get(dose_ul, 0) + 1
        else:
            unseen += 1
        exposures.take(Event(number, "frame", Moment("", 0, ""), fields), pixels)
        assert exposures.newest == number
    found = {round(1000.0 * one.dose_ml, 6): one.frames for one in exposures.photographs()}
    assert found == {dose_ul: count for dose_ul, count in sorted(held.items()) if dose_ul > 0.0}
    assert list(found) == sorted(found)
    assert exposures.not_seen == unseen


def test_notes_do_not_pass_for_the_camera(tmp_path: Path) -> None:
    """A person may write the word camera into a note."""
    steps = (Note("camera"), Capture("full"))
    assert new_run(Sequence("x", steps, exposure_ms=2.0), memory_rig(tmp_path), tmp_path / "run").run().error is None
    assert tankrig.open_run(tmp_path / "run").frames.exposure_ms.values.tolist() == [2.0]
