"""The states a run goes through, and which follow which."""

import threading
from collections.abc import Callable
from enum import Enum

from tankrig.errors import SequenceError, TankrigError


class RunState(Enum):
    """Where a run stands."""

    READY = "ready"
    RUNNING = "running"
    PAUSING = "pausing at the end of the step"
    PAUSED = "paused"
    ABORTING = "aborting"
    FINISHED = "finished"


class FinishReason(Enum):
    """Why a run has finished."""

    COMPLETED = "completed"
    ABORTED = "aborted"
    FAILED = "failed"


class AbortedError(TankrigError):
    """A person has aborted the run."""


_NEXT = {
    RunState.READY: {RunState.RUNNING, RunState.ABORTING, RunState.FINISHED},
    RunState.RUNNING: {RunState.PAUSING, RunState.ABORTING, RunState.FINISHED},
    RunState.PAUSING: {RunState.PAUSED, RunState.RUNNING, RunState.ABORTING, RunState.FINISHED},
    RunState.PAUSED: {RunState.RUNNING, RunState.ABORTING, RunState.FINISHED},
    RunState.ABORTING: {RunState.FINISHED},
    RunState.FINISHED: set(),
}


class RunStates:
    """The state machine of one run; any thread may ask for a change, and the runner's waits wake at each.

    ::

                run             pause              the step is done
        READY ───────▶ RUNNING ───────▶ PAUSING ────────────────────▶ PAUSED
                          ▲               │                             │
                          └─── resume ────┴────────── resume ───────────┘

        READY, RUNNING, PAUSING, PAUSED ── abort ──▶ ABORTING ── all is let go ──▶ FINISHED
        READY, RUNNING, PAUSING, PAUSED ── the last step is done, or a failure; all is let go ──▶ FINISHED

    A pause takes effect between two steps and nowhere else, so that no exposure, dose or wait is cut in two. An abort
    takes effect at once: the runner stops the doser before it asks for this state, and its waits end with
    `AbortedError`. FINISHED is reached once devices, journal and disk have been let go, and nothing follows it.

    Examples
    --------
    >>> states = RunStates()
    >>> states.move(RunState.RUNNING)
    >>> states.request_pause()
    >>> states.now
    <RunState.PAUSING: 'pausing at the end of the step'>
    """

    def __init__(self) -> None:
        self._state = RunState.READY
        self._change = threading.Condition()

    @property
    def now(self) -> RunState:
        """The state."""
        return self._state

    def move(self, state: RunState) -> None:
        """Go to `state`.

        Raises
        ------
        SequenceError
            When that does not follow from the state now.
        """
        with self._change:
            if state not in _NEXT[self._state]:
                raise SequenceError(f"the run is {self._state.value}, so it cannot be {state.value} next")
            self._state = state
            self._change.notify_all()

    def request_pause(self) -> None:
        """Pause at the end of the step; nothing to do unless it is running."""
        self._move_if(RunState.RUNNING, RunState.PAUSING)

    def request_resume(self) -> None:
        """Go on; nothing to do unless it is paused or about to be."""
        self._move_if(RunState.PAUSED, RunState.RUNNING)
        self._move_if(RunState.PAUSING, RunState.RUNNING)

    def request_abort(self) -> None:
        """End as soon as devices allow; nothing to do when it has ended."""
        with self._change:
            if RunState.ABORTING in _NEXT[self._state]:
                self._state = RunState.ABORTING
                self._change.notify_all()

    def check(self) -> None:
        """Raise `AbortedError` when the run is to end."""
        if self._state is RunState.ABORTING:
            raise AbortedError("the run was aborted")

    def sleep(self, seconds: float) -> None:
        """Wait, but not through an abort."""
        with self._change:
            self._change.wait_for(lambda: self._state is RunState.ABORTING, seconds)
        self.check()

    def step_boundary(self, paused: Callable[[], None], resumed: Callable[[], None]) -> None:
        """The one place where a run pauses; `paused` and `resumed` are called before and after."""
        self.check()
        if self._move_if(RunState.PAUSING, RunState.PAUSED):
            paused()
            with self._change:
                self._change.wait_for(lambda: self._state is not RunState.PAUSED)
            self.check()
            resumed()

    def _move_if(self, state: RunState, following: RunState) -> bool:
        with self._change:
            moved = self._state is state
            if moved:
                self._state = following
                self._change.notify_all()
            return moved
