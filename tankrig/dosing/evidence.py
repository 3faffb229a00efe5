"""What a tank holds: one question to all that know something of it, asked before anything moves.

The tank's ledger, the journal of the run that goes on, the doser's count and a person are asked together (`judge`).
Where they agree the answer is known; where they do not, a person decides within bounds that use all that is known:

* What moved within an intent, up to its target, is in the tank.
* What moved within an entry "not into the tank" (calibrating, priming), up to its volume, is not.
* What moved outside of both may be: the low bound is without it, the high bound with it.
* A ledger that is not known to be the run's own, or is older than the run's journal, does not overrule the journal: the
  tank may have been filled anew, or the ledger may have been lost, and the bounds hold both.
"""

import math
from dataclasses import dataclass

from tankrig.devices import Delivered
from tankrig.errors import UndecidedError

from .records import SCALE_ROUNDING, JointCount, NotedCount


@dataclass(frozen=True)
class Account:
    """What the ledger, or the journal of a run, knew last.

    Parameters
    ----------
    tank
        What the tank held, µl.
    noted
        What the doser at hand had counted then; None if nothing of it is noted.
    joint
        Where its count and the tank's were put together, if they still are: sums over many doses are then as sharp as
        one dose.
    target_ul
        Of a dose that was begun and is not known to have ended.
    begun_with
        Identity of the doser of that dose, where it is noted.
    aside_ul
        Of a movement that was begun, is not known to have ended, and does not go into the tank: at most so much.
    filled_utc
        When the ledger was begun: names the filling of the tank.
    used_ul
        Ink that the run had put into the tank by its journal, at most.
    doubt
        Why it may lack something about doses: lines of the journal that are damaged.
    """

    tank: Delivered
    noted: NotedCount | None = None
    joint: JointCount | None = None
    target_ul: float | None = None
    begun_with: str | None = None
    aside_ul: float | None = None
    filled_utc: str | None = None
    used_ul: float = 0.0
    doubt: str | None = None


@dataclass(frozen=True)
class Evidence:
    """All that is known of a tank at one moment.

    Parameters
    ----------
    doser
        Identity of the doser at hand.
    count
        What it has counted, with its bounds, µl.
    unknown
        Whether it says itself that it does not know.
    increment_ul
        Its smallest volume.
    ledger
        What the tank's ledger says; of a new one, a tank of clear water.
    journal
        What the journal of the run that goes on says; None for a new run.
    of_run
        What the tank held after the last dose of this run by the ledger; None if the ledger knows none.
    """

    doser: str
    count: Delivered
    unknown: bool
    increment_ul: float
    ledger: Account
    journal: Account | None = None
    of_run: Delivered | None = None


@dataclass(frozen=True)
class TankFinding:
    """What the tank holds, or what is to be asked.

    Parameters
    ----------
    tank
        With bounds that hold the truth, µl.
    question
        Why a person has to decide; None if it is known.
    """

    tank: Delivered
    question: str | None = None

    def answered(self, said_ul: float, slack_ul: float) -> Delivered:
        """What the tank holds by a person's word, which may be off by `slack_ul` but not outside of the bounds.

        Raises
        ------
        UndecidedError
            If the tank cannot hold that.
        """
        _, low_ul, high_ul = self.tank
        if not low_ul - slack_ul <= said_ul <= high_ul + slack_ul or math.isinf(said_ul):
            raise UndecidedError(f"the tank cannot hold {said_ul:g} µl; {between(self.tank)}: find out which is true")
        exactly_ul = min(max(said_ul, low_ul), high_ul)
        return Delivered(exactly_ul, exactly_ul, exactly_ul)


def between(tank: Delivered) -> str:
    """Bounds in words.

    >>> between(Delivered(1.0, 0.0, 2.5)), between(Delivered(1.0, 0.0, math.inf))
    ('it is between 0 and 2.5 µl', 'it is at least 0 µl')
    >>> between(Delivered(150.0, 150.0, 150.0))
    'it is 150 µl'
    """
    if tank.high_ul - tank.low_ul < 1e-6:
        return f"it is {tank.volume_ul:g} µl"
    if math.isinf(tank.high_ul):
        return f"it is at least {tank.low_ul:g} µl"
    return f"it is between {tank.low_ul:g} and {tank.high_ul:g} µl"


