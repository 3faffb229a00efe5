"""The tank model: what is exact, and as much of the rest as the tolerance asks for."""

import math
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from tankrig.light.double import double_scattering
from tankrig.light.moments.plan import moment_plan
from tankrig.light.single import single_scattering
from tankrig.light.tank.high_orders import high_orders
from tankrig.orders import ORDER_CLASSES
from tankrig.prediction import Prediction, Skipped
from tankrig.scene import Scene

Array = NDArray[np.float64]

NOISE_SHARE = 0.7
"""Share of the tolerance that the noise of orders ≥ 3 may use up."""


def tank_image(
    scene: Scene, tolerance: float = 0.01, max_order: int | None = None, seed: int = 0, batches: int | None = None
) -> Prediction:
    """Image of the finite tank: black walls, matched or Fresnel surface.

    Parameters
    ----------
    scene
        Any scene.
    tolerance
        Relative L2 error of the image to stay below.
    max_order
        Sum orders 1 … max_order only.
    seed
        Of the paths' lattice.
    batches
        A fixed number of shifted lattices instead of what the tolerance asks for: the image is then a smooth
        function of the medium.

    Returns
    -------
    Prediction
        With images of the classes 1, 2, 3, "4-20" and ">20", dark where they were not asked for.

    Examples
    --------
    >>> from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank
    >>> light = Projector("collimated", (Beam((-2.0, 2.0), (58.0, 62.0)),))
    >>> scene = Scene(Tank(), Medium(0.0002, 0.0198, 0.5), light, Camera("orthographic", (80, 120), 2.0))
    >>> image = tank_image(scene, tolerance=0.05)
    >>> [round(float(image.orders[order].sum() / image.image.sum()), 2) for order in (1, 2)]
    [0.14, 0.24]
    """
    highest = max_order or 1_000_000
    orders: dict[int | str, Array] = {1: single_scattering(scene)}
    zero = np.zeros(scene.camera.shape)
    stderr, skipped = zero, [Skipped("light that leaves the tank through its black walls", 0.0)]
    if highest >= 2:
        orders[2] = double_scattering(scene, tolerance)
    known = sum(orders.values(), zero)
    if highest >= 3 and scene.medium.sigma_s > 0.0:
        faintest = 0.01 * tolerance
        noise = NOISE_SHARE * tolerance
        plan = None if max_order or batches else moment_plan(scene, tolerance)
        if plan is None:
            high = high_orders(scene, known, noise, max_order, seed, batches, faintest)
            orders |= high.by_class
        else:
            from tankrig.light.moments.dense import dense_orders

            dense = dense_orders(scene, plan, seed)
            noise = 0.7 * math.sqrt(tolerance**2 - plan.bound**2)
            high = high_orders(scene, known + dense.image, noise, plan.above, seed, faintest=faintest)
            orders |= high.by_class
            orders["4-20"], orders[">20"] = orders["4-20"] + dense.to_20, dense.beyond_20
            what = f"above order {plan.above}, degrees beyond {plan.degree} and cells below {plan.side_mm:.1f} mm"
            skipped.append(Skipped(what, plan.bound))
        stderr = high.stderr
        skipped.append(Skipped(f"paths fainter than {faintest:.0e} of their start", 2 * faintest))
    whole = {key: orders.get(key, zero) for key in ORDER_CLASSES}
    image = np.sum(list(whole.values()), axis=0)
    return Prediction(image, "tank", MappingProxyType(whole), stderr, tuple(skipped))
