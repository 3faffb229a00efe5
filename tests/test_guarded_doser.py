"""The guard keeps to its budgets, writes down before it moves, and never doses after a dose whose end is not known."""

import json
import math
import os
from pathlib import Path

import pytest

from tankrig.devices import Delivered
from tankrig.dosing import DoseDone, DoseIntent, DoseLimits, GuardedDoser, TankLedger
from tankrig.dosing.limits import Remaining
from tankrig.errors import DeviceError, SequenceError, StoreError, UndecidedError

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
