"""Forward models as a series of doses sees them: few light paths for its steps, more of them, or prepared models.

A series has many images and no time for exact ones: its accurate version corrects the quick one at the optimum.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING

from tankrig.estimation.followed import Model, in_water, remembered
from tankrig.estimation.forward import SMOOTHED_BATCHES, low_orders_of
from tankrig.estimation.phase_families import Family
from tankrig.estimation.stated_errors import stated_error
from tankrig.estimation.versions import Models
from tankrig.prediction import Prediction, Skipped
from tankrig.scene import Medium, Scene

if TYPE_CHECKING:
    from tankrig.image.prepare import Prepared

ModelOf = Callable[[Scene, int, int], Model]
"""From a scene, a number of batches and a seed to a model; many batches are accurate, and few are quick."""

QUICK_BATCHES, ACCURATE_BATCHES = 2, 8
"""Lattices of the images of a series: of those that steps are made with, and of those that correct them."""
LATTICES = 4
"""Lattices of light paths in each image of a series, where no prepared model holds the medium."""
PURE_WATER_SIGMA_S = 1.9e-6
"""What pure water itself scatters of green light, 1/mm, as much forwards as backwards (Morel 1974)."""


def series_models(
    scene: Scene, model_of: ModelOf, family: Family | None = None, low_of: ModelOf | None = None
) -> Models:
    """A series' models as versions of one: steps by the quick one, corrections by the accurate one.

    What few lattices say about their noise in each pixel is noise itself: it counts in proportion to the image.

    Parameters
    ----------
    scene
        Its medium does not matter.
    model_of
        What is fitted.
    family
        Of phase functions; None: Henyey–Greenstein.
    low_of
        The model's orders 1 and 2, where they are to be had alone.
    """

    def even(model: Model) -> Model:
        def image(medium: Medium) -> Prediction:
            found = model(medium)
            return replace(found, stderr=None, skipped=(Skipped("noise, and what was left out", stated_error(found)),))

        return lru_cache(maxsize=64)(image)

    quick, accurate = (
        even(model_of(scene, batches, seed)) for batches, seed in ((QUICK_BATCHES, 0), (ACCURATE_BATCHES, 1))
    )
    low = None if low_of is None else remembered(low_of(scene, 0, 0))
    return Models(quick, None, exact=lambda medium, _: accurate(medium), central=False, family=family, low=low)


def tank_model(scene: Scene, batches: int, seed: int) -> Model:
    """The tank's image by a fixed number of lattices of light paths: a smooth function of the medium."""
    from tankrig.light.rays import shift_invariant
    from tankrig.light.tank import tank_image

    if not shift_invariant(scene):
        batches = max(batches, SMOOTHED_BATCHES)

    def image(medium: Medium) -> Prediction:
        return tank_image(replace(scene, medium=medium), seed=seed, batches=batches)

    return image


def low_orders_model(scene: Scene, _batches: int, _seed: int) -> Model:
    """Orders 1 and 2 of the tank's image, which follow no paths."""
    found = low_orders_of(scene)
    assert found is not None
    return found


def modelled_in_water(model_of: ModelOf, sigma_s: float) -> ModelOf:
    """A series' model of ink in water that scatters by itself, see `in_water`."""
    if sigma_s == 0.0:
        return model_of

    def mixed(scene: Scene, batches: int, seed: int) -> Model:
        model = model_of(scene, batches, seed)
        return lambda ink: model(in_water(ink, sigma_s))

    return mixed


def prepared_model(models: "Sequence[Prepared]") -> ModelOf:
    """Prepared models as a series' model: each medium by the one whose box holds it best, the tank's where none does.

    Parameters
    ----------
    models
        Of any scenes and boxes; scenes without any are left to the tank model.
    """

    def model_of(scene: Scene, batches: int, seed: int) -> Model:
        own = [model for model in models if model.scene == scene]
        paths = tank_model(scene, batches if not own else LATTICES, seed)

        def image(medium: Medium) -> Prediction:
            holding = [one for one in own if (medium.phase is None or one.phases == "any") and one.box.holds(medium)]
            model = min(holding, key=lambda one: _off(one, medium), default=None)
            if model is None:
                return paths(medium)
            error = Skipped("what the prepared model is off by", model.error_at(medium))
            return Prediction(model.predict(medium), "prepared", skipped=(error,))

        return image

    return model_of


def _off(model: "Prepared", medium: Medium) -> float:
    """Distance from the middle of the box, in halves of its width in log σt."""
    low, high = (math.log(edge) for edge in model.box.sigma_t)
    return abs(2.0 * (math.log(medium.sigma_t) - low) / (high - low) - 1.0)
