"""What another phase function would say where Henyey–Greenstein's was fitted."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from tankrig.estimation.forward import models_of
from tankrig.estimation.optimiser import COARSE_ENOUGH, solve
from tankrig.estimation.parameters import MediumBlock
from tankrig.estimation.phase_block import CoefficientsBlock, PhaseBlock
from tankrig.estimation.phase_families import free
from tankrig.estimation.phase_result import coefficients_by
from tankrig.estimation.problem import Evaluation, Problem
from tankrig.estimation.stated_errors import COARSE
from tankrig.estimation.uncertainty import ModelError, PatternedError, Sensitivity, SmoothError
from tankrig.estimation.versions import Models, image_of
from tankrig.scene import Medium, Scene

Array = NDArray[np.float64]
Image = NDArray[np.floating]

SEARCH_STEPS = 30
"""Steps of the cheap fit of another phase function, at most."""
ROUGHLY = 0.03
"""Share of what is left by which a step must promise to lower it for the way there to go on, where no more is needed
than that."""
ROUNDING = 1e-12
"""Share of the largest variance below which others are no more than rounding."""


@dataclass(frozen=True)
class Instead:
    """What another phase function than the one fitted would say.

    Parameters
    ----------
    share
        Share of the residual's structure that it explains.
    moved
        (3,) σa, σs and mean cosine with it, less those that were fitted.
    liquid
        With it.
    """

    share: float
    moved: Array
    liquid: Medium


def fitted_instead(
    best: Evaluation, scene: Scene, models: Models, rough: bool = False, near: Medium | None = None
) -> Instead:
    """A Henyey–Greenstein fit against one of a free phase function, by the cheap models.

    What differs between the two is not small in real liquids (σs by a third and more), so that derivatives at the
    optimum would not tell.

    Parameters
    ----------
    best, scene, models
        The fit, its scene and models.
    rough
        Whether no more is needed than the way there and a share that is explained at least.
    near
        Where a rough look has ended.
    """
    problem = with_phase_free(best, scene, models)
    (view,), (medium,) = problem.views, best.media
    begin = problem.at(np.concatenate([one.start(medium) for one in problem.blocks]))
    # Where pixels count by the cheap model's error the valley is wide; where they count by noise steps only end.
    coarse = SmoothError.of(scene, COARSE * np.abs(best.scale[0] * best.images[0]))
    wide = replace(problem, views=(replace(view, error=coarse),))
    start = begin.coordinates if near is None else np.concatenate([one.start(near) for one in problem.blocks])
    there = solve(wide, start, COARSE_ENOUGH, SEARCH_STEPS, share=ROUGHLY if rough else 0.0).coordinates
    end = problem.at(there) if rough else solve(problem, there, COARSE_ENOUGH, SEARCH_STEPS)
    excess, left = (2.0 * one.cost - problem.pixels for one in (begin, end))
    found: Medium = end.media[0]
    moved = np.array(found.coefficients) - np.array(medium.coefficients)
    return Instead(min(1.0 - left / excess, 1.0) if excess > 0.0 else 0.0, moved, found)


def with_phase_free(best: Evaluation, scene: Scene, models: Models) -> Problem:
    """The problem of a Henyey–Greenstein fit with a free phase function, by the cheap models.

    What else the fit's image has at its end than the cheap model's is added wherever the free one goes: what may be
    misaligned, and what the cheap model is off by.
    """
    (view,), (medium,), family = best.problem.views, best.media, free()
    (fitted,) = (block for block in best.problem.blocks if isinstance(block, MediumBlock))
    cheap = (models if models.slopes is None else models_of(scene, "tank", None)).of(family)
    image = image_of(cheap.coarse)
    besides = best.images[0] - image(medium)
    blocks = (CoefficientsBlock(fitted.range), PhaseBlock(family))
    slopes = cheap.slopes_of(cheap.coarse, max(scene.tank.size_mm))
    own = replace(view, forward=lambda liquid: image(liquid) + besides, slopes=slopes, slopes_noise=None)
    return Problem((own,), blocks, best.problem.scaling, quick=False)


@dataclass(frozen=True)
class Freed:
    """What a free phase function would make of a Henyey–Greenstein fit, as far as derivatives at its end tell.

    Parameters
    ----------
    evidence
        Logarithm of how many times likelier the image is by it than by Henyey–Greenstein's: a Gaussian about either,
        with noise and the model's error as they are.
    moved
        (3,) σa, σs and mean cosine with it, less those that were fitted.
    covariance
        (3, 3) of them with it.
    pattern
        (n,) what it changes of the image besides, whitened.
    """

    evidence: float
    moved: Array
    covariance: Array
    pattern: Array

    @property
    def share(self) -> float:
        """How much it is believed, where neither was likelier before: 0 to 1."""
        return float(expit(self.evidence))

    def averaged(self, spread: Array) -> Array:
        """Covariance (k, k) about what was fitted, of which the first three values are the liquid's, by both."""
        found = spread.copy()
        found[:3, :3] += self.share * (self.covariance + np.outer(self.moved, self.moved) - spread[:3, :3])
        return found


