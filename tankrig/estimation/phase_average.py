"""Families of phase functions as one answer, each with its share of the evidence.

A family's nearest member may be far from where a free phase function's fit ended along what an image hardly tells,
where noise of the derivatives adds up to more than anything that is known. So once there are answers an exact image is
made where they are, about which the families are fitted again, and once more (`AGAIN`).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.nearby import Nearby
from tankrig.estimation.phase_evidence import (
    LITTLE,
    NOT_HOPELESS,
    Score,
    Weighed,
    about_spheres,
    by_free,
    families,
    may_peak,
    of_spheres,
)
from tankrig.estimation.phase_families import PLACES, Family, amplitudes_of
from tankrig.estimation.phase_result import PhaseCurve, Scattering
from tankrig.estimation.problem import Evaluation
from tankrig.estimation.spheres import APART, spheres
from tankrig.estimation.versions import Exact
from tankrig.scene import Medium
from tankrig.scene.phase_functions import Mixture

Array = NDArray[np.float64]
Image = NDArray[np.floating]

TRIED = 2
"""Modes of spheres that are fitted by themselves at most, until one does as well as the free phase function."""
AS_WELL = 1.002
"""Share of what a free phase function leaves that spheres may leave: it follows noise with its seventeen numbers."""
FOLLOWED = 0.5
"""Share that it may follow too, squared, of the model's own error or of structure that images hold: free beads of .5 µm
left .7 % less than spheres did, which cost less, priors included, and were right. With smooth faults of .3 to 1 % in
five images, spheres left up to .24 more where they were right, and 2 or more where they were not."""
FAR_LESS = 1.05
"""Times as much as spheres leave that a free phase function leaves where no smooth one is weighed beside them any more.
Of beads of 1 µm it left 3 and 1.1 times as much. With its errors, which count what it leaves, particles of many sizes
were seven and six times as likely as spheres, and σs 9 ± 8 and 24 ± 14 % off, where that of spheres was .1 and .4."""
UNSEEN = 0.3
"""Standard deviation of the share of its light that a liquid which may peak straight on turns by too little for an
image to show it. Petzold's waters and Fournier and Forand's have .25 to .32 more of it than what was fitted to them,
with mean cosines .018 to .038 too small, of which .002 to .012 were stated."""
NEGLIGIBLE, SOME = 1e-3, 0.05
"""Share of the answer below which a family is left out of it, and that all families must have together for exact images
to be made where they say the liquid is."""
AGAIN = (0.25, 1.0)
"""Light paths of these images, of those in the exact image at the optimum: the first moves families by several standard
deviations, and the last has the noise that the covariance counts. Next to an optimum that has an exact image by all
paths both are by the same share of them, see `Nearby`."""


@dataclass(frozen=True, eq=False)
class LikelySpheres:
    """Spheres that are likelier than all else by what a fit of a free phase function knows.

    Parameters
    ----------
    liquids
        Of these, of different diameters, likeliest first; None for one to be looked for anywhere.
    freely
        That fit's optimum.
    spread
        Covariance of its values.
    family
        The free one.
    structure
        What images hold beyond noise and what the model states, squared and whitened.
    """

    liquids: tuple[Medium | None, ...]
    freely: Evaluation
    spread: Array
    family: Family
    structure: float = 0.0

    def weighed(self, best: Evaluation) -> Scattering:
        """What follows from the optimum of a fit of spheres that began there.

        Its exact images say how far spheres are off what was seen, finer structure than a free phase function's
        included. How far a liquid's own p may be off theirs is no part of that fit, and is counted here: an emulsion's
        σs was 1.2 ± .4 % off as that of spheres alone, and is .7 ± 1.1 %.
        """
        coefficients, own = best.values[best.problem.blocks[0].name], best.values["phase"]
        score, _ = _by_free(self.freely, self.spread, self.family)
        phase, base = spheres().phase(own), float(score.at[2])
        place = np.concatenate([coefficients, [base], amplitudes_of(phase.density(PLACES), base)])
        left = _left_by(best.images, self.freely)
        liquid = Medium(float(coefficients[0]), float(coefficients[1]), phase=phase)
        found = about_spheres(score.about(place, left, np.zeros((0, left.size))), liquid, own)
        return replace(together(found), beads=None, explains_as_well=self._explain_as_well(left))

    def alone(self, best: Evaluation) -> bool:
        """Whether spheres leave so much less at the optimum of their fit that nothing is to be weighed beside them.

        Not where images hold structure that is no phase function's, or where the free one's fit ended early for that.
        """
        left, freely = _left_by(best.images, self.freely), self.freely.left
        return self.structure == 0.0 and float(freely @ freely) > FAR_LESS**2 * float(left @ left)

    def _explain_as_well(self, left: Array) -> bool:
        """Whether images that leave (n,) so much explain what was seen as well as the free phase function's do."""
        freely = self.freely.left
        return float(left @ left) < AS_WELL**2 * float(freely @ freely) + FOLLOWED * self.structure


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
    score, freely = _by_free(best, spread, family)
    found = [freely, *families(score, freely)]
    for times in AGAIN:
        shares = _shares(found)[1:]
        if exact is None or shares.sum() < SOME:
            break
        place, liquid = _place(found[1:], shares / shares.sum(), family)
        (added,) = best.added
        left, noise = _left_by([exact(liquid, times).image + added], best), _noise_of(exact, liquid, best)
        score = score.about(place, left, noise)
        found = [freely, *families(score, freely)]
    answer = together(found)
    return unseen_peak(answer) if may_peak(score, found) else answer


