"""When a fit by Henyey–Greenstein's phase function asks for another one, and what that explains of what is left."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.astray_shown import Shown
from tankrig.estimation.fitting import Searched, searched
from tankrig.estimation.left_over import Left, stated_errors
from tankrig.estimation.phase_answer import Asked
from tankrig.estimation.phase_instead import Freed, Instead, fitted_instead, freed
from tankrig.estimation.problem import Evaluation
from tankrig.estimation.residual import (
    PHASE,
    PHASE_TERMS,
    WHOLE,
    Cause,
    cause_by,
    cause_of,
    misalignments,
    phase_of_share,
)
from tankrig.estimation.search import Told
from tankrig.estimation.shots import Shot, weighed_problem
from tankrig.estimation.versions import Models
from tankrig.scene import Medium, Scene

Array = NDArray[np.float64]

LIKE_TANK = ("tank", "prepared")
"""Models of the whole tank that the cheap one can stand in for."""
DOUBTED, EARLY = 1.5, 0.8
"""Mean squared residual that the cheap model with Henyey–Greenstein's leaves, in standard deviations that count its own
error, from which on other phase functions are looked at at once (where they are Henyey–Greenstein's it leaves .8 to
1.2, an emulsion of σs .03 1.7), and share of it that another one explains before a fit goes on with that. Beads of 1
µm, σs .03, were explained by .86, and what went on with Henyey–Greenstein's ended at four times their σs."""
BEYOND, EXPLAINED = 1.5, 0.5
"""Structure over the model's own error from which on, and share of it below which the likeliest cause explains too
little, for Henyey–Greenstein's σs and g to count as determined: a liquid like Petzold's left .45 % beside .2, of which
no cause explained more than .35, with g six standard deviations off."""
BEYOND_DOUBT, UNDOUBTED = 3.0, -10.0
"""Logarithm of how many times likelier (20) another phase function is before Henyey–Greenstein's is given up, and the
one below which families are not weighed beside it. A free one pays for its sixteen shapes, and families for one to
three numbers: beads of .2 µm, σs .030, behind glass and surface had .1, −3.2 and −7.9 by three draws of noise with g
.045 off, twelve standard deviations; liquids of Henyey–Greenstein's there −15 to −21."""


def told_early(shot: Shot, looked: Searched, progress: Told) -> Instead | None:
    """What another phase function explains, where the search's end with Henyey–Greenstein's leaves so much that it is
    not worth going on from; None where that is not so.

    Where the gain is known this is looked for from two places, see `_by_any_gain`.

    Parameters
    ----------
    shot
        The image.
    looked
        Where the search has ended.
    progress
        Told in words what is being done.
    """
    scene = shot.scene
    best = _at_end(shot, looked)
    if 2.0 * best.cost < DOUBTED * best.problem.pixels:
        return None
    progress("looking at other phase functions")
    instead = fitted_instead(best, scene, shot.models, rough=True)
    if best.problem.scaling.gain is not None:
        near = _by_any_gain(shot, looked, progress)
        other = fitted_instead(best, scene, shot.models, rough=True, near=near)
        instead = max(instead, other, key=lambda one: one.share)
    if instead.share < EARLY:
        return None
    told = phase_of_share(instead.share, best.left)
    likely = cause_of(best, scene, cache(partial(misalignments, scene, best.media[0])), told)
    return instead if _is_phase(likely) else None


def _at_end(shot: Shot, looked: Searched) -> Evaluation:
    """Where a search has ended, as the cheap model's own errors count it."""
    problem, (start, *_) = looked
    end, views = problem.at(start), problem.views
    seen = shot.models.coarse(end.media[0])
    counted = weighed_problem(
        problem, [shot], [view.forward for view in views], [view.slopes for view in views], [seen], end.added
    )
    return counted.at(start)


def _by_any_gain(shot: Shot, looked: Searched, progress: Told) -> Medium:
    """What the liquid looks like where the image's brightness says nothing of it.

    Where the gain is known, Henyey–Greenstein's σs makes up for light at right angles that other phase functions have
    less of: .027 where beads of 2 µm have .010, from where no step leads back. With any gain it is .0106 there.
    """
    problem, _ = looked
    freely = searched([shot], problem.blocks, replace(problem.scaling, gain=None, gain_sd=0.0), progress)
    return fitted_instead(_at_end(shot, freely), shot.scene, shot.models, rough=True).liquid


@dataclass(frozen=True)
class PhaseTold:
    """What a residual tells of other phase functions than the one that was fitted.

    Parameters
    ----------
    instead
        What another one would say; None where none was fitted.
    freed
        What a free one would make of a residual that is noise by its size; None where that was not asked.
    misled
        Whether another one explains more than anything else does, so that the fit is not to be believed.
    explained
        Share of what Henyey–Greenstein's leaves that the likeliest other cause explains; 1 where it leaves nothing
        beyond doubt about the model's error.
    """

    instead: Instead | None = None
    freed: Freed | None = None
    misled: bool = False
    explained: float = 1.0

    @property
    def doubted(self) -> bool:
        """Whether structure is left that nothing known explains half of, so that another one may."""
        return self.explained < EXPLAINED

    @property
    def undecided(self) -> bool:
        """Whether a residual that is noise by its size leaves another one too likely to be left out."""
        return not self.misled and self.freed is not None and self.freed.evidence > UNDOUBTED

    @property
    def shown(self) -> bool:
        """Whether a residual that is noise by its size shows another one beyond doubt."""
        return self.misled and self.freed is not None

    def counted(self, spread: Array) -> Array:
        """Covariance (3, 3) of σa, σs and mean cosine, with what another phase function would move them by."""
        if self.instead is not None:
            return np.asarray(spread + self.instead.share * np.outer(self.instead.moved, self.instead.moved))
        return spread if self.freed is None else self.freed.averaged(spread)


