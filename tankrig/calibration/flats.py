"""How much more one pixel counts than another of the same light: vignetting and the pixels' own differences."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tankrig.calibration.exposed import Array

_ORDER = 4


@dataclass(frozen=True, eq=False)
class Flat:
    """Response of each pixel, that of the middle being 1.

    Parameters
    ----------
    response
        (rows, columns); hot pixels have that of the smooth fit.
    response_sd
        Of one pixel, from noise.
    vignetting
        Part of the light that is missing in the darkest corner, by the smooth fit.
    uneven
        Standard deviation of the pixels about the smooth fit (PRNU), noise taken out.
    tilt
        Largest difference between the two flats that has to come from the light: half of it is what one flat alone
        would have been wrong by.
    """

    response: Array
    response_sd: float
    vignetting: float
    uneven: float
    tilt: float


def fit_flat(first: Array, turned: Array, noise: float, good: NDArray[np.bool_]) -> Flat:
    """Make a flat of two pictures of a diffuser, between which it was turned by half a turn.

    What the light varies by from side to side changes its sign with the turn and falls out of the mean. A polynomial
    of order 4 in both directions is the lens; what remains are the pixels.

    Parameters
    ----------
    first, turned
        (rows, columns) linear counts above the dark.
    noise
        Relative standard deviation of one pixel of one picture.
    good
        (rows, columns) pixels to use.
    """
    first, turned = first / first[good].mean(), turned / turned[good].mean()
    both, rows, columns = (first + turned) / 2.0, *first.shape
    y, x = np.meshgrid(np.linspace(-1.0, 1.0, rows), np.linspace(-1.0, 1.0, columns), indexing="ij")
    powers = [(i, j) for i in range(_ORDER + 1) for j in range(_ORDER + 1 - i)]
    terms = np.stack([x**i * y**j for i, j in powers], axis=-1)
    smooth = terms @ np.linalg.lstsq(terms[good], both[good], rcond=None)[0]
    tilted = terms @ np.linalg.lstsq(terms[good], (first - turned)[good], rcond=None)[0]
    middle = float(smooth[rows // 2, columns // 2])
    own = float(np.var((both / smooth)[good]))
    sd = noise / np.sqrt(2.0)
    return Flat(
        response=np.where(good, both, smooth) / middle,
        response_sd=sd,
        vignetting=1.0 - float(smooth.min()) / middle,
        uneven=float(np.sqrt(max(own - sd**2, 0.0))),
        tilt=float(np.ptp(tilted)),
    )