def judge(evidence: Evidence) -> TankFinding:
    """Put all that is known together.

    Examples
    --------
    The ledger says 100 µl, and the doser has counted no more since:

    >>> noted = NotedCount("d", Delivered(500.0, 500.0, 500.0))
    >>> ledger = Account(Delivered(100.0, 100.0, 100.0), noted)
    >>> judge(Evidence("d", noted.count, False, 0.1, ledger)).question is None
    True

    It has counted 20 µl more, which nobody has written down:

    >>> judge(Evidence("d", Delivered(520.0, 520.0, 520.0), False, 0.1, ledger)).tank
    Delivered(volume_ul=100.0, low_ul=100.0, high_ul=120.0)
    """
    by_ledger = _by_count(evidence.ledger, evidence)
    journal = evidence.journal
    if journal is None:
        return by_ledger
    if _is_the_runs_own(evidence):
        return _with_the_runs_ledger(by_ledger, journal, evidence.increment_ul)
    return _with_another_ledger(by_ledger, journal, evidence)


# -- one account and the doser's count ---------------------------------------------------------------------------------


def _by_count(account: Account, evidence: Evidence) -> TankFinding:
    """What the tank holds by one account, and by what the doser has counted since."""
    tank = account.tank
    moved = _moved(account.noted, evidence)
    target_ul = account.target_ul
    if target_ul is not None and account.begun_with not in (None, evidence.doser):
        high_ul = max(tank.high_ul, target_ul) + max(0.0, moved.high_ul if moved else 0.0)
        why = f"a dose was begun with {account.begun_with}, not with {evidence.doser}"
        return _asked(tank, tank.low_ul, high_ul, why)
    if evidence.unknown:
        return _of_a_doser_that_does_not_know(account, moved, evidence)
    if moved is None:
        if target_ul is not None:
            return _asked(tank, tank.low_ul, max(tank.high_ul, target_ul), "the end of the last dose is not known")
        return TankFinding(tank)
    slack_ul = _slack_ul(evidence)
    if _fell(moved, slack_ul):
        return _of_a_doser_that_began_anew(account, evidence)
    within_ul = target_ul - tank.volume_ul if target_ul is not None else account.aside_ul or 0.0
    if moved.volume_ul > within_ul + slack_ul:
        why = f"{evidence.doser} has moved since without this tank's ledger, by {moved.volume_ul - within_ul:g} µl"
        return _asked(tank, tank.low_ul, tank.high_ul + moved.high_ul, why)
    return TankFinding(tank if target_ul is None else _with_dose(account, moved, evidence))


def _with_dose(account: Account, moved: Delivered, evidence: Evidence) -> Delivered:
    """The tank with what was counted within an intent."""
    tank, joint = account.tank, account.joint
    if joint is not None and joint.doser == evidence.doser:
        after = joint.tank_at(evidence.count)
    else:
        after = Delivered(*(held_ul + moved_ul for held_ul, moved_ul in zip(tank, moved, strict=True)))
    return Delivered(*(max(value_ul, tank.low_ul) for value_ul in after))  # ink never comes back


def _of_a_doser_that_does_not_know(account: Account, moved: Delivered | None, evidence: Evidence) -> TankFinding:
    tank, target_ul = account.tank, account.target_ul
    why = f"{evidence.doser} does not know what it has delivered"
    if moved is None or moved.high_ul < -_slack_ul(evidence):
        return _of_a_doser_that_began_anew(account, evidence, why)
    within_ul = 0.0 if target_ul is None else max(0.0, target_ul - tank.volume_ul)
    surely_ul = moved.low_ul if 0.0 < moved.low_ul <= within_ul else 0.0
    return _asked(tank, tank.low_ul + surely_ul, tank.high_ul + max(0.0, moved.high_ul), why)


def _of_a_doser_that_began_anew(account: Account, evidence: Evidence, why: str = "") -> TankFinding:
    """Its count is below what was noted: it tells only what it has counted since it began anew."""
    tank = account.tank
    high_ul = max(tank.high_ul, account.target_ul or 0.0) + max(0.0, evidence.count.high_ul)
    words = f"{evidence.doser} has moved since without this tank's ledger, or has lost its count"
    return _asked(tank, tank.low_ul, high_ul, why or words)


def _moved(noted: NotedCount | None, evidence: Evidence) -> Delivered | None:
    """What the doser has counted since, µl: best value and bounds; None if there is nothing to compare with."""
    before = noted.on_scale_of(evidence.doser) if noted else None
    if before is None:
        return None
    now = evidence.count
    low_ul, high_ul = now.low_ul - before.high_ul, now.high_ul - before.low_ul
    return Delivered(now.volume_ul - before.volume_ul, max(0.0, low_ul), high_ul)


def _slack_ul(evidence: Evidence) -> float:
    return 0.5 * evidence.increment_ul + SCALE_ROUNDING * abs(evidence.count.high_ul) * _was_scaled(evidence)


