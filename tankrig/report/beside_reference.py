"""Whether what a run found of a reference liquid is what is known of it, with both uncertainties."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tankrig.live.results import DoseFit, SeriesFit
from tankrig.materials.coefficients import Optics, Uncertain, sideways
from tankrig.materials.scalar_light import polarised
from tankrig.scene.description import Medium

Array = NDArray[np.float64]

AGREES = 2.0
"""Combined standard deviations by which two numbers that are the same may differ."""
WIDEST = 0.1
"""Combined relative standard deviation from which on agreement says nothing: a wrong number would agree too."""
TANK_SD = 0.005
"""Relative standard deviation of the tank's volume, where nobody says another."""


@dataclass(frozen=True)
class Row:
    """One number of the liquid, as it was found and as it is known.

    Parameters
    ----------
    name, unit
        For people.
    found, found_sd
        By the run, of a ml of what the pump held.
    determined
        Whether the run's fit says that it is.
    known
        By the reference, with what its uncertainty is made of.
    """

    name: str
    unit: str
    found: float
    found_sd: float
    determined: bool
    known: Uncertain

    @property
    def sd(self) -> float:
        """Standard deviation of the difference."""
        return math.hypot(self.found_sd, self.known.sd)

    @property
    def deviations(self) -> float:
        """By how many standard deviations they differ."""
        return (self.found - self.known.value) / self.sd if self.sd > 0.0 else math.inf

    @property
    def says(self) -> str:
        """In a few words, what the comparison says."""
        if not self.determined:
            return "not determined by the run"
        if abs(self.deviations) > AGREES:
            return "disagrees"
        if self.sd > WIDEST * abs(self.known.value):
            return "too uncertain to tell"
        return "agrees"


@dataclass(frozen=True)
class Validation:
    """A run beside a reference liquid.

    Parameters
    ----------
    optics
        The reference, undiluted.
    series, doses
        What the run found: of all doses, and of each alone.
    rows
        σs, σs(1−g), σs·p(90°) per ml, and g.
    tank_ml, stock
        Water in the tank, and parts that one part of the liquid was diluted to before it was dosed.
    doubts
        Why it did not pass, in sentences; empty where it passed.
    polarisation
        Largest degree of the light's linear polarisation that was counted; None where nobody has said it.
    """

    optics: Optics
    series: SeriesFit
    doses: tuple[DoseFit, ...]
    rows: tuple[Row, ...]
    tank_ml: float
    stock: float
    doubts: tuple[str, ...]
    polarisation: float | None = None

    @property
    def passed(self) -> bool:
        """Whether all that was determined agrees, and could have disagreed."""
        return not self.doubts

    @property
    def verdict(self) -> str:
        """In one sentence or more."""
        sigma_s = self.rows[0]
        off, sd = (100.0 * one / sigma_s.known.value for one in (sigma_s.found - sigma_s.known.value, sigma_s.sd))
        both = f"σs per ml is {off:+.1f} % off the reference, ± {sd:.1f} % for both together"
        return f"Passed: {both}." if self.passed else f"Not passed: {both}. {' '.join(self.doubts)}"


def validated(
    optics: Optics,
    series: SeriesFit,
    doses: Sequence[DoseFit],
    tank_ml: float,
    tank_relative_sd: float = TANK_SD,
    stock: float = 1.0,
    polarisation: float | None = None,
) -> Validation:
    """Compare a run's fits with a reference.

    Parameters
    ----------
    optics
        The reference, undiluted.
    series, doses
        Of the run: its series fit, whose covariance counts the doses' errors, and the fits of each dose.
    tank_ml, tank_relative_sd
        Water in the tank.
    stock
        Parts that one part of the liquid was diluted to before it was dosed.
    polarisation
        Largest degree of the light's linear polarisation, 0 … 1; None: nobody knows, and all is possible.
    """
    ink, by = series.ink, 1.0 / (tank_ml * stock)
    covariance = _covariance(series)
    light = _polarised(optics, polarisation)
    numbers: dict[str, tuple[str, tuple[str, ...], Callable[[Medium], float], Uncertain]] = {
        "σs per ml": ("1/mm", ("sigma_s",), lambda one: one.sigma_s, optics.sigma_s),
        "σs(1−g) per ml": ("1/mm", ("sigma_s", "g"), lambda one: one.sigma_s * (1.0 - one.g), _reduced(optics)),
        "σs·p(90°) per ml": ("1/mm/sr", ("sigma_s", "g"), sideways, optics.sideways),
    }
    rows = []
    told = {} if series.scattering is None else {
        "σs(1−g) per ml": series.scattering.reduced, "σs·p(90°) per ml": series.scattering.at_right_angle
    }  # fmt: skip
    for name, (unit, needed, number, stock_value) in numbers.items():
        parts = {cause: by * change for cause, change in stock_value.parts.items()}
        parts |= {"tank": by * stock_value.value * tank_relative_sd, "polarised light": by * stock_value.value * light}
        known = Uncertain(by * stock_value.value, parts)
        determined = all(series.identifiable.get(one, True) for one in needed)
        value, sd = told.get(name) or (number(ink), _sd_of(number, ink, covariance))
        rows.append(Row(name, unit, value, sd, determined, known))
    g_sd = math.sqrt(covariance[2, 2])
    rows.append(Row("g", "", ink.g, g_sd, series.identifiable.get("g", True), optics.g))
    found = Validation(optics, series, tuple(doses), tuple(rows), tank_ml, stock, (), polarisation)
    return replace(found, doubts=_doubts(found))


