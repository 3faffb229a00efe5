"""What is not as described, by what it would leave in the residual."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.fitting import MEDIUM, Problem
from tankrig.estimation.misalignment import USUAL, Misalignment
from tankrig.estimation.observation import Observation
from tankrig.estimation.parameters import to_medium
from tankrig.estimation.residual_map import likely_cause
from tankrig.estimation.uncertainty import Sensitivity
from tankrig.scene import Medium, Scene

Array = NDArray[np.float64]

MOST_BEAMS = 16
"""That are looked at one by one."""
WHOLE = ("tank", "prepared", "montecarlo")
"""Models that describe all light, so that what they leave has another cause."""
FEWEST = 5
"""Pixels left out that can tell of a misalignment; four terms fit as many."""
MOSTLY = 0.5
"""Share of what pixels left out are off by that a misalignment explains before it is named."""


def cause_of(
    problem: Problem, sensitivity: Sensitivity, coordinates: Array, scene: Scene, misaligned: Callable[[], Array]
) -> tuple[str, float] | None:
    """What the structure of the residual looks like, and the share of it that this explains.

    Parameters
    ----------
    problem, coordinates
        That was solved, and where.
    sensitivity
        Of the fit there.
    scene
        As described.
    misaligned
        Gives `misalignments` of that scene with the fitted medium.
    """
    from tankrig.light.double import double_scattering
    from tankrig.light.single import single_scattering

    used, weight = sensitivity.used, sensitivity.weight
    scene = replace(scene, medium=to_medium(coordinates[:MEDIUM]))
    image = problem.image(coordinates)
    fitted = np.linalg.qr(sensitivity.changes.T)[0]

    def unhidden(changes: Array) -> Array:
        left = problem.scaling.unhidden(changes[:, used] * weight, np.asarray(image[used], float), weight)
        left = left[:, : weight.size]
        new: Array = left - (left @ fitted) @ fitted.T
        return new

    def uneven() -> list[Array]:
        rows, columns = scene.camera.shape
        y, x = np.linspace(-1.0, 1.0, rows)[:, None], np.linspace(-1.0, 1.0, columns)
        return [image * way for way in (x, y, x**2, y**2, x * y)]

    def beams() -> list[Array]:
        light = scene.projector
        alone = [replace(scene, projector=replace(light, beams=(beam,))) for beam in light.beams[:MOST_BEAMS]]
        return [single_scattering(one) for one in alone]

    causes: dict[str, Callable[[], list[Array]]] = {
        "uneven ink": uneven,
        "a misaligned beam or camera": lambda: list(misaligned()),
        "another phase function": lambda: [single_scattering(scene), double_scattering(scene, 0.01)],
        "beams of another brightness than described, or missing": beams,
    }
    residual = problem.residual(coordinates)[: weight.size]
    return likely_cause(residual, unhidden, causes)


def misalignment_left_out(
    observation: Observation, fitted: NDArray[np.floating], gain: float, misaligned: Callable[[], Array]
) -> bool:
    """Whether the pixels that were left out as specks are what a misaligned beam or camera shows at beams' edges.

    Parameters
    ----------
    observation
        As it was fitted.
    fitted
        Image, in its units.
    gain
        Fitted.
    misaligned
        Gives `misalignments` of the scene as described with the fitted medium.
    """
    specks = observation.specks
    if specks.sum() < FEWEST:
        return False
    seen = observation.used | specks
    changes = gain * misaligned()[:, seen] / observation.noise[seen]
    off = ((observation.image - fitted) / observation.noise)[seen]
    moved = changes.T @ np.linalg.lstsq(changes.T, off, rcond=None)[0]
    left, were = (float(np.sum(one[specks[seen]] ** 2)) for one in (off - moved, off))
    return left < (1.0 - MOSTLY) * were


def misalignments(scene: Scene, medium: Medium) -> Array:
    """(terms, rows, columns) what each usual misalignment changes in order 1, which carries the edges it is told by."""
    return Misalignment(scene, USUAL, max_order=1).slopes(medium, np.zeros(len(USUAL)))
