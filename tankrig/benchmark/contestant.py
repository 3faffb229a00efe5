"""The ways of making an image that are compared."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tankrig.scene import Scene

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Contestant:
    """A model and how hard it tries.

    Parameters
    ----------
    model
        A name that `tankrig.predict` knows, or "prepared".
    tolerance
        What is asked of it; None where it can't be asked.
    photons
        Of "montecarlo", instead of a tolerance.
    max_order
        Sum orders 1 … max_order only.
    """

    model: str
    tolerance: float | None = None
    photons: int | None = None
    max_order: int | None = None

    @property
    def label(self) -> str:
        """The model and its setting, for tables."""
        if self.photons is not None:
            return f"{self.model}, {self.photons:.0e} photons"
        return f"{self.model}, {self.tolerance:.2%}" if self.tolerance is not None else self.model

    def maker(self, scene: Scene) -> Callable[[], Array]:
        """What makes its image of a scene; only "prepared" does some of the work before.

        Raises
        ------
        SceneError
            When the model cannot treat the scene; also when the image is made.
        """
        from tankrig.image.predict import predict
        from tankrig.image.prepare import prepare
        from tankrig.montecarlo import simulate

        if self.model == "prepared":
            live = prepare(scene)
            return lambda: live.predict(scene.medium)
        if self.photons is not None:
            photons = self.photons
            return lambda: simulate(scene, photons, seed=7).image
        tolerance = self.tolerance or 0.01
        return lambda: np.asarray(predict(scene, self.model, tolerance, self.max_order).image, np.float64)


def contestants(quick: bool = False) -> tuple[Contestant, ...]:
    """All of them, or few that are done within seconds."""
    if quick:
        tank = (Contestant("tank", 0.1), Contestant("tank", 0.01))
        return (*tank, Contestant("single"), Contestant("montecarlo", photons=10_000))
    each = (Contestant("tank", tolerance) for tolerance in (0.1, 0.03, 0.01, 0.005, 0.002))
    photons = (Contestant("montecarlo", photons=count) for count in (10_000, 100_000, 1_000_000))
    others = (Contestant("single"), Contestant("convolution", 0.01), Contestant("diffuse"), Contestant("prepared"))
    return (*each, *photons, *others)
