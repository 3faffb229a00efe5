"""What single scattering would say: the best that a model of light scattered once can do with the same photographs."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tankrig.estimation.scaling import Scaling
from tankrig.light.single import single_scattering
from tankrig.live.exposures import Photograph
from tankrig.scene.description import Medium

REACH = 10.0
"""σt is looked for from the tank model's by this down to this up."""
LOOKS = 9
FINELY = 0.002
"""Of log σt, which is found to so much."""


def fit_single(photographs: Sequence[Photograph], liquid: Medium) -> tuple[float, float]:
    """σt that fits best when all light is taken to be scattered once, and the RMSE that is left.

    Gain is free and common; g and albedo are those of the tank model's fit. Light that goes one way and is seen from
    one side has one angle of scattering, and then g, albedo and gain are one and the same number to this model: σt is
    all that it can tell.

    Parameters
    ----------
    photographs
        Of one liquid.
    liquid
        The tank model's fit of it.
    """
    from scipy.optimize import minimize_scalar

    used = [one.used for one in photographs]
    weight = np.concatenate([1.0 / one.noise[counts] for one, counts in zip(photographs, used, strict=True)])
    observed = np.concatenate([one.image[counts] for one, counts in zip(photographs, used, strict=True)])
    scaling = Scaling(None, 0.0 if photographs[0].offset == 0.0 else None)

    def residual(log_sigma_t: float) -> np.ndarray:
        by = math.exp(log_sigma_t) / liquid.sigma_t
        medium = replace(liquid, sigma_a=by * liquid.sigma_a, sigma_s=by * liquid.sigma_s)
        images = [single_scattering(replace(one.scene, medium=medium)) for one in photographs]
        model = np.concatenate([image[counts] for image, counts in zip(images, used, strict=True)])
        gain, (offset,) = scaling.solve([weight * model], [weight], [weight * observed])
        return observed - gain * model - offset

    def cost(log_sigma_t: float) -> float:
        return float(np.sum((weight * residual(log_sigma_t)) ** 2))

    at, reach = math.log(liquid.sigma_t), math.log(REACH)
    looks = np.linspace(at - reach, at + reach, LOOKS)
    near = int(np.argmin([cost(float(one)) for one in looks]))
    bounds = (float(looks[max(near - 1, 0)]), float(looks[min(near + 1, LOOKS - 1)]))
    best = float(minimize_scalar(cost, bounds=bounds, method="bounded", options={"xatol": FINELY}).x)
    return math.exp(best), float(np.sqrt(np.mean(residual(best) ** 2)))
