"""How much ink may go into a tank."""

from dataclasses import dataclass
from typing import Annotated

from tankrig.checked_toml import MOST
from tankrig.devices import Delivered
from tankrig.errors import SequenceError
from tankrig.ranges import Within, require_ranges

_ROUNDING_UL = 1e-6
FILL_ANEW = "fill it anew and start a new ledger"
"""What to do about a tank that holds too much already: ends the sentences that say so."""
STOPPED = "a stop is latched; clear it first"
DOSING = "it doses; wait for it or stop it"
"""Why nothing is dosed now: ends of such sentences."""

Budget = Annotated[float, Within(0.0, MOST, "is no budget; give a positive number of µl", above=True)]
"""Of ink, µl."""


@dataclass(frozen=True)
class Remaining:
    """What may still be dosed on top of what the tank holds by its best value, in the worst case, µl."""

    dose_ul: float
    run_ul: float
    tank_ul: float


def dosed_to(total_ul: float, tank: Delivered) -> Delivered:
    """What the tank holds after a dose to `total_ul` that goes well: what was uncertain before stays so.

    Parameters
    ----------
    total_ul
        Where the dose ends by the best value, µl.
    tank
        What it holds before.

    Examples
    --------
    >>> dosed_to(200.0, Delivered(100.0, 90.0, 110.0))
    Delivered(volume_ul=200.0, low_ul=190.0, high_ul=210.0)
    """
    added_ul = total_ul - tank.volume_ul
    return Delivered(total_ul, tank.low_ul + added_ul, tank.high_ul + added_ul)


def too_much_already(total_ul: float, tank: Delivered, increment_ul: float = 0.0) -> str | None:
    """Why dosing until the tank holds `total_ul` is refused where it holds more, or None: no dose takes ink out.

    Parameters
    ----------
    total_ul
        What it is to hold, µl.
    tank
        What it holds before.
    increment_ul
        Smallest volume that the doser doses: by so little it may hold more.

    Examples
    --------
    >>> too_much_already(50.0, Delivered(100.0, 90.0, 110.0))
    'the tank holds 100 µl already; fill it anew and start a new ledger'
    """
    if total_ul >= tank.volume_ul - increment_ul:
        return None
    return f"the tank holds {tank.volume_ul:g} µl already; {FILL_ANEW}"


@dataclass(frozen=True)
class DoseLimits:
    """Budgets, µl: for one dose, for one run, for one filling of the tank.

    Each counts the worst case: a dose from the lowest that the tank may hold before it, a tank at the highest that it
    may hold after it. `refusal`, `remaining` and the dry run follow this one rule.

    Raises
    ------
    SequenceError
        If one of them is not a positive number.

    Examples
    --------
    >>> limits = DoseLimits(dose_ul=500.0, run_ul=2000.0, tank_ul=3000.0)
    >>> limits.refusal(600.0, tank=Delivered(0.0, 0.0, 0.0), run_used_ul=0.0)
    'one dose may have 500 µl at most and this one has 600'
    >>> limits.refusal(3200.0, tank=Delivered(2800.0, 2800.0, 2800.0), run_used_ul=0.0)
    'the tank may have 3000 µl at most; fill it anew and start a new ledger'
    >>> limits.refusal(3000.0, tank=Delivered(2800.0, 2790.0, 2810.0), run_used_ul=0.0)
    'the tank may have 3000 µl at most, and would hold up to 3010; fill it anew and start a new ledger'
    """

    dose_ul: Budget
    run_ul: Budget
    tank_ul: Budget

    def __post_init__(self) -> None:
        require_ranges(self, SequenceError)

    def refusal(self, total_ul: float, tank: Delivered, run_used_ul: float) -> str | None:
        """Why dosing until the tank holds `total_ul` is refused, or None; `tank` is what it holds before."""
        dose_ul, high_ul = total_ul - tank.low_ul, dosed_to(total_ul, tank).high_ul
        if dose_ul > self.dose_ul + _ROUNDING_UL:
            return f"one dose may have {self.dose_ul:g} µl at most and this one has {dose_ul:g}"
        if dose_ul > max(0.0, self.run_ul - run_used_ul) + _ROUNDING_UL:
            return f"the run may have {self.run_ul:g} µl at most and has had {run_used_ul:g}"
        if high_ul > self.tank_ul + _ROUNDING_UL:
            unsure = f", and would hold up to {high_ul:g}" if high_ul > total_ul + _ROUNDING_UL else ""
            return f"the tank may have {self.tank_ul:g} µl at most{unsure}; fill it anew and start a new ledger"
        return None

    def refusal_aside(self, volume_ul: float) -> str | None:
        """Why delivering `volume_ul` beside the tank is refused, or None.

        >>> DoseLimits(dose_ul=500.0, run_ul=2000.0, tank_ul=3000.0).refusal_aside(600.0)
        'give more than 0 and no more than the 500 µl that one dose may have'
        """
        if 0.0 < volume_ul <= self.dose_ul:
            return None
        return f"give more than 0 and no more than the {self.dose_ul:g} µl that one dose may have"

    def remaining(self, tank: Delivered, run_used_ul: float) -> Remaining:
        """What is left when the tank holds `tank` and the run has used so much; what is asked beyond it is refused."""
        unsure_ul = tank.volume_ul - tank.low_ul
        run_ul = max(0.0, self.run_ul - run_used_ul - unsure_ul)
        tank_ul = max(0.0, self.tank_ul - tank.high_ul)
        return Remaining(min(max(0.0, self.dose_ul - unsure_ul), run_ul, tank_ul), run_ul, tank_ul)
