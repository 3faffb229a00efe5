"""Steps that stop early: no more light than it takes to know what a person asked for, and the journal says why."""

import itertools
import threading
from pathlib import Path

import pytest

import tankrig
from tankrig import SequenceError
from tankrig.devices import Frame
from tankrig.dosing import DoseLimits
from tankrig.run.rig import Rig
from tankrig.run.runner import UNFITTED, Runner
from tankrig.run.start import new_run, resumed_run
from tankrig.run.state import FinishReason
from tankrig.sequence import Capture, Dose, Pace, Sequence, dry_run
from tankrig.sequence.loading import sequence_from_table, sequence_table
from tankrig.sequence.until import Until
from ui.cli import main

from .memory_rig import memory_rig

WISH = Until(sigma_s="1 %", g=0.01)
SEQUENCE = Sequence(
    "until",
    (Dose(10.0), Capture("full", 8, until=WISH), Capture("full", 8, until=WISH), Capture("dark", 2)),
    exposure_ms=1.0,
)


def knowing(runner: Runner, rig: Rig, model: str = "tank", recorded: int = 0) -> None:
    """A live fit that is never late, and knows σs to 4 % over the number of lit frames that the camera has taken."""
    runner.fitted, seen, capture = True, itertools.count(1), rig.camera.capture

    def captured(after_ns: int, timeout_s: float) -> Frame:
        frame, frames = capture(after_ns, timeout_s), next(seen)
        sd = 0.04 * 0.02 / frames
        fit = {"fit": "dose", "dose_ml": 0.01, "sigma_a": 0.001, "sigma_s": 0.02, "g": 0.5, "sd": [1.0, sd, 0.001]}
        runner.latest_fit = fit | {"model": model, "newest": recorded + frames - 1}
        return frame

    rig.camera.capture = captured


def done(run: tankrig.Run) -> list[dict]:
    return [dict(event.fields) for event in run.events("step") if event["state"] == "done"]


@pytest.mark.parametrize("model", ["tank", "prepared"])
def test_a_step_stops_when_enough_is_known_and_the_next_projects_nothing(tmp_path: Path, model: str) -> None:
    """Light and time are spent on what is not known yet; the run's journal tells why there are fewer frames."""
    rig = memory_rig(tmp_path)
    runner = new_run(SEQUENCE, rig, tmp_path / "run")
    knowing(runner, rig, model)
    assert runner.run().reason is FinishReason.COMPLETED
    run = tankrig.open_run(tmp_path / "run")
    assert run.frames.pattern.values.tolist() == ["full"] * 4 + ["dark"] * 2
    stopped = [(one.get("frames"), one.get("stopped")) for one in done(run)][1:3]
    assert stopped == [(4, "σs to 1.00% and g to 0.001 are known"), (0, "σs to 1.00% and g to 0.001 are known")]
    assert [pattern.name for _, pattern in rig.projector.shown] == ["full", "dark", "dark"]


def test_without_a_live_fit_every_frame_is_taken_and_the_journal_says_so(tmp_path: Path) -> None:
    """A person who switched the fit off must learn that nothing stops early."""
    runner = new_run(SEQUENCE, memory_rig(tmp_path), tmp_path / "run")
    assert runner.run().reason is FinishReason.COMPLETED
    run = tankrig.open_run(tmp_path / "run")
    assert len(run.events("frame")) == 18
    assert any(note.get("text") == UNFITTED for note in run.events("note"))


def test_time_ends_a_step_too(tmp_path: Path) -> None:
    """A wish that cannot be reached must not hold the experiment up."""
    step = Capture("full", 1000, until=Until(sigma_a="0.001 %"), timeout_s=0.05)
    rig = memory_rig(tmp_path)
    runner = new_run(Sequence("late", (Dose(10.0), step), exposure_ms=1.0), rig, tmp_path / "run")
    knowing(runner, rig)
    assert runner.run().reason is FinishReason.COMPLETED
    run = tankrig.open_run(tmp_path / "run")
    assert done(run)[1]["stopped"] == "0.05 s have passed"
    assert 1 <= done(run)[1]["frames"] == len(run.events("frame")) < 1000


