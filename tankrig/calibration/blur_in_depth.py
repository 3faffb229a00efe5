"""How a projector's blur changes with depth: a lens that is no pinhole is sharp at one distance alone.

Light that comes from all over a lens of radius R meets at the focus. Before and behind it, it lies on a disc of radius
f R |u − u_f| projector pixels, f being the focal length in pixels and u one over the distance from the lens that a
place would have without water and wall. Together with the blur b that is there at the focus, too, the variance is
b² + (f R / 2)² (u − u_f)².
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tankrig.calibration.stripe_blur import seen_spreads

Array = NDArray[np.float64]

LEAST_PARTS, LEAST_VIEWS = 8, 4
"""Parts of boards that tell of the blur, and placings that they are of."""
LEAST_DEPTH = 0.4
"""Of the tank's length, over which those parts have to lie."""
MOST_MISFIT = 0.3
"""Scatter of the parts' variances, as a share of what is fitted to them."""
OF_CAMERA, METHOD, METHOD_FOCUS = 0.025, 0.01, 0.008
"""Share by which the camera's blur may be off, which is taken off: what that does to all of it is in the errors; by
which blur and width may be off besides, since a real lens's disc is not quite even; and of the tank's length by which
the focus may be. Discs of five pixels' radius look 1 to 3 % narrower than they are, and so the focus nearer to them: on
seven simulated benches with halos, veil and walls of glass it was .5 to 2.9 mm too near, up to 4.7 sd without this."""
_TELLING, _CHANCE = 3.0, 2.0
"""Standard deviations by which a lens's squared width has to be more than none, and by which a focus beyond the tank
may lie there by chance."""
_LEAST_BLUR_PX = 0.1
_STEPS = np.array([0.3, 100.0, 50.0])
_USUAL_MISFIT = 0.05
_GAUSS_PX, _DISC_PX = np.geomspace(0.3, 3.0, 16), np.linspace(0.0, 7.0, 29)
"""Widths that `seen_spreads` is worked out for."""


@dataclass(frozen=True)
class Way:
    """How far the light goes from the lens, as if it were in air all the way.

    Parameters
    ----------
    before_mm
        From the lens to the water: wall and all.
    index
        Of what is in the tank.
    length_mm
        Of the tank.
    """

    before_mm: float
    index: float
    length_mm: float

    def nearness(self, x_mm: Array | float) -> Array:
        """One over the distance of places in the tank, 1/mm.

        Examples
        --------
        >>> float(Way(300.0, 1.25, 240.0).nearness(125.0))
        0.0025
        """
        return np.asarray(1.0 / (self.before_mm + np.asarray(x_mm) / self.index))


@dataclass(frozen=True, eq=False)
class BlurInDepth:
    """A projector's blur at its focus, how wide its lens is, and where its pictures are sharp.

    Parameters
    ----------
    blur_px
        Standard deviation at the focus, in projector pixels.
    lens_mm
        Diameter of the lens; 0 where it is no wider than a pinhole as far as boards tell.
    focus_mm
        The x at which pictures are sharp, in the tank as it was; NaN of a pinhole.
    sd
        Their standard deviations; of a pinhole's width, how wide it may be.
    parts
        (n, 3) x of each part of a board, the variance of the projector's blur there, and the one that is fitted, px².
    misfit
        Scatter of those, as a share.
    length_mm
        Of the tank.
    """

    blur_px: float
    lens_mm: float
    focus_mm: float
    sd: tuple[float, float, float]
    parts: Array
    misfit: float
    length_mm: float

    @property
    def doubts(self) -> tuple[str, ...]:
        """Why not to believe it, and what to do."""
        found = []
        low, high = (float(one) for one in np.quantile(self.parts[:, 0], (0.02, 0.98)))
        if high - low < LEAST_DEPTH * self.length_mm:
            found.append(
                f"the projector's stripes were seen from x = {low:.0f} to {high:.0f} mm only, which does not tell how "
                f"its blur grows with depth; hold the board near the wall and far from it, too"
            )
        if self.misfit > MOST_MISFIT:
            found.append(
                f"the blur of the projector's stripes scatters by {self.misfit:.0%} about that of a lens; hold the "
                f"board still, in focus of the camera, and in clear water"
            )
        if self.lens_mm > 0.0 and not 0.0 < self.focus_mm < self.length_mm:
            where = "before the wall" if self.focus_mm <= 0.0 else "behind the tank"
            found.append(f"the projector's pictures are sharp {where}; focus the projector to within the tank")
        return tuple(found)


