"""The runner does each step once, stops the doser first, and leaves a run that can go on."""

import json
import os
import threading
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import pytest

import tankrig
from tankrig import DeviceError, SequenceError, StoreError
from tankrig.bench import Bench
from tankrig.checked_toml import checked
from tankrig.errors import UndecidedError
from tankrig.run.recovery import recover
from tankrig.run.rig import RigLock
from tankrig.run.start import is_of, new_run, resumed_run
from tankrig.run.state import FinishReason, RunState
from tankrig.sequence import Capture, Dose, Mix, Note, Sequence, Series, Wait

from .memory_rig import memory_rig

QUICK = Mix(at_least_s=0.0, every_s=0.0)
SERIES = Sequence(
    "series",
    steps=(Note("begin"), Series((0.0, 10.0, 30.0), (QUICK, Capture("dark"), Capture("full", frames=2)))),
    exposure_ms=1.0,
)


def kinds(run: tankrig.Run) -> list[str]:
    return [event.kind for event in run.journal]


def done(run: tankrig.Run) -> list[int]:
    return [event["step"] for event in run.events("step") if event["state"] == "done"]


def in_thread(runner) -> tuple[threading.Thread, list]:
    outcomes = []
    (thread := threading.Thread(target=lambda: outcomes.append(runner.run()))).start()
    return thread, outcomes


def until(condition, timeout_s: float = 10.0) -> None:
    end = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.002)


def test_a_series_is_carried_out_recorded_and_each_frame_shows_its_pattern(tmp_path):
    rig = memory_rig(tmp_path)
    runner = new_run(SERIES, rig, tmp_path / "run")
    heard = []
    runner.listen(lambda event, pixels: heard.append((event, pixels)))
    outcome = runner.run()
    assert outcome.reason is FinishReason.COMPLETED, outcome.error
    assert runner.state is RunState.FINISHED
    run = tankrig.open_run(tmp_path / "run")
    assert done(run) == list(range(13))
    assert run.frames.pattern.values.tolist() == ["dark", "full", "full"] * 3
    assert run.frames.delivered_ul.values.tolist() == [0.0] * 3 + [10.0] * 3 + [30.0] * 3
    means = run.frames.values.mean(axis=(1, 2))
    assert (means[run.frames.pattern.values == "dark"] < 100).all()
    assert (means[run.frames.pattern.values == "full"] > 1000).all()
    assert kinds(run)[-1] == "end"
    assert run.end["reason"] == "completed"
    assert rig.doser.count_ul == 30
    assert [event["total_ul"] for event in run.events("dose_intent")] == [10.0, 30.0]
    assert [event for event, _ in heard] == list(run.journal)
    np.testing.assert_array_equal([pixels for _, pixels in heard if pixels is not None], run.frames.values)
    assert rig.projector.shown[-1][1].name == "dark"
    assert rig.projector.closed


def test_an_intent_is_on_disk_before_ink_moves(tmp_path):
    rig = memory_rig(tmp_path)
    seen = []
    real = rig.doser.dose_to
    rig.doser.dose_to = lambda total: (seen.append(kinds(tankrig.open_run(tmp_path / "run"))[-1]), real(total))[1]
    assert new_run(SERIES, rig, tmp_path / "run").run().reason is FinishReason.COMPLETED
    assert seen == ["dose_intent", "dose_intent"]


def test_it_pauses_at_the_end_of_a_step_only_and_goes_on(tmp_path):
    runner = new_run(Sequence("wait", (Wait(0.2), Note("after"))), memory_rig(tmp_path), tmp_path / "run")
    thread, outcomes = in_thread(runner)
    until(lambda: runner.progress().waiting_for == "time to pass")
    runner.pause()
    assert runner.state is RunState.PAUSING
    until(lambda: runner.state is RunState.PAUSED)
    progress = runner.progress()
    assert (progress.step, progress.steps, progress.label) == (1, 2, "note: after")
    runner.resume()
    thread.join(10)
    assert outcomes[0].reason is FinishReason.COMPLETED
    run = tankrig.open_run(tmp_path / "run")
    order = [(event.kind, event.get("state") or event.get("text")) for event in run.events("step", "note")]
    assert order == [
        ("step", "begun"), ("step", "done"), ("note", "paused"), ("note", "resumed"),
        ("step", "begun"), ("note", "after"), ("step", "done"),
    ]  # fmt: skip


