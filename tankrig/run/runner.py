"""The runner: carries out a sequence on a rig, step by step, and records it."""

import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

from tankrig.devices import Pixels
from tankrig.dosing import DoseDone, DoseIntent, GuardedDoser
from tankrig.errors import DeviceError, SequenceError, StoreError, TankrigError
from tankrig.pattern import Pattern
from tankrig.run.conditions import Conditions
from tankrig.run.event_dispatcher import EventDispatcher, Listener
from tankrig.run.mixing import MixingWatch
from tankrig.run.pattern_display import PatternDisplay
from tankrig.run.progress import Progress, ProgressEstimator
from tankrig.run.rig import Rig
from tankrig.run.state import FinishReason, RunState, RunStates
from tankrig.run.writer import RunWriter
from tankrig.sequence import Burst, Capture, Dose, DryRun, Mix, Note, Sequence, Wait

_log = logging.getLogger(__name__)

_MOST_SATURATED = 0.2
_NEARLY_MIXED = 0.1
"""Share of the picture that is still to change, from which on it tells about as well what ink it is."""
_POLL_S = 0.1
_CATCH_UP_S, _LOOK_S = 2.0, 0.01
"""How long, in all, a step without a timeout waits for a fast live fit to have seen its frames; from look to look."""


@dataclass(frozen=True)
class Outcome:
    """How a run ended.

    Parameters
    ----------
    reason
        Completed, aborted or failed.
    path
        The run's folder.
    error
        What went wrong, when it failed.
    """

    reason: FinishReason
    path: Path
    error: TankrigError | None = None


@dataclass(frozen=True)
class RunPlan:
    """What a runner has to do.

    Parameters
    ----------
    sequence
        All of it.
    patterns
        Drawn, by name.
    dry_run
        What it takes.
    first_step
        Number of the first step that is not done yet.
    frames_taken
        Of that step.
    """

    sequence: Sequence
    patterns: Mapping[str, Pattern]
    dry_run: DryRun
    first_step: int = 0
    frames_taken: int = 0


UNFITTED = "there is no live fit, so that no step stops early: every capture takes all its frames"


class RunJournal:
    """The run's journal as the guarded doser writes it: what it says is on the disk when a call returns."""

    def __init__(self) -> None:
        self.writer: RunWriter | None = None
        self.step: int | None = None

    def dose_intent(self, intent: DoseIntent) -> None:
        """A dose is about to begin."""
        self._write("dose_intent", asdict(intent))

    def dose_done(self, done: DoseDone) -> None:
        """It is over."""
        self._write("dose_done", asdict(done))

    def _write(self, kind: Literal["dose_intent", "dose_done"], fields: Mapping[str, Any]) -> None:
        if self.writer is None:
            raise StoreError("a dose was asked for before there was a journal to write it to; begin a run first")
        self.writer.put(kind, step=self.step, **fields)
        self.writer.flush()


