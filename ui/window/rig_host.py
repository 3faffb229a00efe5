"""The one owner of the rig: its threads open it, look through its camera, dose, and carry out runs."""

import logging
import queue
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from PySide6.QtCore import QObject, Signal

from tankrig.calibration.file import passed_over
from tankrig.devices import CameraDevice, CameraSettings, Projector
from tankrig.dosing import GuardedDoser, TankLedger
from tankrig.errors import DeviceError, TankrigError, UndecidedError
from tankrig.pattern import Pattern
from tankrig.run.rig import Rig
from tankrig.run.state import FinishReason, RunState
from ui.window.fresh_water import said_here
from ui.window.observed_devices import LatestValue, ObservedCamera, ObservedProjector, SeenFrame
from ui.window.rig_file import RigSource
from ui.window.rig_parts import LedgerOnly, RunOrder, import_ahead
from ui.window.status import RigState, RigStatus
from ui.window.threads import OwnedThread, StopThread

if TYPE_CHECKING:
    from drivers.rig import RigFile
    from tankrig.devices import Pixels
    from tankrig.live.exposures import Photograph
    from tankrig.live.live_fit import LiveFit
    from tankrig.run.journal import Event
    from tankrig.run.runner import Runner

_log = logging.getLogger(__name__)

WATCH_S = 0.2
END_S = 40.0
FIT_PATIENCE_S = 120.0
RETRY_S = 0.2


