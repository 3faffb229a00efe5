"""A fit about exact images of which light paths tell by what shares a phase function's coordinates change them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.about_exact import (
    MANY_ENOUGH,
    NEAR_ENOUGH,
    always,
    at_media,
    exact_images,
    few_steps,
    problem_about,
)
from tankrig.estimation.borne_out import HALVINGS, SETTLED, SHARPER, WORSE, borne_out, cost_saved, held_back, settled
from tankrig.estimation.differences import Slopes
from tankrig.estimation.followed import Followed, Model, remembered
from tankrig.estimation.nearby import Nearby
from tankrig.estimation.optimiser import LAST_STEPS, solve
from tankrig.estimation.prior_weight import believing, weight_of_priors
from tankrig.estimation.problem import Evaluation, Problem
from tankrig.estimation.search import Told, by_cost
from tankrig.estimation.shots import Fit, Shot
from tankrig.estimation.versions import Exact
from tankrig.prediction import Prediction
from tankrig.scene import Medium

Vector = NDArray[np.float64]
Image = NDArray[np.floating]

MOST_CORRECTIONS, MOST_ROUGH, CLOSE = 8, 4, 4.0
"""Where a phase function's coordinates are fitted along light paths: exact images at most, so many of them at most by
fewer paths, and how many times as closely as to 0 coordinates that are expected to be 0 ± 1 stay to where an exact
image was made. What an image hardly tells derivatives' noise does, and without that fits followed it."""
FIRST, ROUGH, NEXT = 0.25, 0.125, 0.25
"""Shares of the light paths, where a phase function's coordinates are fitted: in derivatives and in exact images until
a fit by these has settled, for on the way there coordinates move by several standard deviations, and more would not be
worth it; and in exact images next to one by all of them, see `Nearby`."""
MUCH = 10.0
"""How much more, in χ²/2, the exact image costs than was promised where a fit of a phase function's coordinates ended
that has not settled."""


