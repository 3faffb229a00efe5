"""Liquids whose order 1 is found at once: where light and sight meet is the same for all, and takes the time."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import part
from tankrig.scene import Medium
from tankrig.scene.phase import henyey_greenstein, phase_density
from tankrig.scene.phase_table import TableRecord

Array = NDArray[np.float64]


class Asymmetries(NamedTuple):
    """Henyey–Greenstein's phase functions of several liquids, for kernels; they are told by their length."""

    g: Array
    width: float
    """Smallest of their `HenyeyGreensteinRecord.width`."""


class Liquids(NamedTuple):
    """Several media for kernels."""

    sigma_t: Array
    """(n,) extinctions, 1/mm."""
    thinnest: float
    densest: float
    phases: Asymmetries | TableRecord
    """Any other phase function than Henyey–Greenstein's is that of one liquid."""


def liquids_of(media: Sequence[Medium]) -> Liquids:
    """Media for kernels; several must be Henyey–Greenstein's.

    Examples
    --------
    >>> liquids_of([Medium(0.0, 0.01, 0.5), Medium(0.0, 0.02, 0.7)]).densest
    0.02
    """
    sigma_t = np.array([one.sigma_t for one in media], float)
    records = [one.phase_function.record for one in media]
    phases: Asymmetries | TableRecord
    first = records[0]
    if isinstance(first, TableRecord):
        assert len(records) == 1, "several liquids of another phase function than Henyey–Greenstein's"
        phases = first
    else:
        phases = Asymmetries(np.array([one.g for one in records], float), min(one.width for one in records))
    return Liquids(sigma_t, float(sigma_t.min()), float(sigma_t.max()), phases)


@part
def add_scattered(found: Array, light: float, cosine: float, way: float, liquids: Liquids) -> None:
    """Add to (n,) what each liquid scatters by an angle, after so long a way in all, mm."""
    for n in range(found.size):
        found[n] += light * _density(n, cosine, liquids.phases) * math.exp(-liquids.sigma_t[n] * way)


@part
def _density(number: int, cosine: float, phases: Asymmetries | TableRecord) -> float:
    if len(phases) == 2:
        return henyey_greenstein(cosine, phases.g[number])
    return phase_density(cosine, phases)