@dataclass(frozen=True, eq=False)
class Doubt:
    """A fit of one image, and what is asked of other phase functions than the one that was fitted.

    Parameters
    ----------
    best
        The optimum.
    left
        What it leaves of the image.
    scene, models
        The image's, as described.
    asked
        Which phase functions are searched.
    """

    best: Evaluation
    left: Left
    scene: Scene
    models: Models
    asked: Asked

    def causes(self, misaligned: Callable[[], Array]) -> tuple[list[Cause], PhaseTold]:
        """What may explain a residual that holds structure, likeliest first, and what it tells of phase functions.

        Derivatives tell at once where they explain more than other causes do. Far off they do not; then it is fitted,
        and that a rough look explains more is enough where families are weighed next.

        Parameters
        ----------
        misaligned
            Gives `misalignments` of the scene with the fitted medium.
        """
        if not self._may_be_asked:
            whole = self.left.prediction.model in WHOLE
            likely = cause_of(self.best, self.scene, misaligned) if whole else []
            return likely, PhaseTold(explained=self._explained_by(likely))
        if self.left.unexplained <= BEYOND * self.left.stated:
            # So little is the model's own error as likely as anything, and every smooth pattern would explain some.
            free = self._by_derivatives
            if free.evidence < BEYOND_DOUBT:
                return cause_of(self.best, self.scene, misaligned), PhaseTold(freed=free)
        likely, instead = self._asked_of_structure(misaligned)
        misled = _is_phase(likely)
        return likely, PhaseTold(instead, misled=misled, explained=1.0 if misled else self._explained_by(likely))

    def hidden(self, sign: Shown | None) -> PhaseTold:
        """What a residual that is noise by its size tells of phase functions.

        Parameters
        ----------
        sign
            The light astray that it shows.
        """
        if not (self._may_be_asked and self.left.prediction.model == "tank"):
            return PhaseTold()
        free = self._by_derivatives
        if not self._beyond_doubt(free, sign):
            return PhaseTold(freed=free)
        if self.asked.further is None:
            return PhaseTold(Instead(1.0, free.moved, self.best.media[0]), free, misled=True)
        rough = fitted_instead(self.best, self.scene, self.models, rough=True)
        return PhaseTold(_at_least(rough, self._cause_of(free).share), free, misled=True)

    @property
    def _may_be_asked(self) -> bool:
        """Whether Henyey–Greenstein's was fitted, and by a model that the cheap one can stand in for."""
        return self.asked.family is None and self.left.prediction.model in LIKE_TANK

    @cached_property
    def _by_derivatives(self) -> Freed:
        """What a free phase function would say, without a search."""
        errors = stated_errors(self.best, [self.left])
        return freed(self.best, self.scene, self.models, [self.left.noise], errors)

    def _cause_of(self, free: Freed) -> Cause:
        """What a free phase function explains by derivatives, as a cause."""
        return cause_by(PHASE, self.best.left, free.pattern, PHASE_TERMS)

    def _asked_of_structure(self, misaligned: Callable[[], Array]) -> tuple[list[Cause], Instead]:
        """Likely causes, and another phase function as it was fitted."""
        best, scene, models, roughly = self.best, self.scene, self.models, self.asked.further is not None
        told = self._cause_of(self._by_derivatives)
        likely = cause_of(best, scene, misaligned, told)
        if _is_phase(likely):
            return likely, _at_least(fitted_instead(best, scene, models, roughly), told.share)
        instead = fitted_instead(best, scene, models, roughly)
        likely = self._causes_beside(instead, told, misaligned)
        if roughly and not _is_phase(likely):
            instead = fitted_instead(best, scene, models, near=instead.liquid)
            likely = self._causes_beside(instead, told, misaligned)
        return likely, instead

    def _causes_beside(self, instead: Instead, told: Cause, misaligned: Callable[[], Array]) -> list[Cause]:
        """Causes beside a phase function as it was fitted or as derivatives tell, whichever is likelier."""
        fitted = phase_of_share(instead.share, self.best.left)
        likelier = max(told, fitted, key=lambda one: one.evidence)
        return cause_of(self.best, self.scene, misaligned, likelier)

    def _beyond_doubt(self, free: Freed, sign: Shown | None) -> bool:
        """Whether another phase function is beyond doubt, and likelier than the light astray that an image shows.

        Beads of .2 µm, σs .03, left nothing but what looked like a blur by 3.8 standard deviations, with g .046 off;
        another phase function is e⁹⁰ times likelier there than Henyey–Greenstein's.
        """
        astray = 0.0 if sign is None else 0.5 * (sign.deviations**2 - math.log(self.best.left.size))
        return free.evidence > max(BEYOND_DOUBT, astray)

    def _explained_by(self, likely: Sequence[Cause]) -> float:
        """See `PhaseTold.explained`."""
        left = self.left
        much = self.asked.family is None and left.unexplained > BEYOND * left.stated
        if not much:
            return 1.0
        return likely[0].share if likely else 0.0


def _is_phase(likely: Sequence[Cause]) -> bool:
    """Whether the likeliest cause is another phase function."""
    return len(likely) > 0 and likely[0].name == PHASE


def _at_least(instead: Instead, share: float) -> Instead:
    """The same, explaining so much at least."""
    return replace(instead, share=max(instead.share, share))