def _doubts(found: Validation) -> tuple[str, ...]:
    doubts = []
    for row in found.rows:
        if row.says == "disagrees":
            doubts.append(f"{row.name} differs by {row.deviations:+.1f} combined standard deviations.")
    sigma_s = found.rows[0]
    if sigma_s.says != "agrees" and sigma_s.says != "disagrees":
        doubts.append(f"σs per ml is {sigma_s.says}, so nothing was tested.")
    linearity = found.series.linearity
    if linearity is None:
        doubts.append("Whether σs grows in proportion to the dose was not tested; that takes three doses.")
    elif not linearity.holds:
        doubts.append(
            f"σs does not grow in proportion to the dose: {100.0 * linearity.bend:+.1f} ± "
            f"{100.0 * linearity.sd:.1f} % at the highest, where particles so far apart scatter independently."
        )
    return tuple(doubts)


def _covariance(series: SeriesFit) -> Array:
    """(3, 3) of the ink's σa, σs and g; earlier versions stored standard deviations only."""
    if series.covariance:
        return np.array(series.covariance, float)[:3, :3]
    return np.diag(np.square(np.array(series.sd[:3], float)))


def _sd_of(number: Callable[[Medium], float], ink: Medium, covariance: Array) -> float:
    """Of a number of the ink, by its slopes; where the phase function is no Henyey–Greenstein, its shape is kept."""
    sd = np.sqrt(np.diag(covariance))
    steps = 0.1 * np.array([max(one, 1e-9) for one in sd])
    value, slopes = number(ink), np.zeros(3)
    for k, name in enumerate(("sigma_a", "sigma_s", "g")):
        if name == "g" and ink.phase is not None:
            continue
        near = -1.0 if name == "g" and ink.g + steps[k] >= 1.0 else 1.0
        moved = {name: getattr(ink, name) + near * steps[k]}
        slopes[k] = (number(replace(ink, **moved)) - value) / (near * steps[k])
    return math.sqrt(max(float(slopes @ covariance @ slopes), 0.0))


def _reduced(optics: Optics) -> Uncertain:
    """σs(1−g), undiluted, 1/mm: as somebody measured it where somebody did, else by σs and g."""
    measured, wavelength_nm = optics.material.reduced, optics.wavelength_nm
    if measured is None or not measured.covers(wavelength_nm):
        return optics.reduced
    return Uncertain(measured.at(wavelength_nm), {"σs(1−g) of the source": measured.uncertainty(wavelength_nm)})


def _polarised(optics: Optics, degree: float | None) -> float:
    """Relative standard deviation that the light's polarisation adds, all up to its largest effect being as likely."""
    most = polarised(optics.medium.phase_function)
    return (1.0 if most is None else most) * (1.0 if degree is None else degree) / math.sqrt(3.0)


def budget(row: Row) -> Mapping[str, float]:
    """What the uncertainty of a comparison is made of, as shares of the reference, the largest first."""
    parts = {cause: abs(change / row.known.value) for cause, change in row.known.parts.items()}
    parts["fit, with doses"] = row.found_sd / abs(row.known.value)
    return dict(sorted(((cause, one) for cause, one in parts.items() if one > 5e-5), key=lambda pair: -pair[1]))
