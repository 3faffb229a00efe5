"""A light trap before the camera of a simulated bench, and a white card that a person lays on it."""

import numpy as np

from .bench_optics import camera_rays, through_camera_lens, vignetting
from .bench_truth import TANK_MM, Array, TrueBench

_TRAP, _CARD = 0.008, 0.85
"""Albedo of black velvet in folds, and of the card."""
_CARD_MM = 80.0
_PLACES_MM = ((-45.0, -22.0), (48.0, 20.0), (0.0, 0.0), (40.0, -24.0), (-50.0, 18.0))
"""Where it is laid, one after the other, from the middle of the picture; x and y at the height of the water."""
_SAMPLES = 4
"""Along each side of a pixel."""
_NODE_PX = 24


class TrapInView:
    """The trap in the room's light, with or without the card.

    Parameters
    ----------
    bench
        Whose camera looks.
    card
        Which of its placings; None without it.
    """

    def __init__(self, bench: TrueBench, card: int | None) -> None:
        rows, columns = bench.camera.shape
        picture = np.full((rows, columns), _TRAP)
        if card is not None:
            picture += (_CARD - _TRAP) * _covered(bench, card)
        fade = vignetting(bench.camera, *np.meshgrid(np.arange(columns, dtype=float), np.arange(rows, dtype=float)))
        self._picture = bench.room * through_camera_lens(bench, picture, bench.camera.blur_px) * fade

    def radiance(self) -> Array:
        """(rows, columns) W/mm²/sr towards the camera."""
        return self._picture


def _covered(bench: TrueBench, card: int) -> Array:
    """(rows, columns) part of each pixel that sees the card."""
    from scipy.interpolate import RectBivariateSpline

    rows, columns = bench.camera.shape
    random = np.random.default_rng((card, 31))
    middle = np.array([TANK_MM[0] / 2, 0.0]) + _PLACES_MM[card % len(_PLACES_MM)] + random.uniform(-4.0, 4.0, 2)
    turn = np.deg2rad(random.uniform(4.0, 12.0))
    y, x = (np.linspace(-0.5, n - 0.5, max(6, n // _NODE_PX)) for n in (rows, columns))
    start, way = camera_rays(bench, np.stack(np.meshgrid(x, y), axis=-1), filled=False)
    at = start + ((bench.level_mm - start[..., 2]) / way[..., 2])[..., None] * way
    aside = at[..., :2] - middle
    along, across = (aside @ [np.cos(one), np.sin(one)] for one in (turn, turn + np.pi / 2.0))
    fine_y, fine_x = ((np.arange(n * _SAMPLES) + 0.5) / _SAMPLES - 0.5 for n in (rows, columns))
    inside = np.ones((rows * _SAMPLES, columns * _SAMPLES), bool)
    for one in (along, across):
        inside &= np.abs(RectBivariateSpline(y, x, one)(fine_y, fine_x)) < 0.5 * _CARD_MM
    return np.asarray(inside.reshape(rows, _SAMPLES, columns, _SAMPLES).mean(axis=(1, 3)))
