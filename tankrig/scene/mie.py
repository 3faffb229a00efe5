"""Mie scattering by spheres in water."""

import math
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray

from tankrig.ranges import Within
from tankrig.scene.checks import CLOSED, in_ranges, require
from tankrig.scene.mie_series import scattered_by
from tankrig.scene.phase_table import PhaseFunction, sines

Array = NDArray[np.float64]

FEW = 256
"""Cosines below which the series is summed at them, and no table is made."""
REACH, STEPS, RESOLVED = 4.0, (0.05, 0.5), 0.3
"""Standard deviations that a log-normal of diameters goes to; smallest and largest step there, in these; and the step
of πd/λ that resolves resonances. Of spheres of 3 µm with a spread of .4, steps of .15 left p 5 % off."""


@dataclass(frozen=True)
class Mie(PhaseFunction):
    """Spheres in water in unpolarised light, by Mie's series.

    Parameters
    ----------
    diameter_um
        Of the spheres: the mean by number.
    particle_index, water_index
        Refractive indices.
    wavelength_nm
        Of the light, in vacuum.
    spread
        Standard deviation of the diameters over their mean (log-normal); 0: all alike.
    band_nm
        Full width at half maximum of the light's band (Gaussian); 0: one wavelength.

    Examples
    --------
    >>> round(Mie(1.0, 1.5868, 1.3317, 633.0).mean_cosine, 3)
    0.918
    """

    __pydantic_config__ = CLOSED
    diameter_um: Annotated[float, Within(0.001, 50.0, "is outside 0.001 … 50; give the spheres' diameter in µm")]
    particle_index: Annotated[float, Within(1.0, 4.0, "is outside 1 … 4; give the refractive index of the spheres")]
    water_index: Annotated[float, Within(1.0, 2.0, "is outside 1 … 2; give the refractive index of the water")]
    wavelength_nm: Annotated[
        float, Within(200.0, 2000.0, "is outside 200 … 2000; give the light's wavelength in vacuum, nm")
    ]
    spread: Annotated[float, Within(0.0, 0.6, "is outside 0 … 0.6; give a share of the diameter")] = 0.0
    band_nm: Annotated[float, Within(0.0, 2000.0, "is negative or as wide as the wavelength", below=True)] = 0.0
    kind: Literal["mie"] = field(default="mie", repr=False)

    def __post_init__(self) -> None:
        in_ranges(self)
        require(
            self.particle_index != self.water_index,
            "particle_index equals water_index: such spheres scatter nothing",
        )
        require(self.band_nm < self.wavelength_nm, f"band_nm = {self.band_nm} is negative or as wide as the wavelength")

    def density(self, cosine: Array) -> Array:
        """See `PhaseFunction.density`."""
        if np.size(cosine) < FEW:
            return _at_few(self, np.ravel(cosine).tobytes()).reshape(np.shape(cosine))
        return np.asarray(np.interp(np.sqrt(0.5 - 0.5 * cosine), sines(), _spheres(self)[1]))

    def polarisation(self, cosine: Array) -> Array:
        """P(cos θ) = (|S₁|² − |S₂|²) / (|S₁|² + |S₂|²): how far unpolarised light is polarised by one scattering.

        1: all across the plane of scattering; −1: all in it (Bohren and Huffman 1983, Eq. 4.78).
        """
        _, density, across = _spheres(self)
        sine = np.sqrt(np.clip(0.5 - 0.5 * np.asarray(cosine, float), 0.0, 1.0))
        return np.asarray(2.0 * np.interp(sine, sines(), across) / np.interp(sine, sines(), density) - 1.0)

    @cached_property
    def cross_section_um2(self) -> float:
        """Mean scattering cross-section of a sphere, µm²."""
        return _spheres(self)[0]


@lru_cache(maxsize=64)
def _spheres(mie: Mie) -> tuple[float, Array, Array]:
    """Mean scattering cross-section, µm², p at the nodes, and the part of it that is across the plane of scattering."""
    return _summed(mie, 1.0 - 2.0 * sines() ** 2)


@lru_cache(maxsize=64)
def _at_few(mie: Mie, cosines: bytes) -> Array:
    """p at few cosines, of which the same are asked for again and again."""
    return _summed(mie, np.frombuffer(cosines))[1]


def _summed(mie: Mie, cosine: Array) -> tuple[float, Array, Array]:
    """The same at cosines, by the coefficients of Mie's series."""
    ratio = mie.particle_index / mie.water_index
    total, density, across = 0.0, np.zeros(cosine.size), np.zeros(cosine.size)
    for wavelength, light in _band(mie):
        diameters, numbers = np.array(_diameters(mie)).T
        own, whole, part = scattered_by(diameters, ratio, 2e3 * math.pi * mie.water_index / wavelength, cosine)
        total += light * float(numbers @ own)
        density, across = density + light * (numbers @ whole), across + light * (numbers @ part)
    require(bool(np.isfinite(density).all() and 0.0 < total < math.inf), f"Mie's series fails for {mie}")
    return total, density / total, across / total


def _diameters(mie: Mie) -> list[tuple[float, float]]:
    """Diameters in µm with shares of the number."""
    if mie.spread == 0.0:
        return [(mie.diameter_um, 1.0)]
    width = math.sqrt(math.log1p(mie.spread**2))
    # Small spheres scatter as the sixth power of their diameter, large ones as the second: by light, a log-normal is
    # moved up by so many times its variance.
    last = REACH + 6.0 * width
    size = math.pi * mie.water_index * mie.diameter_um / (1e-3 * mie.wavelength_nm) * math.exp(4.0 * width**2)
    step = float(np.clip(RESOLVED / (width * size), *STEPS))
    at = np.linspace(-REACH, last, 2 + int((last + REACH) / step))
    shares = np.exp(-0.5 * at**2)
    return list(zip(mie.diameter_um * np.exp(width * at - 0.5 * width**2), shares / shares.sum(), strict=True))


def _band(mie: Mie) -> list[tuple[float, float]]:
    """Wavelengths in nm with shares of the light."""
    if mie.band_nm == 0.0:
        return [(mie.wavelength_nm, 1.0)]
    at = np.linspace(-2.5, 2.5, 11)
    shares = np.exp(-0.5 * at**2)
    return list(zip(mie.wavelength_nm + mie.band_nm / 2.3548 * at, shares / shares.sum(), strict=True))
