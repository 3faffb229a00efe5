"""What a sequence will take, and whether the rig allows it, before anything moves."""

from dataclasses import dataclass
from typing import Annotated

from tankrig.devices import Delivered
from tankrig.dosing.limits import DoseLimits, dosed_to, too_much_already
from tankrig.errors import SequenceError
from tankrig.ranges import Within, require_ranges
from tankrig.scene.description import CLOSED
from tankrig.sequence.exposure import ExposureRule, require_whole_periods
from tankrig.sequence.sequence import Sequence
from tankrig.sequence.steps import MOST_S, Action, Burst, Capture, Dose, Mix, Wait


@dataclass(frozen=True)
class Pace:
    """How fast a rig is, for estimates of time only.

    Parameters
    ----------
    flip_s
        From one pattern to the next.
    dose_ul_per_s
        Of the doser.
    mixing_s
        Until ink has mixed.
    """

    __pydantic_config__ = CLOSED
    flip_s: Annotated[float, Within(0.0, MOST_S, "is no pace of a rig; give what it needs, in s")] = 0.05
    dose_ul_per_s: Annotated[
        float, Within(1.0 / MOST_S, MOST_S, "is no pace of a doser; give what it needs, in µl/s", below=True)
    ] = 20.0
    mixing_s: Annotated[float, Within(0.0, MOST_S, "is no pace of a rig; give what it needs, in s")] = 20.0

    def __post_init__(self) -> None:
        require_ranges(self, SequenceError)

    def seconds(self, action: Action, sequence: Sequence, tank_ul: float) -> float:
        """What one action takes when the tank holds `tank_ul`."""
        match action:
            case Dose(total_ul):
                return max(0.0, total_ul - tank_ul) / self.dose_ul_per_s
            case Mix():
                return max(self.mixing_s, action.at_least_s)
            case Capture():
                # A frame counts when its exposure began after the flip, so one under way is waited out.
                return self.flip_s + (action.frames + 1) * sequence.camera_settings(action).exposure_ms / 1000
            case Burst():
                # Each time the projector is told what to show, and each pattern is followed by some dark.
                return (
                    action.times * self.flip_s
                    + 1.2 * action.frames * sequence.camera_settings(action).exposure_ms / 1000
                )
            case Wait(seconds):
                return seconds
            case _:
                return 0.0


@dataclass(frozen=True)
class PlannedStep:
    """One line of a dry run; `at_most` where a step may stop before it has taken all frames."""

    label: str
    kind: type[Action]
    seconds: float
    ink_ul: float
    frames: int
    at_most: bool = False


@dataclass(frozen=True)
class DryRun:
    """What a sequence will take.

    Parameters
    ----------
    steps
        Its actions, in order.
    disk_bytes
        Of its frames, uncompressed.
    """

    steps: tuple[PlannedStep, ...]
    disk_bytes: int

    @property
    def seconds(self) -> float:
        """How long it will take."""
        return sum(step.seconds for step in self.steps)

    @property
    def at_most(self) -> bool:
        """Whether time and frames are upper bounds, because steps may stop early."""
        return any(step.at_most for step in self.steps)

    @property
    def ink_ul(self) -> float:
        """How much ink it will dose."""
        return sum(step.ink_ul for step in self.steps)

    @property
    def frames(self) -> int:
        """How many frames it will record."""
        return sum(step.frames for step in self.steps)


def dry_run(
    sequence: Sequence,
    limits: DoseLimits,
    pace: Pace,
    frame_bytes: int,
    tank: Delivered = Delivered(0.0, 0.0, 0.0),  # noqa: B008 - a tuple, which nobody can change
    run_used_ul: float = 0.0,
    resume_at: int | None = None,
    exposure: ExposureRule = ExposureRule(),  # noqa: B008 - frozen
) -> DryRun:
    """Go through a sequence without moving anything.

    Parameters
    ----------
    sequence
        What to go through.
    limits
        Budgets that its doses must keep.
    pace
        How fast the rig is.
    frame_bytes
        Size of one frame.
    tank
        What the tank holds now.
    run_used_ul
        What the run has dosed already, when it is resumed.
    resume_at
        Number of the step that a resumed run goes on with; ink for earlier ones is in the tank.
    exposure
        What exposures must keep to. A run that is resumed keeps those that it was begun with.

    Raises
    ------
    SequenceError
        Naming the first dose that the budgets forbid, or exposure that would flicker.
    """
    if resume_at is None:
        require_whole_periods(sequence, exposure)
    steps = []
    for number, task in enumerate(sequence.tasks):
        action, ink_ul = task.action, 0.0
        seconds = pace.seconds(action, sequence, tank.volume_ul)
        done = resume_at is not None and (
            number < resume_at or (isinstance(action, Dose) and number == resume_at and action.total_ul < tank.high_ul)
        )
        if isinstance(action, Dose) and action.total_ul != tank.volume_ul and not done:
            ink_ul = action.total_ul - tank.volume_ul
            more = too_much_already(action.total_ul, tank)
            if refusal := more or limits.refusal(action.total_ul, tank, run_used_ul):
                raise SequenceError(f"{sequence.called}: {task.label}: {refusal}")
            run_used_ul += action.total_ul - tank.low_ul
            tank = dosed_to(action.total_ul, tank)
        frames = action.frames if isinstance(action, Capture | Burst) else 0
        at_most = isinstance(action, Capture) and action.until is not None
        steps.append(PlannedStep(task.label, type(action), seconds, ink_ul, frames, at_most))
    return DryRun(tuple(steps), sequence.frames * frame_bytes)
