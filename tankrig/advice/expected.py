"""What another photograph is expected to tell, before it is taken.

The ink's σa, σs per ml and g (or the coordinates of a family of phase functions), the water's σa, the logarithm of the
common gain and one error per dose are known with the covariance that photographs give together
(`tankrig.estimation.uncertainty`); another photograph adds its information. That is what a fit of all of them would
state, to first order.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.coordinates import NAMES
from tankrig.estimation.differences import values_of
from tankrig.estimation.ink_blocks import in_tank
from tankrig.estimation.parameters import WIDEST
from tankrig.estimation.phase_families import Family
from tankrig.estimation.phase_result import Scattering, scattering_of
from tankrig.estimation.scaling import Scaling
from tankrig.estimation.uncertainty import Information, Response, SmoothError, total
from tankrig.scene import Medium, Scene

Array = NDArray[np.float64]
Answer = Callable[[Scene, Medium], tuple[Array, Array]]
"""Image of a scene with a medium, and (k, rows, columns) derivatives by `Known.values`."""


@dataclass(frozen=True)
class Shot:
    """One pattern at one dose: taken, or to be taken.

    Parameters
    ----------
    pattern
        Its name.
    scene
        What is seen; its medium means nothing.
    dose_ml, dose_sd_ml
        Ink in the tank.
    frames
        That are averaged.
    used
        (rows, columns) pixels that a fit would look at; None for all.
    """

    pattern: str
    scene: Scene
    dose_ml: float
    dose_sd_ml: float
    frames: int
    used: NDArray[np.bool_] | None = field(default=None, compare=False)


@dataclass(frozen=True)
class Known:
    """What is known, or guessed, of ink and camera.

    Parameters
    ----------
    ink
        Per mm and ml.
    water_sigma_a
        1/mm.
    gain
        Counts per radiance.
    offset_free
        Whether each photograph has an unknown offset.
    noise
        From the (rows, columns) mean of a frame to its variance.
    model_error
        Relative L2 error of the model that will be fitted.
    family
        Of the phase functions that will be fitted, and of the ink's; None: Henyey–Greenstein.
    """

    ink: Medium
    water_sigma_a: float
    gain: float
    offset_free: bool
    noise: Callable[[Array], Array]
    model_error: float
    family: Family | None = None

    @property
    def values(self) -> Array:
        """(k,) what is fitted of the ink: σa, σs per ml and g, or σa, σs and the coordinates of the family."""
        return values_of(self.ink, self.family)

    @property
    def widest(self) -> Array:
        """(k,) standard deviations of these before anything was seen."""
        coefficients = np.full(2, WIDEST * (self.ink.sigma_a + self.ink.sigma_s))
        return np.append(coefficients, usual_widths(self.family))

    def liquid(self, dose_ml: float) -> Medium:
        """In the tank at a dose."""
        return in_tank(self.ink, self.water_sigma_a, dose_ml)


def usual_widths(family: Family | None) -> Array:
    """(k,) standard deviations of g, or of a family's coordinates, before anything was seen."""
    if family is None:
        return np.ones(1)
    return np.where(family.expected, 1.0, family.usual) if family.expected.size else family.usual


@dataclass(frozen=True)
class Expected:
    """What is known after some photographs.

    Parameters
    ----------
    covariance
        (3, 3) of the ink's σa, σs per ml and g.
    relative_sd
        By name; of g it is absolute.
    scattering
        How the ink scatters, with what will be known of its phase function; None where that is Henyey–Greenstein's.
    """

    covariance: Array
    relative_sd: dict[str, float]
    scattering: Scattering | None = None

    def bits_to(self, better: "Expected", name: str | None = None) -> float:
        """Information that turns this into `better`, in bits: about one coefficient, or all three (½ log₂ of the
        ratio of the covariances' determinants)."""
        if name is not None:
            return math.log2(self.relative_sd[name] / better.relative_sd[name])
        before, after = (np.linalg.slogdet(one.covariance)[1] for one in (self, better))
        return float(before - after) / 2.0 / math.log(2.0)


def expected(known: Known, shots: Sequence[Shot], answer: Answer) -> Expected:
    """What a fit of all shots would state, (3, 3) and by name.

    Parameters
    ----------
    known
        Ink and camera.
    shots
        All that are fitted.
    answer
        The model; remember its answers where many selections of the same shots are compared.
    """
    doses = sorted({shot.dose_ml for shot in shots})
    found = total(_about_ink(known, shot, doses, answer) for shot in _averaged(shots))
    ink, densest, count = known.ink, known.liquid(doses[-1]).sigma_t, known.values.size
    widest = np.array([*known.widest, WIDEST * densest, WIDEST, *np.ones(len(doses))])
    covariance, scattering = found.covariance(widest)[:count, :count], None
    if known.family is not None:
        scattering = scattering_of(known.values[:2], known.values[2:], covariance, known.family)
        covariance = scattering.covariance
    sd = np.sqrt(np.diag(covariance))
    scale = (ink.sigma_a, ink.sigma_s, 1.0)
    return Expected(covariance, {name: float(sd[k] / scale[k]) for k, name in enumerate(NAMES)}, scattering)


def _averaged(shots: Sequence[Shot]) -> list[Shot]:
    """Frames of one pattern and dose are one photograph: the model errs in all of them alike."""
    found: dict[tuple[Scene, float], Shot] = {}
    for shot in shots:
        before = found.get((shot.scene, shot.dose_ml))
        frames = shot.frames + (before.frames if before else 0)
        found[shot.scene, shot.dose_ml] = replace(before or shot, frames=frames)
    return list(found.values())


def _about_ink(known: Known, shot: Shot, doses: Sequence[float], answer: Answer) -> Information:
    """A shot's information about ink, water, gain and doses."""
    number, ink, count = doses.index(shot.dose_ml), known.ink, known.values.size
    # Of the ink's values, the water's σa, the logarithm of the gain and the doses by the liquid's values and that gain.
    chain = np.zeros((count + 2 + len(doses), count + 1))
    chain[:count, :count] = np.diag([shot.dose_ml, shot.dose_ml, *np.ones(count - 2)])
    chain[count, 0] = chain[count + 1, count] = 1.0
    chain[count + 2 + number, :2] = shot.dose_sd_ml * ink.sigma_a, shot.dose_sd_ml * ink.sigma_s
    return about_liquid(known, shot, answer).of(chain)


def about_liquid(known: Known, shot: Shot, answer: Answer) -> Information:
    """A shot's information about the liquid's values, and log gain."""
    radiance, slopes = answer(shot.scene, known.liquid(shot.dose_ml))
    image = known.gain * radiance
    noise = np.sqrt(known.noise(image) / shot.frames)
    error = SmoothError.of(shot.scene, known.model_error * image)
    used = np.ones(image.shape, bool) if shot.used is None else shot.used
    changes = np.vstack([known.gain * slopes[:, used], image[used]])
    weights = error.whitening(noise, used)
    one, model = weights.whiten(np.ones(image[used].size)), weights.whiten(image[used])
    left = Scaling(1.0, None if known.offset_free else 0.0).project_out(weights.whiten(changes), [model], [one])
    return Response(left, weights, used).information(noise, error)