def test_abort_while_paused_ends_the_run(tmp_path):
    runner = new_run(Sequence("wait", (Wait(0.1), Note("never"))), memory_rig(tmp_path), tmp_path / "run")
    thread, outcomes = in_thread(runner)
    runner.pause()
    until(lambda: runner.state is RunState.PAUSED)
    runner.abort()
    thread.join(10)
    assert outcomes[0].reason is FinishReason.ABORTED


def test_abort_in_a_dose_stops_it_records_what_went_in_and_the_resumed_run_doses_only_the_rest(tmp_path):
    rig = memory_rig(tmp_path, ul_per_s=200.0)
    runner = new_run(Sequence("dose", (Dose(60.0), Note("after"))), rig, tmp_path / "run")
    thread, outcomes = in_thread(runner)
    until(lambda: rig.doser.moving.is_set() and rig.doser.count_ul > 5)
    runner.abort()
    assert rig.doser.log[-1] == "stop"
    thread.join(10)
    assert (outcomes[0].reason, outcomes[0].error) == (FinishReason.ABORTED, None)
    run = tankrig.open_run(tmp_path / "run")
    partly = rig.doser.count_ul
    assert 5 < partly < 60
    assert run.events("dose_done")[-1]["delivered_ul"] == partly
    assert run.end["reason"] == "aborted"
    rig = memory_rig(tmp_path)
    assert resumed_run(tmp_path / "run", rig).run().reason is FinishReason.COMPLETED
    assert rig.doser.count_ul == 60


def test_abort_reaches_the_doser_at_once_while_the_camera_hangs(tmp_path):
    """The doser is stopped by the call itself, not by the run's thread, which is stuck in the camera."""
    rig = memory_rig(tmp_path)
    rig.camera.hang = threading.Event()
    runner = new_run(SERIES, rig, tmp_path / "run")
    thread, outcomes = in_thread(runner)
    until(lambda: runner.progress().waiting_for == "the first pictures of the ink")
    runner.abort()
    assert rig.doser.log[-1] == "stop"
    assert thread.is_alive()
    rig.camera.hang.set()
    thread.join(10)
    assert outcomes[0].reason is FinishReason.ABORTED


def test_a_failing_device_stops_the_doser_first_then_goes_dark(tmp_path, monkeypatch):
    rig = memory_rig(tmp_path)
    order = []
    monkeypatch.setattr("tankrig.run.pattern_display.CAMERA_TIMEOUT_S", 0.05)
    real_show = rig.projector.show
    real_stop = rig.doser.stop
    rig.projector.show = lambda pattern: (order.append(f"show {pattern.name}"), real_show(pattern))[1]
    rig.doser.stop = lambda: (order.append("stop"), real_stop())[1]
    rig.camera.hang = threading.Event()
    outcome = new_run(SERIES, rig, tmp_path / "run").run()
    assert outcome.reason is FinishReason.FAILED
    assert "camera in memory: gave no frame" in str(outcome.error)
    assert order == ["show full", "stop", "show dark"]
    run = tankrig.open_run(tmp_path / "run")
    assert run.end["reason"] == "failed"
    assert "camera in memory" in run.end["message"]


def test_a_run_that_failed_resumes_where_it_stopped_and_repeats_no_frame(tmp_path):
    rig = memory_rig(tmp_path)
    real, taken = rig.camera.capture, []

    def failing(after_ns, timeout_s):
        if rig.doser.count_ul == 10 and rig.projector.log[-2:] == ["show dark", "show full"]:
            taken.append(after_ns)
            if len(taken) == 2:
                raise DeviceError("camera in memory: unplugged")
        return real(after_ns, timeout_s)

    rig.camera.capture = failing
    assert new_run(SERIES, rig, tmp_path / "run").run().reason is FinishReason.FAILED
    assert len(tankrig.open_run(tmp_path / "run").frames) == 5
    rig = memory_rig(tmp_path)
    outcome = resumed_run(tmp_path / "run", rig).run()
    assert outcome.reason is FinishReason.COMPLETED, outcome.error
    run = tankrig.open_run(tmp_path / "run")
    assert run.frames.pattern.values.tolist() == ["dark", "full", "full"] * 3
    assert done(run) == list(range(13))
    assert rig.doser.count_ul == 30


