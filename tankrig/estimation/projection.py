"""Variable projection: the best gain and offset for a given model image, and what they hide from the medium.

image = gain · radiance + offset is linear in gain and offset, so they are solved for at every step instead of being
searched for (Golub and Pereyra 1973, with Kaufman's Jacobian). The paper's Eq. 15 has neither.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Scaling:
    """Gain and offset, each a number or None where it is free."""

    gain: float | None
    offset: float | None

    def solve(self, model: Array, observed: Array, weight: Array) -> tuple[float, float]:
        """Gain and offset that minimise Σ weight² (observed − gain·model − offset)²; all arrays of one shape (n,)."""
        columns = self._free(model)
        if not columns:
            return float(self.gain or 0.0), float(self.offset or 0.0)
        target = observed - (self.gain or 0.0) * model - (self.offset or 0.0)
        best = np.linalg.lstsq(np.stack(columns, axis=1) * weight[:, None], weight * target, rcond=None)[0]
        gain = float(best[0]) if self.gain is None else self.gain
        offset = float(best[-1]) if self.offset is None else self.offset
        return gain, offset

    def unhidden(self, changes: Array, model: Array, weight: Array) -> Array:
        """Part of weighted changes of the image, shape (k, n), that no change of gain or offset could make."""
        columns = self._free(model)
        if not columns:
            return changes
        basis = np.linalg.qr(np.stack(columns, axis=1) * weight[:, None])[0]
        left: Array = changes - (changes @ basis) @ basis.T
        return left

    def _free(self, model: Array) -> list[Array]:
        free = [model] if self.gain is None else []
        return free if self.offset is not None else [*free, np.ones_like(model)]
