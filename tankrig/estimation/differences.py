"""Derivatives of a forward model by differences: by σa, σs and g, or by the coordinates of a family of phase functions.

Where derivatives come along light paths (`tankrig.light.paths.tangents`) or with a prepared model none are needed.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.coordinates import NAMES
from tankrig.estimation.phase_families import Family
from tankrig.light.tangent import Turning
from tankrig.scene import Medium
from tankrig.scene.phase_table import PhaseFunction

Image = NDArray[np.floating]
Forward = Callable[[Medium], Image]
"""Image of a medium; everything else about the scene is fixed."""
Slopes = Callable[[Medium], Image]
"""Derivatives of the image by σa, σs and g, shape (3, rows, columns); with a family of phase functions by σa, σs and
its coordinates."""

EXACT_STEP = 1e-3
"""Relative step of differences of images that have no noise."""
NEARBY = 0.25
"""Share of a step within which derivatives by σa, σs and g are used again: within a whole one, single scattering's
valley bends by more than where it is left."""
MOMENTS, MOMENTS_ALONG = 5, 12
"""How many moments of p tell what orders ≥ 3 do: of their derivatives by a free phase function's coordinates (beads of
.5 µm at σs .01, an emulsion at .03) three leave 3 and 5 % unexplained, five 1.5 and 2 %; p(90°) besides explains
nothing. Of what order 3 does by the finer shapes five tell nothing, and along paths twelve cost little more."""
ALONG = 0.2
"""Share of a family's steps that derivatives along paths have, which no noise asks to be larger."""
NEAR = 5.0
"""Steps within which derivatives by a phase function's coordinates are used again: it bends little."""


def slopes_of(forward: Forward, length_mm: float, central: bool = True, step: float = 0.03) -> Slopes:
    """Derivatives of a forward model by differences: six images, none where the last ones are near enough.

    One-sided differences, of four images, would do to find an optimum, but in one image their error makes directions
    look determined that are not. Over several doses no directions are as nearly alike, and they suffice.

    Parameters
    ----------
    forward
        Must be smooth in the medium: the same random numbers for every medium.
    length_mm
        Longest side of the tank. Absorption acts over paths of that order, so it is the scale on which σa = 0 is
        stepped away from.
    central
        Whether both sides are looked at.
    step
        Relative step; of (1 − g²) for g. Derivatives are used again within `NEARBY` of it.

    Examples
    --------
    >>> square = lambda medium: np.full((1, 1), medium.sigma_s**2)
    >>> bool(np.isclose(slopes_of(square, 240.0)(Medium(0.0, 3.0, 0.0))[1, 0, 0], 6.0))
    True
    """
    last: list[tuple[Medium, Image]] = []

    def slopes(medium: Medium) -> Image:
        sizes = _steps(medium, step, length_mm)
        if last and all(
            abs(getattr(last[0][0], name) - getattr(medium, name)) <= NEARBY * size
            for name, size in zip(NAMES, sizes, strict=True)
        ):
            return last[0][1]
        found = [_slope(forward, medium, name, size, central) for name, size in zip(NAMES, sizes, strict=True)]
        last[:] = [(medium, np.stack(found))]
        return last[0][1]

    return slopes


def _slope(forward: Forward, medium: Medium, name: str, size: float, central: bool) -> Image:
    at = getattr(medium, name)
    above = forward(replace(medium, **{name: at + size}))
    if not central:
        return (above - forward(medium)) / size
    if name == "g" or at >= size:
        return (above - forward(replace(medium, **{name: at - size}))) / (2.0 * size)
    # Next to σ = 0 only one side exists.
    far = forward(replace(medium, **{name: at + 2.0 * size}))
    slope: Image = (4.0 * above - 3.0 * forward(medium) - far) / (2.0 * size)
    return slope


def values_of(medium: Medium, family: Family | None) -> NDArray[np.float64]:
    """What a liquid's image is differentiated by: σa, σs and g, or σa, σs and the coordinates of a family's member."""
    if family is None:
        return np.array(medium.coefficients)
    return np.array([medium.sigma_a, medium.sigma_s, *family.coordinates(medium.phase_function)])


