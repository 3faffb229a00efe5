"""Whatever is lost, garbled, delayed, stalled, reset, unplugged, stopped or killed, the ink is accounted for.

A state machine drives guard, driver and stand-in of each pump through random commands and faults, with all times scaled
down by one factor, so that many waits run out although nothing is wrong: another fault. It checks that no dose goes
beyond its target, that no budget is exceeded, and that the truth lies between the bounds.
"""

import tempfile
import threading
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import ClassVar

import hypothesis.strategies as st
import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    rule,
    run_state_machine_as_test,
)

from tankrig.devices import Doser
from tankrig.dosing import DoseDone, DoseIntent, DoseLimits, GuardedDoser, TankLedger
from tankrig.errors import TankrigError, UndecidedError

from .doser_bench import AnyBench, Bench, CavroBench, NewEraBench

LIMITS = DoseLimits(dose_ul=40.0, run_ul=100.0, tank_ul=150.0)
ROUNDING_UL = 1e-6
SCALE = 0.02
CASES = 3400
MEMORY = Path("/dev/shm")
FAULTS = st.one_of(
    st.fixed_dictionaries({"lose": st.sampled_from([0.002, 0.02, 0.1])}),
    st.fixed_dictionaries({"corrupt": st.sampled_from([0.002, 0.02, 0.1])}),
    st.fixed_dictionaries({"duplicate": st.sampled_from([0.3, 1.0])}),
    st.fixed_dictionaries({"delay_ms": st.sampled_from([50.0, 250.0, 350.0, 1000.0])}),
    st.fixed_dictionaries({"jitter_ms": st.sampled_from([200.0, 500.0, 1000.0])}),
    st.sampled_from([{"mute": True}, {"deaf": True}, {"mute": True, "deaf": True}, {"junk": True}]),
    st.fixed_dictionaries({}, optional={f"{what}_after": st.integers(0, 300) for what in ("reset", "stall", "unplug")}),
)
SOON_S = st.floats(0.0, 0.03)


class Journal:
    """Journals of all the runs: the highest target ever written down is the most that may ever be delivered."""

    def __init__(self) -> None:
        self.highest_ul = 0.0

    def dose_intent(self, intent: DoseIntent) -> None:
        self.highest_ul = max(self.highest_ul, intent.total_ul)

    def dose_done(self, done: DoseDone) -> None:
        assert done.delivered_low_ul <= done.delivered_ul <= done.delivered_high_ul


