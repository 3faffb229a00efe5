"""How well families of phase functions explain what a fit of a free phase function found.

About the optimum θ̂ of a free fit the images respond as I(θ) ≈ I(θ̂) + Jᵀ(θ − θ̂), and what data say of θ is in the
score J W r, of covariance Σ (camera noise, the model's own smooth error, what structure adds). A member of a family is
a free phase function too, nearly: its ln p is projected on the free one's shapes. So a family is fitted to the score,
by least squares in a dozen numbers instead of thousands of pixels, and its evidence is Laplace's,

    ln Z = −½ (s − F δ)ᵀ Σ⁻¹ (s − F δ) − ½ |ψ|² − ½ ln det(1 + Gᵀ F Σ⁻¹ F G),

with δ = θ(ψ) − θ̂, G = ∂θ/∂ψ and parameters ψ in standard deviations of what is expected: every parameter costs what it
could have explained and did not (MacKay 1992).

No liquid is a member of a family. Its ln p is off the nearest member's by amplitudes of the free shapes as well, of a
standard deviation τ that nobody knows: ψ holds these amplitudes, and `DISCREPANCIES` stand for τ (Kennedy and O'Hagan
2001). Where an image tells such a discrepancy it is taken off; where it can't, what is said is as unsure as that.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.parameters import WIDEST
from tankrig.estimation.phase_families import (
    PLACES,
    Family,
    amplitudes_of,
    fournier_forand,
    free,
    henyey_greenstein,
    reynolds_mccormick,
    two_term,
)
from tankrig.estimation.phase_result import Scattering, scattering_of
from tankrig.estimation.polydisperse import polydisperse
from tankrig.estimation.problem import Evaluation
from tankrig.estimation.spheres import likely, spheres
from tankrig.scene import Medium
from tankrig.scene.free_phase import Shaped

Array = NDArray[np.float64]

DISCREPANCIES = LITTLE, MIDDLE, MUCH = (0.03, 0.1, 0.3)
"""Root mean squares of amplitudes by which liquids are off a family's nearest member, equally likely. Of Reynolds and
McCormick's or two terms, beads of .2 µm and milk-like droplets are .03 off, an emulsion .15, beads of .5 µm .6."""
HARDLY = (0.003, 0.01, 0.03)
"""The same of spheres that are fitted by themselves, since they describe an image as well as any smooth phase function
does: beads of one kind are hardly off them, an emulsion's droplets a little."""
DIFFERENCE = 1e-3
"""Step of each number, in standard deviations of what is expected, by which places are differenced."""
STEPS, FEW_STEPS, ENOUGH = 40, 16, 1e-5
"""Of a family's fit, at most, and of spheres', which begin next to their optimum and take ten times as long; and the
relative changes below which it is over."""
NOT_HOPELESS = 10.0
"""By how much more, squared, a look at spheres may leave than the best other family does for them to be fitted."""
ABOUT_AS_LIKELY = 3.0
"""By how much less, as a logarithm, natural waters may be likely for that: they were .1 less and 6 more so where the
liquid is one, and 6.9 and more less in ten fits of six other liquids."""
MODES, SAME = 4, 0.3
"""Diameters of spheres that fits begin from, and standard deviations of what an image says within which two of them
have ended at the same."""
WILDEST, SHAPE_DIFFERENCE = 5.0, 0.1
"""Largest amplitude of a shape that a liquid is off spheres by, and its step in derivatives."""
INSIDE = 0.01
"""Standard deviations from the edges of what is searched at which a fit of spheres begins at least."""
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
    """What a family says.

    Parameters
    ----------
    at
        As `Score.at`.
    evidence
        Its logarithm.
    liquid
        Where that is.
    answer
        What follows, which takes a second for spheres.
    own
        (k,) the family's coordinates.
    off
        How far the liquid was expected to be off its members, see `DISCREPANCIES`; None of the free family.
    finer
        Whether its members are finer than a free phase function.
    """

    at: Array
    evidence: float
    liquid: Medium
    answer: Callable[[], Scattering]
    own: Array
    off: float | None = None
    finer: bool = False


