"""The problem about a place where exact images are known, to first order and as models bend."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.differences import Forward, Slopes, values_of
from tankrig.estimation.followed import Model
from tankrig.estimation.phase_families import Family
from tankrig.estimation.prior_weight import believing
from tankrig.estimation.problem import Evaluation, Problem
from tankrig.estimation.shots import Fit, Shot, weighed_problem
from tankrig.estimation.stated_errors import stated_error
from tankrig.estimation.versions import corrected, image_of
from tankrig.prediction import Prediction
from tankrig.scene import Medium

Vector = NDArray[np.float64]
Image = NDArray[np.floating]

NEAR_ENOUGH, MANY_ENOUGH = 0.005, 0.1
"""Where searches about exact images stop, see `solve`: to first order, where steps cost nothing; and as the models bend
with a phase function's many coordinates, of which each may be off by less than where there are three."""
BENT_STEPS = 6
"""Steps as the models bend, at most: the exact image's optimum is near, and what more of them find is roughness."""
FEW_STEPS = 12
"""Steps with the accurate model, and as the models bend, at most, where a phase function's coordinates are fitted
or high orders are solved for."""


def few_steps(shots: Sequence[Shot]) -> int:
    """Steps at most where each computes orders 1 and 2 of all images anew: fewer of several."""
    return FEW_STEPS if len(shots) == 1 else BENT_STEPS


@dataclass(frozen=True)
class About:
    """The problem about a place where exact images are known.

    Parameters
    ----------
    weighed
        By the exact images' errors, with models that agree with them at the place.
    bent
        The same with the paths' noise in the exact images taken off what was observed.
    line
        That to first order.
    models
        Of the views of `weighed`.
    apart
        See `Fit`.
    """

    weighed: Problem
    bent: Problem
    line: Problem
    models: tuple[Model, ...]
    apart: tuple[Image | None, ...]

    def believing(self, weight: float) -> "About":
        """With phase functions expected to be smooth so many times as firmly, see `weight_of_priors`."""
        weighed, bent, line = (believing(one, weight) for one in (self.weighed, self.bent, self.line))
        return replace(self, weighed=weighed, bent=bent, line=line)

    def fit(self, coordinates: Vector) -> Fit:
        """The fit that ends at coordinates, or next to them in the box."""
        return Fit(self.weighed.at(np.clip(coordinates, *self.line.box)), self.models, self.apart)


def problem_about(
    problem: Problem, shots: Sequence[Shot], models: Sequence[Model], slopes: Sequence[Image],
    noise: Sequence[Slopes | None], centre: Evaluation, seen: Sequence[Prediction],
    close: tuple[Vector, float] | None = None,
) -> About:  # fmt: skip
    """The problem about a place where exact images are known.

    Parameters
    ----------
    problem
        That is solved.
    shots
        The images.
    models
        That say how images change about the place.
    slopes, noise
        Their derivatives at the place, and patterns of the noise of these.
    centre
        The place.
    seen
        Exact images there.
    close
        See `Problem`.
    """
    media = centre.media
    last = tuple(corrected(*one) for one in zip(models, media, seen, strict=True))
    weighed = weighed_problem(
        problem, shots, [image_of(model) for model in last], [always(one) for one in slopes], seen, centre.added
    ).with_slopes_noise(noise)
    shown = [model(medium) for model, medium in zip(models, media, strict=True)]
    smooth = [one.image for one in shown]
    calm = _without_noise_in_gain(weighed, smooth, seen, centre.added)
    bent = replace(calm.by([image_of(model) for model in models]), close=close)
    families = [shot.models.family for shot in shots]
    straight = [
        _linear(image, medium, slope, family)
        for image, medium, slope, family in zip(smooth, media, slopes, families, strict=True)
    ]
    apart = (
        exact.image - one.image if stated_error(one) < stated_error(exact) else None
        for one, exact in zip(shown, seen, strict=True)
    )  # fmt: skip
    return About(weighed, bent, replace(bent.by(straight), quick=True), last, tuple(apart))


def exact_images(shots: Sequence[Shot], at: Evaluation, times: float = 1.0) -> list[Prediction]:
    """Exact images at a place, with so many times the light paths."""
    return [shot.models.exact(one, times) for shot, one in zip(shots, at.media, strict=True) if shot.models.exact]


def at_media(noise: Sequence[Slopes | None], media: Sequence[Medium]) -> list[Slopes | None]:
    """Patterns of the derivatives' noise as they are at media, wherever they are asked for."""
    return [one and always(one(medium)) for one, medium in zip(noise, media, strict=True)]


def _without_noise_in_gain(
    problem: Problem, smooth: Sequence[Image], seen: Sequence[Prediction], added: Sequence[Image | float]
) -> Problem:
    """The problem with what exact images differ by from smooth ones taken off what was observed, not put on the models.

    Of a free gain the image itself is the derivative. With the paths' noise in it the gain is drawn towards 0 (errors
    in variables; Fuller 1987): for 2·10⁵ paths and a thin liquid by 4 %, and σs by 1.7, where nothing else tells the
    gain from the liquid.
    """
    gain, _ = problem.scale(problem.whitened([one.image + more for one, more in zip(seen, added, strict=True)]))
    views = []
    for view, image, one in zip(problem.views, smooth, seen, strict=True):
        observation = view.observation
        views.append(
            replace(view, observation=replace(observation, image=observation.image - gain * (one.image - image)))
        )
    return replace(problem, views=tuple(views))


def _linear(image: Image, centre: Medium, slopes: Image, family: Family | None) -> Forward:
    """An image, and changes of it to first order."""
    at = values_of(centre, family)
    return lambda medium: np.asarray(image + np.tensordot(values_of(medium, family) - at, slopes, 1))


def always(slopes: Image) -> Slopes:
    """The same at whatever liquid."""
    return lambda _: slopes
