"""How much ink may go into a tank."""

import math
from dataclasses import dataclass

from tankrig.devices import Delivered
from tankrig.errors import SequenceError

_ROUNDING_UL = 1e-6


@dataclass(frozen=True)
class Remaining:
    """What the budgets still allow in the worst case, µl."""

    dose_ul: float
    run_ul: float
    tank_ul: float


@dataclass(frozen=True)
class DoseLimits:
    """Budgets, µl: for one dose, for one run, for one filling of the tank.

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
    """

    dose_ul: float
    run_ul: float
    tank_ul: float

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (isinstance(value, int | float) and math.isfinite(value) and value > 0):
                raise SequenceError(f"limits: {name} = {value!r} is no budget; give a positive number of µl")

    def refusal(self, total_ul: float, tank: Delivered, run_used_ul: float) -> str | None:
        """Why dosing until the tank holds `total_ul` is refused, or None; `tank` is what it holds before.

        Uncertain amounts count in full.
        """
        dose_ul = total_ul - tank.low_ul
        remaining = self.remaining(tank, run_used_ul)
        if dose_ul > self.dose_ul + _ROUNDING_UL:
            return f"one dose may have {self.dose_ul:g} µl at most and this one has {dose_ul:g}"
        if dose_ul > remaining.run_ul + _ROUNDING_UL:
            return f"the run may have {self.run_ul:g} µl at most and has had {run_used_ul:g}"
        if total_ul > self.tank_ul + _ROUNDING_UL:
            return f"the tank may have {self.tank_ul:g} µl at most; fill it anew and start a new ledger"
        return None

    def remaining(self, tank: Delivered, run_used_ul: float) -> Remaining:
        """What is left when the tank holds `tank` and the run has used so much."""
        run_ul = max(0.0, self.run_ul - run_used_ul)
        tank_ul = max(0.0, self.tank_ul - tank.high_ul)
        return Remaining(min(self.dose_ul, run_ul, tank_ul), run_ul, tank_ul)