def families(score: Score, freely: Weighed) -> list[Weighed]:
    """What all stiff families say with each of the discrepancies, and spheres, beside the free family's answer."""
    near, found, members = freely.liquid, [], []
    for family in (henyey_greenstein(), reynolds_mccormick(), two_term(), polydisperse()):
        own = _by_discrepancies(score, family, near)
        members += [amplitudes_of(family.phase(one.own).density(PLACES), float(score.at[2])) for one in own]
        found += own
    return found + of_spheres(score, freely, float(_off(score, np.array(members)).min()) + NOT_HOPELESS)


def may_peak(score: Score, found: Sequence[Weighed]) -> bool:
    """Whether a liquid may scatter much of its light nearly straight on, as natural waters do, which no image shows.

    Their particles, by what turns by more and hardly off it, are then about as likely as the likeliest that was found.
    """
    waters, near = fournier_forand(), found[0].liquid
    first = waters.like(near.g)
    tried = [
        _family(score, waters, near, start, off).evidence
        for start in (first, *waters.others(first))
        for off in (LITTLE, MIDDLE)
    ]
    return max(tried) > max(one.evidence for one in found) - ABOUT_AS_LIKELY


def of_spheres(score: Score, freely: Weighed, enough: float) -> list[Weighed]:
    """Spheres, which have many modes: the likeliest by a rough look are fitted with the middle discrepancy, and those
    that then are likely with the others too; none where the look leaves more than enough."""
    begin = likely(partial(_off, score), float(score.at[2]), MODES, enough)
    modes: list[Weighed] = []
    for start in begin:
        one = _family(score, spheres(), freely.liquid, start, MIDDLE)
        if all(np.linalg.norm(score.response @ (one.at - other.at)) > SAME for other in modes):
            modes.append(one)
    modes = [one for one in modes if one.evidence > max(other.evidence for other in modes) - NOT_HOPELESS]
    more = [_family(score, spheres(), freely.liquid, one.own, off) for one in modes for off in (LITTLE, MUCH)]
    return modes + more


def about_spheres(score: Score, liquid: Medium, own: Array) -> list[Weighed]:
    """What spheres say next to an exact image of them, at coordinates of their own, by each of `HARDLY`; and particles
    of many sizes, which emulsions are besides."""
    found = [_family(score, spheres(), liquid, own, off) for off in HARDLY]
    return found + _by_discrepancies(score, polydisperse(), liquid)


def _by_discrepancies(score: Score, family: Family, near: Medium) -> list[Weighed]:
    """A family, begun where it is most like a liquid, with each of the discrepancies."""
    return [_family(score, family, near, family.like(near.g), off) for off in DISCREPANCIES]


def _off(score: Score, amplitudes: Array) -> Array:
    """(n,) squared, how far amplitudes (n, shapes) of a free phase function are off the score, σa and σs being what
    they may, and a liquid being off by the middle discrepancy."""
    shapes = MIDDLE * score.response[:, 3:]
    root = np.linalg.cholesky(np.eye(len(shapes)) + shapes @ shapes.T)
    misfit = np.linalg.solve(root, score.whitened[:, None] - score.response[:, 3:] @ (amplitudes - score.at[3:]).T)
    free_of, _ = np.linalg.qr(np.linalg.solve(root, score.response[:, :2]))
    return np.asarray(np.sum(misfit**2, axis=0) - np.sum((free_of.T @ misfit) ** 2, axis=0))


def by_free(score: Score, spread: Array, family: Family) -> Weighed:
    """The answer of the fit itself.

    Parameters
    ----------
    score
        Of a fit of a free phase function.
    spread
        Covariance of its values.
    family
        The free one.
    """
    prior = np.where(family.expected, 1.0, 0.0)
    pulls = float(np.sum(score.at[2:][family.expected] ** 2))
    scale = np.concatenate([_widths(score), np.where(prior > 0.0, 1.0, family.usual)])
    liquid = Medium(float(score.at[0]), float(score.at[1]), phase=family.phase(score.at[2:]))
    answer = partial(scattering_of, score.at[:2], score.at[2:], spread, family)
    evidence = _evidence(score.misfit(score.at), pulls, score.response * scale)
    return Weighed(score.at, evidence, liquid, answer, score.at[2:])


