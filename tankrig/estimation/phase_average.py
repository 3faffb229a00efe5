"""Families of phase functions weighed by how well they explain what a fit of a free phase function found.

About the optimum θ̂ of a free fit the images respond as I(θ) ≈ I(θ̂) + Jᵀ(θ − θ̂), and what data say of θ is in the
score J W r, of covariance Σ (camera noise, the model's own smooth error, what structure adds). A member of a family is
a free phase function too, nearly: its ln p is projected on the free one's shapes. So a family is fitted to the score,
by least squares in a dozen numbers instead of thousands of pixels, and its evidence is Laplace's,

    ln Z = −½ (s − F δ)ᵀ Σ⁻¹ (s − F δ) − ½ |ψ|² − ½ ln det(1 + Gᵀ F Σ⁻¹ F G),

with δ = θ(ψ) − θ̂, G = ∂θ/∂ψ and parameters ψ in standard deviations of what is expected: every parameter costs what it
could have explained and did not (MacKay 1992).

A family's nearest member may be far from θ̂ along what an image hardly tells, where noise of the derivatives adds up
to more than anything that is known. So once there are answers an exact image is made where they are, about which the
families are fitted again, and once more (`AGAIN`).

No liquid is a member of a family. Its ln p is off the nearest member's by amplitudes of the free shapes as well, of a
standard deviation τ that nobody knows: ψ holds these amplitudes, and `DISCREPANCIES` stand for τ (Kennedy and O'Hagan
2001). Where an image tells such a discrepancy it is taken off; where it can't, what is said is as unsure as that.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.nearby import Nearby
from tankrig.estimation.parameters import WIDEST
from tankrig.estimation.phase_families import (
    PLACES,
    Family,
    amplitudes_of,
    free,
    henyey_greenstein,
    reynolds_mccormick,
    two_term,
)
from tankrig.estimation.phase_result import PhaseCurve, Scattering, scattering_of
from tankrig.estimation.problem import Evaluation
from tankrig.estimation.versions import Exact
from tankrig.prediction import Prediction
from tankrig.scene import Medium
from tankrig.scene.phase_functions import Mixture

Array = NDArray[np.float64]

DISCREPANCIES = (0.03, 0.1, 0.3)
"""Root mean squares of amplitudes by which liquids are off a family's nearest member, equally likely. Of Reynolds and
McCormick's or two terms, beads of .2 µm and milk-like droplets are .03 off, an emulsion .15, beads of .5 µm .6."""
NEGLIGIBLE, SOME = 1e-3, 0.05
"""Share of the answer below which a family is left out of it, and that all families must have together for exact images
to be made where they say the liquid is."""
AGAIN = (0.25, 1.0)
"""Light paths of these images, of those in the exact image at the optimum: the first moves families by several standard
deviations, and the last has the noise that the covariance counts. Next to an optimum that has an exact image by all
paths both are by the same share of them, see `Nearby`."""
DIFFERENCE = 1e-3
"""Step of each number, in standard deviations of what is expected, by which places are differenced."""
STEPS = 40
LEAST = 1e-3
"""Share of the coefficients that the free fit found below which no family's are sought."""


@dataclass(frozen=True)
class Score:
    """What a fit of a free phase function knows.

    Parameters
    ----------
    at
        (k,) σa, σs, atanh of the base's asymmetry, and amplitudes.
    whitened
        (k,) Σ^−½ s.
    response
        (k, k) Σ^−½ F.
    pulls
        (k, n) Σ^−½ J W^½: times what images leave, whitened, the first of these.
    unlikelier
        ½ ln det Σ over that of the score that it comes from.
    """

    at: Array
    whitened: Array
    response: Array
    pulls: Array
    unlikelier: float = 0.0

    @classmethod
    def of(cls, best: Evaluation, spread: Array) -> "Score":
        """The score at an optimum with the covariance (k, k) of its first k values, whatever that counts.

        Values beyond those (of the set-up, water, doses) follow them wherever they go.
        """
        sensitivity, count = best.sensitivity, len(spread)
        size, weight = sensitivity.widest, sensitivity.weight
        changes, priors = sensitivity.changes * size[:, None], sensitivity.priors * size[:, None]
        fisher = sensitivity.fisher * np.outer(size, size) + priors @ priors.T
        besides = np.linalg.solve((fisher + np.diag(weight))[count:, count:], fisher[count:, :count])
        fisher = fisher[:count, :count] - fisher[:count, count:] @ besides
        size, weight = size[:count], weight[:count]
        # Of the values in units of `widest`, of which covariance is F⁻¹ (Σ + prior) F⁻¹.
        whole = fisher + np.diag(weight)
        scatter = whole @ (spread / np.outer(size, size)) @ whole - np.diag(weight**2)
        values, vectors = np.linalg.eigh(0.5 * (scatter + scatter.T))
        root = vectors / np.sqrt(np.maximum(values, 1e-9 * values[-1]))
        pulls = root.T @ changes[:count]
        at = np.concatenate([best.values[best.problem.blocks[0].name], best.values["phase"]])
        return cls(at, pulls @ best.left, root.T @ fisher / size, pulls)

    def about(self, at: Array, left: Array, noise: Array) -> "Score":
        """The same about another place, where images leave (n,) so much, whitened, with (m, n) patterns of noise that
        the covariance does not count."""
        moved = self.pulls @ noise.T
        root = np.linalg.cholesky(np.eye(len(moved)) + moved @ moved.T)
        pulls, response = np.linalg.solve(root, self.pulls), np.linalg.solve(root, self.response)
        return Score(at, pulls @ left, response, pulls, float(np.sum(np.log(np.diag(root)))))

    def misfit(self, at: Array) -> Array:
        """(k,) s − F (θ − θ̂), whitened."""
        return self.whitened - self.response @ (at - self.at)


