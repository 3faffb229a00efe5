"""The range of media that a prepared model answers for, and coordinates in which its images are near polynomials."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tankrig.errors import SceneError
from tankrig.scene import Medium
from tankrig.scene.phase_functions import HenyeyGreenstein, Mixture

Array = NDArray[np.float64]
Range = tuple[float, float]

ASYMMETRY_POLE = 1.1
ABSORPTION_POLE = 0.004
STEP = 0.125
"""Of coordinates that run over [−1, 1], from one medium whose errors are computed to the next."""
DEPTHS = 3.0
"""Of the tank's length: extinction below DEPTHS/length changes the image's shape in proportion, above it by ratios."""


@dataclass(frozen=True)
class Box:
    """Ranges of extinction, albedo and asymmetry.

    Parameters
    ----------
    sigma_t
        (low, high) extinction, 1/mm.
    albedo
        (low, high) single-scattering albedo.
    g
        (low, high) asymmetry.

    Raises
    ------
    SceneError
        When a range is empty or reaches where no model can be prepared.

    Examples
    --------
    >>> Box().require(Medium(0.1, 0.9, 0.5))
    Traceback (most recent call last):
        ...
    tankrig.errors.SceneError: σt = σa + σs = 1 is outside 0.0005 … 0.12, for which the model was prepared; ...
    """

    sigma_t: Range = (0.0005, 0.12)
    albedo: Range = (0.5, 0.9999)
    g: Range = (-0.4, 0.95)

    def __post_init__(self) -> None:
        for name, (lowest, highest) in {"sigma_t": (1e-6, 1.0), "albedo": (0.01, 1.0), "g": (-0.99, 0.99)}.items():
            low, high = getattr(self, name)
            if not lowest <= low < high <= highest:
                raise SceneError(
                    f"{name} = [{low}, {high}] cannot be prepared; "
                    f"give [low, high] with {lowest} ≤ low < high ≤ {highest}"
                )

    def holds(self, medium: Medium) -> bool:
        """Whether a medium is inside."""
        ranges = ((medium.sigma_t, self.sigma_t), (medium.albedo, self.albedo), (medium.g, self.g))
        return all(low <= value <= high for value, (low, high) in ranges)

    def nearest(self, medium: Medium) -> Medium:
        """The medium inside whose coefficients are nearest.

        Another phase function than Henyey–Greenstein's is mixed with that until its mean cosine is inside.

        Examples
        --------
        >>> box, clear = Box(), Medium(0.0, 0.01, 0.99)
        >>> box.holds(clear), box.holds(box.nearest(clear)), round(box.nearest(clear).g, 4)
        (False, True, 0.95)
        """
        if self.holds(medium):
            return medium
        ranges = ((medium.sigma_t, self.sigma_t), (medium.albedo, self.albedo), (medium.g, self.g))
        inside = 1e-9  # of a range, so that rounding leaves none outside
        sigma_t, albedo, g = (
            float(np.clip(value, low + inside * (high - low), high - inside * (high - low)))
            for value, (low, high) in ranges
        )
        if medium.phase is None:
            return Medium((1.0 - albedo) * sigma_t, albedo * sigma_t, g)
        beyond = self.g[0] if medium.g > g else self.g[1]
        share = (medium.g - g) / (medium.g - beyond) if medium.g != g else 0.0
        mixed = Mixture((medium.phase, HenyeyGreenstein(beyond)), (1.0 - share, share)) if share else medium.phase
        return Medium((1.0 - albedo) * sigma_t, albedo * sigma_t, phase=mixed)

    def require(self, medium: Medium) -> None:
        """Refuse a medium outside.

        Raises
        ------
        SceneError
            That names the coefficient and its range.
        """
        for name, value, (low, high) in (
            ("σt = σa + σs", medium.sigma_t, self.sigma_t),
            ("albedo σs/σt", medium.albedo, self.albedo),
            ("g", medium.g, self.g),
        ):
            if not low - 1e-9 * abs(low) <= value <= high + 1e-9 * abs(high):
                raise SceneError(
                    f"{name} = {value:.6g} is outside {low:g} … {high:g}, for which the model was prepared; "
                    "use tankrig.predict, or prepare with a box that holds it"
                )


@dataclass(frozen=True)
class Coordinates:
    """Maps of a box and back: each coordinate runs over [−1, 1].

    The image's shape follows exp(−σt x) along the beams, so it is linear in σt where the tank is thin and a function of
    log σt where it is thick: log(σt + 3/Lx) needs far lower degrees than log σt (error at degree 8: 0.09 %, not
    0.6 %). In g, −log(1.1 − g) spreads the forward end; in the albedo, −log(1 − ϖ + 0.004) the near-conservative end.

    Parameters
    ----------
    box
        The ranges.
    length_mm
        Of the tank.
    """

    box: Box
    length_mm: float

    @cached_property
    def _offsets(self) -> tuple[float, float, float]:
        return DEPTHS / self.length_mm, ABSORPTION_POLE, ASYMMETRY_POLE

    @cached_property
    def _ends(self) -> Array:
        corners = zip(self.box.sigma_t, self.box.albedo, self.box.g, strict=True)
        return np.array([self._stretched(*corner) for corner in corners])

    @property
    def spans(self) -> Array:
        """Lengths of the box in the stretched coefficients, in the order σt, ϖ, g."""
        low, high = self._ends
        return np.asarray(high - low)

    def _stretched(self, sigma_t: float, albedo: float, g: float) -> tuple[float, float, float]:
        dense, absorbing, forward = self._offsets
        return np.log(sigma_t + dense), -np.log(1.0 - albedo + absorbing), -np.log(forward - g)

    def of(self, sigma_t: float, albedo: float, g: float) -> tuple[Array, Array]:
        """Coordinates in the order σt, ϖ, g, and the derivative of each by its own coefficient."""
        dense, absorbing, forward = self._offsets
        low, high = self._ends
        scale = 2.0 / (high - low)
        at = scale * (np.array(self._stretched(sigma_t, albedo, g)) - low) - 1.0
        return at, scale / np.array([sigma_t + dense, 1.0 - albedo + absorbing, forward - g])

    def near(self, medium: Medium) -> Medium:
        """One of a grid of media, `STEP` apart in each coordinate, that is next to a medium of the box."""
        at, _ = self.of(medium.sigma_t, medium.albedo, medium.g)
        sigma_t, albedo, g = (float(value) for value in self.back(np.clip(np.round(at / STEP) * STEP, -1.0, 1.0)))
        return Medium((1.0 - albedo) * sigma_t, albedo * sigma_t, g)

    def back(self, at: ArrayLike) -> Array:
        """Coefficients σt, ϖ, g at coordinates, (…, 3) both."""
        low, high = self._ends
        stretched = np.exp(np.array([1.0, -1.0, -1.0]) * (low + 0.5 * (high - low) * (np.asarray(at) + 1.0)))
        dense, absorbing, forward = self._offsets
        values = stretched * np.array([1.0, -1.0, -1.0]) + np.array([-dense, 1.0 + absorbing, forward])
        clipped: Array = np.clip(values, *np.array([self.box.sigma_t, self.box.albedo, self.box.g]).T)
        return clipped
