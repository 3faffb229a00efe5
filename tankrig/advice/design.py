"""Pictures that are designed: how much light each cell gets, so that a fit is expected to learn most.

A picture of cells has the image m = Σ w_j c_j, and its derivatives are the same sum of the cells'. What it tells is the
information of `tankrig.estimation.uncertainty` about the liquid of a dose, beside what a fit has to find too: the
common gain, and an offset of each picture where no dark is taken. With Q = 1/(v + e²) of noise v and the model's
error e,

    F = D Q Dᵀ,    S = D Q v Q Dᵀ + U K Uᵀ,    U = Σ D Q e,    C = (F + P)⁻¹ (S + P) (F + P)⁻¹.

The sum in U is over all pictures of one liquid: light is linear in the picture, so that the model errs alike in all of
them, and neither frames nor other pictures average that away. What is minimised is ½ ln det C of σa, σs and the mean
cosine g (D), or ½ ln of the sum of their squared relative errors (A), or the error of one of them; whatever else has to
be found, the coordinates of a family of phase functions included, is marginalised. Its derivatives by w follow
backwards through these products, at about the price of the value; L-BFGS-B keeps w in 0 … 1.
"""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from tankrig.advice.cells import CellLight
from tankrig.advice.expected import Expected, usual_widths
from tankrig.estimation.coordinates import NAMES
from tankrig.estimation.parameters import WIDEST
from tankrig.estimation.uncertainty import CORRELATION_LENGTHS, PATTERN
from tankrig.pattern.kinds import Cells
from tankrig.scene import Scene

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Wanted = Literal["all", "sum", "sigma_a", "sigma_s", "g"]
"""What is to be known: σa, σs and g together (D), the sum of their squared relative errors (A), or one of them."""

STEPS = 60
"""Most steps of an ascent."""
LIMIT_S = 0.9
"""After which no other start is tried."""
FULL, FULL_WIDTH = 0.95, 0.01
"""Part of what the camera can show from which on a pixel tells nothing, and over which that sets in."""
DARKEST = 1e-9
"""Light that a picture without any is taken to have, as a share of the brightest pixel's."""


@dataclass(frozen=True, eq=False)
class Gathered:
    """What photographs of one liquid say so far about its n − 1 values and the log gain, and the model error's pull.

    Parameters
    ----------
    fisher, scatter
        (n, n) see `Information`; the scatter is noise alone.
    pull
        (n, rows, columns) what a model's error of one standard deviation in a pixel pulls with.
    """

    fisher: Array
    scatter: Array
    pull: Array

    @classmethod
    def nothing(cls, values: int, shape: tuple[int, int]) -> "Gathered":
        """Before the first photograph, of a liquid with so many values."""
        known = values + 1
        return cls(np.zeros((known, known)), np.zeros((known, known)), np.zeros((known, *shape)))


