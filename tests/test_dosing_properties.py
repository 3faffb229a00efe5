"""Whatever is lost, garbled, delayed, stalled, reset, unplugged, stopped, hung or killed, the ink is accounted for.

A state machine drives guard, driver and stand-in of each pump through random commands and faults. Only time and the way
of the bytes are made up (`tests.virtual_time`), so that a case takes milliseconds and can be repeated. It checks that
no dose goes beyond its target, that no budget is exceeded, that the truth lies between the bounds, and each rule that
is named in `RULES`: how often it was put to the test is counted.
"""

import json
import os
import shutil
import tempfile
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import ClassVar
from unittest.mock import patch

import hypothesis.strategies as st
import pytest
from hypothesis import HealthCheck, Phase, seed, settings
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    rule,
    run_state_machine_as_test,
)

from drivers.cavro.emulator.core import MODELS
from drivers.cavro.emulator.core import Habits as CavroHabits
from drivers.counted.record import CountFile
from drivers.dosing.doser import PumpDoser
from drivers.new_era.emulator.core import Habits as NewEraHabits
from tankrig.dosing import DoseDone, DoseIntent, DoseLimits, GuardedDoser, TankLedger
from tankrig.errors import DeviceError, TankrigError, UndecidedError

from .doser_bench import AnyBench, Bench, CavroBench, NewEraBench
from .virtual_time import KilledError, World

LIMITS = DoseLimits(dose_ul=40.0, run_ul=100.0, tank_ul=150.0)
ROUNDING_UL = 1e-6
CASES, CHUNKS = 102_000, 17
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
PARTS = st.sampled_from([20.0, 39.0])
SOON_S = st.floats(0.0, 3.0)
RULES = (
    "person's word outside the bounds refused",
    "silent pump answered again and was settled",
    "silent pump answered again and did not know",
    "hung in a dose while others polled",
    "second doser on the count refused",
    "looked at from another thread while dosing",
    "stopped from another thread",
    "killed in a dose",
    "killed while the motor ran",
    "moved beside the tank",
    "budget asked with doubt in the tank",
)


class Journal:
    """Journals of all the runs: the highest target ever written down is the most that may ever be delivered."""

    def __init__(self) -> None:
        self.highest_ul = 0.0

    def dose_intent(self, intent: DoseIntent) -> None:
        self.highest_ul = max(self.highest_ul, intent.total_ul)

    def dose_done(self, done: DoseDone) -> None:
        assert done.delivered_low_ul <= done.delivered_ul <= done.delivered_high_ul


