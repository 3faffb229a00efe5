"""What order 1 says of the liquid, by no more than geometry: a fit that needs no model of multiple scattering.

Along the beams and lines of sight order 1 is

    I₁ = A q(μ) G exp(−σt L),    A = gain · σs p(90°),    q = p(θ)/p(90°),    μ = cos θ

where G and the paths' length L are the bench's. With collimated light and an orthographic camera θ is 90° everywhere;
in perspective a picture sees some 80 to 100°. Over these few angles any smooth phase function is as good as Henyey and
Greenstein's with its own slope b = d ln p/dμ at 90°,

    q = (1 − ⅔ b μ)^(−3/2),    b = 3g/(1 + g²),

so that three numbers are fitted: ln A, σt and b. One sheet can hardly tell b from σt, as θ and L both grow along it;
sheets at several heights can. So b begins with what liquids usually have. With a gain that is absolute A is σs p(90°).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tankrig.errors import ImageError
from tankrig.scene.description import Medium, Scene
from tankrig.separation.order_one import OrderOne
from tankrig.separation.waves import Array, Mask

EXTINCTION_PER_MM = (1e-4, 0.5)
"""In which σt is looked for."""
FAINT = 0.03
"""Of the brightest column's order 1: what is fainter tells more of higher orders than of its decay."""
USUAL_SLOPE, USUAL_SLOPE_SD = 1.2, 0.35
"""b of liquids of which nothing is known: from g = .3 (.8) through .5 (1.2) to .95 (1.5)."""
KNOWN_SLOPE_SD = 0.1
"""Of a phase function that was fitted, over the same angles."""
STEEPEST = 1.49
"""Of b: Henyey and Greenstein's has 1.5 at most, at g = 1."""
STEPS, SETTLED = 12, 1e-4
"""Of the fit at most, and the move in ln A, ln σt and b after which it is over."""
CHANGE = 1e-3
"""Of ln σt and of b, by which order 1 is differentiated."""
STARTS = 25
THIN = 0.6
"""Part of the light that is order 1 from which on it is a fit of its own: the rest tells less than models err by."""
TURNED = (0.0, 0.5, 0.85)
"""g that fits begin from where order 1 cannot tell it."""
TELLING_SLOPE_SD = 0.15
"""Of b, below which g follows from it."""
ALBEDO = 0.97
"""With which fits begin: order 1 does not tell σa from σs."""


@dataclass(frozen=True, eq=False)
class OrderOneFit:
    """A liquid as its order 1 shows it.

    Parameters
    ----------
    sigma_t
        1/mm.
    at_right_angle
        A = gain · σs p(90°), in the unit of the pictures and 1/(mm sr).
    slope
        b = d ln p/d cos θ at 90°.
    covariance
        (3, 3) of ln A, ln σt and b.
    cosines
        (lowest, highest) cos θ that the pictures see.
    """

    sigma_t: float
    at_right_angle: float
    slope: float
    covariance: Array
    cosines: tuple[float, float]

    @property
    def sigma_t_sd(self) -> float:
        """Standard deviation of σt, 1/mm."""
        return self.sigma_t * math.sqrt(self.covariance[1, 1])

    @property
    def at_right_angle_sd(self) -> float:
        """Standard deviation of A, in its unit."""
        return self.at_right_angle * math.sqrt(self.covariance[0, 0])

    @property
    def slope_sd(self) -> float:
        """Standard deviation of b."""
        return math.sqrt(self.covariance[2, 2])

    def phase(self, angle_deg: Array) -> tuple[Array, Array]:
        """p(θ)/p(90°) at scattering angles in degrees, and its standard deviation; beyond `cosines` it is a guess.

        Examples
        --------
        >>> fit = OrderOneFit(0.01, 1.0, 1.2, np.diag([0.0, 0.0, 0.01]), (-0.2, 0.2))
        >>> ratio, sd = fit.phase(np.array([80.0, 90.0, 100.0]))
        >>> ratio.round(3).tolist(), sd.round(3).tolist()
        ([1.252, 1.0, 0.823], [0.025, 0.0, 0.013])
        """
        cosine = np.cos(np.radians(angle_deg))
        base = 1.0 - self.slope * cosine / 1.5
        return base**-1.5, np.abs(cosine) * base**-2.5 * self.slope_sd

    def media(self, gain: float | None = None) -> tuple[Medium, ...]:
        """Henyey–Greenstein liquids that a fit can begin from: σt is order 1's, g as far as it tells it.

        Parameters
        ----------
        gain
            Counts per radiance where that is absolute: p(90°), and so g, then follows from A. None: it follows from b
            where perspective tells it; else there are several liquids.
        """
        if gain is not None:
            turned: tuple[float, ...] = (_asymmetry_of_side(self.at_right_angle / (gain * ALBEDO * self.sigma_t)),)
        elif self.slope_sd < TELLING_SLOPE_SD:
            turned = (asymmetry_of(self.slope),)
        else:
            turned = TURNED
        return tuple(Medium((1.0 - ALBEDO) * self.sigma_t, ALBEDO * self.sigma_t, g) for g in turned)


