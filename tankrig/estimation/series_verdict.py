"""What a person should know about a dilution series, in plain sentences."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.verdict import what_is_left

NAMES = ("sigma_a", "sigma_s", "g", "water_sigma_a")
"""Coefficients in the order of a series' covariance."""
SYMBOLS = {"sigma_a": "σa", "sigma_s": "σs", "g": "g"}


@dataclass(frozen=True)
class Linearity:
    """By how much the ink does more (+) or less (−) than in proportion to its dose, at the highest: share and error."""

    bend: float
    sd: float

    @property
    def holds(self) -> bool:
        """Whether the bend is within three standard deviations of none."""
        return abs(self.bend) <= 3.0 * self.sd


def series_verdict(
    water: float,
    spread: NDArray[np.float64],
    known: Mapping[str, bool],
    linearity: Linearity | None,
    left: tuple[float, float, float],
) -> str:
    """What is determined, whether the ink acts in proportion to its dose, and what the residuals say.

    Parameters
    ----------
    water
        Its σa, 1/mm.
    spread
        (4, 4) covariance in the order of `NAMES`.
    known
        By name, whether it is determined.
    linearity
        None where it could not be tested.
    left
        Arguments of `what_is_left`.
    """
    yes = [symbol for name, symbol in SYMBOLS.items() if known[name]]
    no = [symbol for name, symbol in SYMBOLS.items() if not known[name]]
    sentences = []
    if not no:
        sentences.append("The series determines σa and σs of the ink per ml, and g.")
    else:
        missing = " and ".join(no)
        sentences.append(
            f"The series determines {' and '.join(yes) or 'nothing'} of the ink, but not {missing}: take images at "
            "lower and higher doses, or with more patterns."
        )
    sd = math.sqrt(float(spread[3, 3]))
    if known["water_sigma_a"]:
        sentences.append(f"Water alone absorbs {water:.3g} ± {sd:.1g} /mm.")
    else:
        sentences.append(f"The water's own absorption is below {water + 2.0 * sd:.1g} /mm.")
    if linearity is None:
        sentences.append("Two doses cannot show whether the ink acts in proportion to its dose.")
    else:
        bend = f"{100.0 * linearity.bend:+.2g} ± {100.0 * linearity.sd:.1g} % at the highest dose"
        sentences.append(
            f"The ink acts in proportion to its dose ({bend})." if linearity.holds else
            f"The ink does not act in proportion to its dose ({bend}): the doses are wrong, the ink had not mixed, or "
            "it clumps or settles; the coefficients are not to be trusted."
        )  # fmt: skip
    sentences.append(what_is_left(*left))
    return " ".join(sentences)
