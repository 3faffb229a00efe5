"""Spheres of any size as a family of phase functions, and which of them are like what an image says.

Mie's p goes up and down within some per cent of the diameter, so that a search by images from a few places would end
beside it. But what an image says of a free phase function's shapes fits into a dozen numbers, and by these every sphere
is tried in a millisecond.
"""

import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.phase_families import PLACES, Family, amplitudes_of
from tankrig.scene.mie import Mie
from tankrig.scene.mie_series import scattered_by

Array = NDArray[np.float64]

WAVELENGTH_NM, WATER_INDEX = 633.0, 1.3317
"""Light and water that spheres are computed for: of a phase function only the diameter in wavelengths and the ratio of
the indices tell."""
SMALLEST_UM, LARGEST_UM, STEP = 0.06, 6.0, 0.01
"""Diameters that are looked at, and the step from one to the next, as a share."""
RATIOS = (1.03, 1.06, 1.1, 1.15, 1.19, 1.24)
"""Indices over water's: cells, silica, oil, acrylic, polystyrene, melamine."""
SPREADS = (0.02, 0.06, 0.15, 0.35)
"""Standard deviations of the diameters over their mean."""
WORSE = 16.0
"""By how much further off than the best of a look, squared, others of it may be, for it goes in steps."""
APART = 0.05
"""Logarithm of a diameter within which other places of the look are the same mode."""


def spheres() -> Family:
    """Logarithms of the diameter, of the index over water's less 1, and of the spread of the diameters."""
    middle = np.log([0.6, 0.12, 0.08])

    def member(at: Array) -> Mie:
        diameter, beyond, spread = np.exp(at).tolist()
        return Mie(diameter, WATER_INDEX * (1.0 + beyond), WATER_INDEX, WAVELENGTH_NM, spread)

    def coordinates(one: Mie) -> Array:
        by_wavelength = one.water_index / one.wavelength_nm * WAVELENGTH_NM / WATER_INDEX
        beyond = one.particle_index / one.water_index - 1.0
        return np.log([one.diameter_um * by_wavelength, beyond, max(one.spread, 0.005)])

    return Family(
        "spheres", ("log diameter", "log(index - 1)", "log spread"),
        np.log([SMALLEST_UM, 0.02, 0.005]), np.log([LARGEST_UM, 0.4, 0.5]), np.array([0.05, 0.2, 0.7]),
        np.array([0.002, 0.02, 0.1]), np.array([1.2, 0.5, 1.2]), member, coordinates, lambda _: middle, finer=True,
        describe=described, kind=Mie.kind,
    )  # fmt: skip


def described(one: Mie) -> dict[str, float]:
    """What images tell of spheres: neither the light's wavelength nor the water's index is among it."""
    return {
        "diameter_in_wavelengths": 1e3 * one.diameter_um / one.wavelength_nm,
        "index_over_water": one.particle_index / one.water_index,
        "spread": one.spread,
    }


def likely(misfit_of: Callable[[Array], Array], base: float, count: int, enough: float) -> list[Array]:
    """Coordinates of the likeliest spheres, best first.

    Parameters
    ----------
    misfit_of
        From (n, shapes) amplitudes of a free phase function to (n,) how much each is off what was seen, squared.
    base
        atanh of the asymmetry that the free ones start from.
    count
        How many at most, of different diameters.
    enough
        How far off, squared, they may be.
    """
    places, densities = _looked_at()
    off = misfit_of(amplitudes_of(densities, base))
    found: list[Array] = []
    best = float(off.min())
    for k in np.argsort(off):
        if off[k] > min(enough, best + WORSE):
            break
        if all(abs(places[k, 0] - one[0]) > APART for one in found):
            found.append(places[k])
        if len(found) == count:
            break
    return found


@lru_cache(maxsize=1)
def _looked_at() -> tuple[Array, Array]:
    """(n, 3) coordinates of spheres, and (n, places) p of these at `PLACES`, up to a factor."""
    diameters = np.exp(np.arange(math.log(SMALLEST_UM), math.log(LARGEST_UM), STEP))
    logarithms = np.log(diameters)
    places, densities = [], []
    for ratio in RATIOS:
        _, whole, _ = scattered_by(diameters, ratio, 2e3 * math.pi * WATER_INDEX / WAVELENGTH_NM, PLACES)
        for spread in SPREADS:
            width = math.sqrt(math.log1p(spread**2))
            numbers = np.exp(-0.5 * ((logarithms[:, None] + 0.5 * width**2 - logarithms) / max(width, STEP)) ** 2)
            densities.append(numbers.T @ whole)
            places.append([[one, math.log(ratio - 1.0), math.log(spread)] for one in logarithms])
    return np.concatenate(places), np.concatenate(densities)
