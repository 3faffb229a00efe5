"""What a tank holds is one question: whatever happens to ledger, journal, doser and program, its answer is true.

A state machine lives through dilution series on a doser in memory, with ledgers in memory too: programs are killed at
any moment, any write and any call of the device can fail, ink moves by hand, ledgers are lost, restored from old copies
or begun anew in fresh water, other runs dose in between, pumps are calibrated and exchanged. The person who is asked
knows the truth. After each step: no budget is exceeded, and what is told of the tank holds what is in it.
"""

import os
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import hypothesis.strategies as st
import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)

from tankrig.devices import Delivered
from tankrig.dosing import DoseDone, DoseIntent, DoseLimits, GuardedDoser, TankLedger
from tankrig.dosing import ledger as ledger_module
from tankrig.errors import DeviceError, StoreError, TankrigError, UndecidedError
from tankrig.run.journal import Event, Moment
from tankrig.run.reading import Run
from tankrig.run.start import known_by_journal

LIMITS = DoseLimits(dose_ul=60.0, run_ul=150.0, tank_ul=220.0)
ROUNDING_UL = 1e-3
MEMORY = Path("/dev/shm")
QUIET: dict[str, Any] = {
    "deadline": None, "suppress_health_check": list(HealthCheck), "database": None, "phases": [Phase.generate]
}  # fmt: skip


class Killed(BaseException):
    """The program ends here."""


class Trouble:
    """Lets the n-th thing that can fail do so, once; or ends the program there."""

    def __init__(self) -> None:
        self.left: int | None = None
        self.kills = self.dead = False

    def arm(self, after: int | None, kills: bool = False) -> None:
        self.left, self.kills, self.dead = after, kills, False

    def strikes(self) -> bool:
        if self.dead:
            raise Killed
        if self.left is None:
            return False
        self.left -= 1
        if self.left >= 0:
            return False
        self.left = None
        if self.kills:
            self.dead = True
            raise Killed
        return True


class Pump:
    """A doser in memory; what it pushes out goes where its tube hangs."""

    def __init__(self, number: int, pour: Callable[[float], None], trouble: Trouble) -> None:
        self.name, self.number, self.pour, self.trouble = f"pump {number}", number, pour, trouble
        self.increment_ul, self.correction = 0.1, 1.0
        self.nominal_ul = 1000.0 * number
        self.stopped = self.unknown = False
        self.unsure = (0.0, 0.0)

    @property
    def identity(self) -> str:
        return self.name if self.correction == 1.0 else f"{self.name} ×{self.correction:.6g}"

    @property
    def count_ul(self) -> float:
        return self.nominal_ul * self.correction

    def push(self, volume_ul: float) -> None:
        self.nominal_ul += volume_ul / self.correction
        self.pour(volume_ul)

    def dose_to(self, total_ul: float) -> Delivered:
        self._may_fail("dose_to")
        assert not self.stopped, "the guard doses through a stop"
        assert not self.unknown, "the guard doses although nobody knows where it stands"
        wanted_ul = max(0.0, total_ul - self.count_ul)
        self.push(0.4 * wanted_ul)
        self._may_fail("dose_to")
        self.push(total_ul - self.count_ul if wanted_ul else 0.0)
        self._may_fail("dose_to")
        return self._told()

    def delivered(self) -> Delivered:
        self._may_fail("delivered")
        return self._told()

    def _told(self) -> Delivered:
        if self.unknown:
            low, high = (self.correction * value for value in self.unsure)
            return Delivered(0.5 * (low + high), low, high)
        return Delivered(*[self.count_ul] * 3)

    def stop(self) -> None:
        self.stopped = True
        self._may_fail("stop")

    def clear_stop(self) -> None:
        self._may_fail("clear_stop")
        self.stopped = False

    def resolve(self, volume_ul: float) -> None:
        self._may_fail("resolve")
        assert self.unknown
        self.nominal_ul, self.unknown = volume_ul / self.correction, False

    def close(self) -> None: ...

    def _may_fail(self, call: str) -> None:
        if self.trouble.strikes():
            raise DeviceError(f"{self.name}: {call} failed")


