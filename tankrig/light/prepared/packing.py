"""A prepared model as the arrays of a file, and back."""

import math

import numpy as np
from numpy.typing import NDArray

from tankrig.light.prepared.answer import Answer
from tankrig.light.prepared.box import Coordinates
from tankrig.light.prepared.noise import Noise
from tankrig.light.prepared.polynomials import Plane
from tankrig.light.prepared.term import Term

Arrays = dict[str, NDArray[np.generic]]

_DEGREES = 64
"""Of polynomials, far beyond what a plan takes."""
_MOST_POWER = 64
"""Of σs."""
_MOST_SCALE = 600.0
"""Of a term's logarithm: beyond it there is no number."""


def packed(answer: Answer) -> Arrays:
    """All that the scene and the box don't say."""
    noise = answer.noise
    arrays: Arrays = {"patterns": answer.patterns, "error": answer.error}
    arrays |= {"misses": answer.misses, "tables": np.array(answer.tables)}
    arrays |= {"noise_scale": noise.scale, "noise_pull": noise.pull, "noise_left": noise.left}
    for index, term in enumerate(answer.terms):
        arrays[f"term{index}_power"] = np.array(term.power)
        arrays[f"term{index}_planes"] = np.array([_numbers(term.plane), _numbers(term.scale_plane)])
        arrays[f"term{index}_amplitudes"] = term.amplitudes
        arrays[f"term{index}_scale"] = term.scale
    return arrays


def unpacked(arrays: Arrays, coordinates: Coordinates, shape: tuple[int, int], cells: int) -> Answer:
    """The model again; of a camera's shape, and of so many numbers that an image on paths' cells has.

    Raises
    ------
    KeyError, TypeError, ValueError
        When the arrays are not those of a model of a camera of that shape: none of its kernels is to read beyond them.
    """
    terms: list[Term] = []
    while f"term{len(terms)}_power" in arrays:
        name = f"term{len(terms)}"
        plane, scale_plane = (Plane((int(i), int(j)), float(f)) for i, j, f in arrays[f"{name}_planes"].astype(float))
        amplitudes, scale = (np.asarray(arrays[f"{name}_{part}"], float) for part in ("amplitudes", "scale"))
        _require(min(*plane.degrees, *scale_plane.degrees) >= 0, max(*plane.degrees, *scale_plane.degrees) < _DEGREES)
        _require(amplitudes.ndim == 3, scale.ndim == 2, amplitudes.size > 0, scale.size > 0)
        _require(amplitudes.shape[1] == plane.size, scale.shape[1] == scale_plane.size)
        _require(bool(np.isfinite(amplitudes).all()), bool(np.isfinite(scale).all()))
        power = int(arrays[f"{name}_power"])
        _require(0 <= power <= _MOST_POWER, float(np.abs(scale).sum()) <= _MOST_SCALE)
        terms.append(Term(power, plane, scale_plane, amplitudes, scale))
    patterns, error = np.asarray(arrays["patterns"], np.float32), np.asarray(arrays["error"], float)
    _require(len(terms) > 0, patterns.ndim == 2, error.ndim == 3)
    _require(patterns.shape[1] == shape[0] * shape[1])
    _require(all(term.amplitudes.shape[2] == len(patterns) for term in terms), error.size > 0, len(patterns) > 0)
    _require(bool(np.isfinite(patterns).all()), bool(np.isfinite(error).all()))
    misses, tables = np.asarray(arrays["misses"], np.float32), float(arrays["tables"])
    _require(misses.ndim == 2, misses.shape[1:] == patterns.shape[1:], len(misses) > 0, 0.0 <= tables < math.inf)
    _require(bool(np.isfinite(misses).all()), len(terms) > 1)
    return Answer(coordinates, tuple(terms), patterns, shape, error, _noise(arrays, terms[-1], cells), misses, tables)


def _noise(arrays: Arrays, rest: Term, cells: int) -> Noise:
    """Of the term of orders ≥ 3."""
    scale, pull = (np.asarray(arrays[f"noise_{part}"], float) for part in ("scale", "pull"))
    left = np.asarray(arrays["noise_left"], np.float32)
    _require(scale.ndim == 2, pull.ndim == 3, left.ndim == 3, pull.size > 0)
    albedos, products, media = pull.shape
    _require(scale.shape == (albedos, rest.scale_plane.size), products == rest.plane.size)
    _require(
        left.shape == (media, albedos, cells), albedos < _DEGREES, float(np.abs(scale).sum(1).max()) <= _MOST_SCALE
    )
    _require(bool(np.isfinite(scale).all()), bool(np.isfinite(pull).all()), bool(np.isfinite(left).all()))
    return Noise(rest.power, rest.plane, rest.scale_plane, scale, pull, left)


def _require(*conditions: bool) -> None:
    if not all(conditions):
        raise ValueError("not the arrays of a prepared model")


def _numbers(plane: Plane) -> tuple[float, float, float]:
    return (*plane.degrees, plane.fullness)