@dataclass(frozen=True)
class Weighed:
    """A family's answer, where that is as `Score.at`, and the logarithm of its evidence."""

    answer: Scattering
    at: Array
    evidence: float


def averaged(best: Evaluation, spread: Array, family: Family, exact: Exact | None = None) -> Scattering:
    """What families say together, each with its share of the evidence.

    Parameters
    ----------
    best
        Optimum of a fit of a free phase function.
    spread
        Covariance of its values.
    family
        The free one.
    exact
        Gives exact images where the fit is of one image; None where there are none to be had.
    """
    count = 2 + len(family.names)
    spread = spread[:count, :count]
    score = Score.of(best, spread)
    freely = _free(score, spread, family)
    found = [freely, *_families(score, freely.answer.liquid)]
    for times in AGAIN:
        shares = _shares(found)[1:]
        if exact is None or shares.sum() < SOME:
            break
        place = shares @ np.array([one.at for one in found[1:]]) / shares.sum()
        liquid = Medium(float(place[0]), float(place[1]), phase=family.phase(place[2:]))
        left, noise = _left_by(exact(liquid, times), best), _noise_of(exact, liquid, best)
        found = [freely, *_families(score.about(place, left, noise), freely.answer.liquid)]
    kept = [(one.answer, float(share)) for one, share in zip(found, _shares(found), strict=True) if share > NEGLIGIBLE]
    return mixed([one for one, _ in kept], [share for _, share in kept])


def _left_by(exact: Prediction, best: Evaluation) -> Array:
    """(n,) what an image leaves, whitened."""
    return best.problem.by([lambda _: exact.image]).at(best.coordinates).left


def _noise_of(exact: Exact, liquid: Medium, best: Evaluation) -> Array:
    """(m, n) patterns, whitened, of what noise an exact image has more than the optimum's."""
    if not isinstance(exact, Nearby):
        return np.zeros((0, best.left.size))
    (view,), (gain, _) = best.problem.views, best.scale
    return best.project_out(view.whitened(gain * exact.more_noise(liquid)))[:, : best.left.size]


def _families(score: Score, near: Medium) -> list[Weighed]:
    """All stiff ones, with each of the discrepancies."""
    stiff = henyey_greenstein(), reynolds_mccormick(), two_term()
    return [_family(score, one, near, discrepancy) for one in stiff for discrepancy in DISCREPANCIES]


def _shares(found: Sequence[Weighed]) -> Array:
    """How much of the evidence each has."""
    evidence = np.array([one.evidence for one in found])
    shares = np.exp(evidence - evidence.max())
    return np.asarray(shares / shares.sum())


def _free(score: Score, spread: Array, family: Family) -> Weighed:
    answer = scattering_of(score.at[:2], score.at[2:], spread, family)
    prior = np.where(family.expected, 1.0, 0.0)
    pulls = float(np.sum(score.at[2:][family.expected] ** 2))
    scale = np.concatenate([_widths(score), np.where(prior > 0.0, 1.0, family.usual)])
    return Weighed(answer, score.at, _evidence(score.misfit(score.at), pulls, score.response * scale))