class MemoryJournal:
    """A run's journal; a line that could not be acknowledged may be there all the same."""

    def __init__(self, trouble: Trouble) -> None:
        self.trouble, self.events = trouble, []

    def put(self, kind: str, **fields: Any) -> None:
        if self.trouble.strikes():
            raise StoreError("the run: cannot be written")
        event = Event(len(self.events), kind, Moment("", 0, ""), fields)
        self.events.append(Event.parse(event.line()))
        if self.trouble.strikes():
            raise StoreError("the run: cannot be synced")

    def dose_intent(self, intent: DoseIntent) -> None:
        self.put("dose_intent", **asdict(intent))

    def dose_done(self, done: DoseDone) -> None:
        assert done.delivered_low_ul <= done.delivered_ul <= done.delivered_high_ul
        self.put("dose_done", **asdict(done))

    @property
    def run(self) -> Run:
        return Run(Path("run"), {}, tuple(self.events))

    @property
    def open_ul(self) -> float | None:
        doses = self.run.events("dose_intent", "dose_done")
        return doses[-1]["total_ul"] if doses and doses[-1].kind == "dose_intent" else None


@contextmanager
def failing_disk(trouble: Trouble) -> Iterator[None]:
    """The ledger's calls of the operating system, each of which can fail; a write can leave half a line."""

    def write(handle: int, data: bytes) -> int:
        if trouble.strikes():
            return os.write(handle, data[: len(data) // 2])
        return os.write(handle, data)

    def failing(call: Callable[..., Any]) -> Callable[..., Any]:
        def called(*arguments: Any) -> Any:
            if trouble.strikes():
                raise OSError(5, "Input/output error")
            return call(*arguments)

        return called

    names = {name: getattr(os, name) for name in dir(os) if not name.startswith("__")}
    shim = SimpleNamespace(**names | {"write": write, "fsync": failing(os.fsync), "ftruncate": failing(os.ftruncate)})
    before, ledger_module.os = ledger_module.os, shim
    try:
        yield
    finally:
        ledger_module.os = before


class Tank(RuleBasedStateMachine):
    """One tank, its pumps, its ledgers, its runs; what is really in it is `true_ul`."""

    tally: ClassVar[Counter[str]] = Counter()
    guard: GuardedDoser | None = None
    ledger: TankLedger | None = None

    @initialize()
    def set_up(self) -> None:
        self.folder = tempfile.TemporaryDirectory(dir=MEMORY if MEMORY.is_dir() else None, ignore_cleanup_errors=True)
        self.path = Path(self.folder.name) / "tank.ledger"
        self.trouble, self.true_ul, self.into_tank = Trouble(), 0.0, True
        self.pumps = [Pump(1, self.pour, self.trouble), Pump(2, self.pour, self.trouble)]
        self.pump, self.one_pump, self.told_by_hand = self.pumps[0], True, False
        self.journals: list[MemoryJournal] = [MemoryJournal(self.trouble)]
        self.run, self.copies = 0, [b""]
        self.used_ul: Counter[int] = Counter()
        self.in_run = False
        self.tally["cases"] += 1
        self.open()

    def pour(self, volume_ul: float) -> None:
        if self.into_tank:
            self.true_ul += volume_ul
            if self.in_run:
                self.used_ul[self.run] += volume_ul

    # -- programs come and go ----------------------------------------------------------------------------------------

    @property
    def journal(self) -> MemoryJournal:
        return self.journals[self.run]

    def open(self) -> None:
        """A program begins, or goes on with, the run; a person answers what is asked."""
        self.leave()
        with failing_disk(self.trouble):
            try:
                self.ledger = TankLedger(self.path)
                self.guard = GuardedDoser(
                    self.pump, LIMITS, self.ledger, self.journal, f"run {self.run}", known_by_journal(self.journal.run)
                )
            except (TankrigError, Killed):
                self.leave()

    def leave(self) -> None:
        """The program is gone without a word, as after kill -9."""
        if self.ledger:
            self.ledger.close()
        self.guard = self.ledger = None
        self.trouble.arm(None)

    def ready(self) -> GuardedDoser:
        """A program that knows what the tank holds, its journal up to date: nothing is in the way of a dose."""
        self.leave()
        self.open()
        assert self.guard, "nothing fails now"
        self.answer()
        if (open_ul := self.journal.open_ul) is not None:
            self.journal.dose_done(self.guard.account(open_ul))
        held = self.guard.delivered()
        self.journal.put(
            "session", devices={"doser": self.guard.identity}, delivered_ul=held.volume_ul,
            delivered_low_ul=held.low_ul, delivered_high_ul=held.high_ul, **self.guard.noted,
        )  # fmt: skip
        self.guard.clear_stop()
        self.told_by_hand = False
        self.copies.append(self.path.read_bytes())
        return self.guard

    def answer(self) -> None:
        assert self.guard
        if self.guard.undecided is None:
            self.tally["asked nothing"] += 1
            return
        self.tally["asked"] += 1
        low_ul, high_ul = self.guard.delivered()[1:]
        assert "--delivered-ul" in self.guard.undecided
        for wrong_ul in (low_ul - 1.0, high_ul + 1.0):
            with pytest.raises(DeviceError):
                self.guard.resolve(wrong_ul)
        with pytest.raises(UndecidedError):
            self.guard.dose_to(low_ul + 30.0)
        self.guard.resolve(self.true_ul)
        assert self.guard.undecided is None

    def dose(self, total_ul: float) -> None:
        assert self.guard
        self.in_run, before_ul = True, self.true_ul
        with failing_disk(self.trouble):
            try:
                self.guard.dose_to(total_ul)
                self.tally["doses complete"] += 1
            except UndecidedError:
                self.tally["doses undecided"] += 1
            except TankrigError:
                self.tally["doses cut short" if self.true_ul > before_ul else "doses that did not begin"] += 1
            except Killed:
                self.tally["killed"] += 1
                self.leave()
        self.in_run = False
        assert self.true_ul <= max(total_ul, before_ul) + ROUNDING_UL, "more than its target"
        assert self.true_ul - before_ul <= LIMITS.dose_ul + ROUNDING_UL

    # -- what happens --------------------------------------------------------------------------------------------------

    @rule(part_ul=st.sampled_from([0.1, 3.3, 20.0, 41.5, 60.0, 61.0]))
    def dose_well(self, part_ul: float) -> None:
        self.ready()
        before_ul = self.true_ul
        self.dose(before_ul + part_ul)
        if self.true_ul > before_ul:
            assert self.true_ul == pytest.approx(before_ul + part_ul, abs=ROUNDING_UL)
            assert self.guard
            assert self.guard.undecided is None

    @rule(part_ul=st.sampled_from([20.0, 41.5]), after=st.integers(0, 24), kills=st.booleans(), again=st.booleans())
    def dose_in_trouble(self, part_ul: float, after: int, kills: bool, again: bool) -> None:
        self.ready()
        self.tally["killed at a call or write" if kills else "failed at a call or write"] += 1
        self.trouble.arm(after, kills)
        self.dose(self.true_ul + part_ul)
        self.trouble.arm(None)
        if again and self.guard and not self.pump.stopped:
            self.dose(self.true_ul + part_ul)

    @rule(part_ul=st.sampled_from([20.0, 41.5]), after=st.one_of(st.just(6), st.integers(0, 12)), low=st.booleans())
    def killed_and_the_pump_does_not_know(self, part_ul: float, after: int, low: bool) -> None:
        self.ready()
        start_ul = self.pump.nominal_ul
        self.trouble.arm(after, kills=True)
        self.dose(self.true_ul + part_ul)
        self.leave()
        least_ul = self.pump.nominal_ul if low else start_ul
        self.pump.unknown = self.pump.stopped = True
        self.pump.unsure = (least_ul, max(self.pump.nominal_ul, start_ul + part_ul / self.pump.correction))
        self.tally["pump does not know"] += 1

    @rule(part_ul=st.sampled_from([20.0, 41.5]), after=st.integers(0, 12))
    def killed_and_the_pump_begins_anew(self, part_ul: float, after: int) -> None:
        self.ready()
        if self.pump.nominal_ul < 500.0:  # one that begins anew where it was has to say so itself (`unknown`)
            return
        self.trouble.arm(after, kills=True)
        self.dose(self.true_ul + part_ul)
        self.leave()
        self.pump.nominal_ul, self.one_pump = 0.0, False
        self.tally["pump begins anew"] += 1

    @rule(volume_ul=st.sampled_from([0.5, 10.0, 50.0]), after=st.integers(0, 12), kills=st.booleans())
    def prime(self, volume_ul: float, after: int, kills: bool) -> None:
        self.ready()
        assert self.guard
        self.into_tank = False
        self.trouble.arm(after, kills)
        with failing_disk(self.trouble):
            try:
                assert self.guard.dose_aside(volume_ul) == pytest.approx(volume_ul)
                self.tally["primed"] += 1
            except (TankrigError, Killed) as error:
                self.tally["killed while priming" if isinstance(error, Killed) else "priming failed"] += 1
        self.into_tank = True
        self.open()
        if self.guard and not self.journal.open_ul:
            assert self.guard.undecided is None, "what was booked as not into the tank needs no person"
            assert self.guard.delivered().volume_ul == pytest.approx(self.true_ul, abs=ROUNDING_UL)

    @rule(volume_ul=st.sampled_from([0.5, 30.0]), into_tank=st.booleans(), open_=st.booleans())
    def push_by_hand(self, volume_ul: float, into_tank: bool, open_: bool) -> None:
        self.ready()
        if self.true_ul + volume_ul > LIMITS.tank_ul:
            return
        if not open_:
            self.leave()
        self.into_tank = into_tank
        self.pump.push(volume_ul)
        self.into_tank, self.told_by_hand = True, True
        self.tally["pushed by hand"] += 1
        if open_:
            assert self.guard
            before_ul = self.true_ul
            self.dose(self.true_ul + 20.0)
            assert self.true_ul == before_ul, "dosed although ink had moved that nobody had written down"
            assert self.guard.undecided

    @rule(correction=st.sampled_from([1.0, 1.02, 0.9631]), pushed_ul=st.sampled_from([0.0, 25.0]))
    def calibrate(self, correction: float, pushed_ul: float) -> None:
        self.ready()
        self.leave()
        self.into_tank = False
        self.pump.push(pushed_ul)
        self.into_tank, self.pump.correction = True, correction
        self.open()
        assert self.guard
        low_ul, high_ul = self.guard.delivered()[1:]
        assert (self.guard.undecided is not None) == (pushed_ul > 0.0)
        assert high_ul - low_ul == pytest.approx(pushed_ul, rel=0.07, abs=0.05), "the change of scale was taken for ink"
        self.tally["calibrated"] += 1

    @rule()
    def exchange_the_pump(self) -> None:
        self.ready()
        self.leave()
        self.pump, self.one_pump = self.pumps[2 - self.pump.number], False
        self.pump.stopped = False

    @rule()
    def next_run(self) -> None:
        self.ready()
        self.leave()
        self.journals.append(MemoryJournal(self.trouble))
        self.run = len(self.journals) - 1

    @rule(volume_ul=st.sampled_from([5.0, 35.0]), times=st.integers(1, 2))
    def another_run_in_between(self, volume_ul: float, times: int) -> None:
        """Another run doses into the tank, and the first goes on."""
        first, before_ul = self.run, self.true_ul
        for _ in range(times):
            self.next_run()
            self.ready()
            self.dose(self.true_ul + volume_ul)
        self.leave()
        self.run = first
        self.open()
        assert self.guard
        if self.journal.events and self.true_ul - before_ul > 1.0:
            assert self.guard.undecided, "the journal does not know what went in, and nobody was asked"
            self.tally["another run in between"] += 1

    @precondition(lambda self: len(self.journals) > 1)
    @rule(which=st.integers(0, 5))
    def go_on_with_an_earlier_run(self, which: int) -> None:
        """It may have been begun in another filling."""
        self.ready()
        self.leave()
        self.run = which % len(self.journals)
        self.open()
        assert self.guard
        known = known_by_journal(self.journal.run)
        if known and abs(known.tank.volume_ul - self.true_ul) > 1.0:
            assert self.guard.undecided, "journal and tank do not agree, and nobody was asked"

    @precondition(lambda self: self.one_pump)
    @rule(in_dose=st.booleans(), after=st.integers(0, 12))
    def lose_the_ledger(self, in_dose: bool, after: int) -> None:
        self.ready()
        if in_dose:
            self.trouble.arm(after, kills=True)
            self.dose(self.true_ul + 20.0)
        self.leave()
        self.path.unlink()
        self.open()
        assert self.guard
        if self.true_ul > 1.0:
            assert self.guard.undecided, "the ledger is lost, and nobody was asked"
        self.tally["ledger lost"] += 1
        self.ready()

    @precondition(lambda self: self.one_pump and len(self.copies) > 1)
    @rule(which=st.integers(1, 8))
    def restore_an_old_copy(self, which: int) -> None:
        self.ready()
        self.leave()
        self.path.write_bytes(self.copies[1 + which % (len(self.copies) - 1)])
        self.tally["ledger restored"] += 1
        self.ready()

    @rule(open_window=st.booleans())
    def fill_with_fresh_water(self, open_window: bool) -> None:
        self.ready()
        held_ul = self.true_ul
        self.leave()
        self.path.unlink()
        self.true_ul, self.one_pump, self.copies = 0.0, True, [b""]
        if open_window:
            ledger = TankLedger(self.path)
            GuardedDoser(self.pump, LIMITS, ledger, MemoryJournal(self.trouble), "bench")
            ledger.close()
        self.open()
        assert self.guard
        if held_ul > 1.0:
            assert self.guard.undecided, "the run was begun in another filling, and nobody was asked"
        self.tally["filled anew"] += 1

    # -- what always holds ---------------------------------------------------------------------------------------------

    @invariant()
    def no_budget_is_exceeded(self) -> None:
        assert self.true_ul <= LIMITS.tank_ul + ROUNDING_UL
        assert all(used_ul <= LIMITS.run_ul + ROUNDING_UL for used_ul in self.used_ul.values())

    @invariant()
    def the_truth_is_between_the_bounds(self) -> None:
        if self.guard and not self.told_by_hand:
            self.trouble.arm(None)
            volume_ul, low_ul, high_ul = self.guard.delivered()
            self.tally["bounds compared"] += 1
            assert low_ul - ROUNDING_UL <= self.true_ul <= high_ul + ROUNDING_UL
            assert low_ul <= volume_ul <= high_ul

    def teardown(self) -> None:
        self.leave()
        self.folder.cleanup()


def test_whatever_happens_the_tanks_ink_is_known_or_asked_for() -> None:
    chosen = settings(max_examples=150, stateful_step_count=8, derandomize=True, **QUIET)
    run_state_machine_as_test(Tank, settings=chosen)


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_the_tanks_ink_in_thousands_of_cases() -> None:
    Tank.tally = tally = Counter()
    run_state_machine_as_test(Tank, settings=settings(max_examples=4500, stateful_step_count=12, **QUIET))
    print(", ".join(f"{count} {what}" for what, count in tally.most_common()))