def test_a_completed_run_is_not_resumed(tmp_path):
    new_run(SERIES, memory_rig(tmp_path), tmp_path / "run").run()
    with pytest.raises(StoreError, match="has come to its end"):
        resumed_run(tmp_path / "run", memory_rig(tmp_path))


def test_a_run_is_not_resumed_on_another_bench(tmp_path):
    from dataclasses import replace

    rig = memory_rig(tmp_path)
    rig.camera.early = True
    new_run(SERIES, rig, tmp_path / "run").run()
    rig = memory_rig(tmp_path)
    other = replace(rig, bench=replace(rig.bench, light="pinhole", light_position_mm=(-400.0, 0.0, 60.0)))
    with pytest.raises(StoreError, match="recorded on another bench"):
        resumed_run(tmp_path / "run", other)


def test_a_full_disk_ends_the_run_with_a_sentence_and_the_doser_stopped(tmp_path, monkeypatch):
    rig = memory_rig(tmp_path)
    runner = new_run(SERIES, rig, tmp_path / "run")
    real = os.write

    def full(handle: int, data: object) -> int:
        if rig.doser.count_ul >= 10 and "frames" in str(Path(f"/proc/self/fd/{handle}").readlink()):
            raise OSError(28, "No space left on device")
        return real(handle, data)

    monkeypatch.setattr(os, "write", full)
    outcome = runner.run()
    assert outcome.reason is FinishReason.FAILED
    assert isinstance(outcome.error, StoreError)
    assert "No space left on device" in str(outcome.error)
    assert "stop" in rig.doser.log
    monkeypatch.undo()
    assert len(tankrig.open_run(tmp_path / "run").frames) == 3
    assert resumed_run(tmp_path / "run", memory_rig(tmp_path)).run().reason is FinishReason.COMPLETED
    assert len(tankrig.open_run(tmp_path / "run").frames) == 9
    assert recover(tmp_path / "run").damaged == ()


@pytest.mark.parametrize(
    ("sequence", "reason"),
    [
        (Sequence("x", (Dose(600.0),)), "one dose may have 500 µl"),
        (
            Sequence("x", (Series((400.0, 800.0, 1200.0, 1600.0, 2000.0, 2400.0), (Note("x"),)),)),
            "the run may have 2000 µl",
        ),
    ],
)
def test_a_sequence_over_budget_moves_nothing_and_leaves_nothing(tmp_path, sequence, reason):
    rig = memory_rig(tmp_path)
    with pytest.raises(SequenceError, match=reason):
        new_run(sequence, rig, tmp_path / "run")
    assert rig.doser.count_ul == 0
    assert not (tmp_path / "run").exists()
    assert rig.projector.closed


def test_a_disk_that_is_too_small_is_noticed_before_anything_moves(tmp_path, monkeypatch):
    monkeypatch.setattr("shutil.disk_usage", lambda _: type("Usage", (), {"free": 1000})())
    with pytest.raises(StoreError, match=r"the run needs up to .* make room"):
        new_run(SERIES, memory_rig(tmp_path), tmp_path / "run")


def test_a_dose_left_open_by_a_crash_is_asked_about_and_never_repeated(tmp_path):
    """As a kill between intent and end leaves it: the resumed run needs a person's word."""
    rig = memory_rig(tmp_path)
    runner = new_run(Sequence("dose", (Dose(40.0), Note("after"))), rig, tmp_path / "run")
    runner.run()
    journal = tmp_path / "run" / "journal.jsonl"
    lines = journal.read_bytes().splitlines(keepends=True)
    cut = next(i for i, line in enumerate(lines) if json.loads(line)["kind"] == "dose_done")
    journal.write_bytes(b"".join(lines[:cut]))
    ledger = tmp_path / "tank.ledger"
    ledger.write_bytes(b"".join(ledger.read_bytes().splitlines(keepends=True)[:-1]))
    (tmp_path / "doser.count").write_text("25")
    with pytest.raises(UndecidedError, match=r"--delivered-ul"):
        resumed_run(tmp_path / "run", memory_rig(tmp_path))
    with pytest.raises(UndecidedError, match="find out which is true"):
        resumed_run(tmp_path / "run", memory_rig(tmp_path), delivered_ul=33.0)
    rig = memory_rig(tmp_path)
    assert resumed_run(tmp_path / "run", rig, delivered_ul=25.0).run().reason is FinishReason.COMPLETED
    assert rig.doser.count_ul == 40
    run = tankrig.open_run(tmp_path / "run")
    assert [event["delivered_ul"] for event in run.events("dose_done")] == [25.0, 40.0]


