"""Gain and offset of images, which every step of a fit solves for."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tankrig.checked_toml import MOST
from tankrig.errors import ImageError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Scaling:
    """Gain and offset, which are linear and therefore solved for at every step instead of being searched for.

    image = gain · radiance + offset, with one gain for all images and an offset of each (Golub and Pereyra 1973, with
    Kaufman's Jacobian; the paper's Eq. 15 has neither). A prior on either is one more observation, of the number
    itself. All images are given in standard deviations of their errors, as (n,) arrays of their used pixels.

    Parameters
    ----------
    gain, offset
        The number; None where nothing is known.
    gain_sd, offset_sd
        How well it is known, as a standard deviation; 0: exactly.
    """

    gain: float | None
    offset: float | None
    gain_sd: float = 0.0
    offset_sd: float = 0.0

    @classmethod
    def given(cls, gain: object, offset: object) -> "Scaling":
        """From "free", numbers, or pairs of a number and its standard deviation.

        Raises
        ------
        ImageError
            When either is none of these.
        """
        (gain_mean, gain_sd), (offset_mean, offset_sd) = _known("gain", gain), _known("offset", offset)
        return cls(gain_mean, offset_mean, gain_sd, offset_sd)

    def solve(
        self, models: Sequence[Array], ones: Sequence[Array], observed: Sequence[Array]
    ) -> tuple[float, list[float]]:
        """Gain and offsets that minimise Σ (observed − gain·model − offset)² and what their priors add.

        Parameters
        ----------
        models, observed
            Images.
        ones
            What an offset of one adds to each.
        """
        gain, offset = self.gain or 0.0, self.offset or 0.0
        model = np.concatenate(models)
        # What is left to explain once gain and offset have their expected values, which priors want to keep.
        left = np.concatenate(observed) - gain * model - offset * np.concatenate(ones)
        columns = self._columns(models, ones)
        if self.free_gain:
            column = columns.pop()
            change = float(left @ column[: left.size]) / max(float(column @ column), 1e-300)
            gain, left = gain + change, left - change * model
        changes = [float(left @ one[: left.size]) / float(one @ one) for one in columns] or [0.0] * len(models)
        return gain, [offset + change for change in changes]

    def prior_residuals(self, gain: float, offsets: Sequence[float]) -> Array:
        """Standard deviations by which gain and offsets are short of what they were expected to be, (priors,)."""
        known = [(self.gain, gain, self.gain_sd), *((self.offset, one, self.offset_sd) for one in offsets)]
        return np.array([(expected - found) / sd for expected, found, sd in known if expected is not None and sd])

    def project_out(self, changes: Array, models: Sequence[Array], ones: Sequence[Array]) -> Array:
        """Part of changes of all images, one after the other, (k, n), that no gain and no offset could make.

        Returns
        -------
        (k, n + priors): after the images' pixels what is left of the priors.
        """
        columns = self._columns(models, ones)
        if not columns:
            return changes
        basis = np.stack([one / max(float(np.linalg.norm(one)), 1e-300) for one in columns])
        left: Array = -(changes @ basis[:, : changes.shape[1]].T) @ basis
        left[:, : changes.shape[1]] += changes
        return left

    def drawn(self, changes: Array, models: Sequence[Array], ones: Sequence[Array], squared_noise: float) -> Array:
        """Products of changes and of what is left of the images that a model's noise makes by drawing a gain towards 0.

            ⟨c · (y − γ̂ m)⟩ = c·m ν² / (m·m − ν²),   γ̂ = y·m / m·m,  m = m₀ + noise,  ν² = ⟨noise · noise⟩

        Parameters
        ----------
        changes
            (k, n) of all images, with all that a gain could make of them.
        models
            With the gain.
        ones
            What an offset of one adds to each.
        squared_noise
            Sum of squares of the noise of all models.

        Returns
        -------
        (k,) array, of none where the gain is known.

        Examples
        --------
        >>> light, noise = np.full(10_000, 3.0), np.random.default_rng(1).normal(size=10_000)
        >>> model, change, free = light + noise, np.ones((1, 10_000)), Scaling(None, 0.0)
        >>> gain, _ = free.solve([model], [change[0]], [light])
        >>> told = change @ (light - gain * model), free.drawn(change, [gain * model], [change[0]], gain**2 * 10_000.0)
        >>> abs(float(told[0][0] / told[1][0]) - 1.0) < 0.05
        True
        """
        if not self.free_gain:
            return np.zeros(len(changes))
        column = self._columns(models, ones)[-1]
        light = float(column @ column) - squared_noise
        return changes @ column[: changes.shape[1]] * (squared_noise / max(light, squared_noise, 1e-300))

    @property
    def free_gain(self) -> bool:
        """Whether the gain is solved for."""
        return self.gain is None or self.gain_sd > 0.0

    def _columns(self, models: Sequence[Array], ones: Sequence[Array]) -> list[Array]:
        """What one unit of each free offset, and last of a free gain, does to images and priors; made orthogonal."""
        ends = np.cumsum([0, *(one.size for one in ones)])
        own = int(self.gain_sd > 0.0)
        priors = own + (len(ones) if self.offset_sd > 0.0 else 0)
        columns = []
        for k, one in enumerate(ones if self.offset is None or self.offset_sd > 0.0 else ()):
            column = np.zeros(ends[-1] + priors)
            column[ends[k] : ends[k + 1]] = one
            if self.offset_sd > 0.0:
                column[ends[-1] + own + k] = 1.0 / self.offset_sd
            columns.append(column)
        if self.free_gain:
            column = np.concatenate([*models, np.zeros(priors)])
            if own:
                column[ends[-1]] = 1.0 / self.gain_sd
            for other in columns:
                column = column - other * float(column @ other) / float(other @ other)
            columns.append(column)
        return columns


def _known(name: str, value: object) -> tuple[float | None, float]:
    """A number and its standard deviation; None where free."""
    if value == "free":
        return None, 0.0
    pair = value if isinstance(value, tuple) and len(value) == 2 else (value, 0.0)
    numbers = [float(one) if isinstance(one, float | int | np.number) else math.nan for one in pair]
    possible = np.isfinite(numbers).all() and max(map(abs, numbers)) <= MOST and numbers[1] >= 0.0
    if not possible or (name == "gain" and numbers[0] < 1.0 / MOST):
        wanted = "a positive finite number" if name == "gain" else "a finite number"
        raise ImageError(f'{name} = {value!r} cannot be; give "free", {wanted}, or it and its standard deviation')
    return numbers[0], numbers[1]
