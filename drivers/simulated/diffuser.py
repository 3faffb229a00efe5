"""A diffuser before the simulated camera's lens, lit by the simulated projector: even light of any strength."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from tankrig.pattern import Pattern

from .settings import Truth


def behind_diffuser(shown: Mapping[Pattern, float], truth: Truth, turned: bool) -> NDArray[np.float64]:
    """Radiance that reaches the camera, W/mm²/sr.

    Parameters
    ----------
    shown
        Parts of the time in which patterns were shown.
    truth
        Of the projector's levels and of the diffuser.
    turned
        By half a turn, which turns its unevenness round.
    """
    rows, columns = truth.bench.camera.shape
    wall = truth.bench.wall
    light = sum(part * (float(wall.fractions[pattern.pixels].mean()) + truth.leak) for pattern, part in shown.items())
    tilt = truth.diffuser_tilt * np.linspace(-0.5, 0.5, columns) * (-1.0 if turned else 1.0)
    even: NDArray[np.float64] = np.broadcast_to(1.0 - tilt, (rows, columns)) * truth.diffuser * wall.irradiance * light
    return even