DOSES = Sequence("doses", (Dose(100.0), Note("wait"), Dose(200.0), Note("after")))


def cut_off_in_the_wait(folder: Path) -> Path:
    """As a kill after the first dose leaves it: the tank holds 100 µl, 200 are to come."""
    assert new_run(DOSES, memory_rig(folder), folder / "run").run().reason is FinishReason.COMPLETED
    journal, ledger = folder / "run" / "journal.jsonl", folder / "tank.ledger"
    lines = journal.read_bytes().splitlines(keepends=True)
    second = [i for i, line in enumerate(lines) if json.loads(line)["kind"] == "dose_intent"][1]
    journal.write_bytes(b"".join(lines[: second - 1]))
    ledger.write_bytes(b"".join(ledger.read_bytes().splitlines(keepends=True)[:-2]))
    (folder / "doser.count").write_text("100")
    return folder / "run"


def test_a_run_that_was_cut_off_in_a_wait_goes_on_without_a_question(tmp_path):
    run = cut_off_in_the_wait(tmp_path)
    rig = memory_rig(tmp_path)
    assert resumed_run(run, rig).run().reason is FinishReason.COMPLETED
    assert rig.doser.count_ul == 200


def test_a_run_without_its_ledger_is_asked_about_before_it_goes_on(tmp_path):
    """It would dose 200 µl into the 100 that are there, and say that the tank holds 200."""
    run = cut_off_in_the_wait(tmp_path)
    (tmp_path / "tank.ledger").unlink()
    with pytest.raises(UndecidedError, match=r"journal says that the tank holds 100 µl.* says 0 µl.*between 0 and 100"):
        resumed_run(run, memory_rig(tmp_path))
    with pytest.raises(UndecidedError, match="cannot hold 140"):
        resumed_run(run, memory_rig(tmp_path), delivered_ul=140.0)
    rig = memory_rig(tmp_path)
    assert rig.doser.count_ul == 100
    assert resumed_run(run, rig, delivered_ul=100.0).run().reason is FinishReason.COMPLETED
    assert rig.doser.count_ul == 200
    session = tankrig.open_run(run).events("session")[-1]
    assert session["said_ul"] == 100.0
    assert "ledger was lost" in session["asked"]
    assert json.loads((tmp_path / "tank.ledger").read_text().splitlines()[1])["said_ul"] == 100.0


def test_a_run_whose_tank_another_run_dosed_into_is_asked_about(tmp_path):
    run = cut_off_in_the_wait(tmp_path)
    other = new_run(Sequence("other", (Dose(150.0),)), memory_rig(tmp_path), tmp_path / "other")
    assert other.run().reason is FinishReason.COMPLETED
    with pytest.raises(UndecidedError, match=r"journal says that the tank holds 100 µl.*say 150"):
        resumed_run(run, memory_rig(tmp_path))
    with pytest.raises(UndecidedError, match="cannot hold 100"):
        resumed_run(run, memory_rig(tmp_path), delivered_ul=100.0)
    rig = memory_rig(tmp_path)
    assert resumed_run(run, rig, delivered_ul=150.0).run().reason is FinishReason.COMPLETED
    assert rig.doser.count_ul == 200


def test_the_runs_budget_outlives_its_ledger(tmp_path):
    """What the journal knows to have gone in counts, though the new ledger has never heard of it."""
    run = cut_off_in_the_wait(tmp_path)
    (tmp_path / "tank.ledger").unlink()
    with pytest.raises(SequenceError, match="the run may have 150 µl at most and has had 100"):
        resumed_run(run, memory_rig(tmp_path, run_ul=150.0), delivered_ul=100.0)
    with pytest.raises(SequenceError, match="has had 100"):
        resumed_run(run, memory_rig(tmp_path, run_ul=150.0))