def find_blur_in_depth(views: Sequence[Array], focal_px: float, way: Way) -> BlurInDepth | None:
    """A projector's blur over depth; None from too few parts of boards.

    Parameters
    ----------
    views
        Of each placing (n, 3): x of the parts of the board in mm, the variance that was seen at the stripes' edges
        there, and what the camera's own blur has of it, projector pixels².
    focal_px
        Of the projector.
    way
        Of its light.

    Notes
    -----
    Least squares of the logarithms of what `stripe_blurs` would find, with a loss that a few parts beside the board's
    black do not pull at. Standard deviations are those of placings left out one by one (jackknife), what the camera's
    blur adds that was taken off, and of method 1 % for blur and width, and .8 % of the tank's length for the focus. A
    lens whose squared width is less than three standard deviations above none is a pinhole. A focus beyond the tank by
    less than two of its own is taken to be at its wall.

    Examples
    --------
    >>> way, x = Way(380.0, 1.33, 240.0), np.linspace(5.0, 235.0, 12)
    >>> disc = 900.0 * 7.0 * np.abs(way.nearness(x) - way.nearness(90.0))
    >>> seen = seen_spreads(np.full(12, np.hypot(0.7, 0.3)), disc) ** 2
    >>> found = find_blur_in_depth([np.column_stack([x, seen, np.full(12, 0.09)])] * 4, 900.0, way)
    >>> round(found.blur_px, 2), round(found.lens_mm, 1), round(found.focus_mm)
    (0.7, 14.0, 90)
    """
    good = [one[np.isfinite(one).all(axis=1) & (one[:, 1] > 0.0)] for one in views]
    good = [one for one in good if len(one)]
    if len(good) < LEAST_VIEWS or sum(len(one) for one in good) < LEAST_PARTS:
        return None
    model, every = _Model(focal_px, way), np.concatenate(good)
    blur_px = float(np.sqrt(max(np.quantile(every[:, 1] - every[:, 2], 0.2), _LEAST_BLUR_PX**2)))
    starts = [np.array([min(blur_px, 1.0), 100.0, part * way.length_mm]) for part in (-0.2, 0.1, 0.4, 0.8, 1.2)]
    found = min((model.fitted(every, start) for start in starts), key=lambda one: model.cost(every, one))
    sd = np.hypot(model.spread(good, found), model.by_camera(every, found))
    inside = float(np.clip(found[2], 0.0, way.length_mm))
    if 0.0 < abs(found[2] - inside) < _CHANCE * sd[2]:
        found = model.fitted(every, np.array([found[0], found[1], inside]), free=(0, 1))
    if found[1] > _TELLING * sd[1]:
        return model.told(every, found, sd)
    middle_mm = 0.5 * way.length_mm
    found = model.fitted(every, np.array([blur_px, 0.0, middle_mm]), free=(0,))
    narrow = model.fitted(every, np.array([found[0], 1.0, middle_mm]), free=(0, 1))
    most = max(narrow[1], 0.0) + model.spread(good, narrow, free=(0, 1))[1]
    return model.told(every, found, np.array([model.spread(good, found, free=(0,))[0], most, np.nan]))


