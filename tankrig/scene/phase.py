"""Phase functions as kernels read them: how likely a scattering turns by an angle θ (the paper's Eq. 5, corrected).

Henyey–Greenstein is a formula; any other phase function is a table, dense where p may be steep: it has even steps in
sin(θ/2), of which cos θ is a quadratic, and is linear between them. Kernels take either record, are compiled for each
when it is first used, and tell them apart by their length, which costs nothing then: a choice made while they run kept
compilers from vectorising the loops over paths (measured: 2 ×).
"""

import math

from tankrig.compiled import kernel, part
from tankrig.scene.phase_table import PhaseRecord


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
