"""From counts to colours: one table look-up per pixel, fast enough for every frame."""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import pyqtgraph as pg
from numpy.typing import NDArray

COUNTS = 2**16
COLOURS = {
    "false colour": "inferno", "grey": "CET-L1", "viridis": "viridis", "cividis": "cividis", "magma": "magma",
}  # fmt: skip
"""All perceptually even, and lighter from end to end, so that people who do not tell red from green read them too."""
SATURATED = (0, 229, 255)
"""A colour that neither scale has."""
LEAST = 200.0
"""Counts between the ends of the colours, so that mere noise does not fill them."""


@dataclass(frozen=True)
class Tone:
    """How counts become colours.

    Parameters
    ----------
    low, high
        Counts at the dark and at the bright end.
    gamma
        Brightness goes as this power of the counts between the ends: 1 is linear; 0.5, the square root, shows faint
        scattered light beside beams.
    saturation
        Counts from here on have a colour of their own; None where that is switched off.
    colours
        A key of `COLOURS`.
    """

    low: float = 0.0
    high: float = float(COUNTS - 1)
    gamma: float = 0.5
    saturation: int | None = None
    colours: str = "false colour"

    def between(self, low: float, high: float) -> "Tone":
        """The same with other ends."""
        return replace(self, low=low, high=max(high, low + 1.0))

    def table(self) -> NDArray[np.uint8]:
        """(65536,) index into `palette` of each count.

        >>> tone = Tone(100.0, 500.0, gamma=1.0, saturation=4095)
        >>> tone.table()[[0, 100, 300, 500, 4094, 4095]].tolist()
        [0, 0, 127, 254, 254, 255]
        """
        part = np.clip((np.arange(COUNTS) - self.low) / max(self.high - self.low, 1e-9), 0.0, 1.0)
        index: NDArray[np.uint8] = (254.0 * part**self.gamma + 0.5).astype(np.uint8)
        if self.saturation is not None:
            index[self.saturation :] = 255
        return index

    def palette(self) -> NDArray[np.uint8]:
        """(256, 3) colours; the last is that of saturated pixels."""
        return _palette(self.colours)

    def bar(self, steps: int = 256) -> NDArray[np.uint8]:
        """(1, steps, 3) colours of counts that rise evenly from `low` to `high`: the colour bar."""
        counts = np.linspace(self.low, self.high, steps)
        part = np.clip((counts - self.low) / max(self.high - self.low, 1e-9), 0.0, 1.0)
        colours: NDArray[np.uint8] = self.palette()[(254.0 * part**self.gamma + 0.5).astype(np.uint8)]
        return colours[None]


def how_often(pixels: NDArray[np.unsignedinteger]) -> NDArray[np.intp]:
    """How often each count occurs: of every fourth row and column, where there are many."""
    sample = pixels[::4, ::4] if pixels.size > 100_000 else pixels
    return np.bincount(sample.ravel())


def automatic(often: NDArray[np.intp]) -> tuple[float, float]:
    """Ends that show what is in a picture: from its darkest half percent to its brightest pixels.

    >>> automatic(how_often(np.arange(1000, dtype=np.uint16)))
    (5.0, 999.0)
    """
    upto = np.cumsum(often)
    low, high = np.searchsorted(upto, (0.005 * upto[-1], 0.999 * upto[-1]), "right")
    return float(low), float(max(high, low + LEAST))


@lru_cache
def _palette(colours: str) -> NDArray[np.uint8]:
    """(256, 3) colours of a key of `COLOURS`, and that of saturated pixels."""
    found: NDArray[np.uint8] = pg.colormap.get(COLOURS[colours]).getLookupTable(nPts=255)[:, :3]
    return np.vstack([found, np.array([SATURATED], np.uint8)])


@lru_cache
def residual_palette() -> NDArray[np.uint8]:
    """(256, 3) colours from blue (model too bright) over white to red (model too dark)."""
    colours: NDArray[np.uint8] = pg.colormap.get("CET-D1").getLookupTable(nPts=256)[:, :3]
    return colours