class _Model:
    """What would be seen of a blur at the focus, a lens's squared width, and a focus, in that order.

    Parameters
    ----------
    focal_px, way
        See `find_blur_in_depth`.
    """

    def __init__(self, focal_px: float, way: Way) -> None:
        self._focal_px, self._way, self._seen = focal_px, way, _seen()

    def expected(self, parts: Array, values: Array) -> Array:
        """(n,) variances, as edges show them."""
        gauss2 = values[0] ** 2 + np.maximum(parts[:, 2], 0.0)
        radius = self._radius_px(parts, values)
        wider = np.exp(self._seen.ev(0.5 * np.log(gauss2), np.minimum(radius, _DISC_PX[-1])))
        return np.asarray(wider * (gauss2 + 0.25 * radius**2))

    def cost(self, parts: Array, values: Array) -> float:
        """By how much it misses them."""
        return float(np.sum(np.abs(np.log(self.expected(parts, values) / parts[:, 1]))))

    def fitted(self, parts: Array, start: Array, free: tuple[int, ...] = (0, 1, 2)) -> Array:
        """The values that come nearest, where they are free."""
        from scipy.optimize import least_squares

        chosen, length = list(free), self._way.length_mm
        low, high = np.array([_LEAST_BLUR_PX, 0.0, -0.5 * length]), np.array([10.0, 1e4, 1.5 * length])

        def values(numbers: Array) -> Array:
            whole = start.copy()
            whole[chosen] = numbers
            return whole

        def misses(numbers: Array) -> Array:
            return np.asarray(np.log(self.expected(parts, values(numbers)) / parts[:, 1]))

        begin = np.clip(start, low + 1e-6 * (high - low), high - 1e-6 * (high - low))
        found = least_squares(
            misses, begin[chosen], bounds=(low[chosen], high[chosen]), x_scale=_STEPS[chosen], loss="soft_l1",
            f_scale=_USUAL_MISFIT,
        )  # fmt: skip
        return values(found.x)

    def spread(self, views: Sequence[Array], found: Array, free: tuple[int, ...] = (0, 1, 2)) -> Array:
        """(3,) standard deviations, by leaving out one placing after the other."""
        count = len(views)
        without = np.array(
            [self.fitted(np.concatenate([*views[:k], *views[k + 1 :]]), found, free) for k in range(count)]
        )
        return np.asarray(np.sqrt((count - 1) / count * np.sum((without - without.mean(axis=0)) ** 2, axis=0)))

    def by_camera(self, parts: Array, found: Array) -> Array:
        """(3,) by how much it all changes where the camera blurs by `OF_CAMERA` more."""
        blurred = parts * [1.0, 1.0, (1.0 + OF_CAMERA) ** 2]
        return np.abs(self.fitted(blurred, found) - found)

    def told(self, parts: Array, values: Array, sd: Array) -> BlurInDepth:
        """With what was seen, freed of the camera's blur and of what a disc's edges look wider by."""
        expected, wide = self.expected(parts, values), values[1] > 0.0
        own = values[0] ** 2 + 0.25 * self._radius_px(parts, values) ** 2
        lens_mm = float(np.sqrt(values[1]))
        return BlurInDepth(
            blur_px=float(values[0]),
            lens_mm=lens_mm,
            focus_mm=float(values[2]) if wide else float("nan"),
            sd=(
                float(np.hypot(sd[0], METHOD * values[0])),
                float(np.hypot(sd[1] / (2.0 * lens_mm), METHOD * lens_mm) if wide else np.sqrt(sd[1])),
                float(np.hypot(sd[2], METHOD_FOCUS * self._way.length_mm)),
            ),
            parts=np.column_stack([parts[:, 0], own + parts[:, 1] - expected, own]),
            misfit=1.4826 * float(np.median(np.abs(parts[:, 1] / expected - 1.0))),
            length_mm=self._way.length_mm,
        )

    def _radius_px(self, parts: Array, values: Array) -> Array:
        """Of the disc that the lens makes of a point."""
        apart = self._way.nearness(parts[:, 0]) - self._way.nearness(float(values[2]))
        return np.asarray(0.5 * self._focal_px * np.sqrt(max(values[1], 0.0)) * np.abs(apart))


@lru_cache(maxsize=1)
def _seen() -> Any:
    """Logarithm of what edges show over the true variance, over that of the Gaussian's width, and the disc's radius."""
    from scipy.interpolate import RectBivariateSpline

    gauss, disc = (one.ravel() for one in np.meshgrid(_GAUSS_PX, _DISC_PX, indexing="ij"))
    wider = 2.0 * np.log(seen_spreads(gauss, disc)) - np.log(gauss**2 + 0.25 * disc**2)
    return RectBivariateSpline(np.log(_GAUSS_PX), _DISC_PX, wider.reshape(_GAUSS_PX.size, _DISC_PX.size))