class Dosing(RuleBasedStateMachine):
    """Bench, driver and guard; the person who is asked knows the truth, and first tries what cannot be."""

    tally: ClassVar[Counter[str]] = Counter()
    few: ClassVar[int] = 120
    stops_within_s: ClassVar[float]
    ul_per_s: ClassVar[float]
    guard: GuardedDoser | None = None
    doser: PumpDoser | None = None
    ledger: TankLedger | None = None

    @initialize(seed=st.integers(0, 1000))
    def set_up(self, seed: int) -> None:
        memory = MEMORY if MEMORY.is_dir() else None  # whether writes reach a disk is not what is tested
        self.folder = Path(tempfile.mkdtemp(dir=memory))
        self.world = World()
        self.bench = self.make_bench(self.folder, seed)
        self.journal, self.run, self.run_began_ul, self.aside_ul = Journal(), 0, 0.0, 0.0
        self.held_beside_ul: float | None = None
        self.uncounted_ul = 0.0
        self.tally["cases"] += 1
        self.open()

    def make_bench(self, folder: Path, seed: int) -> AnyBench:
        raise NotImplementedError

    @property
    def tank_ul(self) -> float:
        """What the tank really holds: what was delivered, less what went elsewhere."""
        return self.bench.true_ul - self.aside_ul if self.held_beside_ul is None else self.held_beside_ul

    @property
    def counted_ul(self) -> float:
        """What the doser's total should be: what was delivered, less what a person's word has left out of it."""
        return self.bench.true_ul - self.uncounted_ul

    # -- programs ------------------------------------------------------------------------------------------------------

    def open(self) -> None:
        """A program starts."""
        with suppress(TankrigError):
            self.ledger = TankLedger(self.folder / "tank.jsonl")
            self.doser = self.bench.open()
            self.guard = GuardedDoser(self.doser, LIMITS, self.ledger, self.journal, f"run {self.run}")

    def abandon(self) -> None:
        """The program is gone; what it had open is closed, and nothing else."""
        if self.doser:
            self.bench.bury(self.doser)
        if self.ledger:
            self.ledger.close()
        self.guard = self.doser = self.ledger = None

    @contextmanager
    def killed_at_last(self) -> Iterator[None]:
        """Whatever an exception makes a killed program write after its death has not happened."""
        files: dict[Path, bytes] = {}

        def keep() -> None:
            self.tally["killed in a dose"] += self.doser.dosing
            self.tally["killed while the motor ran"] += self.bench.moving
            files.update({path: path.read_bytes() for path in self.records() if path.exists()})

        self.bench.clock.dying = keep
        with suppress(KilledError):
            yield
            self.bench.clock.kill()
        self.abandon()
        for path, data in files.items():
            if path.read_bytes() != data:
                path.write_bytes(data)

    def records(self) -> list[Path]:
        return [self.folder / "tank.jsonl", self.folder / "count"]

    @contextmanager
    def meanwhile(self, delay_s: float, act: Callable[[], object]) -> Iterator[None]:
        """`act` happens so much later, be it in the dose or after."""
        done = []
        self.world.after(delay_s, lambda: (done.append(True), act()))
        yield
        self.world.advance_to(self.world.now_s + delay_s, lambda: bool(done))

    # -- doses ---------------------------------------------------------------------------------------------------------

    @rule(part_ul=st.sampled_from([0.0, 0.05, 0.1, 3.3, 20.0, 39.97, 40.0, 41.0, -5.0]))
    def dose(self, part_ul: float) -> None:
        if not self.guard:
            return
        held = self.guard.delivered()
        total_ul, before_ul = held.volume_ul + part_ul, self.bench.true_ul
        self.tally["budget asked with doubt in the tank"] += held.high_ul > held.low_ul and not self.guard.undecided
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

    @rule(part_ul=st.sampled_from([3.3, 20.0]), mended=st.booleans())
    def prime(self, part_ul: float, mended: bool) -> None:
        """Into a waste vessel, to which the tube goes, and from which it comes back, only while the pump rests.

        So none of it is the tank's, whatever happens; what a dose that broke off still pushes is that dose's.
        """
        if mended:
            self.put_right()
        if self.guard:
            self.wait_until_it_rests()
            before_ul, self.held_beside_ul = self.bench.true_ul, self.tank_ul
            with suppress(TankrigError):
                self.guard.dose_aside(part_ul)
            self.wait_until_it_rests()
            self.held_beside_ul = None
            self.tally["moved beside the tank"] += self.bench.true_ul > before_ul
            self.aside_ul += self.bench.true_ul - before_ul

    def wait_until_it_rests(self) -> None:
        while self.bench.moving:
            self.world.advance(0.1)

    @rule(faults=FAULTS, part_ul=PARTS, mended=st.booleans())
    def dose_with_faults(self, faults: dict[str, object], part_ul: float, mended: bool) -> None:
        if mended:
            self.put_right()
        self.break_something(faults)
        self.dose(part_ul)

    @rule(part_ul=PARTS, delay_s=SOON_S)
    def dose_and_stop(self, part_ul: float, delay_s: float) -> None:
        self.put_right()
        if self.guard:
            with self.meanwhile(delay_s, self.stop):
                self.dose(part_ul)
            assert self.guard.stopped

    def stop(self) -> None:
        self.tally["stopped from another thread"] += self.doser.dosing
        self.guard.stop()

    @rule(part_ul=PARTS, delay_s=SOON_S, what=st.sampled_from(["reset", "reset", "unplug", "unplug", "forget"]))
    def dose_and_misfortune(self, part_ul: float, delay_s: float, what: str) -> None:
        self.put_right()
        with self.meanwhile(delay_s, lambda: self.bench.do(what)):
            self.dose(part_ul)

    @rule(part_ul=PARTS, moment=st.one_of(st.integers(0, 400), SOON_S), faults=st.one_of(st.just({}), FAULTS))
    def dose_and_die(self, part_ul: float, moment: float, faults: dict[str, object]) -> None:
        """kill -9 after so long, or after so many reads, writes and waits of the line and syncs with the disk."""
        self.put_right()
        self.break_something(faults)
        if self.doser:
            with self.killed_at_last(), patch("os.fsync", self.sync_or_die):
                clock = self.bench.clock
                if isinstance(moment, int):
                    clock.dies_after = moment
                else:
                    self.world.after(moment, lambda: clock.killed or clock.kill())
                self.dose(part_ul)
        self.abandon()
        self.open()

    def sync_or_die(self, _file: int) -> None:
        """Memory needs no syncing, but a program may be killed there."""
        self.bench.clock.alive()

    @rule(part_ul=PARTS, delay_s=SOON_S, seed=st.integers(0, 1000))
    def dose_and_power_cut(self, part_ul: float, delay_s: float, seed: int) -> None:
        self.put_right()
        with self.meanwhile(delay_s, self.bench.power_off), suppress(ValueError):
            self.dose(part_ul)
        self.bench.power_on(seed)

    @rule(part_ul=PARTS, delays_s=st.lists(SOON_S, min_size=1, max_size=4))
    def dose_and_look(self, part_ul: float, delays_s: list[float]) -> None:
        """A window asks from another thread: it is told what holds, and says nothing on the wire."""
        self.put_right()
        for delay_s in delays_s:
            self.world.after(delay_s, self.look)
        self.dose(part_ul)

    def look(self) -> None:
        if self.guard and self.doser and self.doser.dosing:
            before = self.bench.written(self.doser)
            told, held = self.doser.delivered(), self.guard.delivered()
            assert self.bench.written(self.doser) == before, "it was asked while it doses, which feeds its watchdog"
            for bounds, true_ul in ((told, self.counted_ul), (held, self.tank_ul)):
                assert bounds.low_ul - ROUNDING_UL <= true_ul <= bounds.high_ul + ROUNDING_UL
            self.tally["looked at from another thread while dosing"] += 1

    @rule(part_ul=PARTS, delay_s=SOON_S, faults=st.one_of(st.just({}), FAULTS))
    def dose_and_hang(self, part_ul: float, delay_s: float, faults: dict[str, object]) -> None:
        """The dosing thread hangs, a window goes on looking: the pump stops within its watchdog, or its piece."""
        self.put_right()
        self.break_something(faults)
        with self.meanwhile(delay_s, self.hang):
            self.dose(part_ul)

    def hang(self) -> None:
        if not self.guard or not self.doser or not self.doser.dosing:
            return
        self.tally["hung in a dose while others polled"] += self.bench.moving
        hung_s, from_ul = self.world.now_s, self.bench.true_ul
        while self.world.now_s < hung_s + self.stops_within_s + 1.0:
            self.look()
            self.world.advance(0.25)
        after_ul = self.bench.true_ul
        assert after_ul - from_ul <= self.ul_per_s * (self.stops_within_s + 0.1), "somebody fed its watchdog"
        self.world.advance(1.0)
        assert self.bench.true_ul == after_ul, "it still moves"

    @rule(
        part_ul=PARTS,
        delay_s=SOON_S,
        silence_s=st.sampled_from([1.0, 10.0, 60.0, 120.0]),
        deaf=st.booleans(),
        unheard=st.sampled_from([None, "stall", "reset"]),
    )
    def dose_and_fall_silent(
        self, part_ul: float, delay_s: float, silence_s: float, deaf: bool, unheard: str | None
    ) -> None:
        """Nothing is heard of it for a while, nor of what befalls it; when it answers again, what it knows counts."""
        self.put_right()
        self.world.after(delay_s, lambda: self.bench.faults(mute=True, deaf=deaf))
        if unheard:
            self.world.after(delay_s + 0.3, lambda: self.bench.faults(**{f"{unheard}_after": 0}))
        with self.meanwhile(delay_s + silence_s, self.bench.no_faults):
            self.dose(part_ul)
        if self.doser and self.doser.unknown:
            low_ul, high_ul = self.doser.delivered()[1:]
            settled = not self.doser.unknown
            self.tally["silent pump answered again and was settled"] += settled
            self.tally["silent pump answered again and did not know"] += not settled
            assert low_ul - ROUNDING_UL <= self.counted_ul <= high_ul + ROUNDING_UL

    # -- faults and people ---------------------------------------------------------------------------------------------

    @rule(faults=FAULTS)
    def break_something(self, faults: dict[str, object]) -> None:
        self.bench.faults(**faults)

    @rule()
    def mend(self) -> None:
        self.bench.no_faults()
        self.bench.do("plug")

    @rule(duration_s=st.sampled_from([0.5, 5.0]))
    def wait(self, duration_s: float) -> None:
        self.world.advance(duration_s)

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
            self.run, self.run_began_ul = self.run + 1, self.tank_ul
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

    @rule(how=st.sampled_from(["itself", "link", "folder", "second name"]))
    def open_a_second_time(self, how: str) -> None:
        """By whatever path: the count has one doser at a time."""
        if self.doser and self.bench.cable.port is self.bench.port_of(self.doser):  # else its cable was pulled
            with pytest.raises(DeviceError, match=r"another (doser uses|program has) it|second name"):
                self.second_doser(how)
            self.tally["second doser on the count refused"] += 1

    def second_doser(self, how: str) -> None:
        count, other = self.folder / "count", self.folder / "other"
        path = {"itself": count, "folder": other / "count"}.get(how, other)
        try:
            if how == "link":
                other.symlink_to(count)
            elif how == "folder":
                other.symlink_to(self.folder)
            elif how == "second name":
                other.hardlink_to(count)
            CountFile(path, "second doser", 1.0)
        finally:
            other.unlink(missing_ok=True)

    @rule(wrong_ul=st.floats(0.3, 50.0), sign=st.sampled_from([-1, 1]))
    def decide(self, wrong_ul: float = 5.0, sign: int = 1) -> None:
        if self.doser and self.doser.unknown:
            self.say_what_cannot_be(self.doser, wrong_ul, sign)
        if self.guard and self.guard.undecided:
            beside = self.doser.unknown and self.ledger.aside_ul is not None
            with suppress(TankrigError):
                self.guard.resolve(self.tank_ul)
                assert not self.guard.undecided
                self.tally["decided by a person"] += 1
                if beside:  # the person was asked for the tank's content: what went beside it is in nobody's count
                    self.uncounted_ul = self.bench.true_ul - self.doser.last_known.volume_ul

    def say_what_cannot_be(self, doser: PumpDoser, wrong_ul: float, sign: int) -> None:
        _, low_ul, high_ul = doser.delivered()
        beyond_ul = wrong_ul + 2 * doser.increment_ul
        said_ul = high_ul + beyond_ul if sign > 0 else low_ul - beyond_ul
        if doser.unknown and said_ul >= 0.0:
            with pytest.raises(DeviceError) as refusal:
                doser.resolve(said_ul)
            told = "cannot have been delivered in all; it was between" in str(refusal.value)
            self.tally["person's word outside the bounds refused"] += told

    # -- what always holds ---------------------------------------------------------------------------------------------

    @invariant()
    def no_budget_is_exceeded(self) -> None:
        true_ul = self.tank_ul
        assert true_ul <= self.journal.highest_ul + ROUNDING_UL
        assert true_ul <= LIMITS.tank_ul + ROUNDING_UL
        assert true_ul - self.run_began_ul <= LIMITS.run_ul + ROUNDING_UL

    @invariant()
    def the_truth_is_between_the_bounds(self) -> None:
        if self.guard:
            _, low_ul, high_ul = self.guard.delivered()
            assert low_ul - ROUNDING_UL <= self.tank_ul <= high_ul + ROUNDING_UL
        if self.doser and self.doser.unknown:
            _, low_ul, high_ul = self.doser.delivered()
            assert low_ul - ROUNDING_UL <= self.counted_ul <= high_ul + ROUNDING_UL

    @invariant()
    def a_pump_rests_where_nothing_is_undecided(self) -> None:
        """So that a person may then be asked to move its tube."""
        if self.guard and not self.guard.undecided:
            assert not self.bench.moving

    def teardown(self) -> None:
        self.abandon()
        self.bench.power_off()
        shutil.rmtree(self.folder, ignore_errors=True)