@dataclass(frozen=True, eq=False)
class Prospect:
    """A liquid that is thought possible, and what is known of it without the pictures to be designed.

    Parameters
    ----------
    light
        Of the cells in the liquid.
    gain
        Counts per radiance, which fits do not know.
    noise
        From the mean of a frame to its variance, in a pixel of the pictures that are designed with.
    model_error
        Relative L2 error of the model that will be fitted.
    offset_free
        Whether each picture has an unknown offset.
    gathered
        By photographs of this liquid with this camera.
    saturation
        Counts at which the camera is full; None where nothing gets there.
    """

    light: CellLight
    gain: float
    noise: Callable[[Array], Array]
    model_error: float
    offset_free: bool = False
    gathered: Gathered | None = None
    saturation: float | None = None

    @property
    def before(self) -> Gathered:
        """What is known."""
        return self.gathered or Gathered.nothing(self._values, self.light.used.shape)

    @property
    def _values(self) -> int:
        """How many values of the liquid are fitted."""
        return int(self.light.slopes.shape[1])

    def value(self, light: Array, frames: float, wanted: Wanted) -> float:
        """What is minimised, in nats: of cells lit in parts of their light, (pictures, cells), with frames of each."""
        return self._at(light, frames, wanted, slopes=False)[0]

    def value_and_slope(self, light: Array, frames: float, wanted: Wanted) -> tuple[float, Array]:
        """The same, and its derivatives (pictures, cells)."""
        return self._at(light, frames, wanted, slopes=True)

    def expected(self, light: Array, frames: float) -> Expected:
        """What a fit is expected to state with these pictures."""
        seen = [self._seen(one, frames) for one in light]
        covariance, _ = self._covariance(*self._totals(seen)[:2])
        own = _of_coefficients(covariance, self.light.of_coefficients)
        relative = np.sqrt(np.diag(own)) / self._scale
        return Expected(own, dict(zip(NAMES, relative.tolist(), strict=True)))

    def with_pictures(self, light: Array, frames: float) -> "Prospect":
        """After these pictures, each with an offset of its own where that is free."""
        found = self
        for one in light:
            found = found._after(self._seen(one, frames))
        return found

    def with_photograph(self, radiance: Array, slopes: Array, used: Mask, frames: float) -> "Prospect":
        """After frames of any other picture of the same liquid with this camera.

        Parameters
        ----------
        radiance, slopes
            (rows, columns) what is seen of it, and (3, rows, columns) its derivatives by σa, σs and g.
        used
            (rows, columns) pixels that a fit looks at.
        frames
            Of it.
        """
        return self._after(_Seen.of(self, radiance, slopes, used, frames))

    def _after(self, seen: "_Seen") -> "Prospect":
        before, fisher, scatter = self.before, seen.fisher, seen.scatter
        left = _without_offset(fisher) if self.offset_free else np.eye(len(fisher) - 1, len(fisher))
        gathered = Gathered(
            before.fisher + left @ fisher @ left.T,
            before.scatter + left @ scatter @ left.T,
            before.pull + np.tensordot(left, seen.pull, 1),
        )
        return replace(self, gathered=gathered)

    def at_dose(self, light: CellLight, share: float) -> "Prospect":
        """The same ink at another dose, with what is known by now; the model errs otherwise there.

        Parameters
        ----------
        light
            Of the same cells, in the liquid of the other dose.
        share
            This dose over the other: coefficients go with it.
        """
        fisher, scatter, _ = self._totals([])
        by_other = np.ones(len(fisher))
        by_other[:2] = share
        scale = np.outer(by_other, by_other)
        gathered = Gathered(fisher * scale, scatter * scale, np.zeros_like(self.before.pull))
        return replace(self, light=light, gathered=gathered)

    def _at(self, light: Array, frames: float, wanted: Wanted, slopes: bool) -> tuple[float, Array]:
        seen = [self._seen(one, frames) for one in light]
        fisher, scatter, smoothed = self._totals(seen)
        covariance, inverse = self._covariance(fisher, scatter)
        value, by_covariance = _wanted(covariance, self.light.of_coefficients, self._scale, wanted)
        if not slopes:
            return value, np.zeros(0)
        # dC = M dS M − M dF C − C dF M, with M = (F + P)⁻¹.
        through = inverse @ by_covariance
        by_scatter = through @ inverse
        by_fisher = -(through @ covariance + covariance @ by_covariance @ inverse)
        found = [
            self._slope(one, by_fisher, by_scatter, smoothed, number, len(seen)) for number, one in enumerate(seen)
        ]
        return value, np.array(found)

    def _seen(self, light: Array, frames: float) -> "_Seen":
        return _Seen.of(self, *self.light.picture(np.asarray(light, float)), self.light.used, frames)

    def _place(self, number: int, count: int) -> Array:
        """Where a picture's own n values and log gain, and its offset, stand among these and `count` offsets.

        (n + 1 + count, n + 2).
        """
        shared = self._values + 1
        place = np.eye(shared + count, shared + 1)
        place[:, shared] = 0.0
        if number >= 0 and self.offset_free:
            place[shared + number, shared] = 1.0
        return place

    def _totals(self, seen: "Sequence[_Seen]") -> tuple[Array, Array, Array]:
        """Fisher information and scatter about all values, and the model error's pull, smoothed."""
        count, before = len(seen), self.before
        place = self._place(-1, count)[:, :-1]
        fisher, scatter = place @ before.fisher @ place.T, place @ before.scatter @ place.T
        pull = np.tensordot(place, before.pull, 1)
        for number, one in enumerate(seen):
            place = self._place(number, count)
            fisher = fisher + place @ one.fisher @ place.T
            scatter = scatter + place @ one.scatter @ place.T
            pull = pull + np.tensordot(place, one.pull, 1)
        smoothed = _smoothed(pull, self.light.scene)
        return fisher, scatter + np.einsum("aij,bij->ab", pull, smoothed), smoothed

    def _covariance(self, fisher: Array, scatter: Array) -> tuple[Array, Array]:
        """Covariance of all values, (F + P)⁻¹ (scatter + P) (F + P)⁻¹ with the prior P, and (F + P)⁻¹ itself."""
        brightest = self.gain * float(self.light.images.sum(axis=0).max())
        offsets = len(fisher) - self._values - 1
        coefficients = [WIDEST * self.light.scene.medium.sigma_t] * 2
        phase = usual_widths(self.light.family)
        widest = np.array([*coefficients, *phase, WIDEST, *[WIDEST * brightest] * offsets])
        scale = np.outer(widest, widest)
        inverse = np.linalg.inv(fisher * scale + np.eye(len(widest))) * scale
        return np.asarray(inverse @ (scatter + np.diag(widest**-2.0)) @ inverse), np.asarray(inverse)

    @property
    def _scale(self) -> Array:
        medium = self.light.scene.medium
        return np.array([medium.sigma_a, medium.sigma_s, 1.0])

    def _slope(
        self, one: "_Seen", by_fisher: Array, by_scatter: Array, smoothed: Array, number: int, count: int
    ) -> Array:
        place = self._place(number, count)
        own_fisher, own_scatter = place.T @ by_fisher @ place, place.T @ by_scatter @ place
        by_pull = np.tensordot(2.0 * place.T @ by_scatter, smoothed, 1)[:, self.light.used]
        return one.slope(own_fisher, own_scatter, by_pull, self)


