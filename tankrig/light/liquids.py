"""Liquids whose order 1 is found at once: where light and sight meet is the same for all, and takes the time."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import part
from tankrig.scene import Medium
from tankrig.scene.phase import henyey_greenstein
from tankrig.scene.phase_table import HenyeyGreensteinRecord, TableRecord

Array = NDArray[np.float64]


class Asymmetries(NamedTuple):
    """Henyey–Greenstein's phase functions of several liquids, for kernels; they are told by their length."""

    g: Array
    width: float
    """Smallest of their `HenyeyGreensteinRecord.width`."""


class Tables(NamedTuple):
    """Any phase functions of several liquids, for kernels."""

    density: Array
    """(nodes, n) as `TableRecord.density`, side by side: where an angle lies in them is looked up once."""


class Liquids(NamedTuple):
    """Several media for kernels."""

    sigma_t: Array
    """(n,) extinctions, 1/mm."""
    thinnest: float
    densest: float
    phases: Asymmetries | Tables


def liquids_of(media: Sequence[Medium]) -> Liquids:
    """Media for kernels; as tables where one of them is not Henyey–Greenstein's.

    Examples
    --------
    >>> liquids_of([Medium(0.0, 0.01, 0.5), Medium(0.0, 0.02, 0.7)]).densest
    0.02
    """
    sigma_t = np.array([one.sigma_t for one in media], float)
    records = [one.phase_function.record for one in media]
    known = [one for one in records if isinstance(one, HenyeyGreensteinRecord)]
    phases: Asymmetries | Tables
    if len(known) == len(records):
        phases = Asymmetries(np.array([one.g for one in known], float), min(one.width for one in known))
    else:
        tables = [
            one.density if isinstance(one, TableRecord) else medium.phase_function.table
            for one, medium in zip(records, media, strict=True)
        ]
        phases = Tables(np.ascontiguousarray(np.array(tables).T))
    return Liquids(sigma_t, float(sigma_t.min()), float(sigma_t.max()), phases)


@part
def add_scattered(found: Array, light: float, cosine: float, way: float, liquids: Liquids) -> None:
    """Add to (n,) what each liquid scatters by an angle, after so long a way in all, mm."""
    _add_turned(found, light, cosine, way, liquids.sigma_t, liquids.phases)


@part
def _add_turned(
    found: Array, light: float, cosine: float, way: float, sigma_t: Array, phases: Asymmetries | Tables
) -> None:
    """The same; how light fades is worked out once for liquids of one extinction that follow each other."""
    kept = 0.0
    if len(phases) == 2:
        for n in range(found.size):
            if n == 0 or sigma_t[n] != sigma_t[n - 1]:
                kept = light * math.exp(-sigma_t[n] * way)
            found[n] += kept * henyey_greenstein(cosine, phases.g[n])
    else:
        steps = phases.density.shape[0] - 1
        place = math.sqrt(max(0.5 - 0.5 * cosine, 0.0)) * steps
        step = min(int(place), steps - 1)
        share = place - step
        before, after = phases.density[step], phases.density[step + 1]
        for n in range(found.size):
            if n == 0 or sigma_t[n] != sigma_t[n - 1]:
                kept = light * math.exp(-sigma_t[n] * way)
            found[n] += kept * ((1.0 - share) * before[n] + share * after[n])
