"""What a camera's lens spreads beside what is bright: halo and veil, by a white card on a light trap.

    seen = (1 − h − v) P + h G(σ) P + v ⟨P⟩

P is the card as a sharp lens would show it, G a Gaussian, ⟨P⟩ the mean over the picture; see `tankrig.light.leaving`.
Pictures of the trap without the card are subtracted, so that what the trap itself sends back does not count: the black
of a printed board sends back more than a halo is. The light between a card and what surrounds it falls by a hundred
times, so that pictures have to be linear, and the flat of the camera has to be known (`tankrig calibrate radiometry`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tankrig.calibration.file import Calibration
from tankrig.errors import CalibrationError
from tankrig.scene.optics import MOST_HALO, MOST_VEIL

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

LEAST_CARDS = 3
ACROSS = 120
"""Blocks that a picture is wide in: halo and veil have no finer detail."""
LIT, MARGIN = 0.05, 2
"""Share of the card's light from which on a block shows the card, and blocks about those that are left out, too."""
LEAST_PART, MOST_PART = 0.02, 0.4
"""Shares of the picture that a card has to take, and may take."""
MOST_MISFIT = 0.15
"""Share of the light beside the card that may be unlike halo and veil."""
MOST_DRIFT = 0.002
"""Share of the card's light by which the trap's may change meanwhile."""
METHOD = 0.006
"""Share by which all may be off besides: by blocks, and by the flat."""
_FEWEST_SDS = 2.0
_STEPS = 3


@dataclass(frozen=True, eq=False)
class StrayFound:
    """A camera's halo and veil.

    Parameters
    ----------
    share, sigma_px, veil
        Share of the light in the halo, its standard deviation in the camera's pixels, and share in the veil.
    sd
        Their standard deviations, in this order.
    shape
        (rows, columns) of the camera.
    misfit
        Root mean square of what is neither halo nor veil, over that of the light beside the card.
    scatter
        The same with noise, over the card's light.
    drift
        Change of the trap's light meanwhile, as a share of the card's.
    beside
        (n, 3) distance from the card in pixels, light seen there and light fitted, as shares of the card's.
    """

    share: float
    sigma_px: float
    veil: float
    sd: tuple[float, float, float]
    shape: tuple[int, int]
    misfit: float
    scatter: float
    drift: float
    beside: Array

    @property
    def doubts(self) -> tuple[str, ...]:
        """Why not to believe it, and what to do."""
        found = []
        if self.misfit > MOST_MISFIT and self.share > _FEWEST_SDS * self.sd[0]:
            found.append(
                f"{self.misfit:.0%} of the light beside the card is unlike an even veil and one round halo; keep "
                f"bright things and their mirror images away from the trap, clean the lens, and try again"
            )
        if self.drift > MOST_DRIFT:
            found.append(
                f"the trap's light changed by {self.drift:.2%} of the card's meanwhile; keep the lamp steady, and "
                f"stand still"
            )
        return tuple(found)

    def calibration(self, device: str, rests_on: dict[str, str]) -> Calibration:
        """To be kept in a file; `rests_on` holds the hash of the radiometry's."""
        names = ("halo_share", "halo_sigma_px", "veil")
        result: dict[str, Any] = dict(zip(names, (self.share, self.sigma_px, self.veil), strict=True))
        how_well = {
            "scatter_percent": 100.0 * self.scatter,
            "misfit_percent": 100.0 * self.misfit,
            "drift_percent": 100.0 * self.drift,
        }
        return Calibration(
            "stray", device, self.shape, result, dict(zip(names, self.sd, strict=True)), how_well, self.doubts,
            rests_on=rests_on, arrays={"beside": self.beside},
        )  # fmt: skip


