"""The runner's bursts: whole or not at all, taken again where frames are lost, and resumed without one frame twice."""

import time
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
import pytest

import tankrig
from tankrig.devices import BurstTiming, Frame
from tankrig.dosing import DoseLimits
from tankrig.errors import DeviceError, SequenceError
from tankrig.pattern.kinds import Full
from tankrig.run.start import new_run, resumed_run
from tankrig.run.state import FinishReason
from tankrig.sequence import Burst, Capture, Pace, Sequence, dry_run

from .memory_rig import SHAPE, MemoryCamera, MemoryProjector, memory_rig

LEVELS = {f"level {level}": Full(level=level) for level in (40, 80, 120)}
NAMES = tuple(LEVELS)
PERIOD_MS = 3.0


@dataclass
class BurstingProjector(MemoryProjector):
    """Each pattern is a trigger, in its own time."""

    loaded: tuple = ()
    bursts: int = 0
    triggers: list = field(default_factory=list)
    fails_at: int = 10**6

    def load_burst(self, patterns, exposure_ms):
        self.loaded = tuple(patterns)
        return BurstTiming(exposure_ms - 0.2, PERIOD_MS)

    def play_burst(self):
        self.bursts += 1
        if self.bursts >= self.fails_at:
            raise DeviceError("projector in memory: is gone; plug it in")
        now_ns = time.monotonic_ns()
        self.triggers = [(now_ns + round(1e6 * PERIOD_MS * at), one) for at, one in enumerate(self.loaded)]


@dataclass
class TriggeredCamera(MemoryCamera):
    """`misses` counts triggers that it does not see, from the first burst on; `late_ms` by which its stamps are off."""

    misses: set = field(default_factory=set)
    late_ms: dict = field(default_factory=dict)
    armed: bool = False
    triggered_so_far: int = 0

    def arm(self):
        self.armed = True

    def disarm(self):
        self.armed = False

    def triggered(self, _timeout_s):
        assert self.armed
        while self.projector.triggers:
            at_ns, pattern = self.projector.triggers.pop(0)
            number, self.triggered_so_far = self.triggered_so_far, self.triggered_so_far + 1
            if number in self.misses:
                continue
            pixels = np.full(SHAPE, int(pattern.pixels.mean()), np.uint16)
            start_ns = at_ns + round(1e6 * self.late_ms.get(number, 0.0))
            self.sequence += 1
            return Frame(pixels, start_ns, start_ns, time.monotonic_ns(), self.sequence)
        return None


def bursting_rig(folder, **camera):
    rig = memory_rig(folder)
    projector = BurstingProjector()
    return replace(rig, projector=projector, camera=TriggeredCamera(projector, rig.doser, **camera))


def sequence_of(*steps):
    return Sequence("bursts", tuple(steps), LEVELS, exposure_ms=2.0)


def levels_by_name(run) -> bool:
    """Whether each frame is of the pattern that it is said to be of."""
    names = run.frames.pattern.values.tolist()
    return [f"level {round(frame.mean())}" for frame in run.frames.values] == names


def test_a_burst_records_one_frame_of_each_pattern_each_time(tmp_path):
    rig = bursting_rig(tmp_path)
    assert new_run(sequence_of(Burst(NAMES, times=3)), rig, tmp_path / "run").run().reason is FinishReason.COMPLETED
    run = tankrig.open_run(tmp_path / "run")
    assert run.frames.pattern.values.tolist() == list(NAMES) * 3
    assert levels_by_name(run)
    assert {event["exposure_ms"] for event in run.events("frame")} == {1.8}, "the light says for how long"
    assert not rig.camera.armed


def test_frames_that_are_lost_have_the_burst_taken_again_with_a_warning(tmp_path):
    rig = bursting_rig(tmp_path, misses={1, 5})
    assert new_run(sequence_of(Burst(NAMES)), rig, tmp_path / "run").run().reason is FinishReason.COMPLETED
    run = tankrig.open_run(tmp_path / "run")
    assert levels_by_name(run)
    warnings = [note for note in run.events("note") if "a burst is taken again" in note.get("text", "")]
    assert len(warnings) == 2
    assert rig.projector.bursts == 3


@pytest.mark.parametrize(
    ("camera", "reason"),
    [
        ({"misses": set(range(100))}, "3 patterns and only 0 frames"),
        ({"misses": {0, 3, 6}}, "3 patterns and only 2 frames, so that nobody knows which frame is of which"),
        ({"late_ms": {1: 2.5, 4: 2.5, 7: 2.5}}, "frame 2 of a burst is 2.5 ms off its pattern's time"),
    ],
)
def test_frames_that_are_lost_or_late_again_and_again_end_the_run(tmp_path, camera, reason):
    outcome = new_run(sequence_of(Burst(NAMES)), bursting_rig(tmp_path, **camera), tmp_path / "run").run()
    assert outcome.reason is FinishReason.FAILED
    assert reason in str(outcome.error)
    assert not tankrig.open_run(tmp_path / "run").events("frame")


def test_a_run_that_failed_between_bursts_resumes_there_and_takes_none_twice(tmp_path):
    rig = bursting_rig(tmp_path)
    rig.projector.fails_at = 3
    sequence = sequence_of(Capture("level 40"), Burst(NAMES, times=4))
    assert new_run(sequence, rig, tmp_path / "run").run().reason is FinishReason.FAILED
    again = bursting_rig(tmp_path)
    assert resumed_run(tmp_path / "run", again).run().reason is FinishReason.COMPLETED
    run = tankrig.open_run(tmp_path / "run")
    assert run.frames.pattern.values.tolist() == ["level 40", *NAMES * 4]
    assert again.projector.bursts == 2


def test_a_rig_without_triggers_is_told_before_anything_moves(tmp_path):
    with pytest.raises(SequenceError, match=r"burst of 3 patterns: projector in memory .* one of them has no trigger"):
        new_run(sequence_of(Burst(NAMES)), memory_rig(tmp_path), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_a_dry_run_counts_its_frames_and_its_time():
    sequence = sequence_of(Burst(NAMES, times=5))
    plan = dry_run(sequence, DoseLimits(dose_ul=1.0, run_ul=1.0, tank_ul=1.0), Pace(), 100)
    assert plan.frames == sequence.frames == 15
    assert 0.03 < plan.seconds < 1.0


@pytest.mark.parametrize(
    ("step", "reason"),
    [
        (lambda: Burst(()), "patterns is empty; name what to show"),
        (lambda: Burst(("full",), times=0), "times = 0 shows nothing"),
        (lambda: sequence_of(Burst(("levle 40",))), 'pattern "levle 40" is unknown; did you mean "level 40"'),
    ],
)
def test_a_burst_that_makes_no_sense_is_refused_in_a_sentence(step, reason):
    with pytest.raises(SequenceError, match=reason):
        step()


def test_frames_of_a_burst_follow_each_other_in_time(tmp_path):
    rig = bursting_rig(tmp_path)
    new_run(sequence_of(Burst(NAMES * 4)), rig, tmp_path / "run").run()
    starts_ns = [event["exposure_start_ns"] for event in tankrig.open_run(tmp_path / "run").events("frame")]
    assert all(round((later - sooner) / 1e6, 3) == PERIOD_MS for sooner, later in pairwise(starts_ns))