class RigDosing(Dosing):
    stops_within_s, ul_per_s = 1.5, 15.0

    protocol: ClassVar[int] = 1

    def make_bench(self, folder: Path, seed: int) -> AnyBench:
        motor = {"rate": 150.0, "dose_cap": 500, "life_cap": 5000}
        return Bench(folder, world=self.world, seed=seed, protocol=self.protocol, **motor)

    def second_doser(self, how: str) -> None:  # noqa: ARG002, it keeps its count itself
        self.bench.open()


class Rig02Dosing(RigDosing):
    protocol = 2


class NewEraDosing(Dosing):
    """With what the manual says, and each of what it leaves open."""

    stops_within_s = 3.0

    def make_bench(self, folder: Path, seed: int) -> AnyBench:
        rate_ml_per_min = (0.1, 0.6, 2.5, NewEraBench.FASTEST_ML_PER_MIN)[seed % 4]
        self.ul_per_s = 1.05 * rate_ml_per_min * 1000.0 / 60.0
        habits = NewEraHabits(
            power_failure=bool(seed & 4), ignored_first=seed % 3, answers_damaged=bool(seed & 8), checks_rates=True
        )
        return NewEraBench(folder, world=self.world, seed=seed, rate_ml_per_min=rate_ml_per_min, habits=habits)