def find_stray(cards: Sequence[Array], traps: Sequence[Array]) -> StrayFound:
    """Halo and veil from a card that lay at several places of a light trap.

    Parameters
    ----------
    cards
        (rows, columns) each, in proportion to radiance: the card at one place after the other.
    traps
        The trap without it, before and after.

    Raises
    ------
    CalibrationError
        When a picture shows no card, one that is cut off, too small or too large, or the light beside it is darker
        with the card than without.

    Notes
    -----
    Least squares over blocks of pixels that do not show the card, all placings at once. What the card's own pixels
    show is taken for P after the halo and veil that they hold are taken off. Standard deviations: of the scatter
    between blocks, or of placings left out one by one (jackknife), whichever is larger, and .6 % of method.
    """
    if len(cards) < LEAST_CARDS or not traps:
        raise CalibrationError(
            f"{len(cards)} pictures of the card and {len(traps)} of the trap are too few; take at least {LEAST_CARDS} "
            "with the card at different places, and one without"
        )
    shape = cards[0].shape
    size = max(1, round(shape[1] / ACROSS))
    dark = np.mean([_blocks(one, size) for one in traps], axis=0)
    placings = [_Placing.of(_blocks(card, size) - dark, shape, size) for card in cards]
    start = np.array([0.01, np.log(0.1 * shape[1] / size), 0.01])
    found, spread = _fitted(placings, start)
    without = [_fitted([*placings[:k], *placings[k + 1 :]], found)[0] for k in range(len(placings))]
    count = len(placings)
    left_out = (count - 1) / count * np.sum((np.array(without) - np.mean(without, axis=0)) ** 2, axis=0)
    share, sigma, veil = float(found[0]), float(np.exp(found[1])), float(found[2])
    drift = float(np.ptp([_blocks(one, size).mean() for one in traps])) / placings[0].bright
    sd = np.sqrt(np.maximum(spread, left_out))
    sd_share = float(np.hypot(sd[0], METHOD * share))
    sd_veil = float(np.sqrt(sd[2] ** 2 + (METHOD * veil) ** 2 + (0.5 * drift / placings[0].mean) ** 2))
    if share < -_FEWEST_SDS * max(sd_share, 1e-4) or veil < -_FEWEST_SDS * max(sd_veil, 1e-3):
        raise CalibrationError(
            "beside the card it is darker than without it; keep the lamp steady and let the card shade nothing"
        )
    if share > MOST_HALO or veil > MOST_VEIL:
        raise CalibrationError(
            f"{share:.0%} of the light is in the halo and {veil:.0%} in the veil, more than any lens spreads; keep "
            "light off the lens, and the card from lighting what is about it"
        )
    seen = [one.model(found) for one in placings]
    left = np.concatenate([(one.light - model)[one.beside] for one, model in zip(placings, seen, strict=True)])
    light = np.concatenate([one.light[one.beside] for one in placings])
    noise = float(np.median([one.noise for one in placings]))
    rest = max(float(np.mean(left**2)) - noise**2, 0.0)
    return StrayFound(
        share=max(share, 0.0),
        sigma_px=sigma * size,
        veil=max(veil, 0.0),
        sd=(sd_share, float(sigma * size * np.hypot(sd[1], METHOD)), sd_veil),
        shape=(shape[0], shape[1]),
        misfit=float(np.sqrt(rest / np.mean(light**2))),
        scatter=float(np.sqrt(np.mean(left**2))),
        drift=drift,
        beside=_profile(placings, seen, size),
    )


