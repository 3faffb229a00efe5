"""Frames are of the pattern that is said to be on the wall, and none is lost without a word."""

import tankrig
from tankrig.run.start import new_run
from tankrig.run.state import FinishReason
from tankrig.sequence import Capture, Note, Sequence, Wait

from .memory_rig import memory_rig


def test_captures_of_one_pattern_in_a_row_leave_it_there(tmp_path):
    """Showing again what is there would cost the frames that its flip may touch; a wait, or other exposures, does."""
    rig = memory_rig(tmp_path)
    steps = (
        *(Capture("full", frames=2), Note("the same"), Capture("full", frames=2)),
        *(Wait(0.0), Capture("full"), Capture("full", exposure_ms=2.0), Capture("dark"), Capture("full")),
    )
    outcome = new_run(Sequence("row", steps, exposure_ms=1.0), rig, tmp_path / "run").run()
    assert outcome.reason is FinishReason.COMPLETED, outcome.error
    assert rig.projector.log == [f"show {name}" for name in ("full", "full", "full", "dark", "full", "dark")]
    run = tankrig.open_run(tmp_path / "run")
    assert run.frames.pattern.values.tolist() == ["full"] * 6 + ["dark", "full"]
    assert run.frames.step.values.tolist() == [0, 0, 2, 2, 4, 5, 6, 7]


def test_a_frame_that_may_show_an_older_pattern_fails_the_run(tmp_path):
    rig = memory_rig(tmp_path)
    rig.camera.early = True
    outcome = new_run(Sequence("one", (Capture("full"),), exposure_ms=1.0), rig, tmp_path / "run").run()
    assert outcome.reason is FinishReason.FAILED
    assert "too early to be of the pattern" in str(outcome.error)
    assert len(tankrig.open_run(tmp_path / "run").frames) == 0


def test_a_dropped_frame_is_a_gap_in_the_journal_and_the_step_gets_its_frames(tmp_path):
    rig = memory_rig(tmp_path)
    rig.camera.drop = {2, 3}
    sequence = Sequence("frames", (Capture("full", frames=5),), exposure_ms=1.0)
    assert new_run(sequence, rig, tmp_path / "run").run().reason is FinishReason.COMPLETED
    run = tankrig.open_run(tmp_path / "run")
    assert len(run.frames) == 5
    assert [(gap["missing"], gap["after"]) for gap in run.events("gap")] == [(2, 1)]