def _family(score: Score, family: Family, near: Medium, discrepancy: float) -> Weighed:
    """A family, and what liquids may be off it, fitted to the score."""
    from scipy.optimize import least_squares

    widths, like, base = _widths(score), family.like(near.g), float(score.at[2])
    own, shapes = 2 + like.size, score.at.size - 3
    scale = np.concatenate([widths, family.usual, np.full(shapes, discrepancy)])
    middle = np.concatenate([score.at[:2], like, np.zeros(shapes)])

    def place(off: Array) -> Array:
        values = middle + scale * off
        coordinates = np.clip(values[2:own], family.low, family.high)
        nearest = amplitudes_of(family.phase(coordinates).density(PLACES), base)
        return np.concatenate([values[:2], [base], nearest + values[own:]])

    def residual(off: Array) -> Array:
        return np.concatenate([score.misfit(place(off)), off[2:]])

    def changes(off: Array) -> Array:
        return np.vstack([-score.response @ by_numbers(off), np.eye(off.size)[2:]])

    def by_numbers(off: Array) -> Array:
        """Of the place; shapes are added as they are, so that only what comes before them is differenced."""
        found = np.zeros((score.at.size, off.size))
        found[3:, own:] = discrepancy * np.eye(shapes)
        found[:, :own] = _slopes(place, off, own)
        return found

    lowest = np.concatenate([-(1.0 - LEAST) * middle[:2] / widths - 1e-12, np.full(middle.size - 2, -np.inf)])
    end = least_squares(
        residual, np.zeros(middle.size), changes, max_nfev=STEPS, x_scale="jac", bounds=(lowest, np.inf)
    )
    response = -np.asarray(end.jac)[: score.at.size]
    known = np.diag(np.concatenate([np.zeros(2), np.ones(middle.size - 2)]))
    covariance = np.linalg.inv(response.T @ response + known)
    at, by_off = place(end.x), by_numbers(end.x)
    found = scattering_of(at[:2], at[2:], by_off @ covariance @ by_off.T, free())
    values = np.clip((middle + scale * end.x)[2:own], family.low, family.high)
    spread = (covariance * np.outer(scale, scale))[:own, :own]
    plain = scattering_of(at[:2], values, spread, family)
    found = replace(found, parameters=plain.parameters, families=plain.families)
    pulls, unlikely = float(np.sum(end.x[2:] ** 2)), math.log(len(DISCREPANCIES)) + score.unlikelier
    return Weighed(found, at, _evidence(score.misfit(at), pulls, response) - unlikely)


def _slopes(place: Callable[[Array], Array], at: Array, first: int) -> Array:
    """(k, n) derivatives of a place by the first n numbers that lead to it, by central differences."""
    units = DIFFERENCE * np.eye(at.size)[:first]
    return np.array([(place(at + unit) - place(at - unit)) / (2.0 * DIFFERENCE) for unit in units]).T


def _widths(score: Score) -> Array:
    """(2,) standard deviations of σa and σs before anything was seen."""
    return np.full(2, WIDEST * float(score.at[:2].sum()))


def _evidence(misfit: Array, pulls: float, response: Array) -> float:
    """Laplace's, of parameters in standard deviations of what is expected."""
    curvature = np.eye(response.shape[1]) + response.T @ response
    return -0.5 * float(misfit @ misfit) - 0.5 * pulls - 0.5 * float(np.linalg.slogdet(curvature)[1])


def mixed(answers: Sequence[Scattering], likely: Sequence[float]) -> Scattering:
    """Answers as one, with what they differ by in its errors."""
    if len(answers) == 1:
        return answers[0]
    weight = np.array(likely) / sum(likely)
    media = np.array([one.liquid.coefficients for one in answers])
    mean = weight @ media
    covariance = np.einsum("i,ijk->jk", weight, np.array([one.covariance for one in answers]))
    covariance = covariance + np.einsum("i,ij,ik->jk", weight, media - mean, media - mean)
    names = [next(iter(one.families)) for one in answers]
    shares = {name: float(sum(weight[k] for k, own in enumerate(names) if own == name)) for name in names}
    likeliest = max(shares, key=lambda name: shares[name])
    first = answers[max((k for k, own in enumerate(names) if own == likeliest), key=lambda k: float(weight[k]))]
    phase = Mixture(tuple(one.liquid.phase_function for one in answers), tuple(weight.tolist()))
    return replace(
        first, liquid=Medium(float(mean[0]), float(mean[1]), phase=phase), covariance=covariance,
        curve=_mixed_curve(weight, [one.curve for one in answers]),
        beta=_mixed_curve(weight, [one.beta for one in answers if one.beta is not None]),
        at_right_angle=_mixed(weight, [one.at_right_angle for one in answers]),
        reduced=_mixed(weight, [one.reduced for one in answers]),
        families=shares,
    )  # fmt: skip


def _mixed_curve(weight: Array, curves: Sequence[PhaseCurve]) -> PhaseCurve:
    logs = np.array([np.log(one.value) for one in curves])
    value = weight @ np.exp(logs)
    spread = weight @ (np.array([one.sd for one in curves]) ** 2 + (logs - np.log(value)) ** 2)
    return PhaseCurve(curves[0].angle_deg, value, np.sqrt(spread))


def _mixed(weight: Array, numbers: Sequence[tuple[float, float]]) -> tuple[float, float]:
    values, sds = np.array(numbers).T
    mean = float(weight @ values)
    return mean, math.sqrt(float(weight @ (sds**2 + (values - mean) ** 2)))