def freed(
    best: Evaluation, scene: Scene, models: Models, noise: Sequence[Image], errors: Sequence[ModelError]
) -> Freed:
    """What a free phase function would say, without a search; see `Freed`.

    Shapes of ln p(θ) are 0 ± 1 before. What the image pulls at them, b, less what the coefficients do about it, has
    the covariance S of noise and the model's error by Henyey–Greenstein, and S + F F by a free phase function, F being
    their Fisher information: the ratio of both densities is the evidence (MacKay 1992). What noise of the model's image
    pulls by way of a free gain is no sign of anything: of random scenes with slanted light every third was told to have
    another phase function by that.

    Parameters
    ----------
    best, scene, models
        The fit, its scene and models.
    noise, errors
        As for `Sensitivity.covariance`.
    """
    problem = with_phase_free(best, scene, models)
    (medium,) = best.media
    here = problem.at(np.concatenate([one.start(medium) for one in problem.blocks]))
    sensitivity = _with_others(here.sensitivity, best.sensitivity, len(best.problem.blocks[0].names))
    shapes = np.flatnonzero(problem.prior_weight)
    own = np.setdiff1d(np.arange(sensitivity.widest.size), shapes)
    fisher = sensitivity.fisher + sensitivity.priors @ sensitivity.priors.T
    pulls = sensitivity.changes @ best.left - _drawn(here, best, errors)
    (response,) = sensitivity.responses
    scatter = response.information(noise[0], errors[0]).scatter
    aside = np.zeros((shapes.size, pulls.size))
    known = np.diag(1.0 / sensitivity.widest[own] ** 2)
    aside[:, own] = -np.linalg.solve(fisher[np.ix_(own, own)] + known, fisher[np.ix_(own, shapes)]).T
    aside[np.arange(shapes.size), shapes] = 1.0
    b, information = aside @ pulls, aside @ fisher @ aside.T
    amplitudes = np.linalg.solve(information + np.eye(shapes.size), b)
    by_values = np.pad(coefficients_by(free(), here.values["phase"]), ((0, 0), (0, own.size - 3)))
    return Freed(
        _evidence(b, aside @ scatter @ aside.T, information), by_values @ sensitivity.step(best.left),
        by_values @ sensitivity.covariance(noise, errors) @ by_values.T, amplitudes @ (aside @ sensitivity.changes),
    )  # fmt: skip


def _drawn(liquid: Evaluation, all_values: Evaluation, errors: Sequence[ModelError]) -> Array:
    """What noise of the model's image pulls at each value by drawing a free gain towards 0, see `Scaling.drawn`."""
    (error,), (view,), (gain, _) = errors, all_values.problem.views, all_values.scale
    first = len(all_values.problem.blocks[0].names)
    if not isinstance(error, PatternedError):
        return np.zeros(liquid.sensitivity.widest.size + all_values.sensitivity.widest.size - first)
    whole, others = (one.changes_at(gain) for one in (liquid, all_values))
    noise = float(np.sum(np.square(view.whitened(error.patterns))))
    models = [gain * model for model in all_values.models]
    return all_values.problem.scaling.drawn(np.vstack([whole, others[first:]]), models, [view.one], noise)


def _with_others(liquid: Sensitivity, all_values: Sensitivity, first: int) -> Sensitivity:
    """What a fit of a liquid responds to, with the values that another of the same image has from `first` on."""
    (one,), (other,) = liquid.responses, all_values.responses
    return Sensitivity(
        (replace(one, changes=np.vstack([one.changes, other.changes[first:]]), noise=None),),
        np.vstack([liquid.priors, all_values.priors[first:]]),
        np.append(liquid.widest, all_values.widest[first:]),
        np.append(liquid.weight, all_values.weight[first:]),
    )


def _evidence(b: Array, scatter: Array, information: Array) -> float:
    """ln N(b; 0, S + F F) − ln N(b; 0, S).

    Examples
    --------
    >>> one, ten = np.array([[1.0]]), np.array([[100.0]])
    >>> round(_evidence(np.array([0.0]), ten, ten), 2), round(_evidence(np.array([50.0]), ten, ten), 2)
    (-2.31, 10.07)
    """
    sizes, ways = np.linalg.eigh(scatter)
    whiten = ways / np.sqrt(np.maximum(sizes, ROUNDING * sizes[-1]))
    strength, ways = np.linalg.eigh(whiten.T @ information @ information @ whiten)
    strength, pulls = np.maximum(strength, 0.0), ways.T @ (whiten.T @ b)
    return float(0.5 * np.sum(pulls**2 * strength / (1.0 + strength) - np.log1p(strength)))