class Dosing(RuleBasedStateMachine):
    """Bench, driver and guard; the person who is asked always knows the truth."""

    tally: ClassVar[Counter[str]] = Counter()
    few: ClassVar[int] = 40
    guard: GuardedDoser | None = None
    doser: Doser | None = None
    ledger: TankLedger | None = None

    @initialize(seed=st.integers(0, 1000))
    def set_up(self, seed: int) -> None:
        memory = MEMORY if MEMORY.is_dir() else None  # whether writes reach a disk is not what is tested
        self.folder = tempfile.TemporaryDirectory(dir=memory, ignore_cleanup_errors=True)
        self.bench = self.make_bench(Path(self.folder.name), seed)
        self.journal, self.run, self.run_began_ul = Journal(), 0, 0.0
        self.tally["cases"] += 1
        self.open()

    def make_bench(self, folder: Path, seed: int) -> AnyBench:
        raise NotImplementedError

    def open(self) -> None:
        """A program starts."""
        with suppress(TankrigError):
            self.ledger = TankLedger(Path(self.folder.name) / "tank.jsonl")
            self.doser = self.bench.open()
            self.guard = GuardedDoser(self.doser, LIMITS, self.ledger, self.journal, f"run {self.run}")

    def abandon(self) -> None:
        """The program is gone without a word, as after kill -9: its port and its files are closed."""
        if self.doser:
            self.bench.kill(self.doser)
            self.doser.close()
        if self.ledger:
            self.ledger.close()
        self.guard = self.doser = self.ledger = None

    def later(self, delay_s: float, act: object) -> threading.Timer:
        timer = threading.Timer(delay_s, act)
        timer.start()
        return timer

    @rule(part_ul=st.sampled_from([0.0, 0.05, 0.1, 3.3, 20.0, 39.97, 40.0, 41.0, -5.0]))
    def dose(self, part_ul: float) -> None:
        if not self.guard:
            return
        total_ul = self.guard.delivered().volume_ul + part_ul
        before_ul = self.bench.true_ul
        try:
            after = self.guard.dose_to(total_ul)
            assert after.volume_ul > total_ul - self.guard.increment_ul - ROUNDING_UL
            self.tally["doses complete"] += 1
        except UndecidedError:
            self.tally["doses undecided"] += 1
        except TankrigError:
            moved = self.bench.true_ul > before_ul
            self.tally["doses cut short" if moved else "doses that did not begin"] += 1
        assert self.bench.true_ul - before_ul <= LIMITS.dose_ul + ROUNDING_UL

    @rule(faults=FAULTS, part_ul=st.sampled_from([20.0, 39.0]), mended=st.booleans())
    def dose_with_faults(self, faults: dict[str, object], part_ul: float, mended: bool) -> None:
        if mended:
            self.put_right()
        self.break_something(faults)
        self.dose(part_ul)

    @rule(part_ul=st.sampled_from([20.0, 39.0]), delay_s=SOON_S)
    def dose_and_stop(self, part_ul: float, delay_s: float) -> None:
        self.put_right()
        if self.guard:
            timer = self.later(delay_s, self.guard.stop)
            self.dose(part_ul)
            timer.join()
            assert self.guard.stopped

    @rule(
        part_ul=st.sampled_from([20.0, 39.0]),
        delay_s=SOON_S,
        what=st.sampled_from(["reset", "reset", "unplug", "unplug", "forget"]),
    )
    def dose_and_misfortune(self, part_ul: float, delay_s: float, what: str) -> None:
        self.put_right()
        timer = self.later(delay_s, lambda: self.bench.do(what))
        self.dose(part_ul)
        timer.join()

    @rule(part_ul=st.sampled_from([20.0, 39.0]), delay_s=SOON_S)
    def dose_and_die(self, part_ul: float, delay_s: float) -> None:
        self.put_right()
        if self.doser:
            timer = self.later(delay_s, lambda doser=self.doser: self.bench.kill(doser))
            self.dose(part_ul)
            timer.join()
        self.abandon()
        self.open()

    @rule(part_ul=st.sampled_from([20.0, 39.0]), delay_s=SOON_S, seed=st.integers(0, 1000))
    def dose_and_power_cut(self, part_ul: float, delay_s: float, seed: int) -> None:
        self.put_right()
        timer = self.later(delay_s, self.bench.power_off)
        with suppress(ValueError):
            self.dose(part_ul)
        timer.join()
        self.bench.power_on(seed)

    @rule(faults=FAULTS)
    def break_something(self, faults: dict[str, object]) -> None:
        self.bench.faults(**faults)

    @rule()
    def mend(self) -> None:
        self.bench.no_faults()
        self.bench.do("plug")

    def put_right(self) -> None:
        """Mended, opened anew, decided and cleared: the next dose has every chance."""
        self.mend()
        self.start_anew(new_run=False)
        if self.doser:
            self.bench.put_right(self.doser)
        self.decide()
        self.clear_stop()

    @rule(new_run=st.booleans())
    def start_anew(self, new_run: bool) -> None:
        if self.guard:
            self.guard.close()
        self.abandon()
        if new_run:
            self.run, self.run_began_ul = self.run + 1, self.bench.true_ul
        self.open()

    @rule(noise=st.binary(max_size=30))
    def babble(self, noise: bytes) -> None:
        if self.doser:
            with suppress(OSError):
                self.bench.port_of(self.doser).write(noise)

    @rule()
    def clear_stop(self) -> None:
        if self.guard:
            with suppress(TankrigError):
                self.guard.clear_stop()

    @rule()
    def decide(self) -> None:
        if self.guard and self.guard.undecided:
            with suppress(TankrigError):
                self.guard.resolve(self.bench.true_ul)
                assert not self.guard.undecided
                self.tally["decided by a person"] += 1

    @invariant()
    def no_budget_is_exceeded(self) -> None:
        true_ul = self.bench.true_ul
        assert true_ul <= self.journal.highest_ul + ROUNDING_UL
        assert true_ul <= LIMITS.tank_ul + ROUNDING_UL
        assert true_ul - self.run_began_ul <= LIMITS.run_ul + ROUNDING_UL

    @invariant()
    def the_truth_is_between_the_bounds(self) -> None:
        if self.guard:
            _, low_ul, high_ul = self.guard.delivered()
            assert low_ul - ROUNDING_UL <= self.bench.true_ul <= high_ul + ROUNDING_UL
        if self.doser and self.doser.unknown:
            _, low_ul, high_ul = self.doser.delivered()
            assert low_ul - ROUNDING_UL <= self.bench.true_ul <= high_ul + ROUNDING_UL

    def teardown(self) -> None:
        self.abandon()
        with self.bench:
            pass
        self.folder.cleanup()


class RigDosing(Dosing):
    few = 120

    def make_bench(self, folder: Path, seed: int) -> AnyBench:
        return Bench(folder, time_scale=SCALE, seed=seed, rate=400.0, dose_cap=500, life_cap=5000)


class NewEraDosing(Dosing):
    def make_bench(self, folder: Path, seed: int) -> AnyBench:
        return NewEraBench(folder, time_scale=SCALE, seed=seed, rate_ml_per_min=3.0)


class CavroDosing(Dosing):
    def make_bench(self, folder: Path, seed: int) -> AnyBench:
        return CavroBench(folder, time_scale=SCALE, seed=seed, speed_ul_per_s=50.0, syringe_ul=250.0)


QUIET = {"deadline": None, "suppress_health_check": list(HealthCheck), "database": None, "phases": [Phase.generate]}
MACHINES = pytest.mark.parametrize("machine", [RigDosing, NewEraDosing, CavroDosing])


@MACHINES
def test_ink_is_accounted_for_whatever_happens(machine: type[Dosing]) -> None:
    chosen = settings(max_examples=machine.few, stateful_step_count=5, derandomize=True, **QUIET)
    run_state_machine_as_test(machine, settings=chosen)


@pytest.mark.long
@pytest.mark.timeout(7200)
@MACHINES
def test_ink_is_accounted_for_in_thousands_of_cases(machine: type[Dosing]) -> None:
    """Together more than ten thousand: each of the three has its share."""
    machine.tally = tally = Counter()
    run_state_machine_as_test(machine, settings=settings(max_examples=CASES, stateful_step_count=6, **QUIET))
    print(f"{machine.__name__}: " + ", ".join(f"{count} {what}" for what, count in tally.most_common()))
    assert tally["cases"] >= CASES
    for outcome in ("complete", "undecided", "cut short"):
        assert tally[f"doses {outcome}"] > tally["cases"] / 50, "too few to mean anything"
