"""How much of a material a tank needs, in which doses, and what that is worth."""

import math
from dataclasses import dataclass

from tankrig.dosing.limits import DoseLimits
from tankrig.errors import SceneError
from tankrig.materials.coefficients import Optics, Uncertain
from tankrig.scene.description import Tank

DILUTIONS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
"""Parts that one part of the liquid becomes before it is dosed."""
LEAST_UL = 20.0
"""Smallest dose that is planned: of less, a pump's last steps and a drop at the needle are percents."""
HALVINGS = 4
"""A series begins at the last dose over 2 to this power."""


@dataclass(frozen=True)
class DosePlan:
    """Doses of a material into a tank.

    Parameters
    ----------
    optics
        Of the undiluted liquid.
    tank_ml
        Water in the tank, and its relative standard deviation.
    tank_relative_sd
        Of that volume.
    dilution
        Parts that one part of the liquid is to become before it is put into the pump; 1: none.
    totals_ul
        What the pump is to have delivered at each step, rising from 0.
    """

    optics: Optics
    tank_ml: float
    tank_relative_sd: float
    dilution: int
    totals_ul: tuple[float, ...]

    @property
    def per_ml(self) -> Uncertain:
        """σs in the tank of a ml of what the pump holds, 1/mm per ml."""
        stock = self.optics.sigma_s
        by = 1.0 / (self.tank_ml * self.dilution)
        parts = {cause: by * change for cause, change in stock.parts.items()}
        return Uncertain(by * stock.value, {**parts, "tank": by * stock.value * self.tank_relative_sd})

    @property
    def sigma_s(self) -> Uncertain:
        """At the last dose, 1/mm."""
        ml, each = self.totals_ul[-1] / 1000.0, self.per_ml
        return Uncertain(ml * each.value, {cause: ml * change for cause, change in each.parts.items()})

    @property
    def volume_share(self) -> float | None:
        """Of the tank that is particles at the last dose; None where that is not known."""
        beads = self.optics.material.beads
        return (
            None if beads is None else beads.volume_share() * self.totals_ul[-1] / 1000.0 / self.dilution / self.tank_ml
        )


def tank_volume_ml(tank: Tank) -> float:
    """Water in a tank.

    Examples
    --------
    >>> tank_volume_ml(Tank((240.0, 160.0, 120.0)))
    4608.0
    """
    return math.prod(tank.size_mm) / 1000.0


def planned(
    optics: Optics,
    sigma_s: float,
    tank_ml: float,
    tank_relative_sd: float = 0.005,
    limits: DoseLimits | None = None,
    least_ul: float = LEAST_UL,
) -> DosePlan:
    """Doses that take a tank of clear water to a scattering coefficient, each about twice the one before.

    The liquid is diluted beforehand as little as it takes for the first dose to be one that a pump can measure.

    Parameters
    ----------
    optics
        Of the material.
    sigma_s
        That the last dose is to give, 1/mm.
    tank_ml, tank_relative_sd
        Water in the tank.
    limits
        Of the rig; None: no limit.
    least_ul
        Smallest dose.

    Raises
    ------
    SceneError
        When the rig's limits allow no such dose, or no dilution makes it large enough.
    """
    if not (math.isfinite(sigma_s) and sigma_s > 0.0):
        raise SceneError(f"sigma_s = {sigma_s:g} is not positive; give the 1/mm that the tank is to have")
    stock = optics.sigma_s.value
    if sigma_s > 0.01 * stock:
        raise SceneError(
            f"{sigma_s:g}/mm is more than a hundredth of what {optics.material.title} has undiluted, {stock:.3g}/mm; "
            "ask for less"
        )
    undiluted_ul = 1000.0 * sigma_s * tank_ml / stock
    most_ul = min(limits.run_ul, limits.tank_ul) if limits else math.inf
    if undiluted_ul > most_ul:
        raise SceneError(
            f"{sigma_s:g}/mm takes {undiluted_ul:.0f} µl of {optics.material.title} and the rig allows {most_ul:g}; "
            f"ask for {sigma_s * most_ul / undiluted_ul:.2g}/mm, or a stronger liquid"
        )
    for dilution in DILUTIONS:
        total_ul = undiluted_ul * dilution
        if total_ul > most_ul:
            break
        if total_ul / 2**HALVINGS >= least_ul:
            return DosePlan(optics, tank_ml, tank_relative_sd, dilution, _totals(total_ul, limits))
        fitting = dilution, total_ul
    dilution, total_ul = fitting
    if total_ul < least_ul:
        raise SceneError(f"{sigma_s:g}/mm is {total_ul:.2g} µl even diluted 1 : {dilution}; ask for more")
    return DosePlan(optics, tank_ml, tank_relative_sd, dilution, _totals(total_ul, limits, least_ul))


def _totals(total_ul: float, limits: DoseLimits | None, least_ul: float = 0.0) -> tuple[float, ...]:
    """0, then doublings up to the total, none below `least_ul` and no dose above the limit."""
    wanted = [total_ul / 2**halving for halving in range(HALVINGS, -1, -1) if total_ul / 2**halving >= least_ul]
    most_ul = limits.dose_ul - 0.1 if limits else math.inf  # what rounding may add to a dose
    totals = [0.0]
    for target in wanted:
        begin, steps = totals[-1], math.ceil((target - totals[-1]) / most_ul - 1e-9) or 1
        totals += [begin + (target - begin) * (step + 1) / steps for step in range(steps)]
    return tuple(math.floor(10.0 * one + 1e-6) / 10.0 for one in totals)