@dataclass(frozen=True, eq=False)
class _Placing:
    """A card's light in blocks, as shares of the card's brightness.

    Parameters
    ----------
    light
        (rows, columns) of the blocks.
    card, beside
        Blocks that hold the card and their neighbours; and the rest.
    mean
        Mean of the card over the whole picture, and its brightness before all was divided by it.
    noise
        Of a block.
    """

    light: Array
    card: Mask
    beside: Mask
    mean: float
    bright: float
    noise: float

    @classmethod
    def of(cls, light: Array, shape: tuple[int, ...], size: int) -> "_Placing":
        from scipy.ndimage import binary_dilation

        bright = float(np.quantile(light, 0.995))
        shows = light > LIT * bright
        part = float(shows.mean())
        if bright <= 0.0 or not LEAST_PART < part < MOST_PART:
            raise CalibrationError(
                f"the card takes {part:.0%} of the picture; lay a white card on the trap that takes a tenth of it, lit "
                "evenly, and nothing else that is bright"
            )
        bright = float(np.median(light[light > 0.5 * bright]))
        if shows[0].any() or shows[-1].any() or shows[:, 0].any() or shows[:, -1].any():
            raise CalibrationError("the card reaches the picture's edge; lay it so that all of it is seen")
        card = binary_dilation(shows, np.ones((3, 3), bool), MARGIN)
        relative = light / bright
        # Neighbouring blocks differ by noise, and by little else.
        steps = np.diff(relative, axis=1)[(~card)[:, 1:] & (~card)[:, :-1]]
        noise = 1.4826 * float(np.median(np.abs(steps))) / np.sqrt(2.0)
        whole = size**2 / (shape[0] * shape[1])
        return cls(relative, card, ~card, float(relative[card].sum() * whole), bright, noise)

    def model(self, values: Array) -> Array:
        """Light that halo and veil make of the card, everywhere."""
        from scipy.ndimage import gaussian_filter

        share, veil = float(values[0]), float(values[2])
        width = float(np.sqrt(np.exp(2.0 * values[1]) + 1.0 / 6.0))  # from square blocks to square blocks
        seen = np.where(self.card, self.light, 0.0)
        whole = self.mean / max(float(seen.sum()), 1e-300)
        sharp, astray = seen, np.zeros_like(seen)
        for _ in range(_STEPS):
            astray = share * gaussian_filter(sharp, width, mode="constant", truncate=5.0)
            astray = astray + veil * whole * float(sharp.sum())
            sharp = np.where(self.card, seen - astray, 0.0) / (1.0 - share - veil)
        return np.asarray(astray)


def _fitted(placings: Sequence[_Placing], start: Array) -> tuple[Array, Array]:
    """Share, logarithm of the width in blocks, and veil; and their variances by what scatters."""
    from scipy.optimize import least_squares

    columns = placings[0].light.shape[1]

    def misses(values: Array) -> Array:
        return np.concatenate([(one.model(values) - one.light)[one.beside] for one in placings])

    box = ([-0.1, np.log(1.5), -0.3], [0.4, np.log(0.6 * columns), 0.7])
    found = least_squares(misses, np.clip(start, box[0], box[1]), bounds=box, x_scale=[0.01, 0.3, 0.01])
    slopes = np.asarray(found.jac, dtype=float)
    curvature = slopes.T @ slopes
    scale = np.sqrt(np.maximum(np.diag(curvature), 1e-30))
    inverse = np.linalg.inv(curvature / np.outer(scale, scale) + 1e-12 * np.eye(3)) / np.outer(scale, scale)
    return np.asarray(found.x), np.asarray(np.diag(inverse) * 2.0 * found.cost / (found.fun.size - 3))


def _profile(placings: Sequence[_Placing], seen: Sequence[Array], size: int) -> Array:
    """(n, 3) of `StrayFound.beside`."""
    from scipy.ndimage import distance_transform_edt

    rows = []
    for one, model in zip(placings, seen, strict=True):
        away = np.asarray(distance_transform_edt(~(one.light > 0.5)))[one.beside]
        rows.append(np.stack([away, one.light[one.beside], model[one.beside]], axis=1))
    table = np.concatenate(rows)
    whole = np.rint(table[:, 0]).astype(int)
    found = [table[whole == number].mean(axis=0) for number in np.unique(whole)]
    return np.asarray(np.array(found) * np.array([size, 1.0, 1.0]))


def _blocks(light: Array, size: int) -> Array:
    """Means over square blocks; what is left over at the last rows and columns is dropped."""
    rows, columns = (n // size for n in light.shape)
    whole = light[: rows * size, : columns * size]
    return np.asarray(whole.reshape(rows, size, columns, size).mean(axis=(1, 3)), float)
