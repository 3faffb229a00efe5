"""A diffuser before the simulated camera's lens, lit by the simulated projector: even light of any strength."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from tankrig.pattern import Pattern

from .bench_optics import vignetting
from .bench_truth import TrueBench
from .settings import Truth


def behind_diffuser(
    shown: Mapping[Pattern, float], truth: Truth, turned: bool, bench: TrueBench | None = None
) -> NDArray[np.float64]:
    """Radiance that reaches the camera, W/mm²/sr.

    Parameters
    ----------
    shown
        Parts of the time in which patterns were shown.
    truth
        Of the projector's levels and of the diffuser.
    turned
        By half a turn, which turns its unevenness round.
    bench
        Whose projector and whose camera's lens are in use, where boards can be held.
    """
    wall = truth.bench.wall
    if bench is None:
        (rows, columns), fractions, fade = truth.bench.camera.shape, wall.fractions, np.ones(())
    else:
        (rows, columns), fractions = bench.camera.shape, (np.arange(256) / 255.0) ** bench.gamma
        y, x = np.mgrid[:rows, :columns].astype(float)
        fade = vignetting(bench.camera, x, y)
    light = sum(part * (float(fractions[pattern.pixels].mean()) + truth.leak) for pattern, part in shown.items())
    tilt = truth.diffuser_tilt * np.linspace(-0.5, 0.5, columns) * (-1.0 if turned else 1.0)
    even = np.broadcast_to(1.0 - tilt, (rows, columns)) * truth.diffuser * wall.irradiance * light
    return np.asarray(even * fade)