def slope_of(medium: Medium) -> float:
    """b = d ln p/d cos θ at 90° of a liquid's phase function.

    Examples
    --------
    >>> round(slope_of(Medium(0.0, 0.01, 0.5)), 3)
    1.2
    """
    apart = 0.02
    ahead, back = (float(medium.phase_function.at(cosine)) for cosine in (apart, -apart))
    return math.log(ahead / back) / (2.0 * apart)


def asymmetry_of(slope: float) -> float:
    """g of the Henyey–Greenstein phase function with that slope at 90°: the root of b = 3g/(1 + g²) below 1.

    Examples
    --------
    >>> [round(asymmetry_of(slope), 3) for slope in (-1.2, 0.0, 1.2)]
    [-0.5, 0.0, 0.5]
    """
    slope = float(np.clip(slope, -STEEPEST, STEEPEST))
    return 0.0 if slope == 0.0 else (3.0 - math.sqrt(9.0 - 4.0 * slope**2)) / (2.0 * slope)


def _asymmetry_of_side(density: float) -> float:
    """g ≥ 0 of the Henyey–Greenstein phase function with that p(90°), 1/sr; 0 where none has as much."""
    g = np.linspace(0.0, 0.98, 500)
    falling = (1.0 - g**2) / (4.0 * np.pi * (1.0 + g**2) ** 1.5)
    return float(np.interp(-density, -falling, g))


