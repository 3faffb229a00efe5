"""The light that an emission becomes after any number of scatterings, φ = K (Q + S φ), guided by coarser cells.

On cells of twice the side a step costs an eighth, and what it misses of the smooth light between everywhere and
everywhere is a few per cent of the step: so each residual is carried on there, and what remains is taken by generalised
conjugate residuals, whose steps may each be found in another way (Eisenstat, Elman and Schultz 1983). Six to seven fine
steps do what 17 to 27 do without that.
"""

from collections import deque

import numpy as np
from numpy.typing import NDArray

from tankrig.light.moments.cells import averaged_over, interpolated
from tankrig.light.moments.propagation import Propagation, Single

COARSER = 2.0
"""Sides of the coarse cells over those of the fine ones: 1.5 and 2.5 take 1.4 and 1.0 times the time."""
ROUGHLY = 0.3
"""Residual to which a step is carried on: .1 and .03 take 1.1 and 1.3 times the time."""
MOST_STEPS = 60
KEPT = 3
"""Steps that the next one is made independent of: to 2e-4 it takes six, as with all of them, in less memory. To 1e-5,
near what single precision holds, it took 36 to 100 with all of them in three scenes on fine cells, and takes 8."""


def solved(transport: Propagation, coarse: Propagation, scattering: Single, first: Single, residual: float) -> Single:
    """(moments, nx, ny, nz) field φ with φ = K Q + K S φ.

    Parameters
    ----------
    transport
        K.
    coarse
        The same on coarser cells.
    scattering
        (moments, 1, 1, 1) what light is multiplied by where it is scattered, S.
    first
        (moments, nx, ny, nz) light that comes straight, K Q.
    residual
        Of the equation, relative to that.
    """

    def carried_on(left: Single) -> Single:
        here = averaged_over(transport.cells, coarse.cells, left)
        return left + interpolated(coarse.cells, transport.cells, _roughly(coarse, scattering, here) - here)

    left, field = first.copy(), np.zeros_like(first)
    least = residual * _length(first)
    steps: deque[tuple[Single, Single]] = deque(maxlen=KEPT)
    for _ in range(MOST_STEPS):
        if _length(left) <= least:
            break
        step = carried_on(left)
        change = step - transport(scattering * step)
        for other, its_change in steps:
            along = np.vdot(its_change, change)
            step -= along * other
            change -= along * its_change
        size = _length(change)
        step /= size
        change /= size
        along = np.vdot(change, left)
        field += along * step
        left -= along * change
        steps.append((step, change))
    return field


def _roughly(coarse: Propagation, scattering: Single, left: Single) -> Single:
    """What a residual becomes on coarse cells: (1 − K S)⁻¹ of it."""
    from scipy.sparse.linalg import LinearOperator, gmres

    def remaining(flat: Single) -> Single:
        field = flat.reshape(left.shape)
        result: Single = (field - coarse(scattering * field)).ravel()
        return result

    operator = LinearOperator((left.size, left.size), matvec=remaining, dtype=np.float32)
    flat, _ = gmres(operator, left.ravel(), rtol=ROUGHLY, restart=MOST_STEPS, maxiter=1)
    field: Single = flat.reshape(left.shape)
    return field


def _length(values: NDArray[np.float32]) -> float:
    return float(np.linalg.norm(values))
