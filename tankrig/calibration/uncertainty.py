"""Covariance of what a bundle adjustment found: from the corners' noise, and from what was held at uncertain values."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tankrig.calibration.board import Board, BoardView
from tankrig.calibration.file import Calibration
from tankrig.errors import StoreError

Array = NDArray[np.float64]

USUAL_CORRELATION = 0.1
"""Standard deviation, from one set of views to the next, of the correlation of neighbours about none."""
_MOST_CORRELATED = 0.25
"""Of neighbours: more would not be a covariance on a large grid."""


@dataclass(frozen=True, eq=False)
class Named:
    """Numbers with their names, and how they are uncertain together.

    Parameters
    ----------
    names
        Of each.
    values
        (n,) in the same order.
    covariance
        (n, n).
    """

    names: tuple[str, ...]
    values: Array
    covariance: Array

    def only(self, names: Sequence[str]) -> "Named":
        """Some of them, in that order.

        Examples
        --------
        >>> both = Named(("a", "b"), np.array([1.0, 2.0]), np.diag([0.1, 0.4]))
        >>> both.only(["b"]).covariance.tolist()
        [[0.4]]
        """
        which = [self.names.index(name) for name in names]
        return Named(tuple(names), self.values[which], self.covariance[np.ix_(which, which)])

    def beside(self, other: "Named") -> "Named":
        """Both, which know nothing of each other."""
        count = len(self.names)
        covariance = np.zeros((count + len(other.names),) * 2)
        covariance[:count, :count], covariance[count:, count:] = self.covariance, other.covariance
        return Named((*self.names, *other.names), np.concatenate([self.values, other.values]), covariance)

    def table(self) -> dict[str, list[str]]:
        """For a calibration's result: what its array is of."""
        return {"covariance_of": list(self.names)}

    def array(self) -> dict[str, Array]:
        """For a calibration's arrays."""
        return {"covariance": self.covariance, "covariance_at": self.values}

    @classmethod
    def of(cls, calibration: Calibration) -> "Named | None":
        """From a calibration's file; None where that was written before covariances were kept.

        Raises
        ------
        StoreError
            When the covariance that it holds is none.
        """
        if "covariance_of" not in calibration.result:
            return None
        names = tuple(str(name) for name in calibration.result["covariance_of"])
        covariance, values = (calibration.arrays.get(name) for name in ("covariance", "covariance_at"))
        why = _no_covariance(covariance, len(names))
        if values is None or values.shape != (len(names),) or not np.isfinite(values).all():
            why = why or "the values that it is of are not there"
        if why or covariance is None or values is None:
            raise StoreError(
                f"{calibration.path}: its covariance is damaged ({why}); restore the file, or calibrate anew "
                f"(tankrig calibrate {calibration.kind})"
            )
        return cls(names, values, covariance)

    def prefixed(self, prefix: str) -> "Named":
        """The same under longer names."""
        return Named(tuple(f"{prefix}{name}" for name in self.names), self.values, self.covariance)

    def after(self, names: Sequence[str], values: Array, covariance: Array, across: Array) -> "Named":
        """These behind others, whose covariance with them is `across` (others, these)."""
        whole = np.block([[covariance, across], [across.T, self.covariance]])
        return Named((*names, *self.names), np.concatenate([values, self.values]), whole)

    def sd(self, name: str) -> float:
        """Standard deviation of one."""
        return float(np.sqrt(self.covariance[self.names.index(name), self.names.index(name)]))


def independent(sds: Mapping[str, float], values: Mapping[str, float] | None = None) -> Named:
    """Numbers that know nothing of each other, near 0 where nothing else is said."""
    at = [(values or {}).get(name, 0.0) for name in sds]
    return Named(tuple(sds), np.array(at, float), np.diag(np.array(list(sds.values()), float) ** 2))


def _no_covariance(found: Array | None, count: int) -> str | None:
    """Why it is none; None where it is one."""
    if found is None or found.shape != (count, count):
        return f"it should have {count} rows and columns, and has {'none' if found is None else list(found.shape)}"
    if not np.isfinite(found).all():
        return "not all of it is finite"
    sd = np.sqrt(np.maximum(np.diag(found), 0.0))
    scale = np.where(sd > 0.0, sd, 1.0)
    correlation = found / np.outer(scale, scale)
    if (np.diag(found) < 0.0).any() or np.abs(correlation - correlation.T).max() > 1e-6:
        return "it is not symmetric, or a variance is negative"
    if np.linalg.eigvalsh(0.5 * (correlation + correlation.T)).min() < -1e-6:
        return "it is not positive"
    return None


def slopes(function: Callable[[Array], Array], at: Array, steps: Array) -> Array:
    """(rows, n) derivatives by central differences.

    Examples
    --------
    >>> slopes(lambda x: np.array([x[0] ** 2, x[0] * x[1]]), np.array([3.0, 2.0]), np.array([1e-3, 1e-3])).round(6)
    array([[6., 0.],
           [2., 3.]])
    """
    columns = []
    for index, step in enumerate(steps):
        aside = np.zeros_like(at)
        aside[index] = step
        columns.append((function(at + aside) - function(at - aside)) / (2.0 * step))
    return np.stack(columns, axis=1)


