"""What a series is fitted with: the tank model of a medium, and of ink in water that scatters by itself."""

from collections.abc import Callable
from dataclasses import replace

from tankrig.estimation.models import SMOOTHED_BATCHES
from tankrig.prediction import Prediction
from tankrig.scene import Medium, Scene

Model = Callable[[Medium], Prediction]
ModelOf = Callable[[Scene, int, int], Model]
"""From a scene, a number of batches and a seed to a model; many batches are accurate, and few are quick."""

PURE_WATER_SIGMA_S = 1.9e-6
"""What pure water itself scatters of green light, 1/mm, as much forwards as backwards (Morel 1974)."""


def tank_model(scene: Scene, batches: int, seed: int) -> Model:
    """The tank's image by a fixed number of lattices of light paths: a smooth function of the medium."""
    from tankrig.light.rays import shift_invariant
    from tankrig.light.tank import tank_image

    if not shift_invariant(scene):
        batches = max(batches, SMOOTHED_BATCHES)

    def image(medium: Medium) -> Prediction:
        return tank_image(replace(scene, medium=medium), seed=seed, batches=batches)

    return image


def in_water(model_of: ModelOf, sigma_s: float) -> ModelOf:
    """The same of ink in water that scatters by itself: coefficients add up, and g is the mean over what scatters.

    Parameters
    ----------
    model_of
        What is fitted.
    sigma_s
        The water's, 1/mm, isotropic.
    """
    if sigma_s == 0.0:
        return model_of

    def mixed(scene: Scene, batches: int, seed: int) -> Model:
        model = model_of(scene, batches, seed)

        def image(ink: Medium) -> Prediction:
            whole = ink.sigma_s + sigma_s
            return model(Medium(ink.sigma_a, whole, ink.g * ink.sigma_s / whole))

        return image

    return mixed
