"""How a fit goes about phase functions: which are asked for, how they are fitted, and what comes of it."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.coordinates import Range
from tankrig.estimation.fitting import Ending, fitted, guessed, promising
from tankrig.estimation.ink_blocks import Doses, DosesBlock, InkBlock
from tankrig.estimation.parameters import Block, MediumBlock
from tankrig.estimation.phase_average import LikelySpheres, averaged, like_spheres
from tankrig.estimation.phase_block import CoefficientsBlock, InkCoefficientsBlock, PhaseBlock, WaterBlock
from tankrig.estimation.phase_families import (
    FAMILIES,
    Family,
    family_of,
    fixed,
    free,
    henyey_greenstein,
)
from tankrig.estimation.phase_result import Scattering, scattering_of
from tankrig.estimation.problem import Evaluation
from tankrig.estimation.scaling import Scaling
from tankrig.estimation.search import Told
from tankrig.estimation.shots import Fit, Shot
from tankrig.estimation.spheres import spheres
from tankrig.estimation.versions import Exact
from tankrig.scene import Medium, Scene
from tankrig.scene.phase_table import PhaseFunction

Array = NDArray[np.float64]

MOST_RUNGS = 6
"""Places on a family's ladder that a search begins from, at most."""
CHANCE, FAR = 3.0, 1.0
"""Standard deviations of a sum of squares that are no chance, and that are far from what is expected. Beads of .5 µm
were fitted by amplitudes that are 2.3 off; an emulsion's are fewer than expected."""


MOSTLY = 0.5
"""Share of the answer from which on spheres are fitted by themselves, though the liquid may seem to be off them: as
seen from a free phase function's optimum beads of 1 µm were, by a discrepancy of .3, with σs 9 ± 7 % off."""


@dataclass(frozen=True)
class Asked:
    """Which phase functions a fit searches.

    Parameters
    ----------
    family
        None: Henyey–Greenstein.
    averaged
        Whether families are weighed by evidence; `family` is the free one then.
    begin
        Phase function to begin from; None: the one that is most like Henyey–Greenstein.
    further
        What is asked next where these leave what another phase function explains; None: nothing.
    near
        About what the liquid is, of a phase function of the family; None to look for it.
    likely
        The spheres that are fitted, as a free phase function's fit has them, by which they are weighed; None where no
        spheres are.
    """

    family: Family | None = None
    averaged: bool = False
    begin: PhaseFunction | None = None
    further: "Asked | None" = None
    near: Medium | None = None
    likely: LikelySpheres | None = None

    @property
    def is_free(self) -> bool:
        """Whether any smooth phase function is searched."""
        return self.family is not None and self.family.is_free


def asked_for(phase: str | PhaseFunction | None, scene: Scene) -> Asked:
    """What `estimate`'s `phase` means for a scene.

    Raises
    ------
    SceneError
        When it is unknown.
    """
    described = scene.medium.phase
    if phase is None:
        if described is None:
            return Asked()
        phase = described.kind if described.kind in FAMILIES else described
    if phase == "any":
        return Asked(free(), averaged=True)
    asked = Asked(family_of(phase, described))
    begin = phase if isinstance(phase, PhaseFunction) else described
    if begin is None or asked.family is None or not (asked.is_free or asked.family.has(begin)):
        return asked
    return replace(asked, begin=begin)


BlocksOf = Callable[[Family | None], tuple[Block, ...]]
"""Blocks of a liquid, or of ink in water, by the family of phase functions that is searched; None: Henyey–Greenstein.

With a family those of σa and σs come first, and that of the phase function next.
"""


def liquid_blocks(within: Range) -> BlocksOf:
    """Blocks of one liquid in all images."""
    return lambda family: (MediumBlock(within),) if family is None else (CoefficientsBlock(within), PhaseBlock(family))


def ink_blocks(doses: Doses, length_mm: float) -> BlocksOf:
    """Blocks of ink in water that absorbs."""
    errors = DosesBlock(doses)
    return lambda family: (
        (InkBlock(doses, length_mm), errors)
        if family is None
        else (InkCoefficientsBlock(doses, length_mm), PhaseBlock(family), WaterBlock(length_mm), errors)
    )


