"""What a fit says about how a liquid scatters: its phase function as a curve with a band, and what follows from it."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.phase_families import CONE_DEG, Family
from tankrig.scene import Medium

Array = NDArray[np.float64]

ANGLES_DEG = np.array([0.0, 2.0, 5.0, *np.arange(10.0, 181.0, 5.0)])
"""At which the curve is given."""
PER_M = 1000.0
"""From 1/mm to 1/m."""
RIGHT_ANGLE = int(np.flatnonzero(ANGLES_DEG == 90.0)[0])


MOST_LOGARITHM = 300.0
"""Width of a band at most, as a logarithm: what is not known at all has one without end, and numbers do not."""


@dataclass(frozen=True)
class PhaseCurve:
    """A phase function with what is known of it.

    Parameters
    ----------
    angle_deg
        (n,) scattering angles.
    value
        (n,) p in 1/sr.
    sd
        (n,) standard deviation of ln p.
    """

    angle_deg: Array
    value: Array
    sd: Array

    def band(self, level: float = 0.95) -> tuple[Array, Array]:
        """(n,) lowest and highest p, each with probability `level` to lie between."""
        from scipy.special import ndtri

        if not 0.0 < level < 1.0:
            raise ValueError(f"level = {level} is no probability; give one between 0 and 1, such as 0.95")
        factor = np.exp(np.minimum(float(ndtri(0.5 + 0.5 * level)) * self.sd, MOST_LOGARITHM))
        return self.value / factor, self.value * factor


@dataclass(frozen=True)
class Scattering:
    """How a fitted liquid scatters.

    Parameters
    ----------
    liquid
        σa, σs, and the phase function.
    covariance
        (3, 3) of σa, σs and the mean cosine.
    curve
        The phase function with a band.
    at_right_angle
        σs p(90°) in 1/(mm sr), which order 1 is in proportion to, and its standard deviation.
    reduced
        σs (1 − mean cosine) in 1/mm, which thick liquids tell, and its standard deviation.
    parameters
        What the family describes the phase function by, as name: (value, standard deviation).
    families
        How much of the answer each family has, by its name; they add up to 1.
    outside_cone
        σs in 1/mm of what is scattered by more than `CONE_DEG`, which images tell whatever p is within it, and its
        standard deviation.
    beta
        Volume scattering function σs p in 1/(m sr), with the standard deviation of its logarithm; of ink, per ml. It
        is as absolute as σs, which comes from how light fades and spreads and needs no known gain.
    may_peak
        Whether a peak within the cone, as natural waters have one, is as likely as not to have one: then σs and the
        mean cosine are those of what is smooth there, with what a peak may add in `covariance`, and `outside_cone` is
        known.
    beads
        The liquid as spheres alone, where these are likelier than all else and it is hardly off them; else None.
    explains_as_well
        Of spheres that were fitted since a free phase function's fit made them likely: whether they explain what was
        seen as well as that does.
    """

    liquid: Medium
    covariance: Array
    curve: PhaseCurve
    at_right_angle: tuple[float, float]
    reduced: tuple[float, float]
    outside_cone: tuple[float, float]
    parameters: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    families: Mapping[str, float] = field(default_factory=dict)
    beta: PhaseCurve | None = None
    may_peak: bool = False
    beads: Medium | None = None
    explains_as_well: bool = True


def scattering_of(coefficients: Array, coordinates: Array, spread: Array, family: Family) -> Scattering:
    """What follows from coefficients and coordinates of a family, to first order.

    Parameters
    ----------
    coefficients
        (2,) σa and σs.
    coordinates
        (k,) of the family's member.
    spread
        (2 + k, 2 + k) covariance of both.
    family
        Of phase functions.
    """
    sigma_a, sigma_s = (float(one) for one in coefficients)
    liquid = Medium(sigma_a, sigma_s, phase=family.phase(coordinates))
    values, slopes = _read_off(family, coordinates)
    log, mean_cosine, outside = values[:-2], float(values[-2]), sigma_s * math.exp(values[-1])
    of_values = np.hstack([np.zeros((values.size, 2)), slopes])
    of_coefficients = np.vstack([np.eye(2, 2 + coordinates.size), of_values[-2]])
    covariance = of_coefficients @ spread @ of_coefficients.T
    of_beta = of_values.copy()  # and of the logarithm of σs times whatever else is a logarithm
    of_beta[:, 1] += 1.0 / sigma_s
    seen, of_curve = sigma_s * math.exp(log[RIGHT_ANGLE]), of_values[:-2]
    curve = PhaseCurve(ANGLES_DEG, np.exp(log), _sds(of_curve, spread))
    beta = PhaseCurve(ANGLES_DEG, PER_M * sigma_s * curve.value, _sds(of_beta[:-2], spread))
    return Scattering(
        liquid, covariance, curve, (seen, _sd(seen * of_beta[RIGHT_ANGLE], spread)),
        reduced_of(sigma_s, mean_cosine, covariance), (outside, _sd(outside * of_beta[-1], spread)),
        _parameters(family, coordinates, spread[2:, 2:]), {family.name: 1.0}, beta,
    )  # fmt: skip


def coefficients_by(family: Family, coordinates: Array) -> Array:
    """(3, 2 + k) derivatives of σa, σs and the mean cosine by σa, σs and the coordinates."""

    def mean_cosine(at: Array) -> Array:
        return np.array([family.phase(at).mean_cosine])

    found = np.eye(3, 2 + coordinates.size)
    found[2, 2:] = _by_coordinates(mean_cosine, family, coordinates)[0]
    return found


def reduced_of(sigma_s: float, cosine: float, covariance: Array) -> tuple[float, float]:
    """σs (1 − mean cosine) and its standard deviation."""
    return sigma_s * (1.0 - cosine), _sd(np.array([0.0, 1.0 - cosine, -sigma_s]), covariance)


def _read_off(family: Family, coordinates: Array) -> tuple[Array, Array]:
    """(n + 2,) ln p at `ANGLES_DEG`, the mean cosine and the logarithm of the share that turns by more than `CONE_DEG`,
    and (n + 2, k) their derivatives by the coordinates."""
    cosines, cone = np.cos(np.radians(ANGLES_DEG)), np.cos(np.radians([CONE_DEG]))

    def read_off(at: Array) -> Array:
        phase = family.phase(at)
        log = np.log(np.maximum(phase.at(cosines), 1e-300))
        return np.concatenate([log, [phase.mean_cosine], np.log1p(-phase.share_within(cone))])

    return read_off(coordinates), _by_coordinates(read_off, family, coordinates)


def _parameters(family: Family, coordinates: Array, spread: Array) -> dict[str, tuple[float, float]]:
    names = list(family.parameters(coordinates))
    if not coordinates.size or not names:
        return {name: (value, 0.0) for name, value in family.parameters(coordinates).items()}

    def values(at: Array) -> Array:
        return np.array([family.parameters(at)[name] for name in names])

    slopes = _by_coordinates(values, family, coordinates)
    sds = _sds(slopes, spread)
    return {
        name: (float(value), float(sd)) for name, value, sd in zip(names, values(coordinates), sds, strict=True)
    }  # fmt: skip


def _by_coordinates(function, family: Family, coordinates: Array) -> Array:  # type: ignore[no-untyped-def]
    """(n, k) central differences, one-sided at the edge of what is searched."""
    found = []
    for k, size in enumerate(family.difference):
        unit = 0.5 * size * np.eye(coordinates.size)[k]
        above, below = np.minimum(coordinates + unit, family.high), np.maximum(coordinates - unit, family.low)
        found.append((function(above) - function(below)) / max(float(above[k] - below[k]), 1e-300))
    return np.array(found).T if found else np.zeros((function(coordinates).size, 0))


def _sds(slopes: Array, spread: Array) -> Array:
    """(n,) standard deviations of what has slopes (n, k)."""
    return np.asarray(np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", slopes, spread, slopes), 0.0)))


def _sd(slope: Array, spread: Array) -> float:
    return math.sqrt(max(float(slope @ spread @ slope), 0.0))
