"""How far a lens spreads edges, by a curve that is fitted across them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

PIXEL_VARIANCE = 1.0 / 12.0
"""Of a square pixel's area, in pixels², along any direction."""
_STEPS = 12
_LEAST_MEASURED = 3
_MOST_MISFIT = 0.1
_PART = (0.2, 0.8)
"""Of a square's side, from corner to corner, along which its edge is looked at."""
_LEAST_PIXELS, _ENOUGH_PIXELS = 24, 500
OF_SQUARES, OF_STRIPES = 0.025, 0.05
"""By which a blur may be off besides what scatters: by the print's own edges and whole pixels; and for stripes by the
camera's blur that is taken off, and by waves that gamma bends."""


def spreads(distance: Array, value: Array, weight: Array, start: float, width: Array | None = None) -> Array:
    """Standard deviations s of blurred edges, each fitted by a + b Φ((d − d₀)/s), Φ being the normal distribution.

    Parameters
    ----------
    distance, value, weight
        (edges, pixels) across the edge, what is seen there, and 0 for pixels that do not count.
    start
        First guess of s, in the unit of distance.
    width
        (edges,) first guess of the width of a stripe that begins with the edge: a + b Φ((d − d₀)/s)
        − b Φ((d − d₀ − w)/s). None: what begins does not end.

    Returns
    -------
    (edges,) array
        NaN where no edge was found.

    Notes
    -----
    Gauss–Newton over a, b, d₀, ln s and w, all edges at once.

    Examples
    --------
    >>> from scipy.special import ndtr
    >>> d = np.linspace(-3.0, 3.0, 61)[None]
    >>> spreads(d, 5.0 - 2.0 * ndtr((d - 0.2) / 0.7), np.ones_like(d), 1.0).round(6).tolist()
    [0.7]
    """
    from scipy.special import ndtr

    count = len(value)
    wide = np.full(count, np.inf) if width is None else width.astype(float)
    lit, dark = weight * ((distance > 0.0) & (distance < wide[:, None])), weight * (distance < -start)
    before, behind = (np.sum(part * value, axis=1) / np.maximum(np.sum(part, axis=1), 1e-9) for part in (dark, lit))
    base, height = before, behind - before
    middle, log_spread = np.zeros(count), np.full(count, np.log(start))
    with np.errstate(all="ignore"):  # edges that are none end in NaN
        for _ in range(_STEPS):
            spread = np.exp(log_spread)[:, None]
            first = (distance - middle[:, None]) / spread
            last = first - wide[:, None] / spread
            bells = [np.exp(-0.5 * one * one) / np.sqrt(2.0 * np.pi) for one in (first, last)]
            curve = ndtr(first) - ndtr(last)
            turns = first * bells[0] - np.where(np.isfinite(last), last, 0.0) * bells[1]
            per = height[:, None] / spread
            design = np.stack([np.ones_like(curve), curve, -per * (bells[0] - bells[1]), -per * spread * turns], -1)
            if width is not None:
                design = np.concatenate([design, (per * bells[1])[..., None]], axis=-1)
            off = value - base[:, None] - height[:, None] * curve
            step, good = _steps(design, off, weight)
            base, height = base + step[:, 0], height + step[:, 1]
            middle = middle + np.clip(step[:, 2], -start, start)
            log_spread = log_spread + np.clip(step[:, 3], -0.5, 0.5)
            if width is not None:
                wide = wide + np.clip(step[:, 4], -start, start)
        misfit = np.sqrt(np.sum(weight * off * off, axis=1) / np.sum(weight, axis=1)) / np.abs(height)
        good &= (np.abs(step[:, 3]) < 1e-2) & (misfit < _MOST_MISFIT) & (np.abs(middle) < 2.0 * start)
    return np.where(good, np.exp(log_spread), np.nan)


def _steps(design: Array, off: Array, weight: Array) -> tuple[Array, NDArray[np.bool_]]:
    """(edges, parameters) of Gauss–Newton, and which edges have one."""
    normal = np.einsum("ep,epi,epj->eij", weight, design, design)
    right = np.einsum("ep,epi,ep->ei", weight, design, off)
    scale = np.sqrt(np.einsum("eii->ei", normal))
    normal = normal / (scale[:, :, None] * scale[:, None, :]) + 1e-9 * np.eye(design.shape[-1])
    good = np.isfinite(normal).all(axis=(1, 2)) & np.isfinite(right).all(axis=1)
    step = np.full(right.shape, np.nan)
    step[good] = np.linalg.solve(normal[good], (right / scale)[good][..., None])[..., 0] / scale[good]
    return step, good