def test_with_a_timeout_a_slow_fit_is_waited_for(tmp_path: Path) -> None:
    """At the first dose the fit is slow, and frames taken meanwhile would all be wasted."""
    step = Capture("full", 50, until=WISH, timeout_s=20.0)
    runner = new_run(Sequence("slow", (Dose(10.0), step), exposure_ms=1.0), memory_rig(tmp_path), tmp_path / "run")
    runner.fitted = True
    fit = {"fit": "dose", "dose_ml": 0.01, "sigma_a": 1e-3, "sigma_s": 0.02, "g": 0.5, "sd": [1.0, 1e-5, 1e-3]}

    def tell():
        runner.latest_fit = fit | {"model": "tank", "newest": 1}
        runner.latest_fit = {"fit": "series"}  # of the doses that are over, which says nothing about this one

    def later(event, _):
        if event.kind == "frame" and event["index"] == 1:
            threading.Timer(0.3, tell).start()

    runner.listen(later)
    assert runner.run().reason is FinishReason.COMPLETED
    assert len(tankrig.open_run(tmp_path / "run").events("frame")) == 2


def test_a_resumed_run_counts_the_frames_it_has_and_stops_all_the_same(tmp_path: Path) -> None:
    """Resuming must neither take a step's frames twice nor forget what is known."""
    rig = memory_rig(tmp_path)
    runner = new_run(SEQUENCE, rig, tmp_path / "run")
    knowing(runner, rig)
    capture, seen = rig.camera.capture, itertools.count(1)

    def aborted_at_the_second(after_ns: int, timeout_s: float) -> Frame:
        frame = capture(after_ns, timeout_s)
        if next(seen) == 2:
            runner.abort()
        return frame

    rig.camera.capture = aborted_at_the_second
    assert runner.run().reason is FinishReason.ABORTED
    recorded = tankrig.open_run(tmp_path / "run").frames.sizes["frame"]
    assert recorded == 2
    rig = memory_rig(tmp_path)
    again = resumed_run(tmp_path / "run", rig)
    again.latest_fit = runner.latest_fit
    knowing(again, rig, recorded=recorded)
    assert again.run().reason is FinishReason.COMPLETED
    run = tankrig.open_run(tmp_path / "run")
    assert run.frames.step.values.tolist() == [1] * (2 + 4) + [3] * 2
    assert [one.get("frames") for one in done(run)][1:3] == [6, 0]


def test_a_dry_run_says_at_most(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Time and frames of steps that may stop early are bounds, and must not be taken for a forecast."""
    plan = dry_run(SEQUENCE, DoseLimits(100.0, 100.0, 100.0), Pace(), 2)
    assert plan.at_most
    assert [step.at_most for step in plan.steps] == [False, True, True, False]
    text = 'name = "x"\n[[steps]]\ndo = "capture"\npattern = "full"\nframes = 9\nuntil = { sigma_s = "1 %" }\n'
    (tmp_path / "sequence.toml").write_text(text, encoding="utf-8")
    assert main(["run", str(tmp_path / "sequence.toml"), "--dry-run", "--out", str(tmp_path / "run")]) == 0
    assert "at most 9 frames" in " ".join(capsys.readouterr().out.split())


def test_until_survives_a_runs_settings() -> None:
    """A run that is resumed reads its sequence from its own folder."""
    assert sequence_from_table(sequence_table(SEQUENCE), "run") == SEQUENCE


@pytest.mark.parametrize(
    ("step", "message"),
    [
        ({"until": {}}, "until is empty"),
        ({"until": {"sigma_s": "much"}}, r"until.sigma_s = 'much' is no standard deviation"),
        ({"until": {"g": -0.1}}, r"until.g = -0.1 is no standard deviation"),
        ({"until": {"sigma_t": 1.0}}, "sigma_t"),
        ({"timeout_s": 3.0}, "needs until"),
        ({"until": {"g": 0.1}, "timeout_s": 0.0}, "is no time"),
    ],
)
def test_a_wish_that_is_none_is_refused_in_one_sentence(step: dict, message: str) -> None:
    table = {"name": "x", "steps": [{"do": "capture", "pattern": "full", **step}]}
    with pytest.raises(SequenceError, match=message):
        sequence_from_table(table, "sequence.toml")