@dataclass(frozen=True, eq=False)
class _Seen:
    """A picture as the camera would see it: n pixels that a fit could look at.

    Parameters
    ----------
    changes
        (k + 2, n) derivatives by the liquid's k values, log gain and offset, counts.
    weight, variance, error
        (n,) as a fit weighs them, of the mean of the frames, and the model's standard deviation.
    by_image
        (2, n) derivatives of the weight and of the variance by the image.
    used
        (rows, columns) n of them True.
    """

    changes: Array
    weight: Array
    variance: Array
    error: Array
    by_image: Array
    used: Mask

    @classmethod
    def of(cls, prospect: Prospect, radiance: Array, slopes: Array, used: Mask, frames: float) -> "_Seen":
        cells, gain = prospect.light, prospect.gain
        image = np.maximum(gain * radiance[used], 0.0) + DARKEST * gain * float(cells.images.max())
        changes = np.vstack([gain * slopes[:, used], image, np.ones(image.size)])
        variance, error = prospect.noise(image) / frames, prospect.model_error * image
        step = 1e-4 * image
        by_image = (prospect.noise(image + step) / frames - variance) / step
        weight = 1.0 / (variance + error**2)
        by_weight = -(weight**2) * (by_image + 2.0 * prospect.model_error * error)
        if prospect.saturation is not None:
            width = FULL_WIDTH * prospect.saturation
            beyond = np.tanh((image - FULL * prospect.saturation) / width)
            by_weight = 0.5 * (by_weight * (1.0 - beyond) - weight * (1.0 - beyond**2) / width)
            weight = 0.5 * weight * (1.0 - beyond)
        return cls(changes, weight, variance, error, np.stack([by_weight, by_image]), used)

    @property
    def fisher(self) -> Array:
        """(k + 2, k + 2) D Q Dᵀ."""
        return np.asarray((self.changes * self.weight) @ self.changes.T)

    @property
    def scatter(self) -> Array:
        """(k + 2, k + 2) by noise."""
        responses = self.changes * self.weight
        return np.asarray((responses * self.variance) @ responses.T)

    @property
    def pull(self) -> Array:
        """(k + 2, rows, columns) D Q e."""
        found = np.zeros((len(self.changes), *self.used.shape))
        found[:, self.used] = self.changes * (self.weight * self.error * PATTERN)
        return found

    def slope(self, by_fisher: Array, by_scatter: Array, by_pull: Array, prospect: Prospect) -> Array:
        """(cells,) derivatives by the cells' light, from those by what the picture tells.

        Parameters
        ----------
        by_fisher, by_scatter
            (k + 2, k + 2) of its fisher information and its scatter by noise.
        by_pull
            (k + 2, n) of the model error's pull.
        """
        responses = self.changes * self.weight
        error = PATTERN * self.error
        by_responses = 2.0 * (by_scatter @ responses) * self.variance + by_pull * error
        by_changes = 2.0 * (by_fisher @ self.changes) * self.weight + by_responses * self.weight
        by_weight = np.einsum("an,ab,bn->n", self.changes, by_fisher, self.changes)
        by_weight += np.sum(by_responses * self.changes, axis=0)
        by_variance = np.einsum("an,ab,bn->n", responses, by_scatter, responses)
        by_error = PATTERN * np.sum(by_pull * responses, axis=0)
        by_image = (
            by_weight * self.by_image[0] + by_variance * self.by_image[1] + by_error * prospect.model_error
            + by_changes[-2]
        )  # fmt: skip
        images, slopes = prospect.light.images[:, self.used], prospect.light.slopes[:, :, self.used]
        return np.asarray(prospect.gain * (images @ by_image + np.einsum("jkn,kn->j", slopes, by_changes[:-2])))


def _without_offset(fisher: Array) -> Array:
    """(n − 1, n) that takes the part of the offset, the last value, out of what a picture tells."""
    return np.hstack([np.eye(len(fisher) - 1), -fisher[:-1, -1:] / max(float(fisher[-1, -1]), 1e-300)])


