"""Counts per electron and read noise, from how the noise grows with the light."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tankrig.calibration.darks import Dark
from tankrig.calibration.exposed import MOST_SATURATED, Array, Exposed
from tankrig.calibration.linearity import Linearity
from tankrig.errors import ImageError

ROUNDING = 1.0 / 12.0
"""Variance of rounding to whole counts, counts²."""
_GROUPS = 8


@dataclass(frozen=True)
class PhotonTransfer:
    """Noise of a camera at one gain: variance = read + dn_per_e · linear counts, dark current included.

    Parameters
    ----------
    dn_per_e, dn_per_e_sd
        Counts that one electron makes.
    read_noise_e, read_noise_e_sd
        Standard deviation of reading out, electrons, without rounding.
    misfit
        Reduced χ² of the line; far above 1 where light or camera were unsteady.
    """

    dn_per_e: float
    dn_per_e_sd: float
    read_noise_e: float
    read_noise_e_sd: float
    misfit: float


def photon_transfer(sweep: Sequence[Exposed], dark: Dark, linearity: Linearity) -> PhotonTransfer:
    """Fit the photon-transfer line of an exposure sweep.

    The variance in time of n frames, (n = 2: ½ var of their difference), of pixels of like brightness, against their
    mean above the dark; both are made linear first, because a curve that flattens makes noise smaller, too. Electrons
    are Poisson, so the slope is counts per electron.

    Parameters
    ----------
    sweep
        Above the dark; saturated exposures are left out.
    dark, linearity
        Of the same gain.

    Raises
    ------
    ImageError
        When fewer than four exposures are left, or the noise does not grow with the light.
    """
    points = [_points(one, dark, linearity) for one in sweep if one.saturated <= MOST_SATURATED]
    if len(points) < 4:
        raise ImageError(f"{len(points)} exposures are not saturated, and 4 are needed; darken the light")
    signal, variance, relative = np.concatenate(points, axis=1)
    signal, variance = np.append(signal, 0.0), np.append(variance, dark.read_variance)
    relative = np.append(relative, dark.read_variance_sd / dark.read_variance)
    design, expected = np.stack([np.ones_like(signal), signal], axis=1), variance
    for _ in range(4):  # weighted by the line, for a variance that came out small is not known any better
        sd = relative * expected
        line = np.linalg.lstsq(design / sd[:, None], variance / sd, rcond=None)[0]
        expected = np.maximum(design @ line, 0.1 * variance)
    covariance = np.linalg.inv((design / sd[:, None]).T @ (design / sd[:, None]))
    misfit = float(np.sum(((variance - design @ line) / sd) ** 2) / max(len(signal) - 2, 1))
    gain, gain_sd = float(line[1]), float(np.sqrt(covariance[1, 1] * max(misfit, 1.0)))
    if not gain > 3.0 * gain_sd:
        raise ImageError(
            "the noise does not grow with the light, so electrons cannot be counted; use raw frames, without the "
            "camera's noise reduction, gamma or compression"
        )
    read = max(dark.read_variance - ROUNDING, 0.0)
    noise = float(np.sqrt(read)) / gain
    # Rounding adds 1/12 count² on average over levels; to a noise of less than a count it adds by where the level is.
    rounded = (1.0 / np.pi**2 + 4.0 * read) * np.exp(-2.0 * np.pi**2 * read)
    read_sd = float(np.hypot(dark.read_variance_sd, rounded))
    noise_sd = float(np.hypot(read_sd / (2.0 * gain * np.sqrt(max(read, ROUNDING))), noise * gain_sd / gain))
    return PhotonTransfer(gain, gain_sd, noise, noise_sd, misfit)


def _points(one: Exposed, dark: Dark, linearity: Linearity) -> Array:
    """(3, groups): linear counts, those of the dark current with them, their variance, its relative sd."""
    good = ~dark.hot
    mean, variance = one.mean[good], one.variance[good] * linearity.slope(one.mean[good]) ** 2
    groups = np.array_split(np.argsort(mean), _GROUPS)
    linear = linearity.linear(mean) + dark.rate[good] * one.exposure_ms
    rows = []
    for group in groups:
        rows.append((linear[group].mean(), variance[group].mean(), np.sqrt(2.0 / ((one.frames - 1) * len(group)))))
    return np.array(rows).T
