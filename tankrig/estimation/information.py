"""What photographs tell about coefficients: information that adds up from one photograph to the next.

For rows J (what each coefficient changes in a photograph) and weights W, an error ε of the photographs moves a fit by
δθ = (F + P)⁻¹ J W ε with F = Σ J W Jᵀ over the photographs and a weak prior P. Its covariance,

    (F + P)⁻¹ (Σ J W ⟨ε εᵀ⟩ W Jᵀ + P) (F + P)⁻¹,

needs two small matrices of each photograph and nothing else of it, so that what another photograph would add is known
without fitting anything.
"""

import functools
import operator
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.uncertainty import by_smooth_errors

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Information:
    """What photographs say about k coefficients.

    Parameters
    ----------
    fisher
        (k, k) Σ J W Jᵀ.
    scatter
        (k, k) Σ J W ⟨ε εᵀ⟩ W Jᵀ: what camera noise and the model's own error do to J W ε.

    Examples
    --------
    >>> one = Information(np.array([[4.0]]), np.array([[4.0]]))
    >>> two = total([one, one])
    >>> bool(np.isclose(two.covariance(np.array([1e6]))[0, 0], 1 / 8))
    True
    """

    fisher: Array
    scatter: Array

    def __add__(self, other: "Information") -> "Information":
        return Information(self.fisher + other.fisher, self.scatter + other.scatter)

    def of(self, chain: Array) -> "Information":
        """About m other coefficients; `chain` (m, k) holds the derivatives of these by those."""
        return Information(chain @ self.fisher @ chain.T, chain @ self.scatter @ chain.T)

    def covariance(self, prior_sd: Array) -> Array:
        """Covariance of the coefficients, (k, k).

        Parameters
        ----------
        prior_sd
            (k,) standard deviations that were known before; they keep finite what no photograph determines.
        """
        scale = np.outer(prior_sd, prior_sd)
        inverse = np.linalg.inv(self.fisher * scale + np.eye(prior_sd.size))
        spread: Array = inverse @ (self.scatter * scale + np.eye(prior_sd.size)) @ inverse * scale
        return 0.5 * (spread + spread.T)


def total(parts: Iterable[Information]) -> Information:
    """What photographs say together; at least one."""
    return functools.reduce(operator.add, parts)


@dataclass(frozen=True)
class Rows:
    """A photograph as a fit sees it near a medium, in standard deviations; n pixels are used.

    Parameters
    ----------
    changes
        (k, n) of unit changes of the coefficients, less what an unknown offset imitates.
    residual
        (n,) observed less fitted, likewise.
    weight
        (n,) 1 over the standard deviation assumed.
    used
        (rows, columns), n of them True.
    """

    changes: Array
    residual: Array
    weight: Array
    used: NDArray[np.bool_]

    @classmethod
    def of(cls, changes: Array, residual: Array, weight: Array, used: NDArray[np.bool_], offset_free: bool) -> "Rows":
        """From (k, n) changes and (n,) residual in units of the image."""
        rows = np.vstack([changes, residual[None]]) * weight
        if offset_free:
            along = weight / np.linalg.norm(weight)
            rows -= np.outer(rows @ along, along)
        return cls(rows[:-1], rows[-1], weight, used)

    def information(self, noise: Array, error: Array, length: float) -> Information:
        """What it says.

        Parameters
        ----------
        noise, error
            (rows, columns) standard deviations of the camera's noise and of the model's error, units of the image.
        length
            The tank's, in pixels.
        """
        response = self.changes * self.weight
        by_noise = response * noise[self.used]
        scatter = by_noise @ by_noise.T + by_smooth_errors(response, self.used, error, length)
        return Information(self.changes @ self.changes.T, scatter)