def _smoothed(pull: Array, scene: Scene) -> Array:
    """(values, rows, columns) through the correlation of the model's error, as `SmoothError` has it."""
    tall, wide = scene.camera.sides_mm
    found = np.zeros_like(pull)
    for share in CORRELATION_LENGTHS:
        length_mm = share * max(scene.tank.size_mm)
        along_y, along_x = (
            np.exp(-0.5 * ((np.arange(count)[:, None] - np.arange(count)) * side / length_mm) ** 2)
            for count, side in zip(pull.shape[1:], (tall, wide), strict=True)
        )
        found += along_y @ pull @ along_x / len(CORRELATION_LENGTHS)
    return found


def _of_coefficients(covariance: Array, of_coefficients: Array) -> Array:
    """(3, 3) of σa, σs and the mean cosine, from that of all values."""
    values = of_coefficients.shape[1]
    return np.asarray(of_coefficients @ covariance[:values, :values] @ of_coefficients.T)


def _wanted(covariance: Array, of_coefficients: Array, scale: Array, wanted: Wanted) -> tuple[float, Array]:
    """What is minimised, in nats, and its derivatives by the covariance of all values."""
    own = _of_coefficients(covariance, of_coefficients)
    if wanted == "all":
        value, by_own = 0.5 * float(np.linalg.slogdet(own / np.outer(scale, scale))[1]), 0.5 * np.linalg.inv(own)
    elif wanted == "sum":
        total = float(np.sum(np.diag(own) / scale**2))
        value, by_own = 0.5 * math.log(total), np.diag(0.5 / (scale**2 * total))
    else:
        k = NAMES.index(wanted)
        value, by_own = 0.5 * math.log(float(own[k, k]) / scale[k] ** 2), np.zeros((3, 3))
        by_own[k, k] = 0.5 / float(own[k, k])
    by, values = np.zeros_like(covariance), of_coefficients.shape[1]
    by[:values, :values] = of_coefficients.T @ by_own @ of_coefficients
    return value, by


@dataclass(frozen=True, eq=False)
class Design:
    """Pictures that were designed.

    Parameters
    ----------
    pictures
        Of cells.
    light
        (pictures, cells) their parts of the light.
    after
        What a fit is expected to state with them, of the first prospect.
    bits
        Information that they add beyond the best of the starts, on average over the prospects.
    seconds
        That it took.
    """

    pictures: tuple[Cells, ...]
    light: Array
    after: Expected
    bits: float
    seconds: float = field(compare=False, default=0.0)


def designed(
    prospects: Sequence[Prospect],
    starts: Sequence[Array],
    frames: float = 4.0,
    wanted: Wanted = "all",
    limit_s: float = LIMIT_S,
    clock: Callable[[], float] = time.perf_counter,
) -> Design:
    """Pictures from which a fit is expected to learn most, on average over what is thought possible of the liquid.

    Parameters
    ----------
    prospects
        Liquids of the present posterior, with the light of the same cells.
    starts
        (pictures, cells) each: pictures to begin from, such as a sheet and stripes. The best of them is followed first.
    frames
        Of each picture.
    wanted
        What is to be known.
    limit_s
        Seconds after which no other start is tried, and no step is made that would not be over.
    clock
        Of these seconds.

    Returns
    -------
    Design
        Never worse than the best start.
    """
    from scipy.optimize import minimize

    from tankrig.advice.cells import with_parts

    began = clock()
    shape = np.shape(starts[0])

    def value(light: Array) -> float:
        return float(np.mean([one.value(light, frames, wanted) for one in prospects]))

    def both(flat: Array) -> tuple[float, Array]:
        if clock() - began > limit_s:
            raise _TimeOverError
        light = flat.reshape(shape)
        found = [one.value_and_slope(light, frames, wanted) for one in prospects]
        here = float(np.mean([one for one, _ in found]))
        if here < best[0]:
            best[:] = here, light.copy()
        return here, np.mean([slope for _, slope in found], axis=0).ravel()

    ranked = sorted(((value(np.asarray(one, float)), number) for number, one in enumerate(starts)))
    given = ranked[0][0]
    best: list[Any] = [given, np.asarray(starts[ranked[0][1]], float)]
    try:
        for _, number in ranked:
            flat = np.asarray(starts[number], float).ravel()
            minimize(both, flat, jac=True, method="L-BFGS-B", bounds=[(0.0, 1.0)] * flat.size,
                     options={"maxiter": STEPS})  # fmt: skip
    except _TimeOverError:
        pass
    light = np.asarray(best[1])
    cells = prospects[0].light.cells
    pictures = tuple(with_parts(cells, one) for one in light)
    bits = (given - best[0]) / math.log(2.0)
    return Design(pictures, light, prospects[0].expected(light, frames), bits, clock() - began)


class _TimeOverError(Exception):
    """Raised in the middle of an ascent that has had its time."""