def square_edges_px(pixels: NDArray[Any], edges_px: Array, gap: float) -> Array:
    """(n, 3) x and y of the edges between a board's squares, and their standard deviations, in pixels.

    The pixels' own area is in them; edges that are not seen well enough are left out.

    Parameters
    ----------
    pixels
        (rows, columns).
    edges_px
        (edges, 2, 2) x and y of both ends of each.
    gap
        Width of the white between an edge and the marker beside it, over the edge's length.

    Notes
    -----
    Along the straight line between two corners, all pixels tell of one edge; being slanted to the grid it is sampled
    far finer than pixels are apart (ISO 12233). In the white square a marker's black rim begins a little farther on, so
    what is fitted is a stripe.
    """
    every = [(_about(pixels, first, last, gap), 0.5 * (first + last)) for first, last in edges_px]
    edges = [edge for edge, _ in every if edge[0].size >= _LEAST_PIXELS]
    places = [place for edge, place in every if edge[0].size >= _LEAST_PIXELS]
    if not edges:
        return np.zeros((0, 3))
    distance, value, weight = np.zeros((3, len(edges), max(edge[0].size for edge in edges)))
    for row, (away, seen, _) in enumerate(edges):
        distance[row, : away.size], value[row, : away.size], weight[row, : away.size] = away, seen, 1.0
    found = spreads(distance, value, weight, 0.8, np.array([edge[2] for edge in edges]))
    good = np.isfinite(found)
    return np.column_stack([np.array(places)[good], found[good]])


