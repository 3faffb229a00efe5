"""Phase functions as kernels read them: how likely a scattering turns by an angle θ (the paper's Eq. 5, corrected).

Henyey–Greenstein is a formula; any other phase function is a table, dense where p may be steep: it has even steps in
sin(θ/2), of which cos θ is a quadratic, and is linear between them. Kernels take either record, are compiled for each
when it is first used, and tell them apart by their length, which costs nothing then: a choice made while they run kept
compilers from vectorising the loops over paths (measured: 2 ×).
"""

import math

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel, part
from tankrig.scene.phase_table import PhaseRecord

Array = NDArray[np.float64]


@kernel
def henyey_greenstein(cosine: float, g: float) -> float:
    """Phase function p(cos θ) of one scattering, in 1/sr, for a scalar; meant for use inside kernels.

    p = (1 − g²) / (4π (1 + g² − 2 g cos θ)^(3/2)), normalised to ∫ p dω = 1. The paper prints the exponent as 2/3,
    with which the integral is 0.384 at g = 0.8.

    Parameters
    ----------
    cosine
        cos θ = ω'·ω, the incoming direction of travel times the outgoing one.
    g
        Asymmetry, the mean of cos θ; −1 < g < 1.

    Examples
    --------
    >>> round(henyey_greenstein(0.3, 0.0) * 4 * math.pi, 12)
    1.0
    """
    # 1 + g² − 2 g c written as a sum of non-negative terms: no cancellation when g → ±1 and θ → 0 or π.
    spread = (1.0 - abs(g)) ** 2 + 2.0 * abs(g) * (1.0 - cosine if g >= 0.0 else 1.0 + cosine)
    return (1.0 - g) * (1.0 + g) / (4.0 * math.pi * spread * math.sqrt(spread))


@part
def phase_density(cosine: float, phase: PhaseRecord) -> float:
    """p(cos θ) in 1/sr of any phase function."""
    if len(phase) == 2:
        return henyey_greenstein(cosine, phase.g)
    steps = phase.density.size - 1
    place = math.sqrt(max(0.5 - 0.5 * cosine, 0.0)) * steps
    step = min(int(place), steps - 1)
    share = place - step
    density: float = (1.0 - share) * phase.density[step] + share * phase.density[step + 1]
    return density


@part
def henyey_greenstein_cosine(u: float, g: float) -> float:
    """cos θ of a Henyey–Greenstein scattering by a coordinate u in [0, 1) that counts from straight on."""
    root = (1.0 - g * g) / (1.0 + g - 2.0 * g * u)
    linear = 1.0 - 2.0 * u + 6.0 * g * u * (1.0 - u)
    cosine = linear if abs(g) < 1e-3 else (1.0 + g * g - root * root) / (2.0 * g)
    return min(max(cosine, -1.0), 1.0)


@part
def drawn_cosine(u: float, phase: PhaseRecord) -> float:
    """cos θ of a scattering, by a coordinate u in [0, 1) that counts from straight on; a smooth function of the phase.

    Tables have even steps of 1 − (1 − u)^(1/4): few scatterings turn back, and those that do are seen.
    """
    if len(phase) == 2:
        return henyey_greenstein_cosine(u, phase.g)
    steps = phase.cosines.size - 1
    place = (1.0 - math.sqrt(math.sqrt(1.0 - u))) * steps
    step = min(int(place), steps - 1)
    share = place - step
    cosine: float = (1.0 - share) * phase.cosines[step] + share * phase.cosines[step + 1]
    return cosine


@kernel
def densities(found: Array, cosines: Array, n: int, phase: PhaseRecord) -> None:
    """p at the first n of some cosines, in 1/sr; `found` may be `cosines`.

    A table is read in a loop of its own. Compilers cannot tell that what a loop stores is not in the table, and
    vectorise nothing in it: with all in one loop scatterings took twice as long.
    """
    if len(phase) == 2:
        for i in range(n):
            found[i] = henyey_greenstein(cosines[i], phase.g)
    else:
        steps = phase.density.size - 1
        for i in range(n):
            found[i] = math.sqrt(max(0.5 - 0.5 * cosines[i], 0.0)) * steps
        _read(found, n, phase.density)


@kernel
def drawn_cosines(found: Array, u: Array, n: int, phase: PhaseRecord) -> None:
    """`drawn_cosine` by each of the first n of some coordinates."""
    if len(phase) == 2:
        for i in range(n):
            found[i] = henyey_greenstein_cosine(u[i], phase.g)
    else:
        steps = phase.cosines.size - 1
        for i in range(n):
            found[i] = (1.0 - math.sqrt(math.sqrt(1.0 - u[i]))) * steps
        _read(found, n, phase.cosines)


@kernel
def _read(places: Array, n: int, table: Array) -> None:
    """Turn places in a table, counted in its steps, into what it says there."""
    last = table.size - 2
    for i in range(n):
        step = min(int(places[i]), last)
        share = places[i] - step
        places[i] = (1.0 - share) * table[step] + share * table[step + 1]