class CavroDosing(Dosing):
    """With what the manuals say, and each of what they leave open, at speeds from the slowest to the fastest."""

    few = 60  # of each of the two models, which one driver drives
    stops_within_s, model = 1.0, "xcalibur"
    SYRINGE_UL = 250.0
    SPEEDS = (0.25, 2.0, 5.0, 10.0, 15.0, 20.0, 30.0, 37.5, 50.0, 60.0, 70.0, 90.0, 120.0, 160.0, 200.0, 250.0)
    """µl/s; the slowest two, whose doses take minutes, in an eighth of the cases."""

    def make_bench(self, folder: Path, seed: int) -> AnyBench:
        self.ul_per_s = self.SPEEDS[seed % len(self.SPEEDS)]
        habits = CavroHabits(
            model=MODELS[self.model],
            speeds_interact=True,
            speed_rounding=seed % 3 - 1,
            repeat_flag_decides=bool(seed & 16),
            overload_stays=bool(seed & 32),
        )
        speed = {"speed_ul_per_s": self.ul_per_s, "syringe_ul": self.SYRINGE_UL}
        return CavroBench(folder, world=self.world, seed=seed, habits=habits, **speed)


class XlpDosing(CavroDosing):
    model = "xlp"


QUIET = {"deadline": None, "suppress_health_check": list(HealthCheck), "database": None}
MACHINES = [RigDosing, Rig02Dosing, NewEraDosing, CavroDosing, XlpDosing]


