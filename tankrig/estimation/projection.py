"""Variable projection: the best gain and offset for a given model image, and what they hide from the medium.

image = gain · radiance + offset is linear in gain and offset, so they are solved for at every step instead of being
searched for (Golub and Pereyra 1973, with Kaufman's Jacobian). The paper's Eq. 15 has neither. A prior on either is one
more observation, of the number itself.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Scaling:
    """Gain and offset, each a number or None where it is free.

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

    def solve(self, model: Array, observed: Array, weight: Array) -> tuple[float, float]:
        """Gain and offset that minimise Σ weight² (observed − gain·model − offset)² and what their priors add.

        All arrays have one shape, (n,).
        """
        gain, offset = self.gain or 0.0, self.offset or 0.0
        columns = self._columns(model, weight)
        if not len(columns):
            return gain, offset
        # What is left to explain once gain and offset have their expected values, which priors want to keep.
        left = np.zeros(columns.shape[1])
        left[: model.size] = weight * (observed - gain * model - offset)
        change = list(np.linalg.lstsq(columns.T, left, rcond=None)[0])
        if self._free_gain:
            gain += float(change.pop(0))
        return gain, offset + float(change[0]) if change else offset

    def beliefs(self, gain: float, offset: float) -> Array:
        """Standard deviations by which gain and offset are short of what they were expected to be, (priors,)."""
        priors = ((self.gain, gain, self.gain_sd), (self.offset, offset, self.offset_sd))
        return np.array([(expected - found) / sd for expected, found, sd in priors if expected is not None and sd])

    def unhidden(self, changes: Array, model: Array, weight: Array) -> Array:
        """Part of weighted changes of the image, shape (k, n), that no change of gain or offset could make.

        Returns
        -------
        (k, n + priors): after the image's pixels what is left of the priors.
        """
        columns = self._columns(model, weight)
        if not len(columns):
            return changes
        basis = np.linalg.qr(columns.T)[0]
        left: Array = -(changes @ basis[: model.size]) @ basis.T
        left[:, : model.size] += changes
        return left

    @property
    def _free_gain(self) -> bool:
        return self.gain is None or self.gain_sd > 0.0

    def _columns(self, model: Array, weight: Array) -> Array:
        """(free ones, n + priors) what one unit of each does to the weighted image, and to the priors."""
        found, priors = [], []
        if self._free_gain:
            found.append(model * weight)
            priors.append(self.gain_sd)
        if self.offset is None or self.offset_sd > 0.0:
            found.append(weight)
            priors.append(self.offset_sd)
        rows = [[float(k == row) / sd for row in range(len(found))] for k, sd in enumerate(priors) if sd > 0.0]
        known = np.array(rows).reshape(len(rows), len(found)).T
        return np.concatenate([np.array(found).reshape(-1, model.size), known], axis=1)
