"""Prepared models as the model of a series: each medium by the model whose box holds it best, the tank's where none."""

import math
from collections.abc import Sequence

from tankrig.estimation.series_model import Model, ModelOf, tank_model
from tankrig.image.prepare import Prepared
from tankrig.prediction import Prediction, Skipped
from tankrig.scene.description import Medium, Scene

LATTICES = 4
"""Of light paths, where no prepared model holds a medium."""


def prepared_model(models: Sequence[Prepared]) -> ModelOf:
    """A series' model, see `fit_series`.

    Parameters
    ----------
    models
        Of any scenes and boxes; scenes without any are left to the tank model.
    """

    def model_of(scene: Scene, batches: int, seed: int) -> Model:
        own = [model for model in models if model.scene == scene]
        paths = tank_model(scene, batches if not own else LATTICES, seed)

        def image(medium: Medium) -> Prediction:
            model = min((one for one in own if _inside(one, medium)), key=lambda one: _off(one, medium), default=None)
            if model is None:
                return paths(medium)
            error = Skipped("what the prepared model is off by", model.error_at(medium))
            return Prediction(model.predict(medium), "prepared", skipped=(error,))

        return image

    return model_of


def _inside(model: Prepared, medium: Medium) -> bool:
    box = model.box
    ranges = ((medium.sigma_t, box.sigma_t), (medium.albedo, box.albedo), (medium.g, box.g))
    return all(low <= value <= high for value, (low, high) in ranges)


def _off(model: Prepared, medium: Medium) -> float:
    """Distance from the middle of the box, in halves of its width in log σt."""
    low, high = (math.log(edge) for edge in model.box.sigma_t)
    return abs(2.0 * (math.log(medium.sigma_t) - low) / (high - low) - 1.0)
