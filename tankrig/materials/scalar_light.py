"""What unpolarised light of one wavelength leaves out of a suspension of spheres, bounded.

Order 1 that leaves at an angle θ is p(θ) (1 + q P(θ)) in place of p(θ): q is the light's own polarisation (+1: all of
its field across the plane of scattering, −1: all in it), P(θ) the spheres' (Bohren and Huffman 1983, Eq. 4.78). Light
that scatters once is polarised, so that order 2 differs from ∫ p p even where the projector's light is not.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tankrig.scene.mie import Mie
from tankrig.scene.phase_functions import Mixture
from tankrig.scene.phase_table import PhaseFunction

Array = NDArray[np.float64]

SEEN_DEG = (80.0, 100.0)
"""Angles that a camera above the tank sees order 1 at, with its perspective."""


@dataclass(frozen=True)
class LeftOut:
    """How far wrong scalar light of one wavelength may be.

    Parameters
    ----------
    polarisation
        (least, most) of P(θ) over the angles that the camera sees.
    second_order
        Relative change of order 2, over the whole image, that the polarisation of once-scattered light makes.
    band
        Largest relative change of σs p(θ) over the seen angles when the light has a band, and that band in nm.
    band_nm
        Full width at half maximum.
    """

    polarisation: tuple[float, float]
    second_order: float
    band: float
    band_nm: float

    def first_order(self, degree: float = 1.0) -> float:
        """Largest relative change of order 1 with light of a degree of polarisation 0 … 1, across or along."""
        return degree * max(abs(one) for one in self.polarisation)


def polarised(phase: PhaseFunction) -> float | None:
    """Largest |P(θ)| over the angles that the camera sees; None where the particles are not known to be spheres."""
    cosine = np.cos(np.radians(np.linspace(*SEEN_DEG, 41)))
    if isinstance(phase, Mie):
        return float(np.abs(phase.polarisation(cosine)).max())
    if isinstance(phase, Mixture) and all(isinstance(one, Mie) for one in phase.parts):
        parts = [(share * one.at(cosine), one) for share, one in zip(phase.shares, phase.parts, strict=True)]
        across = sum(light * one.polarisation(cosine) for light, one in parts if isinstance(one, Mie))
        return float(np.abs(across / sum(light for light, _ in parts)).max())
    return None


def left_out(mie: Mie, band_nm: float = 20.0) -> LeftOut:
    """Bounds for spheres.

    Parameters
    ----------
    mie
        Of them, in light of one wavelength.
    band_nm
        Width of the projector's colour, where that is not a laser.

    Examples
    --------
    >>> small = left_out(Mie(0.05, 1.59, 1.33, 633.0))
    >>> small.polarisation[1] > 0.99, small.second_order < -0.05
    (True, True)
    """
    cosine = np.cos(np.radians(np.linspace(*SEEN_DEG, 41)))
    polarisation = mie.polarisation(cosine)
    ends = float(polarisation.min()), float(polarisation.max())
    return LeftOut(ends, second_order(mie), band_change(mie, band_nm), band_nm)


def band_change(mie: Mie, band_nm: float) -> float:
    """Largest relative change of σs p(θ), over the angles that the camera sees, when light has a band of that width."""
    cosine = np.cos(np.radians(np.linspace(*SEEN_DEG, 41)))
    one, banded = replace(mie, band_nm=0.0), replace(mie, band_nm=band_nm)
    changed = banded.cross_section_um2 * banded.at(cosine) / (one.cross_section_um2 * one.at(cosine)) - 1.0
    return float(np.abs(changed).max())


def second_order(mie: Mie) -> float:
    """Relative change of order 2 by the polarisation of once-scattered light: ∫ p₁ p₂ P₁ P₂ cos 2φ / ∫ p₁ p₂.

    Light enters along x and leaves along z, as in the tank; φ is the angle between the two planes of scattering, and
    all directions in between count alike, as they do over a whole image of a thin tank.
    """
    nodes, weights = np.polynomial.legendre.leggauss(200)
    azimuth = (np.arange(360) + 0.5) * math.pi / 180.0
    first = nodes[:, None]  # cosine between x and the direction in between
    across = np.sqrt(1.0 - first**2)
    second = across * np.cos(azimuth)  # and between it and z
    sine_second = np.sqrt(np.maximum(1.0 - second**2, 1e-300))
    # The planes' normals are x × ω and ω × z; with ω = (c, s sin a, s cos a) their product is s c cos a.
    cos_phi = first * np.cos(azimuth) / sine_second
    scalar = mie.at(first) * mie.at(second)
    vector = scalar * mie.polarisation(first) * mie.polarisation(second) * (2.0 * cos_phi**2 - 1.0)
    return float(weights @ vector.sum(axis=1) / (weights @ scalar.sum(axis=1)))