def test_a_journal_of_an_earlier_version_is_judged_by_what_it_has(tmp_path):
    """It notes neither count nor filling, and its lines have no checksums."""
    run = cut_off_in_the_wait(tmp_path)
    journal, group = run / "journal.jsonl", run / "zarr.json"
    group.write_text(group.read_text().replace('"format": 2', '"format": 1'))
    new_keys = {"count_ul", "count_low_ul", "count_high_ul", "filled_utc", "crc32c"}
    lines = [json.loads(line) for line in journal.read_text().splitlines()]
    assert new_keys <= set(lines[0])
    old = [{key: value for key, value in line.items() if key not in new_keys} for line in lines]
    journal.write_text("".join(f"{json.dumps(line)}\n" for line in old))
    before = journal.read_bytes()
    ledger = (tmp_path / "tank.ledger").read_bytes()
    (tmp_path / "tank.ledger").unlink()
    with pytest.raises(UndecidedError, match=r"journal says that the tank holds 100 µl.*at least 0 µl"):
        resumed_run(run, memory_rig(tmp_path))
    assert journal.read_bytes() == before
    (tmp_path / "tank.ledger").write_bytes(ledger)
    rig = memory_rig(tmp_path)
    assert resumed_run(run, rig).run().reason is FinishReason.COMPLETED
    assert rig.doser.count_ul == 200


def leaves(table: dict, path: tuple = ()):
    for key, value in table.items():
        yield (*path, key)
        if isinstance(value, dict):
            yield from leaves(value, (*path, key))


def test_a_key_that_a_run_does_not_have_yet_counts_at_its_default(tmp_path):
    """A later version adds keys to the bench; the runs that were interrupted before must still go on."""
    bench = memory_rig(tmp_path).bench
    stored = json.loads(json.dumps(asdict(bench)))
    optional = 0
    for path in list(leaves(stored)):
        older = json.loads(json.dumps(stored))
        place = older
        for key in path[:-1]:
            place = place[key]
        value = place.pop(path[-1])
        try:
            default_is_meant = asdict(checked(Bench, older, "bench", StoreError)) == asdict(bench)
        except StoreError:
            default_is_meant = False  # it has no default: every version wrote it
        optional += default_is_meant
        assert is_of(bench, older) == default_is_meant, (path, value)
    assert optional >= 5


def test_a_bench_with_a_field_of_a_later_version_is_still_the_bench_of_an_older_run(tmp_path):
    bench = memory_rig(tmp_path).bench
    stored = json.loads(json.dumps(asdict(bench)))

    @dataclass(frozen=True)
    class LaterBench(Bench):
        stirrer_rpm: float = 0.0

    fields = {name: getattr(bench, name) for name in vars(bench)}
    assert is_of(LaterBench(**fields), stored)
    assert not is_of(LaterBench(**fields, stirrer_rpm=30.0), stored)
    assert not is_of(bench, stored | {"light": "pinhole", "light_position_mm": [-400.0, 0.0, 60.0]})


def test_it_waits_until_the_ink_has_mixed_and_records_the_time_scale(tmp_path):
    rig = memory_rig(tmp_path)
    rig.camera.mixing_s = 0.15
    steps = (Dose(10.0), Mix(tolerance=0.01, every_s=0.01, at_least_s=0.1, timeout_s=20.0))
    outcome = new_run(Sequence("mix", steps), rig, tmp_path / "run").run()
    assert outcome.reason is FinishReason.COMPLETED, outcome.error
    mixed = tankrig.open_run(tmp_path / "run").events("step")[-1]
    assert 0.1 < mixed["time_scale_s"] < 0.2
    assert mixed["remaining"] <= 0.01
    assert 0.3 < mixed["seconds"] < 2.0


def test_pictures_of_ink_that_has_nearly_mixed_are_shown_while_it_mixes_and_are_not_recorded(tmp_path):
    """By them a live fit has its models prepared before there is a frame."""
    rig = memory_rig(tmp_path)
    rig.camera.mixing_s = 0.15
    steps = (Dose(10.0), Mix(tolerance=0.01, every_s=0.01, at_least_s=0.1, timeout_s=20.0), Capture("full", 1))
    runner = new_run(Sequence("mix", steps), rig, tmp_path / "run")
    shown = []
    runner.while_mixing.append(lambda *seen: shown.append(seen))
    assert runner.run().reason is FinishReason.COMPLETED
    run = tankrig.open_run(tmp_path / "run")
    (frame,) = run.frames
    mixed = run.pixels(run.events("frame")[0]).astype(float)
    pattern, pixels, conditions = shown[0]
    assert (pattern.hash, conditions.tank.volume_ul) == (frame.pattern_hash, 10.0)
    assert np.linalg.norm(pixels - mixed) < 0.1 * np.linalg.norm(mixed)
    assert len(shown) < run.events("step")[-3]["pictures"] - 6