def fit_order_one(
    sheets: Sequence[tuple[OrderOne, Scene]], slope: tuple[float, float] = (USUAL_SLOPE, USUAL_SLOPE_SD)
) -> OrderOneFit:
    """σt, gain · σs p(90°) and the slope of p at 90° from order 1 of sheets of one liquid.

    Parameters
    ----------
    sheets
        Order 1 in the unit of the pictures, and the scene of its sheet, of which the medium does not matter.
    slope
        What is believed of b, and its standard deviation; `slope_of` a fitted liquid with `KNOWN_SLOPE_SD`.

    Returns
    -------
    OrderOneFit
        Its errors are noise, what carrying on to a period of 0 leaves unsure (as one change alike in all of a picture,
        and as one along the beams), and what is believed of b.

    Raises
    ------
    ImageError
        When order 1 is not known anywhere, or is nowhere brighter than dark.
    """
    views = [_View.of(measured, scene) for measured, scene in sheets]
    believed, sd = slope
    expected, prior = np.array([0.0, 0.0, believed]), np.diag([0.0, 0.0, 1.0 / max(sd, 1e-6) ** 2])
    at = expected.copy()
    at[1] = _first_log_extinction(views, believed)
    at[0] = _log_amplitude(views, at)
    low, high = np.array([(-np.inf, np.inf), np.log(EXTINCTION_PER_MM), (-STEEPEST, STEEPEST)]).T
    for number in range(STEPS + 1):
        parts = [view.at(at) for view in views]
        inverse = np.linalg.inv(prior + sum(one.changes @ one.changes.T for one in parts))
        pull = sum(one.changes @ (view.seen - one.image) for view, one in zip(views, parts, strict=True))
        step = inverse @ (prior @ (expected - at) + pull)
        moved = np.clip(at + step * min(1.0, 1.0 / float(np.abs(step).max() + 1e-300)), low, high)
        if number == STEPS or float(np.abs(moved - at).max()) < SETTLED:
            break
        at = moved
    # What carrying on to a period of 0 leaves unsure is counted and not fitted: its shapes are only about so. It is
    # alike in all sheets, for it is one power of the period.
    unsure = inverse @ sum(one.changes @ view.unsure.T for view, one in zip(views, parts, strict=True))
    covariance = inverse + unsure @ unsure.T
    cosines = [view.cosines(at) for view in views]
    return OrderOneFit(
        float(np.exp(at[1])), float(np.exp(at[0])), float(at[2]), covariance,
        (min(low for low, _ in cosines), max(high for _, high in cosines)),
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Image:
    """Order 1 of some values, and its (3, n) changes by them, in standard deviations."""

    image: Array
    changes: Array


@dataclass(frozen=True, eq=False)
class _View:
    """A sheet's order 1 where it tells of its decay, (n,) pixels in standard deviations, and by what it may be off.

    As many pixels as are as good as one count as one. `unsure`, (2, n): off alike everywhere, and along the beams.
    """

    scene: Scene
    known: Mask
    sd: Array
    seen: Array
    unsure: Array

    @classmethod
    def of(cls, measured: OrderOne, scene: Scene) -> "_View":
        known = measured.known
        if not known.any():
            raise ImageError("order 1 is not known anywhere, so its decay is not either; see its doubts")
        along = np.where(known, measured.image, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
        if not along.max() > 0.0:
            raise ImageError("order 1 is no brighter than the dark, so that it tells nothing; expose for longer")
        known = known & (along > FAINT * float(along.max()))
        sd = math.sqrt(measured.alike) * measured.sd[known]
        across = np.broadcast_to(np.linspace(-1.0, 1.0, measured.image.shape[1]), measured.image.shape)[known]
        model = measured.model[known] / sd
        return cls(scene, known, sd, measured.image[known] / sd, np.stack([model, model * across]))

    def at(self, values: Array) -> _Image:
        """See `_Image`; one image of single scattering for it, and one for each of two changes."""
        log_amplitude, log_sigma_t, slope = values
        here = self.ideal(log_sigma_t, slope)
        turned = -CHANGE if slope > 0.0 else CHANGE
        longer = (self.ideal(log_sigma_t + CHANGE, slope) - here) / CHANGE
        steeper = (self.ideal(log_sigma_t, slope + turned) - here) / turned
        amplitude = float(np.exp(log_amplitude))
        return _Image(amplitude * here, amplitude * np.stack([here, longer, steeper]))

    def cosines(self, values: Array) -> tuple[float, float]:
        """(lowest, highest) cos θ that is seen: p is in proportion to 1 + 3gμ where g is small."""
        sigma_t = float(np.exp(values[1]))
        less, more = (self._lit(sigma_t, g) for g in (-CHANGE, CHANGE))
        lit = less > 0.0
        cosine = (more[lit] - less[lit]) / (more[lit] + less[lit]) / (3.0 * CHANGE)
        return float(cosine.min()), float(cosine.max())

    def ideal(self, log_sigma_t: float, slope: float) -> Array:
        """Order 1 where A = 1."""
        g, sigma_t = asymmetry_of(slope), float(np.exp(log_sigma_t))
        side = (1.0 - g**2) / (4.0 * np.pi * (1.0 + g**2) ** 1.5)
        return np.asarray(self._lit(sigma_t, g) / (sigma_t * side) / self.sd)

    def _lit(self, sigma_t: float, g: float) -> Array:
        from tankrig.light.single import single_scattering

        return np.asarray(single_scattering(replace(self.scene, medium=Medium(0.0, sigma_t, g)))[self.known])


def _log_amplitude(views: Sequence[_View], values: Array) -> float:
    """ln A that explains most, by the other values: order 1 is linear in A."""
    images = [view.ideal(values[1], values[2]) for view in views]
    seen = sum(float(one @ view.seen) for view, one in zip(views, images, strict=True))
    return math.log(max(seen / sum(float(one @ one) for one in images), 1e-300))


def _first_log_extinction(views: Sequence[_View], slope: float) -> float:
    """The best of a few, by how much of what is seen each explains."""

    def explained(log_sigma_t: float) -> float:
        images = [view.ideal(log_sigma_t, slope) for view in views]
        size = math.sqrt(sum(float(one @ one) for one in images))
        return sum(float(one @ view.seen) for view, one in zip(views, images, strict=True)) / max(size, 1e-300)

    low, high = (math.log(one) for one in EXTINCTION_PER_MM)
    return float(max(np.linspace(low, high, STARTS), key=explained))
