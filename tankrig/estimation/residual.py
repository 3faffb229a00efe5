"""What a fit leaves: how much of it is structure, where it stands out, and what is not as described by its looks."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation import astray_causes
from tankrig.estimation.found_optics import as_found
from tankrig.estimation.light_beside import sizes_along
from tankrig.estimation.observation import Observation
from tankrig.estimation.problem import Evaluation
from tankrig.estimation.set_up import USUAL, Misalignment
from tankrig.scene import Medium, Scene

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SMOOTHED = 1.5
"""Standard deviation, in pixels, of the Gaussian over which the map is averaged."""
TELLING = 0.3
"""Share of a residual's structure that a cause explains before it is named."""
ALIKE, COUNTED = 6.0, 10.0
"""Twice the logarithm of how many times likelier a cause is than another that is named beside it (20), and than one
that what it may have done is counted of (150): a floor of 4 % was a veil seventy times rather, by a prepared model of
rough paths, with σs six deviations off."""
LOCAL = 6.0
"""Standard deviations of the averaged residual, model's error counted, that are no chance at any place of an image."""
MOST_BEAMS = 16
"""That are looked at one by one."""
PHASE_TERMS = 6
"""What an image tells of a free phase function: five moments and p(90°). Its other shapes stay what was expected."""
PHASE = "another phase function"
"""A cause, as the verdict names it."""
WHOLE = ("tank", "prepared", "montecarlo")
"""Models that describe all light, so that what they leave has another cause."""
FEWEST = 5
"""Pixels left out that can tell of a misalignment; four terms fit as many."""
MOSTLY = 0.5
"""Share of what pixels left out are off by that a misalignment explains before it is named."""


def structure_map(residual: Array, used: Mask, error: Array | None = None) -> Array:
    """Residual averaged over neighbouring pixels, in standard deviations of what noise and model leave of it.

    Parameters
    ----------
    residual
        (rows, columns) in standard deviations of the noise; anything where it isn't used.
    used
        Where it counts.
    error
        Of the model, (rows, columns), in the unit of `residual` and alike over neighbours, so that it does not average
        out; none where not given.

    Returns
    -------
    (rows, columns): beyond ±4 there is structure; NaN where nothing near was used.

    Examples
    --------
    >>> noise = np.random.default_rng(1).normal(0, 1, (60, 80))
    >>> everywhere = np.ones((60, 80), bool)
    >>> float(structure_map(noise, everywhere).std().round())
    1.0
    >>> float(structure_map(noise + 0.7, everywhere).mean().round())
    4.0
    """
    from scipy.ndimage import gaussian_filter

    near = gaussian_filter(used.astype(float), SMOOTHED)
    total = gaussian_filter(np.where(used, residual, 0.0), SMOOTHED)
    # The kernel's square is a Gaussian narrower by √2, with a total of 1/(4π width²).
    variance = gaussian_filter(used.astype(float), SMOOTHED / np.sqrt(2.0)) / (4.0 * np.pi * SMOOTHED**2)
    if error is not None:
        variance += gaussian_filter(np.where(used, error, 0.0), SMOOTHED) ** 2
    found: Array = np.where(near > 0.1, total / np.sqrt(np.maximum(variance, 1e-12)), np.nan)
    return found


def standing_out(residual: Array, used: Mask, error: Array) -> tuple[float, int, int] | None:
    """Where a residual stands out most, as in `structure_map`; None where chance may do that.

    Returns
    -------
    Standard deviations, row, column.

    Examples
    --------
    >>> noise = np.random.default_rng(1).normal(0, 1, (60, 80))
    >>> everywhere, exact = np.ones((60, 80), bool), np.zeros((60, 80))
    >>> standing_out(noise, everywhere, exact)
    >>> noise[20:23, 40:43] += 5.0
    >>> standing_out(noise, everywhere, exact)[1:]
    (21, 41)
    """
    sizes = np.nan_to_num(np.abs(structure_map(residual, used, error)))
    row, column = np.unravel_index(np.argmax(sizes), sizes.shape)
    size = float(sizes[row, column])
    return (size, int(row), int(column)) if size > LOCAL else None


