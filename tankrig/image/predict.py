"""`predict`: a scene's image by the model that is asked for, or by the cheapest that holds the tolerance."""

from tankrig.errors import SceneError
from tankrig.image.prediction import Prediction
from tankrig.scene import Scene


def predict(
    scene: Scene,
    model: str | None = None,
    tolerance: float = 0.01,
    max_order: int | None = None,
    seed: int = 0,
) -> Prediction:
    """Image that the scene's camera would see.

    Parameters
    ----------
    scene
        Tank, medium, projector and camera.
    model
        None: the tank, whichever way is cheapest. Or "single", "convolution", "tank", "diffuse", "montecarlo".
    tolerance
        Relative L2 error of the image to aim for, 0 < tolerance ≤ 1.
    max_order
        Sum orders of scattering 1 … max_order only; None for all.
    seed
        Of the random numbers, where the model uses any.

    Raises
    ------
    SceneError
        When the model is unknown or cannot treat the scene.
    """
    raise SceneError(f'model = "{model}" is unknown')
