"""Candidates for the next photograph, ranked by what they are expected to tell per minute, per µl or in all."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Literal

import numpy as np

from tankrig.advice.expected import Answer, Array, Expected, Known, Shot, expected
from tankrig.estimation.forward import models_of
from tankrig.estimation.phase_families import Family
from tankrig.estimation.versions import Models
from tankrig.image.prepare import Prepared, prepare
from tankrig.light.prepared.box import Box
from tankrig.scene import Medium, Scene

By = Literal["minute", "ul", "all"]

TOLERANCE = 0.03
"""Tolerance of the models that advice is computed with: derivatives to a few per cent are enough."""
ROOM, ASYMMETRY_ROOM = 1.1, 0.08
ALBEDO = (0.3, 0.9999)


@dataclass(frozen=True)
class Candidate:
    """Something to do next.

    Parameters
    ----------
    shot
        What is photographed.
    minutes
        That it takes, dosing and mixing included.
    volume_ul
        Ink to be dosed for it.
    """

    shot: Shot
    minutes: float
    volume_ul: float


@dataclass(frozen=True)
class Advice:
    """What a candidate is expected to be worth.

    Parameters
    ----------
    candidate
        What to do.
    after
        What will be known.
    bits
        Information gained.
    """

    candidate: Candidate
    after: Expected
    bits: float

    @property
    def bits_per_minute(self) -> float:
        """Information for the time."""
        return self.bits / self.candidate.minutes

    @property
    def bits_per_ul(self) -> float | None:
        """Information for the ink; None where none is dosed."""
        return self.bits / self.candidate.volume_ul if self.candidate.volume_ul > 0.0 else None


def ranked(
    known: Known,
    taken: Sequence[Shot],
    candidates: Sequence[Candidate],
    answer: Answer,
    by: By = "minute",
    name: str | None = None,
) -> tuple[Expected | None, list[Advice]]:
    """What is known now, and the candidates, the best first.

    Parameters
    ----------
    known
        Ink and camera.
    taken
        What has been photographed; may be empty.
    candidates
        To compare.
    answer
        The model.
    by
        Rank by bits per minute, per µl (where no ink is needed: first), or in all.
    name
        Count information about "sigma_a", "sigma_s" or "g" only; None: about all three.
    """
    remembered = lru_cache(maxsize=None)(answer)
    before = expected(known, taken, remembered) if taken else None
    found = []
    for candidate in candidates:
        after = expected(known, [*taken, candidate.shot], remembered)
        bits = before.bits_to(after, name) if before else -_spread(after, name)
        found.append(Advice(candidate, after, bits))

    def worth(advice: Advice) -> float:
        if by == "minute":
            return advice.bits_per_minute
        if by == "ul":
            return np.inf if advice.bits_per_ul is None else advice.bits_per_ul
        return advice.bits

    return before, sorted(found, key=worth, reverse=True)


def _spread(after: Expected, name: str | None) -> float:
    """Bits of uncertainty left, from a start where each coefficient is known to a factor of e or g to 1."""
    if name is not None:
        return float(np.log2(after.relative_sd[name]))
    sd = np.sqrt(np.diag(after.covariance))
    relative = np.array(list(after.relative_sd.values()))
    scale = np.outer(relative / sd, relative / sd)
    return float(np.linalg.slogdet(after.covariance * scale)[1]) / 2.0 / float(np.log(2.0))


def answer_by_paths(family: Family | None) -> Answer:
    """The tank's model with the phase functions of a family: light paths are followed for each liquid anew."""

    @cache
    def models(scene: Scene) -> Models:
        return models_of(scene, "tank", None, family)

    def answer(scene: Scene, medium: Medium) -> tuple[Array, Array]:
        _, quiet = models(scene).refined(medium)  # noise of derivatives would pass for information
        slopes = models(scene).slopes_of(quiet, max(scene.tank.size_mm))(medium)
        return np.asarray(quiet(medium).image), np.asarray(slopes)

    return answer


def prepared_answer(
    known: Known, scenes: Sequence[Scene], doses_ml: Sequence[float], progress: Callable[[float], object]
) -> Answer:
    """The model of some scenes for all media that doses can give: prepared, kept on disk.

    Raises
    ------
    SceneError, CacheError
        See `tankrig.prepare`.
    """
    import warnings

    liquids = [known.liquid(dose) for dose in doses_ml]
    densities, g = [liquid.sigma_t for liquid in liquids], known.ink.g
    box = Box(
        (min(densities) / ROOM, max(densities) * ROOM), ALBEDO, (g - ASYMMETRY_ROOM, min(g + ASYMMETRY_ROOM, 0.97))
    )
    different = list(dict.fromkeys(scenes))
    models: dict[Scene, Prepared] = {}
    for number, scene in enumerate(different):

        def share(done: float, number: int = number) -> None:
            progress((number + done) / len(different))

        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            models[scene] = prepare(scene, TOLERANCE, share, box)

    def answer(scene: Scene, medium: Medium) -> tuple[Array, Array]:
        # Ink that absorbs nothing is beyond every box, and as good as what is at its edge.
        clear = medium.albedo > box.albedo[1]
        return models[scene].predict(box.nearest(medium) if clear else medium, derivatives=True)

    return answer