@dataclass(frozen=True)
class Cause:
    """What a residual's structure looks like: a name, the share of the structure that it explains, and the evidence.

    Of a cause with k terms that lowers χ² of n pixels by Δ that is Δ − k ln n, twice the logarithm of what Schwarz
    (1978) weighs models by: five terms of uneven ink imitate a veil's one, and explain a little more.
    """

    name: str
    share: float
    evidence: float


def likely_cause(
    residual: Array,
    project_out: Callable[[Array], Array],
    causes: Mapping[str, Callable[[], list[Array]]],
    sizes: Mapping[str, tuple[float, float]] = MappingProxyType({}),
    told: Sequence[Cause] = (),
) -> list[Cause]:
    """Which causes explain a residual, the likeliest first; after it only those that are nearly as likely.

    Parameters
    ----------
    residual
        (n,) weighted, of the used pixels.
    project_out
        Changes of the image (k, rows, columns) weighted, less what the fit has already had a chance to explain, (k, n).
    causes
        Name and changes of the image.
    sizes
        From and to what causes of one change are believed, in units of it, by name; others may have any.
    told
        Causes that were looked for otherwise.

    Returns
    -------
    Causes; empty where none explains `TELLING` of the structure.
    """
    excess = max(float(residual @ residual) - residual.size, 1e-300)
    found = list(told)
    for name, changes in causes.items():
        left = project_out(np.stack(changes()))
        if name in sizes:
            low, high = sizes[name]
            size = float(residual @ left[0]) / max(float(left[0] @ left[0]), 1e-300)
            if not low < size < high:
                continue
        basis = np.linalg.qr(left.T)[0]
        gained, terms = float(np.sum((residual @ basis) ** 2)), basis.shape[1]
        found.append(Cause(name, min((gained - terms) / excess, 1.0), gained - terms * math.log(residual.size)))
    found = sorted((one for one in found if one.share > TELLING), key=lambda one: -one.evidence)
    return [one for one in found if one.evidence > found[0].evidence - ALIKE]


def phase_of_share(share: float, residual: Array) -> Cause:
    """A phase function that was fitted and explains a share of what is left, as a cause."""
    gained = share * max(float(residual @ residual) - residual.size, 0.0)
    return Cause(PHASE, share, gained - PHASE_TERMS * math.log(residual.size))


def cause_by(name: str, residual: Array, pattern: Array, terms: int) -> Cause:
    """A cause whose pattern, (n,) whitened and less what the fit explains, was chosen among those of so many terms."""
    gained = float(residual @ pattern) ** 2 / max(float(pattern @ pattern), 1e-300)
    excess = max(float(residual @ residual) - residual.size, gained, 1e-300)
    return Cause(name, max((gained - terms) / excess, 0.0), gained - terms * math.log(residual.size))


def cause_of(
    best: Evaluation, scene: Scene, misaligned: Callable[[], Array], phase: Cause | None = None
) -> list[Cause]:
    """What the structure of the residual looks like, the likeliest first, see `likely_cause`.

    Parameters
    ----------
    best
        The optimum.
    scene
        As described.
    misaligned
        Gives `misalignments` of that scene with the fitted medium.
    phase
        What a free phase function explains; None where none was looked at.
    """
    from tankrig.light.double import double_scattering
    from tankrig.light.single import single_scattering

    (view,), (image,), (medium,) = best.problem.views, best.images, best.media
    scene = replace(scene, medium=medium)
    fitted = np.linalg.qr(best.sensitivity.changes.T)[0]

    def project_out(changes: Array) -> Array:
        left = best.project_out(view.whitened(changes))[:, : best.left.size]
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
        "beams of another brightness than described, or missing": beams,
        **astray_causes.causes(scene, image, found=as_found(scene, sizes_along(best.problem.blocks, best.values))),
    }
    told = []
    if phase is None:
        causes[PHASE] = lambda: [single_scattering(scene), double_scattering(scene, 0.01)]
    else:
        told.append(phase)
    gain, _ = best.scale
    sizes = {
        name: (low * gain, high * gain)
        for name, (low, high) in ((name, sign.sizes(scene)) for name, sign in astray_causes.SIGNS.items())
    }
    return likely_cause(best.left, project_out, causes, sizes, told)


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