def unseen_peak(answer: Scattering) -> Scattering:
    """An answer with what light that turns by too little to be seen may add: to σs, and to the mean cosine, but hardly
    to σs (1 − g)."""
    liquid = answer.liquid
    moved = UNSEEN * np.array([0.0, liquid.sigma_s, 1.0 - liquid.g])
    return replace(answer, covariance=answer.covariance + np.outer(moved, moved), may_peak=True)


def like_spheres(best: Evaluation, spread: Array, family: Family) -> tuple[Medium, ...]:
    """Liquids of spheres, where one is likelier than any smooth phase function: it, and others that may be, of other
    diameters. Parameters are as for `averaged`.

    What an image leaves that no free phase function is fine enough for says nothing against spheres.
    """
    score, freely = _by_free(best, spread, family)
    found = of_spheres(score, freely, NOT_HOPELESS - 2.0 * freely.evidence)
    first, *others = sorted([freely, *found], key=lambda one: -one.evidence)
    if not first.finer:
        return ()
    modes = [first]
    for one in others:
        elsewhere = one.finer and all(abs(float(one.own[0] - other.own[0])) > APART for other in modes)
        if elsewhere and one.evidence > first.evidence - NOT_HOPELESS:
            modes.append(one)
    return tuple(_as_spheres(one) for one in modes[:TRIED])


def _by_free(best: Evaluation, spread: Array, family: Family) -> tuple[Score, Weighed]:
    """What a fit of a free phase function knows, and its own answer."""
    count = 2 + len(family.names)
    spread = spread[:count, :count]
    score = Score.of(best, spread)
    return score, by_free(score, spread, family)


def _place(found: Sequence[Weighed], shares: Array, family: Family) -> tuple[Array, Medium]:
    """Where families say together that the liquid is; where one that a free phase function is too coarse for, as most
    of them say."""
    likeliest = found[int(np.argmax(shares))]
    if likeliest.finer and float(shares.max()) > 0.5:
        return likeliest.at, likeliest.liquid
    place = shares @ np.array([one.at for one in found])
    return place, Medium(float(place[0]), float(place[1]), phase=family.phase(place[2:]))


def _left_by(images: Sequence[Image], best: Evaluation) -> Array:
    """(n,) what an image of each view leaves, whitened; with all light in it, a floor's and a halo's too."""
    models = best.problem.whitened(images)
    return best.problem.left_by(models, *best.problem.scale(models))


def _noise_of(exact: Exact, liquid: Medium, best: Evaluation) -> Array:
    """(m, n) patterns, whitened, of what noise an exact image has more than the optimum's."""
    if not isinstance(exact, Nearby):
        return np.zeros((0, best.left.size))
    (view,), (gain, _) = best.problem.views, best.scale
    return best.project_out(view.whitened(gain * exact.more_noise(liquid)))[:, : best.left.size]


def together(found: Sequence[Weighed]) -> Scattering:
    """Answers as one, by their shares of the evidence."""
    shares = _shares(found)
    kept = [(one, float(share)) for one, share in zip(found, shares, strict=True) if share > NEGLIGIBLE]
    beads = [one for one, share in zip(found, shares, strict=True) if one.finer and one.off == LITTLE and share > 0.5]
    answer = mixed([one.answer() for one, _ in kept], [share for _, share in kept])
    return replace(answer, beads=_as_spheres(beads[0]) if beads else None)


def _as_spheres(found: Weighed) -> Medium:
    return Medium(float(found.at[0]), float(found.at[1]), phase=spheres().phase(found.own))


def _shares(found: Sequence[Weighed]) -> Array:
    """How much of the evidence each has."""
    evidence = np.array([one.evidence for one in found])
    shares = np.exp(evidence - evidence.max())
    return np.asarray(shares / shares.sum())


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
        outside_cone=_mixed(weight, [one.outside_cone for one in answers]),
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