def test_ink_that_does_not_mix_in_time_fails_with_what_to_do(tmp_path):
    rig = memory_rig(tmp_path)
    rig.camera.mixing_s = 5.0
    steps = (Dose(10.0), Mix(every_s=0.01, at_least_s=0.1, timeout_s=0.5))
    outcome = new_run(Sequence("mix", steps), rig, tmp_path / "run").run()
    assert outcome.reason is FinishReason.FAILED
    assert "still changed after 0.5 s" in str(outcome.error)


def test_a_saturated_picture_is_not_taken_for_a_mixed_tank(tmp_path):
    rig = memory_rig(tmp_path)
    rig.camera.saturation = 1000
    outcome = new_run(Sequence("mix", (Dose(10.0), QUICK)), rig, tmp_path / "run").run()
    assert outcome.reason is FinishReason.FAILED
    assert "of the picture is saturated" in str(outcome.error)


def test_slow_and_failing_listeners_neither_hold_the_run_up_nor_lose_events(tmp_path):
    runner = new_run(
        Sequence("many", (Capture("full", frames=40),), exposure_ms=1.0), memory_rig(tmp_path), tmp_path / "run"
    )
    gate, heard = threading.Event(), []

    def slow(event, pixels):
        gate.wait(10)
        heard.append((event.kind, pixels is not None))

    def failing(*_):
        raise RuntimeError("a bug in a window")

    runner.listen(slow)
    runner.listen(failing)
    thread, outcomes = in_thread(runner)
    until(lambda: tankrig.open_run(tmp_path / "run").end is not None)
    gate.set()
    thread.join(10)
    assert outcomes[0].reason is FinishReason.COMPLETED
    until(lambda: heard and heard[-1][0] == "end")
    assert sum(kind == "frame" for kind, _ in heard) == 40
    assert sum(pixels for _, pixels in heard) < 12


def test_fits_are_recorded_beside_the_frames_and_waited_for_at_the_end(tmp_path):
    runner = new_run(SERIES, memory_rig(tmp_path), tmp_path / "run")
    fitted = []

    def fit(event, _):
        if event.kind == "frame":
            runner.record("fit", index=event["index"], sigma_s=0.02)
            fitted.append(event["index"])

    def finished():
        if len(fitted) < 9:
            return False
        runner.record("fit", series=True)
        return True

    runner.listen(fit)
    runner.before_end.append(finished)
    assert runner.run().reason is FinishReason.COMPLETED
    run = tankrig.open_run(tmp_path / "run")
    assert [fit.get("index") for fit in run.fits] == [*range(9), None]
    assert runner.latest_fit == {"series": True}
    with pytest.raises(StoreError, match="the run has ended"):
        runner.record("note", text="too late")


def test_an_abort_does_not_wait_for_fits_that_never_come(tmp_path):
    """Ctrl-C after the last step must end the program, not leave it waiting for minutes."""
    runner = new_run(SERIES, memory_rig(tmp_path), tmp_path / "run")
    asked = threading.Event()

    def never():
        asked.set()
        return False

    runner.before_end.append(never)
    threading.Thread(target=lambda: asked.wait(30) and runner.abort()).start()
    assert runner.run().reason is FinishReason.ABORTED
    assert len(tankrig.open_run(tmp_path / "run").frames) == 9


def test_a_rig_is_for_one_program(tmp_path):
    lock = RigLock(tmp_path / "rig.lock", "bench 1")
    with pytest.raises(StoreError, match=rf"rig bench 1 is in use by another program \(process {os.getpid()}\)"):
        RigLock(tmp_path / "rig.lock", "bench 1")
    lock.close()
    lock.close()
    RigLock(tmp_path / "rig.lock", "bench 1").close()
