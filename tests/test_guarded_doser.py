"""The guard keeps to its budgets, writes down before it moves, and never doses after a dose whose end is not known."""

import json
import math
import os
from collections.abc import Callable
from pathlib import Path

import hypothesis.strategies as st
import pytest
from hypothesis import given, settings

from tankrig.devices import Delivered
from tankrig.dosing import DoseDone, DoseIntent, DoseLimits, GuardedDoser, TankLedger
from tankrig.dosing.limits import Remaining, dosed_to
from tankrig.dosing.records import JointCount
from tankrig.errors import DeviceError, SequenceError, StoreError, UndecidedError
from tankrig.sequence import Note, Pace, Sequence, Series, dry_run

LIMITS = DoseLimits(dose_ul=50.0, run_ul=120.0, tank_ul=200.0)


class Syringe:
    """A doser without a wire; can be made to break off, and to forget."""

    name = "syringe"
    increment_ul = 0.1

    def __init__(self, identity: str = "syringe 1", count_ul: float = 1000.0) -> None:
        self.identity, self.count_ul = identity, count_ul
        self.stopped = self.unknown = False
        self.breaks_after_ul = math.inf
        self.before_moving = lambda: None
        self.stops = 0

    def dose_to(self, total_ul: float) -> Delivered:
        self.before_moving()
        moved_ul = min(total_ul - self.count_ul, self.breaks_after_ul)
        self.count_ul += moved_ul
        if moved_ul == self.breaks_after_ul:
            raise DeviceError("syringe: broken")
        return self.delivered()

    def delivered(self) -> Delivered:
        return Delivered(self.count_ul, self.count_ul, self.count_ul)

    def stop(self) -> None:
        self.stops += 1
        self.stopped = True

    def clear_stop(self) -> None:
        self.stopped = False

    def resolve(self, volume_ul: float) -> None:
        self.count_ul, self.unknown = volume_ul, False

    def close(self) -> None: ...


class Journal:
    def __init__(self) -> None:
        self.lines: list[DoseIntent | DoseDone] = []

    def dose_intent(self, intent: DoseIntent) -> None:
        self.lines.append(intent)

    def dose_done(self, done: DoseDone) -> None:
        self.lines.append(done)


class Killed(BaseException):
    """The program ends here."""


