"""What the window knows of the rig at a moment."""

import math
from dataclasses import dataclass
from enum import Enum

from tankrig.devices import Delivered
from tankrig.dosing.limits import DOSING, STOPPED, Remaining
from tankrig.run.progress import Progress
from tankrig.run.state import RunState


class RigState(Enum):
    """What the rig is doing for the window."""

    OPENING = "opening the rig"
    IDLE = "ready"
    RUNNING = "a run is going on"
    ASKING = "waiting for a person's word on the ink"
    LENT = "a calibration goes on"
    FAILED = "the rig cannot be used"
    CLOSED = "closed"


@dataclass(frozen=True)
class RigStatus:
    """What the window knows of the rig at a moment.

    Parameters
    ----------
    state
        What the rig is doing.
    trouble
        One sentence, where something is wrong.
    troubles
        How many there have been: the same sentence may be told again.
    tank
        Ink in the tank, µl.
    remaining
        What the budgets still allow, µl.
    target_ul
        Of the dose under way.
    stopped
        Whether the doser's stop is latched.
    undecided
        What a person has to decide about the ink before anything moves.
    progress, run_state
        Of the run.
    preparation
        What its fits wait for, in words; empty where they wait for nothing.
    aside_ul
        Of what is being delivered beside the tank.
    exposing_left_s
        Of a long exposure under way.
    used_ul
        Ink that doses by hand, or the run, have put into the tank, at most, µl.
    increment_ul
        Smallest volume that the doser doses, µl.
    """

    state: RigState = RigState.OPENING
    trouble: str = ""
    troubles: int = 0
    tank: Delivered | None = None
    remaining: Remaining | None = None
    target_ul: float | None = None
    stopped: bool = False
    undecided: str | None = None
    progress: Progress | None = None
    run_state: RunState | None = None
    preparation: str = ""
    aside_ul: float | None = None
    exposing_left_s: float | None = None
    used_ul: float = 0.0
    increment_ul: float = 0.0

    @property
    def running(self) -> bool:
        """Whether a run goes on."""
        return self.run_state not in (None, RunState.READY, RunState.FINISHED)

    @property
    def finishing(self) -> bool:
        """Whether all steps of the run are done, and it is being brought to its end."""
        return self.running and self.progress is not None and self.progress.step >= self.progress.steps

    @property
    def busy(self) -> bool:
        """Whether the rig is in use for something that must not be disturbed."""
        return self.state in (RigState.RUNNING, RigState.ASKING, RigState.LENT) or self.dosing

    @property
    def dosing(self) -> bool:
        """Whether the pump moves because a person has asked for it by hand."""
        return self.target_ul is not None or self.aside_ul is not None

    @property
    def no_dose(self) -> str:
        """Why nothing can be dosed by hand now, in the words in which the doser would refuse it; empty where it can."""
        if self.undecided is not None:
            return "it is not known how much ink the tank holds; say it first"
        if self.dosing:
            return DOSING
        if self.state is not RigState.IDLE:
            return f"{self.state.value}; doses by hand have to wait"
        return STOPPED if self.stopped else ""

    @property
    def over_the_picture(self) -> str:
        """What has to be known of a picture that does not move; empty where it does."""
        if self.state is RigState.LENT:
            return "a calibration goes on and has the camera; the Calibration page shows what it sees"
        if self.exposing_left_s is not None:
            return f"exposing, {math.ceil(self.exposing_left_s)} s left"
        return ""

    @property
    def words(self) -> str:
        """One line for the status bar."""
        if self.state is RigState.FAILED:
            return self.trouble or str(self.state.value)
        if self.undecided is not None:
            return "the tank's ink is not known: see the Doser page"
        if self.progress is not None and self.running:
            return self._run_words(self.progress)
        if self.target_ul is not None:
            return f"dosing until the tank holds {self.target_ul:g} µl"
        if self.aside_ul is not None:
            return f"delivering {self.aside_ul:g} µl into the waste vessel; the tank holds what it held"
        if self.stopped:
            return "the doser is stopped; clear the stop on the Doser page, or start a run, to go on"
        return str(self.state.value)

    def _run_words(self, now: Progress) -> str:
        if self.run_state is RunState.PAUSED:
            return f"paused before step {now.step + 1} of {now.steps}: {now.label}"
        if self.run_state is RunState.ABORTING:
            return "the run is being ended"
        state = "pausing after" if self.run_state is RunState.PAUSING else "running"
        waiting = f"; waiting for {now.waiting_for}" if now.waiting_for else ""
        models = f"; {self.preparation}" if self.preparation else ""
        if self.finishing:
            if self.tank is not None and self.tank.high_ul <= 0.0:
                return "finishing: what was recorded is being closed; without ink there is nothing to fit"
            return f"finishing: the last fits are being made{models}"
        return f"{state} step {now.step + 1} of {now.steps}: {now.label}{waiting}{models}"
