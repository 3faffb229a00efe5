"""Orders 1 and 2 of a scene as forms of a phase function's splines, at a few σt."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tankrig.light.double.pairs import PairTables, double_pairs
from tankrig.light.prepared.phases.plan import PhasePlan
from tankrig.light.prepared.phases.traits import PhaseTraits, splines
from tankrig.light.single import single_scattering_of
from tankrig.scene import Medium, Scene
from tankrig.scene.phase_functions import HenyeyGreenstein
from tankrig.scene.phase_splines import PhaseSplines
from tankrig.scene.phase_table import NODES, PhaseFunction, PhaseRecord, TableRecord

Array = NDArray[np.float64]


@dataclass(frozen=True)
class _Spline(PhaseFunction):
    """One spline in the place of a phase function; only its values are ever asked for."""

    splines: PhaseSplines
    number: int

    @property
    def mean_cosine(self) -> float:
        """Of no meaning."""
        return 0.0

    @property
    def record(self) -> PhaseRecord:
        """Its values."""
        return TableRecord(0.0, 0.5, np.ascontiguousarray(self.splines.at_nodes[:, self.number]), np.zeros(NODES))


@dataclass(frozen=True)
class LowOrders:
    """At one σt, over σs and σs².

    Parameters
    ----------
    traits
        Of phase functions.
    once
        (splines, pixels) of order 1.
    twice
        Of order 2.
    """

    traits: PhaseTraits
    once: Array
    twice: PairTables

    def images(self, numbers: Array) -> Array:
        """(2, pixels) of a phase function's traits."""
        second = self.twice.image(numbers[self.traits.twice])
        return np.stack([numbers[self.traits.once] @ self.once, second.ravel()])


def low_orders_at(scene: Scene, plan: PhasePlan, sigma_t: float) -> LowOrders:
    """Orders 1 and 2 at one σt."""
    fine, coarse = splines(plan.traits.once_deg), splines(plan.traits.twice_deg)
    at_all = replace(scene, medium=Medium(0.0, sigma_t, phase=HenyeyGreenstein(0.0)))
    media = [Medium(0.0, sigma_t, phase=_Spline(fine, number)) for number in range(fine.count)]
    images = single_scattering_of(at_all, media) / sigma_t
    return LowOrders(plan.traits, images.reshape(fine.count, -1), double_pairs(at_all, coarse))
