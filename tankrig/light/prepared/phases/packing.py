"""A model of any phase function as the arrays of a file, and back."""

import numpy as np
from numpy.typing import NDArray

from tankrig.light.prepared.phases.answer import HighOrders, LowOrder, PhaseAnswer
from tankrig.light.prepared.phases.plan import PhasePlan
from tankrig.light.prepared.phases.products import Excess

Arrays = dict[str, NDArray[np.generic]]

_MOST_SCALE = 600.0
"""Of a logarithm: beyond it there is no number."""


def packed(answer: PhaseAnswer) -> Arrays:
    """All that the scene and the plan don't say."""
    return {
        "patterns": answer.patterns, "error": answer.error, "mean": answer.rest.excess.mean,
        "directions": answer.rest.excess.directions, "once": answer.once.amplitudes, "once_scale": answer.once.scale,
        "twice": answer.twice.amplitudes, "twice_scale": answer.twice.scale, "rest": answer.rest.amplitudes,
        "rest_scale": answer.rest.scale,
    }  # fmt: skip


def unpacked(arrays: Arrays, plan: PhasePlan, shape: tuple[int, int]) -> PhaseAnswer:
    """The model again.

    Raises
    ------
    KeyError, TypeError, ValueError
        When the arrays are not those of a model of that plan and a camera of that shape.
    """
    known = {name: np.asarray(one, np.float32 if name in _SINGLE else float) for name, one in arrays.items()}
    traits, products, scale_products = plan.traits, plan.products, plan.scale_products
    degrees, count = len(plan.low_sigma_t), len(known["patterns"])
    once, twice = (part.stop - part.start for part in (traits.once, traits.twice))
    excess = Excess(known["mean"], known["directions"])
    expected = {
        "patterns": (count, shape[0] * shape[1]), "error": (4,), "mean": (traits.highest - 1,),
        "directions": (traits.highest - 1, products.directions), "once": (degrees, once, count),
        "once_scale": (degrees,), "twice": (twice, degrees, twice, count), "twice_scale": (degrees,),
        "rest": (len(plan.base.albedos), products.size, count),
        "rest_scale": (len(plan.base.albedos), scale_products.size),
    }  # fmt: skip
    if count == 0 or any(
        known[name].shape != size or not np.isfinite(known[name]).all() for name, size in expected.items()
    ):
        raise ValueError("not the arrays of a prepared model")
    if any(float(np.abs(known[f"{name}_scale"]).sum()) > _MOST_SCALE for name in ("once", "twice", "rest")):
        raise ValueError("not the arrays of a prepared model")
    return PhaseAnswer(
        plan.base.coordinates, traits, LowOrder(1, known["once_scale"], known["once"]),
        LowOrder(2, known["twice_scale"], known["twice"]),
        HighOrders(excess, products, scale_products, known["rest"], known["rest_scale"]), known["patterns"], shape,
        known["error"],
    )  # fmt: skip


_SINGLE = ("patterns", "once", "twice")
