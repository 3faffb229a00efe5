"""A published number against the wavelength, with its uncertainty, its range and its source."""

import math
import re
from dataclasses import dataclass
from typing import Literal

import numpy as np

from tankrig.errors import SceneError
from tankrig.scene.checks import CLOSED, require


@dataclass(frozen=True)
class Curve:
    """A number as a source gives it.

    Parameters
    ----------
    law
        "power": a λ^b; "polynomial": Σ cₖ λᵏ; "inverse-powers": Σ cₖ λ⁻ᵏ; "rows": linear between rows.
    source
        Who measured it, and whose its uncertainty is.
    coefficients
        Of the laws but "rows", λ in nm.
    wavelengths_nm, values
        The rows, rising.
    relative_sd, sd
        One standard deviation, as a share of the value or in its own unit; they add in quadrature.
    range_nm
        Wavelengths it holds for; of rows: from the first to the last.
    temperature_c
        At which it was measured, where the source says so.

    Examples
    --------
    >>> law = Curve("power", "somebody", (3.873e8, -2.397), relative_sd=0.03, range_nm=(400, 900))
    >>> round(law.at(633.0), 1), round(law.uncertainty(633.0), 1)
    (74.7, 2.2)
    """

    __pydantic_config__ = CLOSED
    law: Literal["power", "polynomial", "inverse-powers", "rows"]
    source: str
    coefficients: tuple[float, ...] = ()
    wavelengths_nm: tuple[float, ...] = ()
    values: tuple[float, ...] = ()
    relative_sd: float = 0.0
    sd: float = 0.0
    range_nm: tuple[float, float] | None = None
    temperature_c: float | None = None

    def __post_init__(self) -> None:
        if self.law == "rows":
            paired = len(self.wavelengths_nm) == len(self.values) >= 2
            require(paired and bool(np.all(np.diff(self.wavelengths_nm) > 0.0)), "rows: give rising pairs")
            object.__setattr__(self, "range_nm", (self.wavelengths_nm[0], self.wavelengths_nm[-1]))
        else:
            require(len(self.coefficients) > 0 and self.range_nm is not None, "coefficients or range_nm is missing")

    def covers(self, wavelength_nm: float) -> bool:
        """Whether the source says something of a wavelength."""
        assert self.range_nm is not None
        return self.range_nm[0] <= wavelength_nm <= self.range_nm[1]

    def at(self, wavelength_nm: float) -> float:
        """The value at a wavelength.

        Raises
        ------
        SceneError
            When that is outside the range of the source.
        """
        if not self.covers(wavelength_nm):
            low, high = self.range_nm or (0.0, 0.0)
            raise SceneError(
                f"{self._author} says nothing at {wavelength_nm:g} nm; give a wavelength from {low:g} to {high:g} nm"
            )
        if self.law == "rows":
            return float(np.interp(wavelength_nm, self.wavelengths_nm, self.values))
        if self.law == "power":
            factor, exponent = self.coefficients
            return float(factor * wavelength_nm**exponent)
        along = wavelength_nm if self.law == "polynomial" else 1.0 / wavelength_nm
        return float(np.polynomial.polynomial.polyval(along, self.coefficients))

    def uncertainty(self, wavelength_nm: float) -> float:
        """One standard deviation at a wavelength, in the value's unit."""
        return math.hypot(self.sd, self.relative_sd * self.at(wavelength_nm))

    @property
    def _author(self) -> str:
        """Names and year, with which sources begin."""
        found = re.match(r".*?\b\d{4}\b", self.source)
        return found[0] if found else self.source