def fit_phase(
    shots: Sequence[Shot],
    asked: Asked,
    blocks_of: BlocksOf,
    scaling: Scaling,
    progress: Told,
    few: Sequence[int] = (0,),
    densest: Medium | None = None,
    ending: Ending = Ending(),  # noqa: B008
) -> Fit:
    """Fit coefficients and a family's phase function to images.

    Coefficients are looked for with Henyey–Greenstein first, whose three numbers are found from anywhere, or with the
    phase function to begin from where there is one.

    Parameters
    ----------
    shots
        The images, and their models.
    asked
        Which phase functions are searched.
    blocks_of
        What else is.
    scaling, progress, few, ending
        As for `fitted`; the last of the few is densest.
    densest
        About what that is; None to look for it.
    """
    family = asked.family or henyey_greenstein()
    blocks = blocks_of(family)
    if asked.near is not None:
        start = np.concatenate([one.start(asked.near) for one in blocks])
        return fitted(shots, blocks, scaling, progress, start, few, ending)
    at = densest
    if at is None:
        only = None if asked.begin is None else fixed(asked.begin)
        plain = [replace(shot, models=replace(shot.models, family=only)) for shot in shots]
        at = guessed(plain, blocks_of(only), scaling, progress, few)
    before, start, after = blocks[0].start(at), blocks[1].start(at), [one.start(at) for one in blocks[2:]]

    def place(coordinates: Array) -> Array:
        return np.concatenate([before, coordinates, *after])

    starts = [place(start)]
    if densest is None or not family.has(densest.phase):
        starts += [place(other) for other in family.others(start)]
        rungs = [place(np.concatenate([[rung], start[1:]])) for rung in family.ladder]
        starts += promising(shots, blocks, scaling, rungs, few)[:MOST_RUNGS] if rungs else []
    return fitted(shots, blocks, scaling, progress, few=few, ending=ending, starts=starts)


def answer_of(
    best: Evaluation, spread: Array, asked: Asked, explained: bool = True, exact: Exact | None = None
) -> Scattering:
    """The liquid at an optimum.

    Parameters
    ----------
    best
        The optimum: of a liquid, or of ink, which is answered per ml.
    spread
        Covariance of all its values.
    asked
        Which phase functions were.
    explained
        Whether noise and the model's own error explain what is left. Where they do not, the free phase function does
        not hold either, and what is left is no measure of how much worse a stiffer one is.
    exact
        See `averaged`.
    """
    if asked.family is None:
        medium, covariance = Medium(*best.values[best.problem.blocks[0].name][:3]), spread[:3, :3]
        scale = np.diag([1.0, 1.0, 1.0 / ((1.0 - medium.g) * (1.0 + medium.g))])
        coordinates = np.array([math.atanh(medium.g)])
        found = scattering_of(
            np.array(medium.coefficients[:2]), coordinates, scale @ covariance @ scale, henyey_greenstein()
        )
        return replace(found, liquid=medium, covariance=covariance)
    if asked.likely is not None and not (explained and asked.likely.alone(best)):
        return asked.likely.weighed(best)
    if asked.averaged and explained:
        return averaged(best, spread, asked.family, exact)
    count = 2 + len(asked.family.names)
    coefficients = best.values[best.problem.blocks[0].name]
    return scattering_of(coefficients, best.values["phase"], spread[:count, :count], asked.family)


def likely_spheres(
    best: Evaluation, spread: Array, asked: Asked, answer: Scattering, unsure: bool, anywhere: bool = False,
    structure: float = 0.0,
) -> LikelySpheres | None:  # fmt: skip
    """Spheres that are worth a fit of their own; None where families are not weighed, or none are.

    Parameters
    ----------
    best, spread, asked
        As for `answer_of`.
    answer
        What that gave.
    unsure
        Whether what the free phase function's fit knows is no measure of how far a liquid is off spheres: it does not
        describe the images, say, or has not settled.
    anywhere
        Whether spheres are looked for anywhere, where none are likely by what that fit knows and its phase function is
        far from what is expected of smooth ones: what it knows it has from derivatives.
    structure
        As for `LikelySpheres`.
    """
    if not asked.averaged or asked.family is None:
        return None
    settled = () if answer.beads is None else (answer.beads,)
    beads: tuple[Medium | None, ...] = like_spheres(best, spread, asked.family) if unsure else settled
    if not beads and anywhere and rougher(best.values["phase"], asked.family, FAR):
        beads = (None,)
    return LikelySpheres(beads, best, spread, asked.family, structure) if beads else None


def mostly_spheres(answer: Scattering) -> bool:
    """Whether spheres have most of an answer."""
    return answer.families.get(spheres().name, 0.0) > MOSTLY


def is_rough(best: Evaluation, asked: Asked) -> bool:
    """Whether a free phase function was fitted, and is rougher than they are expected to be."""
    return asked.family is not None and asked.is_free and rougher(best.values["phase"], asked.family)


def rougher(coordinates: Array, family: Family, deviations: float = CHANCE) -> bool:
    """Whether amplitudes that are expected to be 0 ± 1 are together larger than chance lets them be.

    Then shapes too fine to be among them are not as small as was expected either, and what a fit says of σs rests on
    that.

    Examples
    --------
    >>> at = np.concatenate([[1.0], np.ones(16)])
    >>> rougher(at, free()), rougher(1.7 * at, free())
    (False, True)
    """
    expected = coordinates[family.expected]
    return float(expected @ expected) > expected.size + deviations * math.sqrt(2.0 * expected.size)
