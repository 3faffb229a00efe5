"""The guard around every doser: budgets, intent before motion, and no dose after one whose end is not known."""

import math
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from typing import Any, Protocol

from tankrig.devices import Delivered, Doser
from tankrig.errors import DeviceError, TankrigError, UndecidedError

from .evidence import Account, Evidence, TankFinding, between, judge, used_elsewhere_ul
from .ledger import TankLedger
from .limits import DOSING, STOPPED, DoseLimits, Remaining, too_much_already
from .records import COUNT_KEYS, DoseDone, DoseIntent, JointCount

_CLOSE_S = 60.0


class DoseJournal(Protocol):
    """Where a run writes its doses down; each call returns when that is on the disk."""

    def dose_intent(self, intent: DoseIntent) -> None:
        """A dose is about to begin."""

    def dose_done(self, done: DoseDone) -> None:
        """It is over."""


class NoRun:
    """The journal of doses outside of runs: the tank's ledger has them already."""

    def dose_intent(self, intent: DoseIntent) -> None:
        """A dose is about to begin."""

    def dose_done(self, done: DoseDone) -> None:
        """It is over."""


class GuardedDoser:
    """A doser that keeps to budgets and accounts for the ink in the tank; itself a `tankrig.devices.Doser`.

    Volumes are what the *tank* holds, counted by its ledger since it was filled, not the doser's own count. On opening,
    and before each dose, ledger, doser and the journal of a run that goes on are asked together what it holds
    (`tankrig.dosing.evidence`): where they agree a dose that was cut off is settled; otherwise `undecided` is a
    sentence that says what a person has to decide, and nothing moves before `resolve`.

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
    known
        What the journal of a run that goes on knew last of the tank; None for a new run.
    """

    def __init__(
        self,
        doser: Doser,
        limits: DoseLimits,
        ledger: TankLedger,
        journal: DoseJournal,
        run: str,
        known: Account | None = None,
    ) -> None:
        self._doser, self._limits, self._ledger, self._journal, self._run = doser, limits, ledger, journal, run
        self._known_by_journal, self._count = known, Delivered(0.0, 0.0, 0.0)
        self._decided: dict[str, Any] = {}
        self._used_elsewhere_ul = 0.0
        self._dosing = threading.Lock()
        self._finding = TankFinding(ledger.tank)
        self._ask()

    # -- who and what ------------------------------------------------------------------------------------------------

    @property
    def name(self) -> str:
        """For messages."""
        return self._doser.name

    @property
    def identity(self) -> str:
        """What tells the device from others of its kind."""
        return self._doser.identity

    @property
    def increment_ul(self) -> float:
        """Smallest volume that the device doses, µl."""
        return self._doser.increment_ul

    @property
    def stopped(self) -> bool:
        """Whether a stop is latched."""
        return self._doser.stopped

    @property
    def unknown(self) -> bool:
        """Whether a person has to say what the tank holds."""
        return self._finding.question is not None

    @property
    def undecided(self) -> str | None:
        """What a person has to decide before anything moves, in a sentence with its numbers; None if nothing is."""
        why, dose = self._finding.question, self._ledger.open_dose
        if why is None:
            return None
        run = f" (run {dose.run})" if dose else ""
        held = between(self._finding.tank).removeprefix("it is ")
        return f"{self._ledger.path}: {why}; the tank holds {held}{run}: say how much it is in all (--delivered-ul)"

    @property
    def noted(self) -> dict[str, Any]:
        """What a run's journal notes beside the tank's content, so that it can be compared later."""
        return {**self._counted, "filled_utc": self._ledger.filled_utc, **self._decided}

    @property
    def _counted(self) -> dict[str, float]:
        return dict(zip(COUNT_KEYS, self._count, strict=True))

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
        with self._alone(f"dose to {total_ul:g} µl"):
            joint = self._known()
            before = self._ledger.tank
            self._refuse_unless_allowed(total_ul, before)
            self._journal.dose_intent(DoseIntent(total_ul, before.volume_ul, self.identity))
            self._ledger.begin(self._run, total_ul, self._count)
            with self._stopped_on_trouble():
                self._doser.dose_to(max(self._count.volume_ul, joint.count_at(total_ul)))
            return self._settled(total_ul)

    def dose_aside(self, volume_ul: float, why: str = "into a waste vessel") -> float:
        """Deliver `volume_ul` beside the tank, to prime, to rinse or to weigh it; the tank holds what it held.

        Before, a person hangs the tube elsewhere; ask for that only where nothing is `undecided`. Else a dose that
        broke off may still push, and what it pushes counts as in the tank.

        Parameters
        ----------
        volume_ul
            How much; no more than one dose may have.
        why
            Written into the ledger.

        Returns
        -------
        float
            What was delivered, µl, as the doser counts it.

        Raises
        ------
        UndecidedError
            If it is not known what the tank holds, before or after.
        DeviceError
            If it is refused (nothing has moved), stopped or interrupted.
        """
        if refusal := self._limits.refusal_aside(volume_ul):
            raise DeviceError(f"{self.name}: asked for {volume_ul:g} µl beside the tank; {refusal}")
        with self.aside(volume_ul, why) as doser:
            before_ul = self._count.volume_ul
            return doser.dose_to(before_ul + volume_ul).volume_ul - before_ul

    @contextmanager
    def aside(self, most_ul: float, why: str) -> Iterator[Doser]:
        """Lend the bare doser for movements by `most_ul` at most that do not go into the tank, such as calibrating.

        The ledger says so before anything moves, so that a crash in the middle is settled too.

        Raises
        ------
        UndecidedError
            If it is not known what the tank holds, before or after.
        StoreError
            If it cannot be written down.
        """
        with self._alone("move beside the tank"):
            self._known()
            self._ledger.begin_aside(most_ul, why)
            with self._stopped_on_trouble():
                yield self._doser
            self._ask()
            if self.undecided:
                raise UndecidedError(self.undecided)

    @contextmanager
    def _alone(self, what: str) -> Iterator[None]:
        if not self._dosing.acquire(blocking=False):
            raise DeviceError(f"{self.name}: asked to {what} while {DOSING}")
        try:
            yield
        finally:
            self._dosing.release()

    def _known(self) -> JointCount:
        """Ask again what the tank holds; where the doser's count and the tank's are put together."""
        self._ask()
        if self.undecided or self._ledger.joint is None:
            raise UndecidedError(self.undecided)
        return self._ledger.joint

    def _refuse_unless_allowed(self, total_ul: float, before: Delivered) -> None:
        asked = f"{self.name}: asked to dose until the tank holds {total_ul:g} µl, but"
        if not math.isfinite(total_ul):
            raise DeviceError(f"{asked} that is no volume")
        if self.stopped:
            raise DeviceError(f"{asked} {STOPPED}")
        more = too_much_already(total_ul, before, self.increment_ul)
        if refusal := more or self._limits.refusal(total_ul, before, self.used_ul):
            raise DeviceError(f"{asked} {refusal}")

    @contextmanager
    def _stopped_on_trouble(self) -> Iterator[None]:
        """Whatever goes wrong while the doser moves, it is stopped, and what is known of it is written down."""
        try:
            yield
        except BaseException:
            with suppress(TankrigError, OSError):
                self._doser.stop()
            with suppress(TankrigError, OSError):
                dose = self._ledger.open_dose
                if dose:
                    self._settled(dose.total_ul)
                else:
                    self._ask()
            raise

    def _settled(self, total_ul: float) -> Delivered:
        """Write down what a dose delivered, or that it is not known."""
        tank = self._ledger.tank
        in_doubt = tank._replace(high_ul=max(total_ul, tank.high_ul))
        self._finding = TankFinding(in_doubt, "the end of the last dose is not known")
        self._ask()
        if self.undecided:
            raise UndecidedError(self.undecided)
        self._journal.dose_done(self._entry(total_ul))
        return self._ledger.tank

    # -- asking, stopping, deciding ----------------------------------------------------------------------------------

    def delivered(self) -> Delivered:
        """What the tank holds, with hard bounds."""
        dose, joint = self._ledger.open_dose, self._ledger.joint
        if self._dosing.locked() and dose and joint:
            return joint.tank_at(self._doser.delivered())
        return self._finding.tank

    def remaining(self) -> Remaining:
        """What the budgets still allow, µl."""
        return self._limits.remaining(self.delivered(), self.used_ul)

    @property
    def used_ul(self) -> float:
        """Ink that the run has put into the tank, at most, µl."""
        return max(self._ledger.used_ul(self._run), self._used_elsewhere_ul)

    def account(self, total_ul: float) -> DoseDone:
        """The end of the run's last dose, to `total_ul`, for a journal that was cut off before it was written.

        Raises
        ------
        UndecidedError
            If a person has to say it first.
        """
        self._known()
        return self._entry(total_ul)

    def stop(self) -> None:
        """Stop at once, from any thread; latched until `clear_stop`."""
        self._doser.stop()

    def clear_stop(self) -> None:
        """Let the doser move again; does not move it."""
        self._doser.clear_stop()

    def resolve(self, volume_ul: float) -> None:
        """A person says what the tank holds in all; what the doser knows by now is asked first.

        Raises
        ------
        UndecidedError
            If the tank cannot hold that.
        DeviceError
            If nothing is undecided, or if the doser does not answer.
        """
        question = self._finding.question
        if question is None:
            raise DeviceError(f"{self.name}: nothing is undecided; the tank holds {self.delivered().volume_ul:g} µl")
        self._ask()
        try:
            exactly = self._finding.answered(volume_ul, self.increment_ul)
        except UndecidedError as error:
            raise UndecidedError(f"{self.name}: {error}") from None
        self._decided = {"said_ul": volume_ul, "asked": question}
        if self._finding.question is None:  # the doser has come to know meanwhile, and agrees
            return
        if self._doser.unknown:
            count, joint = self._count, self._ledger.joint
            wanted_ul = joint.count_at(exactly.volume_ul) if joint else count.low_ul
            self._doser.resolve(min(max(wanted_ul, count.low_ul), count.high_ul))
            self._count = self._doser.delivered()
        self._join(exactly, **self._decided)
        self._known_by_journal, self._finding = None, TankFinding(self._ledger.tank)

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

    # -- one question ------------------------------------------------------------------------------------------------

    def _ask(self) -> None:
        """Ask all that know something, and write down what was open and is settled now."""
        ledger = self._ledger
        self._count = self._doser.delivered()
        evidence = Evidence(
            self.identity,
            self._count,
            self._doser.unknown,
            self.increment_ul,
            ledger.account(self.identity),
            self._known_by_journal,
            ledger.after_run(self._run),
        )
        finding, self._used_elsewhere_ul = judge(evidence), used_elsewhere_ul(evidence)
        if finding.question is None:
            self._write_down(finding)
            self._known_by_journal = None
        self._finding = finding

    def _write_down(self, finding: TankFinding) -> None:
        """Close what is open in the ledger, and put the doser's count and the tank's together where they are not."""
        ledger = self._ledger
        try:
            if ledger.open_dose:
                ledger.end(finding.tank, self._count)
            anew = ledger.joint is None or ledger.joint.doser != self.identity or ledger.aside_ul is not None
            if anew or finding.tank != ledger.tank or self._used_elsewhere_ul > ledger.used_ul(self._run):
                self._join(finding.tank)
        except BaseException:
            if self._finding.question is None:
                self._finding = TankFinding(finding.tank, "it could not be written down")
            raise

    def _join(self, tank: Delivered, **why: Any) -> None:
        if self._used_elsewhere_ul > self._ledger.used_ul(self._run):
            why |= {"run": self._run, "run_used_ul": self._used_elsewhere_ul}
        self._ledger.join(JointCount(self.identity, tank, self._count), **why)

    def _entry(self, total_ul: float) -> DoseDone:
        tank = self._ledger.tank
        complete = tank.volume_ul > total_ul - self.increment_ul
        return DoseDone(*tank, complete=complete, doser=self.identity, **self._counted)
