"""The guard around every doser: budgets, intent before motion, and no dose after one whose end is not known."""

import math
import threading
from contextlib import ExitStack, suppress
from typing import Protocol

from tankrig.devices import Delivered, Doser
from tankrig.errors import DeviceError, StoreError, UndecidedError

from .ledger import TankLedger
from .limits import DoseLimits, Remaining
from .records import DoseDone, DoseIntent, Joint

_CLOSE_S = 60.0


class DoseJournal(Protocol):
    """Where a run writes its doses down; each call returns when that is on the disk."""

    def dose_intent(self, intent: DoseIntent) -> None:
        """A dose is about to begin."""

    def dose_done(self, done: DoseDone) -> None:
        """It is over."""


class GuardedDoser:
    """A doser that keeps to budgets and accounts for the ink in the tank; itself a `tankrig.devices.Doser`.

    Volumes are what the *tank* holds, counted by its ledger since it was filled, not the doser's own count. On opening
    it reconciles: a dose that was begun and is not known to have ended is settled by the doser's count where that lies
    between the dose's two ends; otherwise `undecided` is a sentence that says what a person has to decide, and nothing
    moves before `resolve`.

    Whenever a journal holds an intent without its end and nothing is undecided, `account` is the entry that it lacks.

    Parameters
    ----------
    doser
        The device; closed with the guard.
    limits
        Budgets.
    ledger
        Of the tank; closed with the guard.
    journal
        Of the run.
    run
        Names the run in the ledger, the same when it is resumed.
    """

    def __init__(self, doser: Doser, limits: DoseLimits, ledger: TankLedger, journal: DoseJournal, run: str) -> None:
        self._doser, self._limits, self._ledger, self._journal, self._run = doser, limits, ledger, journal, run
        self._dosing = threading.Lock()
        self.undecided = self._reconciled()

    # -- who and what ------------------------------------------------------------------------------------------------

    @property
    def name(self) -> str:
        """For messages."""
        return self._doser.name

    @property
    def identity(self) -> str:
        """Of the device."""
        return self._doser.identity

    @property
    def increment_ul(self) -> float:
        """Of the device."""
        return self._doser.increment_ul

    @property
    def stopped(self) -> bool:
        """Whether a stop is latched."""
        return self._doser.stopped

    @property
    def unknown(self) -> bool:
        """Whether a person has to say what the tank holds."""
        return self.undecided is not None

    # -- dosing ------------------------------------------------------------------------------------------------------

    def dose_to(self, total_ul: float) -> Delivered:
        """Dose until the tank holds `total_ul`; returns what it then holds.

        The intent is on the disk, in the journal and in the ledger, before anything moves; on any exception the doser
        is stopped, and what it delivered is written down if it is known.

        Raises
        ------
        UndecidedError
            If it is not known what the tank holds, before or after.
        DeviceError
            If it is refused (nothing has moved), stopped or interrupted.
        StoreError
            If it cannot be written down.
        """
        if not self._dosing.acquire(blocking=False):
            raise DeviceError(f"{self.name}: asked to dose to {total_ul:g} µl while it doses; wait for it or stop it")
        try:
            return self._dose(total_ul)
        finally:
            self._dosing.release()

    def _dose(self, total_ul: float) -> Delivered:
        joint = self._known()
        count = self._doser.delivered()
        before = joint.tank_at(count)
        self._refuse_unless_allowed(total_ul, before)
        self._journal.dose_intent(DoseIntent(total_ul, before.volume_ul, self.identity))
        self._ledger.begin(self._run, total_ul)
        try:
            self._doser.dose_to(max(count.volume_ul, joint.count_at(total_ul)))
        except BaseException:
            self._doser.stop()
            with suppress(DeviceError, StoreError):
                self._settle(joint, total_ul)
            raise
        return self._settle(joint, total_ul)

    def _known(self) -> Joint:
        if self.undecided or self._ledger.open_dose or self._doser.unknown:
            self.undecided = self._reconciled()
        if self.undecided is not None or self._ledger.joint is None:
            raise UndecidedError(self.undecided)
        return self._ledger.joint

    def _refuse_unless_allowed(self, total_ul: float, before: Delivered) -> None:
        asked = f"{self.name}: asked to dose until the tank holds {total_ul:g} µl, but"
        if not math.isfinite(total_ul):
            raise DeviceError(f"{asked} that is no volume")
        if self.stopped:
            raise DeviceError(f"{asked} a stop is latched; clear it first")
        if total_ul < before.volume_ul - self.increment_ul:
            raise DeviceError(f"{asked} it holds {before.volume_ul:g} µl already; fill it anew and start a new ledger")
        if refusal := self._limits.refusal(total_ul, before, self._ledger.used_ul(self._run)):
            raise DeviceError(f"{asked} {refusal}")

    def _settle(self, joint: Joint, total_ul: float) -> Delivered:
        """Write down what a dose delivered, or that it is not known."""
        self.undecided = self._question("the end of the last dose is not known")
        if self._doser.unknown:
            raise UndecidedError(self.undecided)
        tank = joint.tank_at(self._doser.delivered())
        self._ledger.end(tank)
        self.undecided = None
        self._journal.dose_done(self._entry(tank, total_ul))
        return tank

    # -- asking, stopping, deciding ----------------------------------------------------------------------------------

    def delivered(self) -> Delivered:
        """What the tank holds, with hard bounds."""
        if self._dosing.locked() and self._ledger.joint:
            return self._ledger.joint.tank_at(self._doser.delivered())
        tank, dose = self._ledger.tank, self._ledger.open_dose
        if dose:
            return tank._replace(high_ul=max(dose.total_ul, tank.high_ul))
        return tank._replace(high_ul=math.inf) if self.undecided else tank

    def remaining(self) -> Remaining:
        """What the budgets still allow, µl."""
        return self._limits.remaining(self.delivered(), self._ledger.used_ul(self._run))

    def account(self, total_ul: float) -> DoseDone:
        """The end of the run's last dose, to `total_ul`, for a journal that was cut off before it was written.

        Raises
        ------
        UndecidedError
            If a person has to say it first.
        """
        self._known()
        return self._entry(self._ledger.tank, total_ul)

    def stop(self) -> None:
        """Stop at once, from any thread; latched until `clear_stop`."""
        self._doser.stop()

    def clear_stop(self) -> None:
        """Let the doser move again; does not move it."""
        self._doser.clear_stop()

    def resolve(self, volume_ul: float) -> None:
        """A person says what the tank holds in all.

        Raises
        ------
        DeviceError
            If nothing is undecided, or if the tank cannot hold that.
        """
        if self.undecided is None:
            raise DeviceError(f"{self.name}: nothing is undecided; the tank holds {self.delivered().volume_ul:g} µl")
        bounds = self.delivered()
        slack_ul = self.increment_ul
        if not bounds.low_ul - slack_ul <= volume_ul <= bounds.high_ul + slack_ul or math.isinf(volume_ul):
            raise DeviceError(
                f"{self.name}: the tank cannot hold {volume_ul:g} µl; "
                f"it is between {bounds.low_ul:g} and {bounds.high_ul:g} µl"
            )
        count, joint = self._doser.delivered(), self._ledger.joint
        if self._doser.unknown:
            wanted_ul = joint.count_at(volume_ul) if joint else count.low_ul
            self._doser.resolve(min(max(wanted_ul, count.low_ul), count.high_ul))
        exactly = Delivered(volume_ul, volume_ul, volume_ul)
        self._ledger.join(Joint(self.identity, exactly, self._doser.delivered()))
        self.undecided = None

    def close(self) -> None:
        """Stop a dose that runs, write down what it delivered, and let go of doser and ledger."""
        with ExitStack() as last_first:
            try:
                if self._dosing.locked():
                    self._doser.stop()
            finally:  # a device that fails to stop or to close must not keep the ledger from other programs
                if self._dosing.acquire(timeout=_CLOSE_S):
                    last_first.callback(self._dosing.release)
                last_first.callback(self._ledger.close)
                last_first.callback(self._doser.close)

    # -- reconciling -------------------------------------------------------------------------------------------------

    def _reconciled(self) -> str | None:
        """Settle by the doser's count what was left open; what a person has to decide if that cannot be done."""
        joint, dose = self._ledger.joint, self._ledger.open_dose
        if self._doser.unknown:
            return self._question(f"{self.name} does not know what it has delivered")
        count = self._doser.delivered()
        if joint is None or (dose is None and joint.doser != self.identity):
            self._ledger.join(Joint(self.identity, self._ledger.tank, count))
            return None
        tank, slack_ul = joint.tank_at(count), 0.5 * self.increment_ul
        low_ul = self._ledger.tank.volume_ul - slack_ul
        high_ul = (dose.total_ul if dose else self._ledger.tank.volume_ul) + slack_ul
        if joint.doser != self.identity:
            return self._question(f"a dose was begun with {joint.doser}, not with {self.identity}")
        if not low_ul <= tank.volume_ul <= high_ul:
            return self._question(f"{self.name} has moved since without this tank's ledger")
        if dose:
            self._ledger.end(tank)
        return None

    def _question(self, what: str) -> str:
        tank, dose = self._ledger.tank, self._ledger.open_dose
        held = f"at least {tank.low_ul:g} µl"
        if dose:
            held = f"between {tank.low_ul:g} and {dose.total_ul:g} µl (run {dose.run})"
        return f"{self._ledger.path}: {what}; the tank holds {held}: say how much it is in all (--delivered-ul)"

    def _entry(self, tank: Delivered, total_ul: float) -> DoseDone:
        return DoseDone(*tank, complete=tank.volume_ul > total_ul - self.increment_ul)