class Runner:
    """Carries out one sequence, once; `tankrig.run.start` makes it.

    `run` works in the thread that calls it; `pause`, `resume` and `abort` may be called from any other. It pauses at
    the end of a step only, and an abort stops the doser before anything else::

                run             pause              the step is done
        READY ───────▶ RUNNING ───────▶ PAUSING ────────────────────▶ PAUSED
                        │ ▲               │                             │
                        │ └─── resume ────┴────────── resume ───────────┘
                        │
                        │ the last step is done and the fits are recorded, or something has failed, or `abort`
                        ▼
        stop the doser (unless all is done), go dark, close the doser, write `end`, let go of rig, writer and listeners:
        each is tried, whatever the others raise
                        │
                        ▼
                     FINISHED, with an `Outcome`: completed, aborted or failed

    Between `abort` and FINISHED the state is ABORTING; `tankrig.run.state` has the table of what may follow what.

    Parameters
    ----------
    rig, doser, writer, dispatcher, journal
        What it works with; closed when it ends, the doser first.
    plan
        What to do.
    """

    def __init__(
        self,
        rig: Rig,
        doser: GuardedDoser,
        writer: RunWriter,
        dispatcher: EventDispatcher,
        journal: RunJournal,
        plan: RunPlan,
    ) -> None:
        self._rig, self._doser, self._writer, self._dispatcher = rig, doser, writer, dispatcher
        self._journal, self._plan = journal, plan
        self._states = RunStates()
        self._estimator = ProgressEstimator(plan.dry_run, plan.first_step)
        self._display = PatternDisplay(rig, writer, doser)
        self._newest_lit = -1
        self._taken_up = False
        self.path = writer.path
        self._latest_fit: Mapping[str, Any] | None = None
        self._dose_fit: Mapping[str, Any] = {}
        self.fitted = False
        """Whether a live fit is attached: without one no step stops early."""
        self.before_end: list[Callable[[], bool]] = []
        """After the last step the end is not recorded before each of these has said yes: who still has fits to record
        holds it back. They are asked again and again, and an abort ends the waiting."""
        self.while_mixing: list[Callable[[Pattern, Pixels, Conditions], object]] = []
        """Called with pictures of ink that has nearly mixed, which are not recorded, in the thread of the run: who
        wants to know early what ink it is need not wait for frames. They have to return at once."""

    @property
    def state(self) -> RunState:
        """Where the run stands."""
        return self._states.now

    @property
    def doser(self) -> GuardedDoser:
        """For asking what the tank holds, and for stopping; the run alone doses."""
        return self._doser

    @property
    def plan(self) -> RunPlan:
        """What it has to do."""
        return self._plan

    @property
    def latest_fit(self) -> Mapping[str, Any] | None:
        """What the live fit has found last, as it tells it."""
        return self._latest_fit

    @latest_fit.setter
    def latest_fit(self, table: Mapping[str, Any] | None) -> None:
        self._latest_fit = table
        if table and table.get("fit") == "dose":
            self._dose_fit = table

    def progress(self) -> Progress:
        """How far the run is."""
        return self._estimator.progress()

    def listen(self, listener: Listener) -> None:
        """Call `listener(event, pixels)` after each event is safely recorded, in a thread that the run never waits for.

        `pixels` is None but for frames, and for a frame too when the listener has fallen behind.
        """
        self._dispatcher.listen(listener)

    def record(self, kind: Literal["fit", "note"], **fields: Any) -> None:
        """Record what a fit found, or a note, from any thread."""
        if kind == "fit":
            self.latest_fit = fields
        self._writer.put(kind, **fields)

    def pause(self) -> None:
        """Pause at the end of the step."""
        self._states.request_pause()

    def resume(self) -> None:
        """Go on after a pause."""
        self._states.request_resume()

    def abort(self) -> None:
        """Stop the doser at once, then end the run."""
        try:
            self._doser.stop()
        finally:
            self._states.request_abort()

    def run(self) -> Outcome:
        """Carry the sequence out.

        Returns
        -------
        Outcome
            Also when devices, the disk or the sequence fail. Other errors are raised when all is cleaned up. In each
            case the doser has been stopped first, and what was recorded is safe.
        """
        if self._taken_up:
            raise SequenceError(f"{self.path}: this runner has done its work; resume the run with another")
        self._taken_up, error = True, None
        try:
            self._states.move(RunState.RUNNING)
            self._carry_out()
        except BaseException as caught:  # whatever it was: it is told when all is cleaned up
            error = caught
        return self._ended(error)

    def give_up(self, error: BaseException | None = None) -> None:
        """Let go of everything when `run` was never called, and record why; nothing to do when it was.

        Parameters
        ----------
        error
            What kept the run from beginning.
        """
        if not self._taken_up:
            self._taken_up = True
            self._states.request_abort()
            self._end(FinishReason.FAILED if error else FinishReason.ABORTED, error)

    def _carry_out(self) -> None:
        self._begin()
        tasks = self._plan.sequence.tasks
        for step in range(self._plan.first_step, len(tasks)):
            self._states.step_boundary(partial(self._writer.put, "note", text="paused"), self._resumed)
            self._do(step)
        self._wait_for_the_rest()
        self._writer.flush()

    def _ended(self, error: BaseException | None) -> Outcome:
        """Clean up after what happened, and tell it; what is no error of tankrig's is raised."""
        if error is None:
            reason = FinishReason.COMPLETED
        elif isinstance(error, TankrigError) and self._states.now is RunState.ABORTING:
            reason = FinishReason.ABORTED
            error = error if self._undecided() else None  # devices that were stopped complain
        else:
            reason = FinishReason.FAILED
        trouble = self._end(reason, error)
        if trouble is not None and not isinstance(trouble, TankrigError):
            raise trouble
        if trouble and reason is FinishReason.COMPLETED:
            reason = FinishReason.FAILED
        return Outcome(reason, self.path, trouble)

    def _undecided(self) -> bool:
        try:
            return self._doser.unknown
        except Exception:  # a doser that cannot be asked
            return True

    def _wait_for_the_rest(self) -> None:
        self._estimator.waiting_for = "the last fits"
        for ready in self.before_end:
            while not self._says_yes(ready):
                self._states.sleep(_POLL_S)

    def _says_yes(self, ready: Callable[[], bool]) -> bool:
        """One that fails is not waited for: what the run recorded is complete without it."""
        try:
            return ready()
        except Exception as error:
            _log.exception("what the run's end waited for has failed")
            text = f"what the run's end waited for has failed ({type(error).__name__}: {error}); it is not waited for"
            self._writer.put("note", text=text, warning=True)
            return True

    def _resumed(self) -> None:
        self._display.forget()  # a person may have had another pattern there
        self._writer.put("note", text="resumed")

    def _begin(self) -> None:
        held, rig = self._doser.delivered(), self._rig
        self._writer.put(
            "session",
            program=f"tankrig {version('tankrig')}",
            first_step=self._plan.first_step,
            rig=rig.name,
            devices={"projector": rig.projector.name, "camera": rig.camera.name, "doser": rig.doser.identity},
            delivered_ul=held.volume_ul,
            delivered_low_ul=held.low_ul,
            delivered_high_ul=held.high_ul,
            **self._doser.noted,
        )
        if not self.fitted and any(isinstance(t.action, Capture) and t.action.until for t in self._plan.sequence.tasks):
            self._writer.put("note", text=UNFITTED)
        if self._doser.stopped:  # a person who starts a run has seen to what it was stopped for
            self._doser.clear_stop()
            self._writer.put("note", text="the doser's stop was cleared")
        self._writer.flush()

    def _do(self, step: int) -> None:
        task = self._plan.sequence.tasks[step]
        self._journal.step = step
        if not isinstance(task.action, Capture | Note):
            self._display.forget()
        self._estimator.begin(step)
        self._writer.put("step", step=step, state="begun", label=task.label)
        match task.action:
            case Dose() as dose:
                fields = self._dose(dose)
            case Mix() as mix:
                fields = self._mix(mix, task.label)
            case Capture() as capture:
                fields = self._capture(capture, step)
            case Burst() as burst:
                fields = self._burst(burst, step)
            case Wait(seconds):
                self._estimator.waiting_for = "time to pass"
                self._states.sleep(seconds)
                fields = {}
            case Note(text):
                self._writer.put("note", text=text)
                fields = {}
        self._writer.put("step", step=step, state="done", **fields)
        self._estimator.done(type(task.action))

    def _dose(self, dose: Dose) -> dict[str, Any]:
        if self._doser.delivered().volume_ul >= dose.total_ul - self._doser.increment_ul / 2:
            return {"moved": False}
        self._estimator.waiting_for = f"{self._doser.name} to dose to {dose.total_ul:g} µl"
        self._doser.dose_to(dose.total_ul)
        return {"moved": True}

    def _mix(self, mix: Mix, label: str) -> dict[str, Any]:
        pattern = self._plan.patterns[mix.pattern]
        self._estimator.waiting_for = "the first pictures of the ink"
        self._display.show(pattern, self._plan.sequence.camera_settings(mix))
        watch, start_s = MixingWatch(), time.monotonic()
        while True:
            self._states.check()
            frame, conditions = self._display.frame()
            saturated = float((frame.pixels >= self._rig.camera.saturation).mean())
            if saturated > _MOST_SATURATED:
                raise SequenceError(
                    f"{label}: {saturated:.0%} of the picture is saturated, where no ink is seen to mix; give the step "
                    f"a shorter exposure_ms or another pattern, then start anew"
                )
            mixing = watch.look(frame.pixels, frame.exposure_start_ns / 1e9)
            if mixing.remaining <= mix.tolerance and mixing.seconds >= mix.at_least_s:
                return {**asdict(mixing), "pattern_hash": pattern.hash}
            if mixing.remaining <= _NEARLY_MIXED:
                for see in self.while_mixing:
                    see(pattern, frame.pixels, conditions)
            if time.monotonic() - start_s > mix.timeout_s:
                raise DeviceError(
                    f"{label}: up to {min(mixing.remaining, 1.0):.1%} of the picture still changed after "
                    f"{mix.timeout_s:g} s, "
                    f"and {mix.tolerance:.1%} is allowed; stir, or allow more or longer, then resume the run"
                )
            if mixing.remaining < 1.0:
                self._estimator.waiting_for = (
                    f"the ink to mix: up to {mixing.remaining:.2%} of the picture changes, {mix.tolerance:.2%} may"
                )
            self._states.sleep(mix.every_s)

    def _capture(self, capture: Capture, step: int) -> dict[str, Any]:
        pattern = self._plan.patterns[capture.pattern]
        taken = self._plan.frames_taken if step == self._plan.first_step else 0
        begun_s, previous = time.monotonic(), None
        for number in range(taken, capture.frames):
            why = self._enough(capture, begun_s, number)
            if why:
                return {"frames": number, "stopped": why}
            self._states.check()
            if number == taken:
                self._estimator.waiting_for = "the camera"
                self._display.show(pattern, self._plan.sequence.camera_settings(capture))
            frame, conditions = self._display.frame()
            if previous is not None and frame.sequence > previous + 1:
                self._writer.put("gap", step=step, missing=frame.sequence - previous - 1, after=previous)
            index = self._writer.put_frame(frame, step, pattern.hash, **conditions.line())
            if pattern.pixels.any():
                self._newest_lit = index
            previous = frame.sequence
        return {}

    def _burst(self, burst: Burst, step: int) -> dict[str, Any]:
        patterns = [self._plan.patterns[name] for name in burst.patterns]
        taken = self._plan.frames_taken if step == self._plan.first_step else 0
        self._estimator.waiting_for = "the camera"
        settings = self._plan.sequence.camera_settings(burst)
        while taken < burst.frames:
            self._states.check()
            now = patterns[taken % len(patterns) :]
            frames, conditions = self._display.burst(now, settings)
            for frame, pattern in zip(frames, now, strict=True):
                index = self._writer.put_frame(frame, step, pattern.hash, **conditions.line())
                if pattern.pixels.any():
                    self._newest_lit = index
            taken += len(now)
        return {}

    def _enough(self, capture: Capture, begun_s: float, frames: int) -> str:
        """Why a step takes no more frames; empty when it goes on."""
        if capture.until is None or not self.fitted:
            return ""
        self._estimator.waiting_for = "the live fit"
        patient = capture.timeout_s is not None and frames > 1  # two frames tell the noise
        longest_s = (frames and capture.timeout_s) or _CATCH_UP_S  # before the first frame there is the last step's fit
        if (fit := self._caught_up(begun_s + longest_s, patient)) and capture.until.reached(fit):
            return capture.until.found(fit)
        if capture.timeout_s is not None and time.monotonic() - begun_s > capture.timeout_s:
            return f"{capture.timeout_s:g} s have passed"
        return ""

    def _caught_up(self, end_s: float, patient: bool) -> Mapping[str, Any] | None:
        """The live fit of the dose under way, None where there is none; a fast one is waited for, or any."""
        while (patient or self._dose_fit.get("model") == "prepared") and time.monotonic() < end_s:
            if self._dose_fit.get("newest", -1) >= self._newest_lit:
                break
            self._states.sleep(_LOOK_S)
        fit = self._dose_fit
        of_now = abs(fit.get("dose_ml", -1.0) - self._doser.delivered().volume_ul / 1000) < 1e-6
        return fit if of_now and "error" not in fit else None

    def _end(self, reason: FinishReason, error: BaseException | None) -> BaseException | None:
        """Stop the doser unless all went well, go dark, record the end, let go of everything; the first error.

        Whatever one of these raises, the others are still done.
        """
        errors = [error] if error is not None else []

        def attempt(action: Callable[[], object]) -> None:
            try:
                action()
            except BaseException as caught:
                errors.append(caught)

        def record() -> None:
            self._writer.finish(reason=reason.value, message=_sentence(errors[0]) if errors else "")

        if reason is not FinishReason.COMPLETED:
            attempt(self._doser.stop)
        attempt(lambda: self._rig.projector.show(self._plan.patterns["dark"]))
        attempt(self._doser.close)
        attempt(record)
        attempt(self._rig.close)
        attempt(self._writer.close)
        attempt(self._dispatcher.close)
        attempt(lambda: self._states.move(RunState.FINISHED))
        for later in errors[1:]:
            _log.error("while the run was ended: %s", _sentence(later))
        return errors[0] if errors else None


def _sentence(error: BaseException) -> str:
    """An error in words; of one that is not tankrig's own, its name too."""
    return str(error) if isinstance(error, TankrigError) else f"failed unexpectedly ({type(error).__name__}: {error})"
