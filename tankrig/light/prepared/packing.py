"""A prepared model as the arrays of a file, and back."""

import numpy as np
from numpy.typing import NDArray

from tankrig.light.prepared.answer import Answer
from tankrig.light.prepared.box import Coordinates
from tankrig.light.prepared.polynomials import Plane
from tankrig.light.prepared.term import Term

Arrays = dict[str, NDArray[np.generic]]


def packed(answer: Answer) -> Arrays:
    """All that the scene and the box don't say."""
    arrays: Arrays = {"patterns": answer.patterns, "error": answer.error}
    for index, term in enumerate(answer.terms):
        arrays[f"term{index}_power"] = np.array(term.power)
        arrays[f"term{index}_planes"] = np.array([_numbers(term.plane), _numbers(term.scale_plane)])
        arrays[f"term{index}_amplitudes"] = term.amplitudes
        arrays[f"term{index}_scale"] = term.scale
    return arrays


def unpacked(arrays: Arrays, coordinates: Coordinates, shape: tuple[int, int]) -> Answer:
    """The model again."""
    terms: list[Term] = []
    while f"term{len(terms)}_power" in arrays:
        name = f"term{len(terms)}"
        plane, scale_plane = (Plane((int(i), int(j)), float(f)) for i, j, f in arrays[f"{name}_planes"].astype(float))
        amplitudes, scale = (np.asarray(arrays[f"{name}_{part}"], float) for part in ("amplitudes", "scale"))
        terms.append(Term(int(arrays[f"{name}_power"]), plane, scale_plane, amplitudes, scale))
    patterns, error = np.asarray(arrays["patterns"], np.float32), np.asarray(arrays["error"], float)
    return Answer(coordinates, tuple(terms), patterns, shape, error)


def _numbers(plane: Plane) -> tuple[float, float, float]:
    return (*plane.degrees, plane.fullness)