@pytest.mark.parametrize("machine", MACHINES)
def test_ink_is_accounted_for_whatever_happens(machine: type[Dosing]) -> None:
    quick = settings(
        max_examples=machine.few, stateful_step_count=8, derandomize=True, phases=[Phase.generate], **QUIET
    )
    run_state_machine_as_test(machine, settings=quick)


@pytest.mark.parametrize("machine", [NewEraDosing, CavroDosing, XlpDosing])
def test_what_a_dose_that_broke_off_still_pushes_is_that_doses(machine: type[Dosing]) -> None:
    """The cable is pulled and priming asked for while the pump runs on: the tube waits until it rests."""
    case = machine()
    case.set_up(seed=118)
    case.dose_and_misfortune(part_ul=39.0, delay_s=0.8, what="unplug")
    assert case.bench.moving
    case.prime(part_ul=3.3, mended=False)
    case.put_right()
    case.the_truth_is_between_the_bounds()
    case.no_budget_is_exceeded()
    case.teardown()


@pytest.mark.long
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("chunk", range(CHUNKS))
@pytest.mark.parametrize("machine", MACHINES)
def test_ink_is_accounted_for_in_a_hundred_thousand_cases(
    machine: type[Dosing], chunk: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """All chunks together; each prints its seed and the totals so far (`-n 2 -rP`), the last the totals of all."""
    number = zlib.crc32(f"{machine.__name__} {chunk}".encode()) + int(os.environ.get("DOSING_SEED", "0"))
    cases = CASES // CHUNKS // len(MACHINES)
    counted = seed(number)(type(machine.__name__, (machine,), {"tally": Counter()}))
    chosen = settings(max_examples=cases, stateful_step_count=8, phases=[Phase.generate, Phase.shrink], **QUIET)
    run_state_machine_as_test(counted, settings=chosen)
    told = ", ".join(f"{count} {what}" for what, count in counted.tally.most_common())
    print(f"{machine.__name__}, seed {number}: {told}")
    assert counted.tally["cases"] >= cases
    for outcome in ("complete", "undecided", "cut short"):
        assert counted.tally[f"doses {outcome}"] > cases / 50, "too few to mean anything"
    base = tmp_path_factory.getbasetemp()
    session = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
    add_up(session / "dosing-tally", f"{machine.__name__}-{chunk}", counted.tally)


def add_up(folder: Path, name: str, tally: Counter[str]) -> None:
    folder.mkdir(exist_ok=True)
    (folder / f"{name}.json").write_text(json.dumps(tally))
    parts = [json.loads(path.read_text()) for path in folder.glob("*.json")]
    total: Counter[str] = sum(map(Counter, parts), Counter())
    print(
        f"so far {len(parts)} of {CHUNKS * len(MACHINES)} chunks: {total['cases']} cases, 0 doses repeated, "
        "0 over budget, 0 bounds that exclude the truth; " + ", ".join(f"{total[what]} {what}" for what in RULES)
    )
    if len(parts) == CHUNKS * len(MACHINES):
        assert all(total[what] >= 1000 for what in RULES), "a rule was hardly put to the test"