class RigHost(QObject):
    """Opens the rig, previews while nothing else goes on, and hands the rig to a run when one is ordered.

    One thread has the camera and the projector; a dose outside of a run has one of its own, a run is carried out in
    the first. A third watches, and a fourth does nothing but stop. Signals arrive in the window's thread.

    Parameters
    ----------
    source
        Which rig.
    """

    status_changed = Signal(object)
    """RigStatus."""
    rig_opened = Signal(object)
    """RigFile, each time the rig has been opened."""
    recorded = Signal(object, object, object)
    """Path of a run, an Event of its journal, and with a fit the list of Photographs that it fitted."""
    run_began = Signal(object, object, object)
    """Path, Sequence, and the Events that its journal holds already."""
    run_ended = Signal(object)
    """Outcome."""
    left_unfitted = Signal(object, str)
    """Path of a run that is completed, and what of it has no fit; before `run_ended`."""
    pattern_shown = Signal(object)
    """Pattern that is on the projector's output."""

    def __init__(self, source: RigSource) -> None:
        super().__init__()
        self.source = source
        self.frames: LatestValue[SeenFrame] = LatestValue()
        self._orders: queue.SimpleQueue[Callable[[Rig], object]] = queue.SimpleQueue()
        self._run_order: RunOrder | None = None
        self._refill = False
        self._lent: Callable[[], object] | None = None
        self._wake = threading.Event()
        self._state, self._trouble, self._troubles = RigState.OPENING, "", 0
        self._question: str | None = None
        self._guard: GuardedDoser | None = None
        self._runner: Runner | None = None
        self._fit: LiveFit | None = None
        self._target_ul: float | None = None
        self._aside_ul: float | None = None
        self._camera: ObservedCamera | None = None
        self._dose_thread: OwnedThread | None = None
        self.camera_settings = CameraSettings(20.0)
        self._pattern: Pattern | None = None
        self._stopper = StopThread(self._stop, self._dosing)
        self._away = False
        self._description: RigFile | None = None
        self._watcher = OwnedThread("rig-watch", self._watch, 5.0)
        self._worker = OwnedThread("rig", self._work, END_S)

    # -- what the window asks for; all return at once ------------------------------------------------------------------

    def stop(self) -> None:
        """Stop the doser and abort the run, if one goes on; one that waits for a person's word is given up."""
        if self._question is not None:
            self.reopen()
        self._run_order = None
        self._stopper.press()

    def window_alive(self) -> None:
        """A sign of life; without one, ink that moves is stopped."""
        self._stopper.alive()

    def pause(self) -> None:
        """Pause the run at the end of its step."""
        if self._runner:
            self._runner.pause()

    def resume(self) -> None:
        """Go on with a paused run."""
        if self._runner:
            self._runner.resume()

    def start_run(self, order: RunOrder) -> None:
        """Carry out a run as soon as the rig has been handed over."""
        self._run_order, self._question, self._trouble = order, None, ""
        self._wake.set()

    def show(self, pattern: Pattern) -> None:
        """Put a pattern on the output, while no run goes on."""
        self._pattern = pattern
        self._orders.put(lambda rig: rig.projector.show(pattern))

    def configure(self, settings: CameraSettings) -> None:
        """Set the camera, while no run goes on."""
        self.camera_settings = settings
        self._orders.put(self._configured)

    def clear_stop(self) -> None:
        """Let the doser move again."""
        self._orders.put(lambda _: self._guarded().clear_stop())

    def resolve(self, volume_ul: float) -> None:
        """A person says what the tank holds in all."""
        if self._question is not None and self._run_order is not None:
            self.start_run(replace(self._run_order, delivered_ul=volume_ul))
        else:
            self._orders.put(lambda _: self._guarded().resolve(volume_ul))

    def dose_to(self, total_ul: float) -> None:
        """Dose, outside of a run, until the tank holds `total_ul`."""
        if not self._may_dose():
            return
        self._target_ul, self._trouble = total_ul, ""
        self._dose_thread = OwnedThread("dose", lambda _: self._dose(total_ul), END_S)

    def dose_aside(self, volume_ul: float) -> None:
        """Deliver so much into a waste vessel, outside of a run: the tank holds what it held."""
        if not self._may_dose():
            return
        self._aside_ul, self._trouble = volume_ul, ""
        self._dose_thread = OwnedThread("dose", lambda _: self._prime(volume_ul), END_S)

    def _may_dose(self) -> bool:
        ready = self._guard is not None and not self._by_hand and self._state is RigState.IDLE
        if not ready:
            self._tell("the rig is not ready to dose; wait until it is")
        return ready

    @property
    def _by_hand(self) -> bool:
        return self._target_ul is not None or self._aside_ul is not None

    def reopen(self) -> None:
        """Open the rig again after it failed, or give up what it waits for."""
        self._run_order, self._question, self._trouble = None, None, ""
        self._wake.set()

    def set_rate(self, ul_per_s: float) -> None:
        """Have the pump deliver at another rate from now on: the rig is opened again with it, while nothing moves."""
        if self._may_dose():
            _log.info("the pump's rate is %g µl/s from now on", ul_per_s)
            self.use(replace(self.source, rate_ul_per_s=ul_per_s))

    def use(self, source: RigSource) -> None:
        """Let go of the rig and open another one."""
        self.source = source
        self._pattern = None
        self.reopen()

    def refill(self) -> None:
        """The tank has been filled anew."""
        self._refill, self._trouble = True, ""
        self._wake.set()

    def lend(self, stop: Callable[[], object] | None) -> None:
        """Let go of the rig for somebody who opens it and can be told to `stop`; None: take it back."""
        self._lent = stop
        self._wake.set()

    @property
    def in_motion(self) -> bool:
        """Whether a run, a dose or a calibration goes on, so that there is something to stop."""
        return self._dosing() or (self._run_order is not None and self._question is None)

    def look_away(self, away: bool) -> None:
        """Whether the window looks at something else than the camera's preview."""
        self._away = away

    def tell_rig(self) -> None:
        """Say again which rig it is."""
        if self._description is not None:
            self.rig_opened.emit(self._description)

    def close(self) -> bool:
        """Stop, end the run, let go of the rig; whether all threads have ended in time."""
        if self._dosing():
            self.stop()
        self._worker.ending.set()
        self._wake.set()
        if self._runner:
            self._runner.abort()
        threads = (self._dose_thread, self._worker, self._watcher)
        ended = [thread.close() for thread in threads if thread is not None]
        self._stopper.close()
        return all(ended)

    # -- the thread that has camera and projector ----------------------------------------------------------------------

    def _work(self, ending: threading.Event) -> None:
        while not ending.is_set():
            self._wake.clear()
            order = self._run_order
            try:
                if self._refill:
                    self._refill = False
                    _log.info("%s", self.source.refill())
                if self._lent is not None:
                    self._wait(RigState.LENT, ending)
                elif order is None:
                    self._idle(ending)
                else:
                    self._try_run(order)
            except UndecidedError as question:
                self._ask(str(question), ending)
            except TankrigError as error:
                self._fail(str(error), ending)
            except BaseException as error:
                _log.exception("the rig's thread met what it does not know")
                self._fail(f"failed unexpectedly ({type(error).__name__}: {error}); the log tells where", ending)
        self._set(RigState.CLOSED)

    def _idle(self, ending: threading.Event) -> None:
        """Preview until something else is asked for."""
        self._set(RigState.OPENING)
        with ExitStack() as opened:
            description, rig = self._open(opened, looking=True)
            for over in passed_over(Path(description.calibration_folder), description.calibration):
                self._tell(str(over))
            ledger = TankLedger(rig.ledger)
            opened.callback(ledger.close)
            self._guard = GuardedDoser(rig.doser, rig.limits, ledger, LedgerOnly(), "bench")
            opened.callback(self._leave)
            self.rig_opened.emit(description)
            self._configured(rig)
            if self._pattern is not None and self._pattern.shape == rig.projector.shape:
                rig.projector.show(self._pattern)
            self._set(RigState.IDLE)
            while not (ending.is_set() or self._wake.is_set()):
                self._serve(rig)
                self._preview(rig.camera)

    def _configured(self, rig: Rig) -> None:
        """Set the camera as was asked for last, and know what it has made of that: it may be able to do less."""
        asked = self.camera_settings
        taken = rig.camera.configure(asked)
        if self.camera_settings == asked:  # nobody has asked for something else meanwhile
            self.camera_settings = taken

    def _serve(self, rig: Rig) -> None:
        """What the window has asked for; what a device refuses is told and changes nothing else."""
        while not self._orders.empty():
            try:
                self._orders.get()(rig)
            except TankrigError as error:
                self._tell(str(error))
            else:
                self._trouble = ""

    def _guarded(self) -> GuardedDoser:
        if self._guard is None:
            raise DeviceError("the doser is not open; open the rig again")
        return self._guard

    def _leave(self) -> None:
        """End a dose that runs, and let go of the doser."""
        if self._guard is not None:
            if self._by_hand:
                self._guard.stop()
            if self._dose_thread is not None:
                self._dose_thread.close()
            self._guard.close()
            self._guard = None

    def _open(self, opened: ExitStack, looking: bool = False) -> "tuple[RigFile, Rig]":
        from drivers.rig import open_rig

        description = self._description = self.source.description()
        rig = open_rig(description, looking, self._look_meanwhile if looking else None)
        opened.callback(rig.close)
        projector, camera = self._observed(rig.projector, rig.camera)
        return description, replace(rig, projector=projector, camera=camera)

    def _observed(self, projector: Projector, camera: CameraDevice) -> tuple[ObservedProjector, ObservedCamera]:
        seen_projector = ObservedProjector(projector, self._shown)
        self._camera = ObservedCamera(camera, seen_projector, self._see)
        return seen_projector, self._camera

    def _look_meanwhile(self, projector: Projector, camera: CameraDevice, booting: Callable[[], bool]) -> None:
        """Preview while the doser boots: a pump takes seconds, and who opens the window waits for its picture."""
        _, camera = self._observed(projector, camera)
        camera.configure(self.camera_settings)
        while booting():
            self._preview(camera)

    def _preview(self, camera: CameraDevice) -> None:
        camera.capture(time.monotonic_ns(), 5.0 + 2e-3 * self.camera_settings.exposure_ms)

    def _try_run(self, order: RunOrder) -> None:
        """What cannot be run is told, and the rig stays as it is."""
        try:
            self._carry_out(order)
        except UndecidedError:
            raise
        except TankrigError as error:
            self._tell(f"the run did not begin: {error}")
        self._run_order = None

    def _carry_out(self, order: RunOrder) -> None:
        import_ahead()
        from tankrig.live.attached import fitted_live, require_fittable
        from tankrig.live.refit import unfitted
        from tankrig.run.reading import open_run
        from tankrig.run.start import new_run, resumed_run

        self._set(RigState.RUNNING)
        with ExitStack() as opened:
            description, rig = self._open(opened)
            self.rig_opened.emit(description)
            if order.sequence is None:
                runner = resumed_run(order.path, rig, order.delivered_ul)
            else:
                require_fittable(order.sequence, rig.bench)
                runner = new_run(order.sequence, rig, order.path, order.delivered_ul)
            self._guard, self._runner = runner.doser, runner
            if self._run_order is None:  # stopped meanwhile
                runner.abort()
            try:
                with fitted_live(runner, FIT_PATIENCE_S) as self._fit:
                    runner.listen(partial(self._heard, order.path))
                    self.run_began.emit(order.path, runner.plan.sequence, open_run(order.path).journal)
                    outcome = runner.run()
            except BaseException as error:
                runner.give_up(error)  # where it could not begin: it is ended, so that it can be resumed
                raise
            finally:
                self._fit = self._runner = self._guard = None
        self._trouble = ""
        missing = unfitted(open_run(outcome.path))
        if missing:
            _log.warning("%s", missing.sentence(outcome.path))
            if outcome.reason is FinishReason.COMPLETED:
                self.left_unfitted.emit(outcome.path, str(missing))
        self.run_ended.emit(outcome)

    def _heard(self, path: Path, event: "Event", _: "Pixels | None") -> None:
        from tankrig.live.results import DoseFit, from_fields

        fit = self._fit
        if event.kind == "note" and event.get("warning"):
            self._tell(event["text"])
        photographs: list[Photograph] = []
        if event.kind == "fit" and fit is not None:
            found = from_fields(event.fields)
            photographs = fit.photographs(found.dose_ml) if isinstance(found, DoseFit) else []
        self.recorded.emit(path, event, photographs)

    def _ask(self, question: str, ending: threading.Event) -> None:
        """Wait for a person's word on the ink, or for the run to be given up."""
        self._question = question
        _log.warning("%s", question)
        self._wait(RigState.ASKING, ending)

    def _fail(self, sentence: str, ending: threading.Event) -> None:
        """Say what is wrong and wait for a person."""
        self._run_order = None
        self._tell(sentence)
        self._wait(RigState.FAILED, ending)

    def _wait(self, state: RigState, ending: threading.Event) -> None:
        self._set(state)
        while not (ending.is_set() or self._wake.wait(RETRY_S)):
            pass

    # -- dosing, stopping, watching ------------------------------------------------------------------------------------

    def _dose(self, total_ul: float) -> None:
        guard = self._guard
        try:
            if guard is not None:
                guard.dose_to(total_ul)
        except TankrigError as error:
            self._tell(str(error))
        finally:
            self._target_ul = None

    def _prime(self, volume_ul: float) -> None:
        guard = self._guard
        try:
            if guard is not None:
                pushed_ul = guard.dose_aside(volume_ul)
                _log.info("%g µl went into the waste vessel; the tank holds what it held", pushed_ul)
        except TankrigError as error:
            self._tell(str(error))
        finally:
            self._aside_ul = None

    def _dosing(self) -> bool:
        return self._by_hand or self._runner is not None or self._lent is not None

    def _stop(self) -> None:
        runner, guard = self._runner, self._guard
        stop = runner.abort if runner is not None else self._lent or (guard.stop if guard is not None else None)
        if stop is not None:
            stop()
        _log.warning("STOP: %s", "the run is aborted" if runner else "the doser is stopped")

    def _watch(self, ending: threading.Event) -> None:
        while not ending.wait(WATCH_S):
            self._publish()

    def _publish(self) -> None:
        guard, runner = self._guard, self._runner
        status = RigStatus(
            self._state,
            self._trouble,
            self._troubles,
            target_ul=self._target_ul,
            undecided=self._question,
            aside_ul=self._aside_ul,
            exposing_left_s=self._camera.exposing_left_s if self._camera is not None else None,
        )
        if guard is not None:
            with suppress(DeviceError, AttributeError):  # a device that is gone is told of by whoever works with it
                status = replace(
                    status, tank=guard.delivered(), remaining=guard.remaining(), stopped=guard.stopped,
                    used_ul=guard.used_ul, increment_ul=guard.increment_ul,
                    undecided=self._question or (None if self._dosing() else guard.undecided),
                )  # fmt: skip
        if runner is not None:
            preparation = _preparation(self._fit) if self._fit is not None else ""
            status = replace(status, progress=runner.progress(), run_state=runner.state, preparation=preparation)
            if runner.state is RunState.RUNNING and status.progress is not None:
                status = replace(status, target_ul=None)
        self.status_changed.emit(status)

    def _see(self, frame: SeenFrame) -> None:
        if not self._away:
            self.frames.put(frame)

    def _shown(self, pattern: Pattern) -> None:
        self.pattern_shown.emit(pattern)

    def _set(self, state: RigState) -> None:
        self._state = state
        self._publish()

    def _tell(self, sentence: str) -> None:
        sentence = said_here(sentence)
        self._trouble, self._troubles = sentence, self._troubles + 1
        _log.error("%s", sentence)


def _preparation(fit: "LiveFit") -> str:
    """What the fits of a run wait for, in words; imported where there are fits, for it brings numba along."""
    from tankrig.live.formatting import preparation_in_words

    return preparation_in_words(fit.preparation)