def liquid_slopes_of(
    forward: Forward, length_mm: float, family: Family, central: bool = True, step: float = 0.03,
    low: Forward | None = None,
) -> Slopes:  # fmt: skip
    """The same as `slopes_of` by σa, σs and the coordinates of a family of phase functions.

    Of a family of many coordinates orders ≥ 3 are not computed anew for each: light that has turned three times or more
    has forgotten how, but for the first moments of p, so that `MOMENTS` images tell what it does along any coordinate.

    Parameters
    ----------
    forward, length_mm, central, step
        As for `slopes_of`.
    family
        Of the media's phase functions. Its coordinates are stepped to one side, along which images bend little, and
        derivatives are used again within `NEAR` of those steps.
    low
        Orders 1 and 2 of the same model; None where they are not to be had alone.

    Examples
    --------
    >>> from tankrig.estimation.phase_families import reynolds_mccormick
    >>> from tankrig.scene.phase_functions import ReynoldsMcCormick
    >>> at_right_angle = lambda medium: np.full((1, 1), float(medium.phase_function.at(0.0)))
    >>> slopes = liquid_slopes_of(at_right_angle, 240.0, reynolds_mccormick())
    >>> slopes(Medium(0.0, 3.0, phase=ReynoldsMcCormick(0.7, 0.5))).round(3).ravel().tolist()
    [0.0, 0.0, -0.046, -0.035]
    """
    last: list[tuple[NDArray[np.float64], Image]] = []

    def at(values: NDArray[np.float64]) -> Image:
        return forward(Medium(float(values[0]), float(values[1]), phase=family.phase(values[2:])))

    def slopes(medium: Medium) -> Image:
        values = values_of(medium, family)
        absorption, scattering = _coefficient_steps(medium, step, length_mm)
        sizes = np.array([absorption, scattering, *family.difference])
        near = np.array([absorption, scattering, *(NEAR * family.difference)])
        if last and (np.abs(last[0][0] - values) <= near).all():
            return last[0][1]
        room = family.high - values[2:]
        sizes[2:] = np.where(room < sizes[2:], -sizes[2:], sizes[2:])
        here, found = forward(medium), []
        for k, size in enumerate(sizes[:2]):
            ahead, behind = (values + by * np.eye(values.size)[k] for by in (size, -size))
            two_sided = central and behind[k] >= 0.0
            found.append((at(ahead) - at(behind)) / (2.0 * size) if two_sided else (at(ahead) - here) / size)
        turned = [_turned(medium, family, values[2:] + off) for off in np.diag(sizes[2:])]
        if low is None or len(turned) <= MOMENTS:
            found += [(forward(one) - here) / size for one, size in zip(turned, sizes[2:], strict=True)]
        else:
            below = low(medium)
            high = _by_moments(lambda one: forward(one) - low(one), here - below, medium, family, values[2:])
            found += [(low(one) - below) / size + rest
                      for one, size, rest in zip(turned, sizes[2:], high(turned, sizes[2:]), strict=True)]  # fmt: skip
        last[:] = [(values, np.stack(found))]
        return last[0][1]

    return slopes


def family_slopes_of(along: Callable[[Medium, Sequence[PhaseFunction]], Image], family: Family) -> Slopes:
    """The same as `liquid_slopes_of` of a model that knows its derivatives; see `Models.along`."""

    def slopes(medium: Medium) -> Image:
        coordinates = values_of(medium, family)[2:]
        sizes = np.where(family.high - coordinates < family.difference, -family.difference, family.difference)
        found = along(medium, [family.phase(coordinates + step) for step in np.diag(sizes)])
        found[2:] /= sizes[:, None, None]
        return found

    return slopes


def turning_of(medium: Medium, family: Family) -> tuple[Turning, NDArray[np.float64]]:
    """Where a family's coordinates turn a liquid's phase function, for derivatives along paths, and (k,) their steps.

    Of a family of many coordinates paths have the scores of `MOMENTS_ALONG` ways, as in `liquid_slopes_of`.
    """
    coordinates = values_of(medium, family)[2:]
    sizes = ALONG * np.where(family.high - coordinates < family.difference, -family.difference, family.difference)
    others = [family.phase(coordinates + off) for off in np.diag(sizes)]
    if len(others) <= MOMENTS_ALONG:
        return Turning(others, others, np.eye(len(others))), sizes

    def moments(phase: PhaseFunction) -> NDArray[np.float64]:
        return phase.moments(MOMENTS_ALONG)[1:] - middle

    middle = medium.phase_function.moments(MOMENTS_ALONG)[1:]
    towards = np.array([moments(one) for one in others])
    ways = [family.phase(coordinates + way * sizes) for way in np.linalg.svd(towards, full_matrices=False)[0].T]
    by_ways = towards @ np.linalg.inv(np.array([moments(one) for one in ways]))
    return Turning(others, ways, by_ways), sizes


def _turned(medium: Medium, family: Family, coordinates: NDArray[np.float64]) -> Medium:
    """A liquid with another phase function."""
    return Medium(medium.sigma_a, medium.sigma_s, phase=family.phase(coordinates))


def _by_moments(
    forward: Forward, here: Image, medium: Medium, family: Family, coordinates: NDArray[np.float64]
) -> Callable[[Sequence[Medium], NDArray[np.float64]], Image]:
    """Derivatives of what depends on the first moments of p only, by coordinates that have been stepped along.

    `MOMENTS` images are stepped to along the ways that change moments most.
    """

    def moments(liquid: Medium) -> NDArray[np.float64]:
        return liquid.phase_function.moments(MOMENTS)[1:]

    middle, size = moments(medium), family.difference
    off = [_turned(medium, family, coordinates + step) for step in np.diag(size)]
    by_step = np.array([moments(one) - middle for one in off])  # of coordinates in units of their steps
    ways = np.linalg.svd(by_step, full_matrices=False)[0].T  # (MOMENTS, coordinates)
    ahead = [_turned(medium, family, coordinates + way * size) for way in ways]
    images = np.stack([forward(one) - here for one in ahead])
    per_moment = np.linalg.lstsq(np.array([moments(one) - middle for one in ahead]), images.reshape(MOMENTS, -1))[0]

    def slopes(turned: Sequence[Medium], sizes: NDArray[np.float64]) -> Image:
        rates = np.array([(moments(one) - middle) / by for one, by in zip(turned, sizes, strict=True)])
        return np.asarray((rates @ per_moment).reshape(len(turned), *here.shape))

    return slopes


def _coefficient_steps(medium: Medium, step: float, length_mm: float) -> tuple[float, float]:
    """Step of σa and of σs."""
    return max(step * medium.sigma_a, 0.5 * step / length_mm), step * medium.sigma_s


def _steps(medium: Medium, step: float, length_mm: float) -> tuple[float, float, float]:
    """Step of each coefficient, in the order of `NAMES`."""
    return *_coefficient_steps(medium, step, length_mm), step * (1.0 - medium.g) * (1.0 + medium.g)