@dataclass(frozen=True)
class ByShares:
    """A fit about exact images, where a phase function's coordinates change what paths bring by shares of it.

    Orders 1 and 2 are computed as they are, see `Followed.about`. Derivatives along paths are dear, and told twice: by
    few lattices where the search has ended, and where a fit by few paths has settled, or has made `MOST_ROUGH` images.
    There one exact image is made by all paths, and further ones next to it, see `Nearby`. Each image shows how far the
    derivatives that led to it hold, and teaches them; where it bears out nothing, the fit goes on from where it was.

    Parameters
    ----------
    problem
        That was solved.
    shots
        Whose exact images are asked for.
    models
        Of their views.
    progress
        Told in words what is being done.
    """

    problem: Problem
    shots: Sequence[Shot]
    models: Sequence[Followed]
    progress: Told

    @classmethod
    def of(cls, problem: Problem, shots: Sequence[Shot], models: Sequence[Model], progress: Told) -> "ByShares | None":
        """For models that are differentiated; None where no phase function's coordinates are fitted along paths."""
        followed = [model for model in models if isinstance(model, Followed)]
        if any(shot.models.family for shot in shots) and len(followed) == len(models):
            return cls(problem, shots, followed, progress)
        return None

    @property
    def near(self) -> Vector:
        """Standard deviations that a settled value stays within."""
        return SETTLED * self.problem.looseness

    @property
    def each(self) -> float:
        """Share of all paths that each of several images follows: together they tell as much as one by all of them."""
        return 1.0 / len(self.shots)

    @property
    def following(self) -> float:
        """Share of the paths in exact images next to one by all of them: all, where members of the family that are
        apart look alike, for there a fit followed what noise a quarter of them adds (beads of 2 µm, off by 1 %)."""
        family = self.models[0].family
        return NEXT if family is None or not family.ladder.size else 1.0

    def shares_at(self, centre: Evaluation, share: float) -> "_Shares":
        """Derivatives by a share of the lattices, or all that each of several images follows.

        By all of them they are fine, those of orders 1 and 2 too, and told once: these are dear.
        """
        fine = share >= 1.0
        told = [model.with_share(min(share, self.each), fine) for model in self.models]
        of_media = list(zip(told, centre.media, strict=True))
        shares = [model.shares(medium) for model, medium in of_media]
        low = [model.low_shares(medium) if fine else None for model, medium in of_media]
        noise = [shot.slopes_noise_of(model) for shot, model in zip(self.shots, told, strict=True)]
        return _Shares(told, shares, low, at_media(noise, centre.media))

    def about(self, centre: Evaluation, seen: Sequence[Prediction], told: "_Shares", start: Evaluation) -> Fit:
        """The optimum as models change about the exact images of a place."""
        parts = list(zip(told.models, centre.media, seen, told.shares, told.low, strict=True))
        near = [model.about(medium, one, share) for model, medium, one, share, _ in parts]
        slopes = [model.slopes_about(medium, one.image, share, low) for model, medium, one, share, low in parts]
        close = centre.coordinates, CLOSE
        here = problem_about(believing(self.problem, 1.0), self.shots, near, slopes, told.noise, centre, seen, close)
        end = solve(here.line, start.coordinates, NEAR_ENOUGH, LAST_STEPS, damping=0.0)
        weight = weight_of_priors(end, seen, [shot.scene for shot in self.shots])
        if weight > 1.0:
            here = here.believing(weight)
            end = solve(here.line, end.coordinates, NEAR_ENOUGH, LAST_STEPS, damping=0.0)
        end = by_cost(here.bent.at(one.coordinates) for one in (end, start))[0]  # along which moments bend
        end = solve(here.bent, end.coordinates, MANY_ENOUGH, few_steps(self.shots), damping=0.0)
        return here.fit(end.coordinates)

    def by_few_paths(self, best: Evaluation) -> tuple[Evaluation, int]:
        """Where images by few paths lead, and how many of them were made."""
        roughly = partial(exact_images, self.shots, times=ROUGH)
        self.progress("correcting by accurate images")
        centre, seen, told = best, roughly(best), self.shares_at(best, FIRST)
        fit = self.about(centre, seen, told, centre)
        for made in range(1, MOST_ROUGH + 1):
            if made > 1 and settled(fit.optimum, centre, self.near):  # the first is too rough
                return fit.optimum, made
            self.progress("correcting by accurate images")
            further, shown = borne_out(fit, centre, roughly, HALVINGS)
            gained = cost_saved(fit, centre, further, shown)
            if made < MOST_ROUGH:
                told = told.taught(centre, seen, further, shown)
            if gained > 0.0:
                centre, seen = further, shown
            if made < MOST_ROUGH:
                fit = self.about(centre, seen, told, centre)
        return centre, MOST_ROUGH

    def by_all_paths(self, centre: Evaluation, most: int, sharper: bool) -> Fit:
        """The optimum about images by all paths, after so many more of them at most."""
        self.progress("correcting by accurate images")
        told, seen = self.shares_at(centre, 1.0), exact_images(self.shots, centre, self.each)
        next_to = self.each * self.following
        parts = [remembered(partial(_by_share, shot.models.exact, next_to)) for shot in self.shots if shot.models.exact]
        by_all = self.following == 1.0
        around = [Nearby(*one, by_all) for one in zip(parts, centre.media, seen, strict=True)]

        def exactly(at: Evaluation) -> list[Prediction]:
            return [one(medium) for one, medium in zip(around, at.media, strict=True)]

        fit = self.about(centre, seen, told, centre)
        for _ in range(most):
            if settled(fit.optimum, centre, self.near):
                break
            self.progress("correcting by accurate images")
            ahead, shown = borne_out(fit, centre, exactly, HALVINGS)
            gained = cost_saved(fit, centre, ahead, shown)
            told = told.taught(centre, seen, ahead, shown)
            if gained > -WORSE:
                centre, seen = ahead, shown
            fit = self.about(centre, seen, told, centre)
        if sharper and held_back(fit.optimum):
            self.progress("correcting by images as accurate as the photographs")
            fit = self.about(centre, exact_images(self.shots, centre, SHARPER * self.each), told, fit.optimum)
        moved = _still_moved(fit.optimum, centre, exactly, self.near)
        return replace(fit, moved=moved, exact=around[0] if len(around) == 1 else None)


def _still_moved(
    end: Evaluation, centre: Evaluation, exact: Callable[[Evaluation], list[Prediction]], near: Vector
) -> Vector | None:
    """By how much the last exact image moved the values, where they have not settled and the exact image at their end
    costs much more than was promised; else None."""
    if settled(end, centre, near):
        return None
    there = end.problem.by([always(one.image) for one in exact(end)]).at(end.coordinates)
    return end.row - centre.row if there.cost - end.cost > MUCH else None


class _Shares(NamedTuple):
    """Derivatives of the logarithm of each image's parts at a place."""

    models: list[Followed]
    """Models that told them."""
    shares: list[Image]
    """Derivatives of what paths bring, see `Followed.shares`."""
    low: list[Image | None]
    """Those of orders 1 and 2, see `Followed.low_shares`; None where they are told anew at each place."""
    noise: list[Slopes | None]
    """Patterns of the paths' noise in the former."""

    def taught(
        self, centre: Evaluation, seen: Sequence[Prediction], ahead: Evaluation, shown: Sequence[Prediction]
    ) -> "_Shares":
        """The same, but so that they would have foretold exact images ahead of a place.

        Where gain, σs and phase function nearly make up for each other, a step that lowers the cost by little changes
        images by thirty times as much, and derivatives that are 1 % off promise what they do not keep.
        """
        parts = zip(self.models, self.shares, centre.media, seen, ahead.media, shown, strict=True)
        return self._replace(shares=[model.taught(shares, *places) for model, shares, *places in parts])


def _by_share(exact: Exact, share: float, medium: Medium) -> Prediction:
    """An exact image by a share of its light paths."""
    return exact(medium, share)