def corner_pairs(views: Sequence[BoardView], board: Board, among: Sequence[bool] | None = None) -> tuple[Array, Array]:
    """(2n, 2n) of 0 and 1: coordinates of corners, x and y of each in turn, that are the same, and those of neighbours.

    Corners of one view that are neighbours on the board share pixels and what the method of finding them is pulled by.
    Where `among` is given, pairs of the views that it is true of; the others have zeros.
    """
    sizes = [2 * len(view.ids) for view in views]
    ends = np.cumsum([0, *sizes])
    same, near = np.zeros((2, ends[-1], ends[-1]))
    counted = [True] * len(views) if among is None else among
    for view, counts, start, end in zip(views, counted, ends[:-1], ends[1:], strict=True):
        if not counts:
            continue
        same[start:end, start:end] = np.eye(end - start)
        square = np.rint(view.points_mm(board)[:, :2] / board.square_mm)
        apart = np.abs(square[:, None] - square[None]).sum(axis=-1)
        near[start:end, start:end] = np.kron(apart == 1.0, np.eye(2))
    return same, near


def noise_covariance(misses: Array, explained: Array, kinds: Sequence[tuple[Array, Array]]) -> Array:
    """(n, n) covariance of the noise in residuals; of each kind two numbers: variance, and covariance of neighbours.

    Parameters
    ----------
    misses
        (n,) residuals of a least-squares fit.
    explained
        (n, parameters) derivatives by all that could have explained them; what these explain says nothing of noise.
    kinds
        Of noise: for each the pairs of `corner_pairs`, (n, n), of the rows that it is in.

    Notes
    -----
    Expectations of rᵀ K r, K being any of the pairs and r the residuals less what the derivatives explain, are linear
    in the numbers sought (MINQUE, Rao 1971). Neighbours are alike or opposed by where they lie among the pixels, so
    that their correlation differs from one set of views to the next. A few views do not tell it: were they believed,
    half of all intervals would be too narrow and the others too wide. So it is drawn towards none as far as it is
    uncertain (2 v² E⁻¹ for independent noise of variance v, E being those expectations), against `USUAL_CORRELATION`.
    """
    basis, sizes, _ = np.linalg.svd(explained / np.linalg.norm(explained, axis=0), full_matrices=False)
    basis = basis[:, sizes > 1e-9 * sizes[0]]
    left = misses - basis @ (basis.T @ misses)
    pairs = [one for both in kinds for one in both]
    cut = [one - (one @ basis) @ basis.T for one in pairs]
    expected = np.array([[np.sum(a * b.T) for b in cut] for a in cut])
    inverse = np.linalg.pinv(expected)
    found = inverse @ np.array([left @ one @ left for one in pairs])
    chance = 2.0 * np.diag(inverse)[1::2]
    covariance = np.zeros((misses.size, misses.size))
    for (same, near), variance, across, chance2 in zip(kinds, found[::2], found[1::2], chance, strict=True):
        if not variance > 0.0:  # too few corners to tell them apart
            variance, across = float(left @ same @ left) / float(np.trace(same)), 0.0
        correlation = across / variance / (1.0 + chance2 / USUAL_CORRELATION**2)
        covariance += variance * (same + float(np.clip(correlation, -_MOST_CORRELATED, _MOST_CORRELATED)) * near)
    return covariance


def found_covariance(
    slope: Array, noise: Array, held_slope: Array | None = None, held: Array | None = None
) -> tuple[Array, Array]:
    """What least squares found, by noise and by what it held.

    Parameters
    ----------
    slope
        (rows, found) derivatives of the residuals by what was found, which minimises their squares.
    noise
        (rows, rows) covariance of the residuals' noise.
    held_slope
        (rows, held) derivatives by what was held; None where nothing was.
    held
        (held, held) its covariance.

    Returns
    -------
    covariance, across
        (found, found) of what was found, and (found, held) of it with what was held.

    Notes
    -----
    Implicit function theorem: with residuals r(x, θ), x moves by S δθ, S = −(JᵀJ)⁻¹ Jᵀ J_θ, and by −(JᵀJ)⁻¹ Jᵀ of the
    noise.

    Examples
    --------
    A length that is measured twice with a ruler: noise averages out, the ruler's error doesn't.

    >>> ones = np.ones((2, 1))
    >>> covariance, _ = found_covariance(ones, 0.2 * np.eye(2), -ones, np.array([[0.5]]))
    >>> covariance.round(9).tolist()
    [[0.6]]
    """
    scale = np.linalg.norm(slope, axis=0)
    solver = np.linalg.pinv(slope / scale) / scale[:, None]
    covariance = solver @ noise @ solver.T
    if held_slope is None or held is None:
        return covariance, np.zeros((len(covariance), 0))
    moves = -solver @ held_slope
    across = moves @ held
    return covariance + across @ moves.T, across
