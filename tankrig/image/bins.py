"""How pixels of a camera are put together before a fit: as coarsely as the light's detail allows, and who counts."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tankrig.scene.description import Camera, Scene
from tankrig.scene.outline import blurred_pixels, lit_pixels

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FIT_PIXEL_MM = 4.0
"""Sides of bins at most: the tank's light is smooth, and beams are as wide."""
KEPT = 2.0 / 3.0
"""Share of the lit pixels away from edges that lie in whole bins at least, or bins are made smaller."""
LEFT = 0.05
"""Share of the lit pixels away from edges below which a pattern is too fine."""
MOST_BINS = 20_000
"""Half of what can be prepared for."""
HALF = 0.5
"""Share of a bin's pixels that must count for their mean to stand for the bin."""


@dataclass(frozen=True)
class Bins:
    """Blocks of a camera's pixels; what is left over at the last rows and columns is in none.

    Parameters
    ----------
    by, along
        Rows and columns of a block.

    Examples
    --------
    >>> pixels = np.arange(15.0).reshape(3, 5)
    >>> Bins(2, 2).means(pixels).tolist()
    [[3.0, 5.0]]
    >>> without_the_first = np.arange(15).reshape(3, 5) > 0
    >>> Bins(2, 2).means(pixels, without_the_first).tolist()
    [[4.0, 5.0]]
    """

    by: int
    along: int

    @property
    def size(self) -> int:
        """Pixels of a bin."""
        return self.by * self.along

    def camera(self, camera: Camera) -> Camera:
        """The camera whose pixels are the bins of another's."""
        return camera.binned(self.by, self.along)

    def means(self, pixels: NDArray[np.generic], counts: Mask | None = None) -> Array:
        """(rows, columns) mean over the pixels of each bin that count; over all of them where none does."""
        if counts is None:
            return self.sums(pixels) / self.size
        many = self.sums(counts)
        return np.where(many > 0, self.sums(np.where(counts, pixels, 0)) / np.maximum(many, 1), self.means(pixels))

    def shares(self, counts: Mask) -> Array:
        """(rows, columns) share of each bin's pixels that count."""
        return self.sums(counts) / self.size

    def clear_of(self, full: Mask) -> Mask:
        """(rows, columns) bins that neither hold nor adjoin a saturated pixel.

        The mean of a bin's other pixels would be too dark, and beside a full pixel others hold what it spills over.

        Examples
        --------
        >>> full = np.zeros((2, 6), bool)
        >>> full[0, 2] = True
        >>> Bins(2, 2).clear_of(full).tolist()
        [[False, False, True]]
        """
        if not full.any():
            return np.ones((full.shape[0] // self.by, full.shape[1] // self.along), bool)
        return np.asarray(self.sums(beside(full)) == 0)

    def sums(self, pixels: NDArray[np.generic]) -> Array:
        """(rows, columns) sum over the pixels of each bin."""
        rows, columns = pixels.shape[0] // self.by, pixels.shape[1] // self.along
        whole = pixels[: rows * self.by, : columns * self.along]
        exact = np.uint32 if whole.dtype.kind in "bu" else np.float64
        lines = whole.reshape(rows, self.by, columns * self.along).sum(axis=1, dtype=exact)  # rows first: 5 × faster
        return np.asarray(lines.reshape(rows, columns, self.along).sum(axis=2))


def beside(full: Mask) -> Mask:
    """(rows, columns) those pixels, and the eight about each."""
    import cv2

    return np.asarray(cv2.dilate(full.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0)


@dataclass(frozen=True, eq=False)
class Seen:
    """What a pattern's picture is good for, pixel by pixel.

    Parameters
    ----------
    sharp
        (rows, columns) pixels that blur does not matter to.
    lit
        Those that the pattern's beams light.
    """

    sharp: Mask
    lit: Mask

    @classmethod
    def of(cls, scene: Scene) -> "Seen":
        """Of a scene with the whole camera."""
        return cls(~blurred_pixels(scene), lit_pixels(scene))

    @property
    def nothing_left(self) -> bool:
        """Whether blur matters to as good as all that is lit."""
        return int((self.sharp & self.lit).sum()) < LEFT * int(self.lit.sum())

    def kept(self, bins: Bins) -> float:
        """Share of the lit and sharp pixels that lie in bins of sharp pixels only."""
        good = self.sharp & self.lit
        whole = np.kron(bins.shares(self.sharp) == 1.0, np.ones((bins.by, bins.along), bool))
        return float(good[: whole.shape[0], : whole.shape[1]][whole].sum()) / max(int(good.sum()), 1)


def bins_for(camera: Camera, seen: Sequence[Seen]) -> Bins:
    """The largest bins, of `FIT_PIXEL_MM` at most, that leave whole ones between the edges of every pattern's light.

    A bin across an edge is the mean of what is sharp and what is not, so it is lost; the finer the bins are across
    beams, the less is. Along beams light is smooth, so that a calibrated camera's bins may be longer than wide; others
    have square ones.

    Parameters
    ----------
    camera
        Whole. Where it says `bin`, that is taken.
    seen
        Of the patterns.
    """
    if camera.bin:
        return Bins(camera.bin, camera.bin)
    sizes = zip(camera.sides_mm, camera.shape, strict=True)
    rows, columns = (min(max(1, int(FIT_PIXEL_MM / side)), count) for side, count in sizes)
    coarsest = Bins(rows, columns) if camera.kind == "calibrated" else Bins(*[min(rows, columns)] * 2)
    blurred = [one for one in seen if not one.sharp.all() and not one.nothing_left]
    if not blurred:
        return coarsest
    possible = [one for one in _finer(coarsest, camera) if _count(camera, one) <= MOST_BINS] or [coarsest]
    ranked = sorted(possible, key=lambda one: _count(camera, one))
    kept = {one: min(pattern.kept(one) for pattern in blurred) for one in ranked}
    return next((one for one in ranked if kept[one] >= KEPT), max(ranked, key=lambda one: kept[one]))


def _finer(coarsest: Bins, camera: Camera) -> Iterable[Bins]:
    for by in range(coarsest.by, 0, -1):
        if camera.kind != "calibrated":
            yield Bins(by, by)
            continue
        along = coarsest.along
        while along >= by:
            yield Bins(by, along)
            along //= 2


def _count(camera: Camera, bins: Bins) -> int:
    return (camera.shape[0] // bins.by) * (camera.shape[1] // bins.along)