def _family(score: Score, family: Family, near: Medium, start: Array, discrepancy: float) -> Weighed:
    """A family, and what liquids may be off it, fitted to the score from some coordinates on."""
    from scipy.optimize import least_squares

    widths, like, base = _widths(score), family.like(near.g), float(score.at[2])
    own, shapes = 2 + like.size, score.at.size - 3
    scale = np.concatenate([widths, family.usual, np.full(shapes, discrepancy)])
    middle = np.concatenate([score.at[:2], like, np.zeros(shapes)])

    def place(off: Array) -> Array:
        values = middle + scale * off
        coefficients = np.maximum(values[:2], 0.0)  # as rounding of widths that hardly end may not leave them
        return np.concatenate([coefficients, [base], nearest(tuple(values[2:own])) + values[own:]])

    @lru_cache(maxsize=16)
    def nearest(coordinates: tuple[float, ...]) -> Array:
        return amplitudes_of(family.phase(np.array(coordinates)).density(PLACES), base, family.told_from_deg)

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
    highest, begin = np.full(middle.size, np.inf), np.zeros(middle.size)
    begin[2:own] = (start - like) / family.usual
    if family.finer:  # at an edge nothing would tell a coordinate, and what lies beyond would count as unknown
        lowest[2:own], highest[2:own] = (family.low - like) / family.usual, (family.high - like) / family.usual
        begin[2:own] = np.clip(begin[2:own], lowest[2:own] + INSIDE, highest[2:own] - INSIDE)
    end = least_squares(
        residual,
        begin,
        changes,
        max_nfev=FEW_STEPS if family.finer else STEPS,
        x_scale="jac",
        bounds=(lowest, highest),
        ftol=ENOUGH,
        xtol=ENOUGH,
    )
    response = -np.asarray(end.jac)[: score.at.size]
    known = np.diag(np.concatenate([np.zeros(2), np.ones(middle.size - 2)]))
    covariance = np.linalg.inv(response.T @ response + known)
    at, by_off = place(end.x), by_numbers(end.x)
    values = middle + scale * end.x
    values[2:own] = np.clip(values[2:own], family.low, family.high)
    spread = covariance * np.outer(scale, scale)

    def answer() -> Scattering:
        plain = scattering_of(at[:2], values[2:own], spread[:own, :own], family)
        if family.finer:
            found = scattering_of(at[:2], values[2:], spread, _shaped(family, shapes))
        else:
            found = scattering_of(at[:2], at[2:], by_off @ covariance @ by_off.T, free())
        return replace(found, parameters=plain.parameters, families=plain.families)

    pulls, unlikely = float(np.sum(end.x[2:] ** 2)), math.log(len(DISCREPANCIES)) + score.unlikelier
    of, its = (_shaped(family, shapes), values[2:]) if family.finer else (free(), at[2:])
    liquid = Medium(float(at[0]), float(at[1]), phase=of.phase(its))
    evidence = _evidence(score.misfit(at), pulls, response) - unlikely
    return Weighed(at, evidence, liquid, answer, values[2:own], discrepancy, family.finer)


def _shaped(family: Family, shapes: int) -> Family:
    """A family's members times so many shapes of a free phase function."""
    own, none = family.low.size, np.zeros(shapes)
    return replace(
        family,
        low=np.concatenate([family.low, none - WILDEST]), high=np.concatenate([family.high, none + WILDEST]),
        difference=np.concatenate([family.difference, none + SHAPE_DIFFERENCE]),
        member=lambda at: Shaped(family.phase(at[:own]), tuple(at[own:].tolist())), describe=lambda _: {},
    )  # fmt: skip


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