def _was_scaled(evidence: Evidence) -> bool:
    noted = evidence.ledger.noted or (evidence.journal.noted if evidence.journal else None)
    return noted is not None and noted.doser != evidence.doser


def _fell(moved: Delivered, slack_ul: float) -> bool:
    return moved.volume_ul < -slack_ul


def _asked(tank: Delivered, low_ul: float, high_ul: float, why: str) -> TankFinding:
    return TankFinding(Delivered(min(max(tank.volume_ul, low_ul), high_ul), low_ul, high_ul), why)


# -- the ledger and the run's journal ----------------------------------------------------------------------------------


def used_elsewhere_ul(evidence: Evidence) -> float:
    """Ink that the run had put in by its journal, at most, where the ledger cannot know of it."""
    journal = evidence.journal
    if journal is None or _is_the_runs_own(evidence):
        return 0.0
    open_ul = 0.0 if journal.target_ul is None else max(0.0, journal.target_ul - journal.tank.low_ul)
    return journal.used_ul + open_ul


def _is_the_runs_own(evidence: Evidence) -> bool:
    """Whether the ledger is of the filling that the run was begun in, and knows all that its journal knows."""
    ledger, journal, slack_ul = evidence.ledger, evidence.journal, evidence.increment_ul
    if journal is None:
        return True
    if ledger.tank.high_ul < journal.tank.low_ul - slack_ul:  # ink never comes back: an older copy, or another filling
        return False
    if journal.filled_utc is not None:
        return journal.filled_utc == ledger.filled_utc
    return evidence.of_run is not None and _agree(evidence.of_run, journal, slack_ul)


def _agree(tank: Delivered, journal: Account, slack_ul: float) -> bool:
    """Whether a tank is what the journal knew, or what its open dose can have made of it."""
    if journal.target_ul is None:
        return abs(tank.volume_ul - journal.tank.volume_ul) <= slack_ul
    return journal.tank.low_ul - slack_ul <= tank.volume_ul <= journal.target_ul + slack_ul


def _with_the_runs_ledger(by_ledger: TankFinding, journal: Account, slack_ul: float) -> TankFinding:
    tank = by_ledger.tank
    if by_ledger.question is not None:
        return by_ledger
    if (open_question := _left_open(journal, tank)) is not None:
        return TankFinding(tank, open_question)
    if not _agree(tank, journal, slack_ul):
        why = (
            f"the run's journal says that the tank holds {journal.tank.volume_ul:g} µl, and its ledger and the doser "
            f"say {tank.volume_ul:g}: it was dosed into, or decided on, outside of this run"
        )
        return TankFinding(tank, why)
    return by_ledger


def _with_another_ledger(by_ledger: TankFinding, journal: Account, evidence: Evidence) -> TankFinding:
    by_journal = _by_count(journal, evidence)
    if journal.noted is None and not _nothing_dosed(journal):  # of an earlier version: no count to go by
        by_journal = TankFinding(by_journal.tank._replace(high_ul=math.inf), by_journal.question)
    tanks = (by_ledger.tank, by_journal.tank)
    tank = by_ledger.tank._replace(low_ul=min(one.low_ul for one in tanks), high_ul=max(one.high_ul for one in tanks))
    agree = abs(by_ledger.tank.volume_ul - by_journal.tank.volume_ul) <= _slack_ul(evidence)
    if agree:
        why = by_ledger.question or by_journal.question or _left_open(journal, by_ledger.tank)
        return by_ledger if why is None and math.isinf(tank.high_ul) else TankFinding(tank, why)
    by_doser = f", by the doser {by_journal.tank.volume_ul:g}" if journal.noted else ""
    why = (
        f"the run's journal says that the tank holds {_held(journal)}{by_doser}, and this ledger, which is not known "
        f"to be of the same filling, says {by_ledger.tank.volume_ul:g} µl: "
        "the tank was filled anew, or its ledger was lost"
    )
    return TankFinding(tank, why)


def _nothing_dosed(journal: Account) -> bool:
    return journal.tank.high_ul == 0.0 and journal.target_ul is None and journal.doubt is None


def _held(journal: Account) -> str:
    if journal.target_ul is None:
        return f"{journal.tank.volume_ul:g} µl"
    return f"{journal.tank.volume_ul:g} to {journal.target_ul:g} µl"


def _left_open(journal: Account, tank: Delivered) -> str | None:
    """What the journal itself leaves open; None if nothing."""
    if journal.target_ul is not None:
        why = f"the run was interrupted in a dose to {journal.target_ul:g} µl"
    elif journal.doubt is not None:
        why = journal.doubt
    else:
        return None
    return f"{why}; by ledger and doser the tank holds {tank.volume_ul:g} µl"
