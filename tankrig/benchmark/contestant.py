"""The ways of making an image that are compared."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.util import find_spec

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
        A name that `tankrig.predict` knows, "prepared", "plain" or "mitsuba".
    tolerance
        What is asked of it; None where it can't be asked.
    samples
        Instead of a tolerance: photons of "montecarlo" and "plain", paths per pixel of "mitsuba".
    max_order
        Sum orders 1 … max_order only.
    """

    model: str
    tolerance: float | None = None
    samples: int | None = None
    max_order: int | None = None

    @property
    def label(self) -> str:
        """The model and its setting, for tables."""
        if self.samples is not None:
            count = f"{self.samples} per pixel" if self.model == "mitsuba" else f"{self.samples:.0e} photons"
            return f"{self.model}, {count}"
        return f"{self.model}, {self.tolerance:.2%}" if self.tolerance is not None else self.model

    def warm(self, scene: Scene) -> None:
        """Make an image that doesn't count, for its code to be compiled."""
        (self if self.samples is None else replace(self, samples=1)).maker(scene)()

    def maker(self, scene: Scene) -> Callable[[], Array]:
        """What makes its image of a scene; only "prepared" does some of the work before.

        Raises
        ------
        SceneError
            When the model cannot treat the scene; also when the image is made.
        """
        from tankrig.image.predict import predict

        if self.model == "prepared":
            from tankrig.image.prepare import prepare

            live = prepare(scene)
            return lambda: live.predict(scene.medium)
        if self.samples is not None:
            simulated, samples = _SIMULATORS[self.model], self.samples
            return lambda: simulated(scene, samples)
        tolerance = self.tolerance or 0.01
        return lambda: np.asarray(predict(scene, self.model, tolerance, self.max_order).image, np.float64)


def _montecarlo(scene: Scene, samples: int) -> Array:
    from tankrig.montecarlo import simulate

    return simulate(scene, samples, seed=7).image


def _plain(scene: Scene, samples: int) -> Array:
    from tankrig.benchmark.plain import plain_image

    return plain_image(scene, samples, seed=7)


def _mitsuba(scene: Scene, samples: int) -> Array:
    from tankrig.benchmark.mitsuba_tank import mitsuba_image

    return mitsuba_image(scene, samples, seed=7)


_SIMULATORS = {"montecarlo": _montecarlo, "plain": _plain, "mitsuba": _mitsuba}


def contestants(quick: bool = False, prepared: bool = False) -> tuple[Contestant, ...]:
    """All that take part.

    Parameters
    ----------
    quick
        Few, which are done within seconds.
    prepared
        Also prepared models, which take minutes per case to prepare.
    """
    if quick:
        tank = (Contestant("tank", 0.1), Contestant("tank", 0.01))
        return (*tank, Contestant("single"), *_sampled("montecarlo", 10_000), *_sampled("plain", 100_000))
    return (
        *(Contestant("tank", tolerance) for tolerance in (0.1, 0.03, 0.01, 0.005, 0.002)),
        *(Contestant("single"), Contestant("convolution", 0.01), Contestant("diffuse")),
        *((Contestant("prepared"),) if prepared else ()),
        *_sampled("montecarlo", 10_000, 100_000, 1_000_000),
        *_sampled("plain", 100_000, 1_000_000, 4_000_000),
        *(_sampled("mitsuba", 16, 64, 256) if find_spec("mitsuba") else ()),
    )


def _sampled(model: str, *counts: int) -> tuple[Contestant, ...]:
    return tuple(Contestant(model, samples=count) for count in counts)
