"""Particles whose scattering Mie's theory gives: beads by their label, and the droplets of a fat emulsion."""

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tankrig.materials.curve import Curve
from tankrig.scene.checks import CLOSED, require
from tankrig.scene.description import Medium
from tankrig.scene.mie import Mie
from tankrig.scene.phase_functions import Mixture

Array = NDArray[np.float64]

SMALLEST_UM, LARGEST_UM = 0.05, 10.0


@dataclass(frozen=True)
class Beads:
    """Beads of one diameter in water, as a label describes them.

    Parameters
    ----------
    index, water_index
        Refractive indices against the wavelength.
    solids, solids_relative_sd
        g of polymer per ml of the suspension.
    density, density_relative_sd
        Of the polymer, g/ml.
    diameter_um, diameter_relative_sd
        Mean by number.
    spread
        Standard deviation of the diameters over their mean.
    index_sd
        Of the particles' index; half of what sources differ by.
    labels
        Where solids, diameters and density are from.
    """

    __pydantic_config__ = CLOSED
    index: Curve
    water_index: Curve
    solids: float
    solids_relative_sd: float
    density: float
    density_relative_sd: float
    diameter_relative_sd: float
    spread: float
    index_sd: float
    labels: str
    diameter_um: float = 1.0

    def __post_init__(self) -> None:
        require(
            SMALLEST_UM <= self.diameter_um <= LARGEST_UM,
            f"beads of {self.diameter_um:g} µm are outside {SMALLEST_UM:g} … {LARGEST_UM:g} µm",
        )
        require(0.0 < self.solids <= 0.2, f"solids = {self.solids:g} g/ml is outside 0 … 0.2; 1 % solids are 0.01")

    def mie(self, wavelength_nm: float, band_nm: float = 0.0) -> Mie:
        """Of the beads; with a band, at the indices of its middle."""
        particle, water = self.index.at(wavelength_nm), self.water_index.at(wavelength_nm)
        return Mie(self.diameter_um, particle, water, wavelength_nm, self.spread, band_nm)

    def volume_share(self) -> float:
        """Of the suspension that is polymer."""
        return self.solids / self.density

    def liquid(self, wavelength_nm: float, index_off: float = 0.0, band_nm: float = 0.0) -> Medium:
        """The suspension, undiluted: σs = share · ⟨cross-section⟩ / ⟨volume⟩ (independent scattering).

        Parameters
        ----------
        wavelength_nm
            In vacuum.
        index_off
            By which the particles' index is higher than believed.
        band_nm
            Width of the light's band.
        """
        mie = self.mie(wavelength_nm, band_nm)
        mie = replace(mie, particle_index=mie.particle_index + index_off)
        volume_um3 = math.pi / 6.0 * self.diameter_um**3 * (1.0 + self.spread**2) ** 3  # ⟨d³⟩ of a log-normal
        per_mm = 1e3 * self.volume_share() * mie.cross_section_um2 / volume_um3
        return Medium(0.0, per_mm, phase=mie)

    def varied(self, wavelength_nm: float, band_nm: float = 0.0) -> dict[str, tuple[Medium, ...]]:
        """The suspension with one thing after the other a standard deviation higher and lower, by what that is."""

        def liquid(name: str, share: float) -> Medium:
            changed: dict[str, Any] = {name: getattr(self, name) * (1.0 + share)}
            return replace(self, **changed).liquid(wavelength_nm, band_nm=band_nm)

        either = (1.0, -1.0)
        return {
            "refractive index": tuple(self.liquid(wavelength_nm, sign * self.index_sd, band_nm) for sign in either),
            "diameter": tuple(liquid("diameter_um", sign * self.diameter_relative_sd) for sign in either),
            "solids": (liquid("solids", self.solids_relative_sd),),
            "density": (liquid("density", self.density_relative_sd),),
        }


_WATER, _OIL, _DISPERSION = 1.311, 1.451, (1.154e4, -1.132e9)
"""n = 1.311 (water) or 1.451 (soybean oil) + 1.154e4/λ² − 1.132e9/λ⁴, λ in nm (Michels et al. 2008)."""
_SIZES = np.arange(0.25, 12.0, 0.25)
"""Diameters over d₀ that stand for all: below and above is .1 % of the light."""


@lru_cache(maxsize=32)
def droplets(mean_cosine: float, wavelength_nm: float) -> Mixture:
    """Phase function of oil droplets in water with diameters ∝ exp(−d/d₀), d₀ such that ⟨cos θ⟩ is `mean_cosine`.

    What sources publish of fat emulsions is σs and g; sizes fall off exponentially (van Staveren et al. 1991, Appl.
    Opt. 30, 4507).

    Examples
    --------
    >>> round(droplets(0.66, 633.0).mean_cosine, 3)
    0.66
    """
    import miepython
    from scipy.optimize import brentq

    require(0.1 <= mean_cosine <= 0.9, f"no fat emulsion has the mean cosine {mean_cosine:.3g}")
    dispersion = _DISPERSION[0] / wavelength_nm**2 + _DISPERSION[1] / wavelength_nm**4
    oil, water = _OIL + dispersion, _WATER + dispersion

    def light(scale_um: float) -> tuple[Array, Array]:
        """Scattered by the droplets of each size, up to a factor; and their mean cosines."""
        _, scattering, _, cosine = miepython.efficiencies_mx(
            np.full(_SIZES.size, oil / water), math.pi * scale_um * _SIZES * water / (wavelength_nm / 1000.0)
        )
        return np.exp(-_SIZES) * scattering * _SIZES**2, np.asarray(cosine)

    def missed(scale_um: float) -> float:
        weights, cosine = light(scale_um)
        return float(weights @ cosine / weights.sum()) - mean_cosine

    scale_um = float(brentq(missed, 0.01, 1.0, xtol=1e-6))
    shares = light(scale_um)[0]
    spheres = tuple(Mie(scale_um * float(size), oil, water, wavelength_nm) for size in _SIZES)
    return Mixture(spheres, tuple((shares / shares.sum()).tolist()))
