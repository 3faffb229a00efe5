"""The live fit on prepared models: all patterns of one dose in a few milliseconds, from the last estimate.

Gauss–Newton steps in (log σt, logit ϖ, atanh g) and the logarithm of the common gain, which is linear and therefore
right after one step; an offset, where it is free, is projected out of each photograph (the paper's Eq. 15 has neither).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tankrig.errors import ImageError
from tankrig.estimation.information import Rows, total
from tankrig.estimation.observation import Observation, structure
from tankrig.estimation.series_input import observed
from tankrig.estimation.uncertainty import PATTERN
from tankrig.image.prepare import Prepared
from tankrig.live.exposures import Photograph
from tankrig.scene.description import Medium

Array = NDArray[np.float64]

MOST_STEPS = 12
ENOUGH = 0.005
"""The last step is one that promises less than this of half the sum of squares: a tenth of a standard deviation."""
LONGEST_STEP = np.array([0.5, 1.0, 0.3])
"""In log σt, logit ϖ and atanh g."""
WIDEST = 10.0
"""Standard deviation known before: of σa and σs in units of σt, and of log gain; g is known to 1."""


@dataclass(frozen=True)
class LiveEstimate:
    """One liquid, from photographs of several patterns with one unknown gain.

    Parameters
    ----------
    medium
        Fitted.
    covariance
        (3, 3) of (σa, σs, g): camera noise and the models' own errors.
    gain
        Common.
    rmse
        Root mean square of the residuals, all photographs.
    model_error
        Counted, relative L2: what the models state or, where that is more, what the residuals show.
    """

    medium: Medium
    covariance: Array
    gain: float
    rmse: float
    model_error: float


def fit_prepared(photographs: Sequence[Photograph], models: Sequence[Prepared], start: Medium) -> LiveEstimate | None:
    """Fit photographs of one dose by prepared models, one for each.

    Parameters
    ----------
    photographs
        Of one dose.
    models
        Prepared for their scenes, with one box.
    start
        The last estimate; moved into the box where it is outside.

    Returns
    -------
    LiveEstimate, or None where the photographs want a medium at the edge of the box or beyond

    Raises
    ------
    ImageError
        When they cannot be fitted.
    """
    seen = observed([one.image for one in photographs], [one.scene for one in photographs],
                    [one.noise for one in photographs])  # fmt: skip
    edges = _Edges.of(models[0])
    at = edges.inside(edges.coordinates(start))
    for _ in range(MOST_STEPS):
        parts = _parts(photographs, seen, models, edges.medium(at))
        chain = np.eye(4)
        chain[:3, :3] = edges.slopes(at)
        rows = [chain @ part.rows.changes for part in parts]
        curvature = sum((one @ one.T for one in rows), np.zeros((4, 4)))
        downhill = sum((one @ part.rows.residual for one, part in zip(rows, parts, strict=True)), np.zeros(4))
        step = edges.held(at, curvature, downhill)
        promise = float(step @ downhill - 0.5 * step @ curvature @ step)
        at = at + step[:3]
        if promise < ENOUGH:
            break
    if promise >= ENOUGH or edges.reached(at):
        return None
    return _described(parts, edges.medium(at), photographs[0].scene.tank.size_mm)


@dataclass(frozen=True)
class _Part:
    """One photograph and what the model says about it."""

    seen: Observation
    rows: Rows
    gain: float
    residual: Array
    brightness: float
    error: float
    image: Array
    pixel_mm: float


def _parts(
    photographs: Sequence[Photograph], seen: Sequence[Observation], models: Sequence[Prepared], medium: Medium
) -> list[_Part]:
    """All photographs at a medium, with the gain that suits them best."""
    answers = [model.predict(medium, derivatives=True) for model in models]
    errors = [model.error_at(medium) for model in models]
    free = photographs[0].offset == "free"
    pixels = [image[one.used] for (image, _), one in zip(answers, seen, strict=True)]
    observations = [one.image[one.used] for one in seen]
    weights = [1.0 / one.noise[one.used] for one in seen]
    rough = _gain(pixels, observations, weights, free)
    weights = [
        1.0 / np.hypot(one.noise[one.used], error * rough * radiance)
        for one, error, radiance in zip(seen, errors, pixels, strict=True)
    ]
    gain = _gain(pixels, observations, weights, free)
    parts = []
    for photograph, one, (image, slopes), error, radiance, weight in zip(
        photographs, seen, answers, errors, pixels, weights, strict=True
    ):
        fitted = gain * radiance
        left = one.image[one.used] - fitted
        if free:
            left = left - np.average(left, weights=weight**2)
        changes = np.vstack([gain * slopes[:, one.used], fitted[None]])
        rows = Rows.of(changes, left, weight, one.used, free)
        pixel_mm = photograph.scene.camera.pixel_mm
        parts.append(_Part(one, rows, gain, left, _rms(fitted), error, gain * image, pixel_mm))
    return parts


def _gain(pixels: Sequence[Array], observed: Sequence[Array], weights: Sequence[Array], free: bool) -> float:
    """Weighted least squares of all photographs, an offset of each projected out where free."""
    above = below = 0.0
    for model, image, weight in zip(pixels, observed, weights, strict=True):
        centred = weight**2 * (model - (np.average(model, weights=weight**2) if free else 0.0))
        above += float(centred @ image)
        below += float(centred @ model)
    if above <= 0.0:
        raise ImageError(
            "the images are dark where the scenes' light is and bright where it is not; check that images and scenes "
            "belong together and which way up the images are"
        )
    return above / below


def _described(parts: Sequence[_Part], medium: Medium, size_mm: Sequence[float]) -> LiveEstimate:
    """The estimate at an optimum, with errors as those of a series: what the residuals show is counted."""
    found, counted = [], []
    for part in parts:
        residual = np.full(part.seen.image.shape, np.nan)
        residual[part.seen.used] = part.residual
        shared = structure(residual, part.seen.used)
        white = math.sqrt(max(_rms(part.residual) ** 2 - shared**2, 0.0))
        noisier = max(white / _rms(part.seen.noise[part.seen.used]), 1.0)
        counted.append(max(shared / part.brightness, part.error))
        error = PATTERN * counted[-1] * np.abs(part.image)
        found.append(part.rows.information(noisier * part.seen.noise, error, max(size_mm) / part.pixel_mm))
    widest = np.array([WIDEST * medium.sigma_t, WIDEST * medium.sigma_t, 1.0, WIDEST])
    return LiveEstimate(
        medium=medium,
        covariance=total(found).covariance(widest)[:3, :3],
        gain=parts[0].gain,
        rmse=math.sqrt(float(np.mean([_rms(part.residual) ** 2 for part in parts]))),
        model_error=_rms(np.array(counted)),
    )


@dataclass(frozen=True)
class _Edges:
    """The box of prepared models in the coordinates that steps are made in."""

    low: Array
    high: Array

    @classmethod
    def of(cls, model: Prepared) -> "_Edges":
        box = model.box
        low, high = (np.array([math.log(box.sigma_t[k]), _logit(box.albedo[k]), math.atanh(box.g[k])]) for k in (0, 1))
        return cls(low, high)

    def coordinates(self, medium: Medium) -> Array:
        """(log σt, logit ϖ, atanh g)."""
        return np.array([math.log(medium.sigma_t), _logit(min(medium.albedo, 1.0 - 1e-9)), math.atanh(medium.g)])

    def inside(self, at: Array) -> Array:
        """The nearest place inside, a little off the edges."""
        margin = 1e-3 * (self.high - self.low)
        return np.clip(at, self.low + margin, self.high - margin)

    def medium(self, at: Array) -> Medium:
        """At coordinates."""
        sigma_t, albedo = math.exp(at[0]), 1.0 / (1.0 + math.exp(-at[1]))
        return Medium(sigma_t * (1.0 - albedo), sigma_t * albedo, math.tanh(at[2]))

    def slopes(self, at: Array) -> Array:
        """Derivatives of (σa, σs, g), columns, by the coordinates, rows."""
        medium = self.medium(at)
        turned = medium.sigma_s * (1.0 - medium.albedo)
        return np.array([[medium.sigma_a, medium.sigma_s, 0.0], [-turned, turned, 0.0], [0.0, 0.0, 1.0 - medium.g**2]])

    def held(self, at: Array, curvature: Array, downhill: Array) -> Array:
        """Gauss–Newton step in coordinates and log gain that stays inside: what would leave is held at its edge."""
        free = np.ones(4, bool)
        ridge = 1e-9 * np.diag(np.diag(curvature) + 1e-12 * np.trace(curvature))
        step = np.zeros(4)
        for _ in range(3):
            step[:] = 0.0
            step[free] = np.linalg.solve((curvature + ridge)[np.ix_(free, free)], downhill[free])
            aim = at + step[:3]
            out = free[:3] & (((at <= self.low) & (aim < self.low)) | ((at >= self.high) & (aim > self.high)))
            if not out.any():
                break
            free[:3] &= ~out
        step[:3] /= max(1.0, float(np.max(np.abs(step[:3]) / LONGEST_STEP)))
        step[:3] = np.clip(at + step[:3], self.low, self.high) - at
        return step

    def reached(self, at: Array) -> bool:
        """Whether it is at an edge of σt or g; absorption may be as small as can be."""
        near = (at <= self.low + 1e-6) | (at >= self.high - 1e-6)
        return bool(near[0] or near[2] or at[1] <= self.low[1] + 1e-6)


def _logit(share: float) -> float:
    return math.log(share / (1.0 - share))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