class Lab:
    """A tank with its ledger; programs come and go."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "tanks" / "a.jsonl"
        self.syringe = Syringe()
        self.journal = Journal()
        self.guard: GuardedDoser | None = None

    def open(self, run: str = "run") -> GuardedDoser:
        if self.guard:
            self.guard.close()
        self.guard = GuardedDoser(self.syringe, LIMITS, TankLedger(self.path), self.journal, run)
        return self.guard

    def kill_in_dose(self, total_ul: float, after_ul: float) -> None:
        """The program is killed in mid-dose, the syringe goes on for so much: the ledger keeps what it had."""
        kept = b""

        def killed() -> None:
            nonlocal kept
            kept = self.path.read_bytes()
            self.syringe.count_ul += after_ul
            raise Killed

        self.syringe.before_moving = killed
        with pytest.raises(Killed):
            self.guard.dose_to(total_ul)
        self.guard.close()
        self.guard = None
        self.path.write_bytes(kept)
        self.syringe.before_moving = lambda: None
        self.syringe.stopped = False

    def kinds(self) -> list[str]:
        return [json.loads(line)["kind"] for line in self.path.read_text().splitlines()]


@pytest.fixture
def lab(tmp_path: Path) -> Lab:
    return Lab(tmp_path)


def exactly(volume_ul: float) -> Delivered:
    return Delivered(*[pytest.approx(volume_ul)] * 3)


def test_volumes_are_the_tanks_not_the_syringes(lab: Lab) -> None:
    guard = lab.open()
    assert guard.delivered() == exactly(0.0)
    assert guard.dose_to(30.0) == exactly(30.0)
    assert lab.syringe.count_ul == 1030.0
    assert lab.open("next run").delivered() == exactly(30.0)


def test_the_intent_is_on_the_disk_before_anything_moves(lab: Lab) -> None:
    guard = lab.open()
    seen = []
    lab.syringe.before_moving = lambda: seen.append((lab.kinds()[-1], lab.journal.lines[-1]))
    guard.dose_to(30.0)
    assert seen == [("intent", DoseIntent(total_ul=30.0, from_ul=0.0, doser="syringe 1"))]
    assert lab.kinds()[-1] == "done"
    assert lab.journal.lines[-1] == DoseDone(30.0, 30.0, 30.0, complete=True)


@pytest.mark.parametrize(
    ("totals", "why"), [([50.2], "one dose"), ([50, 100, 121], "the run may"), ([math.nan], "no volume")]
)
def test_what_exceeds_a_budget_is_refused_before_anything_moves(lab: Lab, totals: list[float], why: str) -> None:
    guard = lab.open()
    for total in totals[:-1]:
        guard.dose_to(total)
    count, lines = lab.syringe.count_ul, len(lab.journal.lines)
    with pytest.raises(DeviceError, match=why):
        guard.dose_to(totals[-1])
    assert lab.syringe.count_ul == count
    assert len(lab.journal.lines) == lines
    assert not guard.stopped


def test_the_runs_budget_outlives_the_program_and_the_tanks_outlives_the_run(lab: Lab) -> None:
    for total in (50, 100):
        lab.open().dose_to(total)
    guard = lab.open()
    assert guard.remaining() == Remaining(pytest.approx(20), pytest.approx(20), pytest.approx(100))
    with pytest.raises(DeviceError, match="run may have 120"):
        guard.dose_to(121)
    guard = lab.open("second run")
    guard.dose_to(150)
    guard.dose_to(200)
    with pytest.raises(DeviceError, match="tank may have 200"):
        guard.dose_to(201)


def test_an_interrupted_dose_is_settled_by_the_syringes_count_and_not_repeated(lab: Lab) -> None:
    lab.open().dose_to(10.0)
    lab.kill_in_dose(40.0, after_ul=12.0)
    guard = lab.open()
    assert not guard.unknown
    assert guard.delivered() == exactly(22.0)
    assert guard.account(40.0) == DoseDone(*exactly(22.0), complete=False)
    assert guard.dose_to(40.0) == exactly(40.0)
    assert lab.syringe.count_ul == pytest.approx(1040.0)
    assert guard.remaining().run_ul == pytest.approx(80.0)


def test_a_syringe_that_does_not_know_needs_a_person(lab: Lab) -> None:
    lab.open().dose_to(10.0)
    lab.kill_in_dose(40.0, after_ul=12.0)
    lab.syringe.unknown, lab.syringe.count_ul = True, 0.0
    guard = lab.open()
    assert "between 10 and 40 µl (run run)" in guard.undecided
    with pytest.raises(UndecidedError, match="--delivered-ul"):
        guard.dose_to(40.0)
    with pytest.raises(UndecidedError):
        guard.account(40.0)
    assert guard.delivered()[1:] == (10.0, 40.0)
    for wrong in (9.0, 41.0, math.nan, math.inf):
        with pytest.raises(DeviceError, match="between 10 and 40"):
            guard.resolve(wrong)
    guard.resolve(22.0)
    assert guard.dose_to(40.0) == exactly(40.0)
    assert guard.remaining().run_ul == pytest.approx(80.0)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda syringe: setattr(syringe, "count_ul", syringe.count_ul + 30.0), "has moved since"),
        (lambda syringe: setattr(syringe, "count_ul", 0.0), "has moved since"),
        (lambda syringe: setattr(syringe, "identity", "syringe 2"), "begun with syringe 1, not with syringe 2"),
    ],
)
def test_a_count_that_cannot_be_this_doses_needs_a_person(lab: Lab, change, why: str) -> None:
    lab.open()
    lab.kill_in_dose(40.0, after_ul=12.0)
    change(lab.syringe)
    guard = lab.open()
    assert why in guard.undecided
    guard.resolve(12.0)
    assert guard.dose_to(40.0) == exactly(40.0)


def test_a_new_syringe_goes_on_where_the_old_one_ended(lab: Lab) -> None:
    lab.open().dose_to(10.0)
    lab.syringe = Syringe("syringe 2", count_ul=77.0)
    assert lab.open().dose_to(20.0) == exactly(20.0)
    assert lab.syringe.count_ul == pytest.approx(87.0)


def test_ink_that_went_past_the_ledger_needs_a_person(lab: Lab) -> None:
    lab.open().dose_to(10.0)
    lab.syringe.count_ul += 5.0
    guard = lab.open()
    assert "has moved since" in guard.undecided
    assert guard.delivered() == (10.0, 10.0, 15.0), "without it, without it, with it"
    guard.resolve(15.0)
    assert guard.dose_to(20.0) == exactly(20.0)
    assert lab.syringe.count_ul == pytest.approx(1020.0)


def test_a_dose_that_fails_is_stopped_and_written_down(lab: Lab) -> None:
    guard = lab.open()
    lab.syringe.breaks_after_ul = 7.0
    with pytest.raises(DeviceError, match="broken"):
        guard.dose_to(40.0)
    assert lab.syringe.stops == 1
    assert lab.journal.lines[-1] == DoseDone(*exactly(7.0), complete=False)
    lab.syringe.breaks_after_ul = math.inf
    with pytest.raises(DeviceError, match="stop is latched"):
        guard.dose_to(40.0)
    guard.clear_stop()
    assert guard.dose_to(40.0) == exactly(40.0)


def test_nothing_moves_if_the_intent_cannot_be_written(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    guard = lab.open()
    before = lab.path.read_bytes()

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as disk:
        disk.setattr("tankrig.dosing.ledger.os.write", full)
        with pytest.raises(StoreError, match="make room"):
            guard.dose_to(10.0)
    with monkeypatch.context() as disk:
        disk.setattr(lab.journal, "dose_intent", full)
        with pytest.raises(OSError, match="No space"):
            guard.dose_to(10.0)
    assert lab.syringe.count_ul == 1000.0
    assert lab.path.read_bytes() == before
    assert guard.dose_to(10.0) == exactly(10.0)


@pytest.mark.parametrize("call", ["write", "fsync"])
def test_a_dose_whose_end_cannot_be_written_is_settled_later(
    lab: Lab, monkeypatch: pytest.MonkeyPatch, call: str
) -> None:
    """A full disk can be cleared; a disk that cannot sync is trusted again only when the ledger is opened anew."""

    def broken(*_: object) -> None:
        raise OSError(28, "No space left on device")

    guard = lab.open()
    with monkeypatch.context() as disk:
        lab.syringe.before_moving = lambda: disk.setattr(os, call, broken)
        with pytest.raises(StoreError, match="make room"):
            guard.dose_to(10.0)
    lab.syringe.before_moving = lambda: None
    lab.syringe.stopped = False
    assert guard.delivered() == (0.0, 0.0, 10.0)
    if call == "fsync":
        with pytest.raises(StoreError):
            guard.dose_to(20.0)
        guard = lab.open()
    assert guard.dose_to(20.0) == exactly(20.0)
    assert lab.syringe.count_ul == pytest.approx(1020.0)


def test_a_power_cut_at_any_byte_of_the_ledger_forgets_no_ink(lab: Lab) -> None:
    """Whatever part of the last write is lost, the ledger opens, and counts or asks, never below the truth."""
    guard, intents = lab.open(), []
    lab.syringe.before_moving = lambda: intents.append(lab.path.stat().st_size)
    for total in (20.0, 50.0):
        guard.dose_to(total)
    guard.close()
    lab.guard = None
    counts = dict(zip(intents, (1020.0, 1050.0), strict=True))
    whole = lab.path.read_bytes()
    ends = [size + part for size in range(len(whole)) if whole[size] == ord("\n") for part in (-1, 0, 1, 2)]
    for cut in sorted({*range(0, len(whole), 11), *range(25), *ends}):
        lab.path.write_bytes(whole[:cut])
        lab.syringe.count_ul = max((count for size, count in counts.items() if size <= cut), default=1000.0)
        guard = lab.open()
        assert not guard.unknown
        assert guard.delivered() == exactly(lab.syringe.count_ul - 1000.0)


def test_a_second_program_on_the_tank_is_refused(lab: Lab) -> None:
    lab.open()
    with pytest.raises(StoreError, match="another program"):
        TankLedger(lab.path)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("hello\n", "line 1 is no entry"),
        ('{"number": 1, "kind": "tank", "format": 2}\n', "newer version"),
        ('{"number": 1, "kind": "tank", "format": 1}\n{"number": 3}\n{"number": 3}\n', "line 2 is no entry"),
    ],
)
def test_a_file_that_is_no_ledger_is_refused_and_left_alone(tmp_path: Path, text: str, why: str) -> None:
    path = tmp_path / "tank.jsonl"
    path.write_text(text)
    with pytest.raises(StoreError, match=why):
        TankLedger(path)
    assert path.read_text() == text


def test_a_place_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(StoreError, match="another place"):
        TankLedger(tmp_path / "file" / "tank.jsonl")


@pytest.mark.parametrize("wrong", [0.0, -1.0, math.nan, math.inf])
def test_a_budget_that_is_none_is_refused(wrong: float) -> None:
    with pytest.raises(SequenceError, match="run_ul"):
        DoseLimits(dose_ul=1.0, run_ul=wrong, tank_ul=1.0)


def test_nothing_undecided_is_nothing_to_resolve(lab: Lab) -> None:
    with pytest.raises(DeviceError, match="nothing is undecided"):
        lab.open().resolve(3.0)


# -- budgets count the worst case --------------------------------------------------------------------------------------


@st.composite
def tanks(draw: st.DrawFn) -> Delivered:
    volume_ul = draw(st.floats(0.0, 250.0))
    below_ul, above_ul = draw(st.floats(0.0, 30.0)), draw(st.floats(0.0, 30.0))
    return Delivered(volume_ul, max(0.0, volume_ul - below_ul), volume_ul + above_ul)


CASES = pytest.mark.parametrize("cases", [150, pytest.param(5000, marks=pytest.mark.long)])


def drawn(cases: int, check: Callable[..., None], **strategies: st.SearchStrategy) -> None:
    settings(max_examples=cases, deadline=None, derandomize=True, database=None)(given(**strategies)(check))()


@CASES
def test_no_allowed_dose_exceeds_a_budget_in_the_worst_case_and_what_remains_is_allowed(cases: int) -> None:
    part_ul, used_ul = st.floats(0.01, 60.0), st.floats(0.0, 130.0)
    drawn(cases, keeps_its_budgets, tank=tanks(), part_ul=part_ul, used_ul=used_ul, near=st.booleans())


def keeps_its_budgets(tank: Delivered, part_ul: float, used_ul: float, near: bool) -> None:
    left_ul = LIMITS.remaining(tank, used_ul).dose_ul
    if near and left_ul > 0.01:
        part_ul = left_ul * (1.0 if part_ul > 30.0 else 1.0 + 1e-3)
    total_ul = tank.volume_ul + part_ul
    refused = LIMITS.refusal(total_ul, tank, used_ul) is not None
    if not refused:
        worst_dose_ul, worst_tank_ul = total_ul - tank.low_ul, dosed_to(total_ul, tank).high_ul
        assert worst_dose_ul <= LIMITS.dose_ul + 1e-5
        assert used_ul + worst_dose_ul <= LIMITS.run_ul + 1e-5
        assert worst_tank_ul <= LIMITS.tank_ul + 1e-5
    if abs(part_ul - left_ul) > 1e-5:
        assert refused == (part_ul > left_ul)


@CASES
def test_the_dry_run_allows_what_the_guard_would(cases: int) -> None:
    parts_ul = st.lists(st.floats(1.0, 60.0), min_size=1, max_size=5)
    drawn(cases, dry_run_agrees, tank=tanks(), parts_ul=parts_ul, used_ul=st.floats(0.0, 60.0))


def dry_run_agrees(tank: Delivered, parts_ul: list[float], used_ul: float) -> None:
    totals = [tank.volume_ul + sum(parts_ul[: number + 1]) for number in range(len(parts_ul))]
    held, used, allowed = tank, used_ul, True
    for total_ul in totals:
        allowed = allowed and LIMITS.refusal(total_ul, held, used) is None
        used, held = used + total_ul - held.low_ul, dosed_to(total_ul, held)
    sequence = Sequence("doses", (Series(tuple(totals), (Note("x"),)),))
    try:
        dry_run(sequence, LIMITS, Pace(), 1, tank, used_ul)
    except SequenceError:
        assert not allowed
    else:
        assert allowed


def test_a_tank_of_90_to_110_is_not_dosed_to_200_under_a_budget_of_200(lab: Lab) -> None:
    """By its high bound it would hold 210."""
    guard = lab.open("first")
    guard.dose_to(50.0)
    guard.dose_to(100.0)
    guard.close()
    lab.guard = None
    ledger = TankLedger(lab.path)
    ledger.join(JointCount("syringe 1", Delivered(100.0, 90.0, 110.0), lab.syringe.delivered()))
    ledger.close()
    guard = lab.open()
    assert guard.remaining().tank_ul == pytest.approx(90.0)
    assert guard.dose_to(140.0) == Delivered(pytest.approx(140.0), pytest.approx(130.0), pytest.approx(150.0))
    guard.dose_to(179.0)
    with pytest.raises(DeviceError, match="would hold up to 210"):
        guard.dose_to(200.0)
    guard.dose_to(190.0)
    assert guard.delivered().high_ul == pytest.approx(200.0)


# -- a person's word and what the doser knows --------------------------------------------------------------------------


def test_a_doser_that_answers_again_is_asked_before_a_person_is_believed(lab: Lab) -> None:
    lab.open()
    lab.kill_in_dose(40.0, after_ul=30.0)
    lab.syringe.unknown = True
    guard = lab.open()
    assert guard.undecided
    lab.syringe.unknown = False
    with pytest.raises(UndecidedError, match="it is 30 µl: find out which is true"):
        guard.resolve(6.0)
    assert guard.delivered() == exactly(30.0)
    assert guard.dose_to(40.0) == exactly(40.0)
    assert lab.syringe.count_ul == pytest.approx(1040.0)


def test_a_count_that_survived_bounds_what_a_person_may_say(lab: Lab) -> None:
    """The doser is not sure of the end, but it is of the first 30 µl: 15 cannot be true."""
    lab.open()
    lab.kill_in_dose(40.0, after_ul=30.0)
    lab.syringe.unknown = True
    lab.syringe.delivered = lambda: Delivered(1035.0, 1030.0, 1040.0)
    guard = lab.open()
    with pytest.raises(UndecidedError, match="between 30 and 40"):
        guard.resolve(15.0)


def test_the_answer_and_the_question_are_written_down(lab: Lab) -> None:
    lab.open().dose_to(10.0)
    lab.syringe.count_ul += 5.0
    guard = lab.open()
    guard.resolve(12.0)
    entry = json.loads(lab.path.read_text().splitlines()[-1])
    assert entry["said_ul"] == 12.0
    assert "has moved since" in entry["asked"]
    assert guard.noted["said_ul"] == 12.0


# -- beside the tank ---------------------------------------------------------------------------------------------------


def test_what_is_primed_is_not_in_the_tank_and_needs_no_person(lab: Lab) -> None:
    guard = lab.open()
    guard.dose_to(30.0)
    seen = []
    lab.syringe.before_moving = lambda: seen.append(lab.kinds()[-1])
    assert guard.dose_aside(45.0) == pytest.approx(45.0)
    assert seen == ["aside"], "it is written down before anything moves"
    assert guard.delivered() == exactly(30.0)
    assert lab.open().dose_to(50.0) == exactly(50.0)
    assert lab.syringe.count_ul == pytest.approx(1095.0)


def test_a_crash_while_priming_is_settled_and_a_push_beyond_it_is_asked_about(lab: Lab) -> None:
    guard = lab.open()
    guard.dose_to(30.0)
    lab.syringe.breaks_after_ul = 7.0
    with pytest.raises(DeviceError, match="broken"):
        guard.dose_aside(45.0)
    assert lab.syringe.stops == 1
    guard = lab.open()
    assert guard.undecided is None
    assert guard.delivered() == exactly(30.0)
    ledger = lab.path.read_bytes()
    lab.open().close()
    with lab.path.open("ab") as file:
        entry = {"number": len(ledger.splitlines()) + 1, "kind": "aside", "utc": "", "most_ul": 20.0, "why": "priming"}
        file.write(json.dumps(entry).encode() + b"\n")
    lab.syringe.count_ul += 26.0
    guard = lab.open()
    assert guard.undecided
    assert guard.delivered()[1:] == (30.0, pytest.approx(56.0))


@pytest.mark.parametrize("volume_ul", [0.0, -1.0, 51.0, math.nan, math.inf])
def test_what_is_no_volume_beside_the_tank_is_refused(lab: Lab, volume_ul: float) -> None:
    guard = lab.open()
    with pytest.raises(DeviceError, match="beside the tank"):
        guard.dose_aside(volume_ul)
    assert lab.syringe.count_ul == 1000.0


# -- one ledger --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("link", ["symbolic", "hard", "folder"])
def test_a_ledger_is_locked_whatever_name_leads_to_it(lab: Lab, tmp_path: Path, link: str) -> None:
    lab.open()
    other = tmp_path / "other.jsonl"
    if link == "symbolic":
        other.symlink_to(lab.path)
    elif link == "hard":
        other.hardlink_to(lab.path)
    else:
        (tmp_path / "again").symlink_to(lab.path.parent)
        other = tmp_path / "again" / lab.path.name
    with pytest.raises(StoreError, match="another program"):
        TankLedger(other)


@pytest.mark.parametrize("how", ["renamed", "replaced", "deleted"])
def test_nothing_moves_when_the_ledger_is_no_longer_the_file_that_is_held(lab: Lab, how: str) -> None:
    """A second program would open the new file and dose beside the first one."""
    guard = lab.open()
    guard.dose_to(10.0)
    kept = lab.path.with_name("kept")
    lab.path.rename(kept)
    if how == "replaced":
        TankLedger(lab.path).close()
    elif how == "deleted":
        kept.unlink()
    with pytest.raises(StoreError, match="renamed, replaced or deleted"):
        guard.dose_to(20.0)
    assert lab.syringe.count_ul == pytest.approx(1010.0)


def test_two_ledgers_of_one_doser_are_told_by_its_count(lab: Lab, tmp_path: Path) -> None:
    """Two rig files in two folders name the same doser: each asks for what went in by the other."""
    guard = lab.open()
    guard.dose_to(10.0)
    other = GuardedDoser(lab.syringe, LIMITS, TankLedger(tmp_path / "other.jsonl"), Journal(), "other run")
    other.dose_to(25.0)
    with pytest.raises(UndecidedError, match="between 10 and 35"):
        guard.dose_to(20.0)
    assert lab.open().undecided


def test_a_run_whose_name_is_no_utf8_is_booked_like_any_other(lab: Lab) -> None:
    guard = lab.open(os.fsdecode(b"run \xff"))
    guard.dose_to(10.0)
    assert lab.open(os.fsdecode(b"run \xff")).remaining().run_ul == pytest.approx(110.0)
    assert lab.kinds().count("done") == 1