def _about(pixels: NDArray[Any], first: Array, last: Array, gap: float) -> tuple[Array, Array, float]:
    """Distances of pixels from the line between two corners, into the white, what is seen there, and its width."""
    rows, columns = pixels.shape
    way = last - first
    length = float(np.hypot(*way))
    way = way / length
    reach = 2.0 * gap * length
    low, high = np.minimum(first, last) - reach, np.maximum(first, last) + reach
    x, y = np.meshgrid(
        np.arange(max(int(low[0]), 0), min(int(high[0]) + 2, columns)),
        np.arange(max(int(low[1]), 0), min(int(high[1]) + 2, rows)),
    )
    along = ((x - first[0]) * way[0] + (y - first[1]) * way[1]) / length
    away = (y - first[1]) * way[0] - (x - first[0]) * way[1]
    near = (along > _PART[0]) & (along < _PART[1]) & (np.abs(away) < reach)
    away, seen = away[near], pixels[y[near], x[near]].astype(float)
    close = np.abs(away) < 0.5 * reach
    if np.sum(seen[close & (away > 0.0)]) * np.sum(close & (away < 0.0)) < np.sum(seen[close & (away < 0.0)]) * np.sum(
        close & (away > 0.0)
    ):
        away = -away
    inside = np.flatnonzero(away < 0.8 * reach)  # behind the marker's rim its bits begin
    inside = inside[:: -(-inside.size // _ENOUGH_PIXELS) or 1]
    return away[inside], seen[inside], 0.5 * reach


@dataclass(frozen=True)
class Blur:
    """Standard deviation of what a lens spreads, besides its pixels' own area.

    Parameters
    ----------
    px, sd_px
        In the device's pixels, and its standard deviation.
    """

    px: float
    sd_px: float

    @classmethod
    def of(cls, variances_px2: Sequence[float], method: float = OF_SQUARES) -> "Blur | None":
        """From variances that were measured apart from each other; None from fewer than three.

        Parameters
        ----------
        variances_px2
            NaN where one could not be measured.
        method
            Share by which all may be off together.

        Examples
        --------
        >>> Blur.of([0.24, 0.25, 0.26]).px
        0.5
        """
        found = np.array([one for one in variances_px2 if np.isfinite(one)])
        if found.size < _LEAST_MEASURED:
            return None
        mean, sd = float(found.mean()), float(found.std(ddof=1) / np.sqrt(found.size))
        width = float(np.sqrt(max(mean, 0.0)))
        return cls(width, float(np.hypot(sd / (2.0 * max(width, np.sqrt(sd), 1e-3)), method * width)))


@dataclass(frozen=True)
class BlurOverPicture:
    """How a camera's blur changes from the middle of its picture to the corners, besides its pixels' own area.

    Between them it goes with the square of the distance from the middle, as `tankrig.scene.optics.Blur` has it.

    Parameters
    ----------
    middle_px, corner_px
        Standard deviations of what the lens spreads.
    sd_px
        Those of both.
    """

    middle_px: float
    corner_px: float
    sd_px: tuple[float, float]

    @property
    def varies(self) -> bool:
        """Whether middle and corners differ by more than chance lets them."""
        middle, corner = self.sd_px
        return abs(self.corner_px - self.middle_px) > _TELLING * float(np.hypot(middle, corner))

    def at(self, x: float, y: float, shape: tuple[int, int]) -> float:
        """Standard deviation at a place of a picture of (rows, columns), pixels' own area not in it.

        Examples
        --------
        >>> over = BlurOverPicture(0.5, 0.7, (0.01, 0.02))
        >>> over.at(39.5, 29.5, (60, 80)), round(over.at(79.5, -0.5, (60, 80)), 3)
        (0.5, 0.7)
        """
        rows, columns = shape
        outward = 0.5 * (((2.0 * x + 1.0) / columns - 1.0) ** 2 + ((2.0 * y + 1.0) / rows - 1.0) ** 2)
        return self.middle_px + (self.corner_px - self.middle_px) * outward

    @classmethod
    def of(cls, edges: Sequence[Array], shape: tuple[int, int]) -> "BlurOverPicture | None":
        """From the edges of several views; None from too few.

        Parameters
        ----------
        edges
            (n, 3) of each view: x, y and standard deviation, pixels' own area and all.
        shape
            (rows, columns) of the pictures.

        Notes
        -----
        Least squares without edges beyond three scaled median deviations; edges of one view err together, so standard
        deviations are of views (cluster-robust sandwich; Liang and Zeger 1986).

        Examples
        --------
        >>> y, x = (one.ravel().astype(float) for one in np.mgrid[0:60:6, 0:80:8])
        >>> corner = 0.5 * (((x - 39.5) / 40.0) ** 2 + ((y - 29.5) / 30.0) ** 2)
        >>> view = np.column_stack([x, y, np.sqrt((0.5 + 0.2 * corner) ** 2 + 1.0 / 12.0)])
        >>> found = BlurOverPicture.of([view] * 3, (60, 80))
        >>> round(found.middle_px, 3), round(found.corner_px, 3)
        (0.5, 0.7)
        """
        used = [one for one in edges if len(one)]
        if len(used) < _LEAST_MEASURED:
            return None
        rows, columns = shape
        views = np.repeat(np.arange(len(used)), [len(one) for one in used])
        x, y, seen = np.concatenate(used).T
        outward = 0.5 * (((2.0 * x + 1.0) / columns - 1.0) ** 2 + ((2.0 * y + 1.0) / rows - 1.0) ** 2)
        width = np.sqrt(np.maximum(seen**2 - PIXEL_VARIANCE, 0.0))
        design, good = np.column_stack([1.0 - outward, outward]), np.ones(width.size, bool)
        for _ in range(3):
            values = np.linalg.lstsq(design[good], width[good], rcond=None)[0]
            off = width - design @ values
            good = np.abs(off - np.median(off)) < 3.0 * 1.4826 * max(float(np.median(np.abs(off))), 1e-9) + 1e-9
        if good.sum() < _ENOUGH_EDGES or np.ptp(outward[good]) < _LEAST_OUTWARD:
            return None
        scores = np.array([design[(views == k) & good].T @ off[(views == k) & good] for k in range(len(used))])
        inverse = np.linalg.inv(design[good].T @ design[good])
        spread = inverse @ (scores.T @ scores) @ inverse * len(used) / (len(used) - 1)
        sd = np.hypot(np.sqrt(np.diag(spread)), OF_SQUARES * values)
        middle, corner = (float(max(value, 0.0)) for value in values)
        return cls(middle, corner, (float(sd[0]), float(sd[1])))


_TELLING, _ENOUGH_EDGES, _LEAST_OUTWARD = 2.0, 40, 0.3
"""Standard deviations by which a blur has to change; edges that tell of it, and how far apart they have to lie, as
parts of the way from the middle to a corner."""
