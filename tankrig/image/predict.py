"""`predict`: a scene's image by the model that is asked for, or by the one that knows the tank."""

import math
import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from tankrig.errors import SceneError
from tankrig.prediction import Image, Prediction, Skipped
from tankrig.scene import Scene

BUDGET_S = 120.0
"""Seconds that a prediction may take."""

MODELS = ("tank", "single", "convolution", "diffuse", "montecarlo")
"""Names that `predict` knows."""
BLACK_WALLS = ("convolution", "diffuse")
"""Those that know no walls that reflect."""
MOST_SEED = 2**63 - 1


def predict(
    scene: Scene,
    model: str | None = None,
    tolerance: float = 0.01,
    max_order: int | None = None,
    seed: int = 0,
    budget_s: float = BUDGET_S,
    progress: Callable[[float], object] | None = None,
) -> Prediction:
    """Image that the scene's camera would see.

    Parameters
    ----------
    scene
        Tank, medium, projector and camera.
    model
        None: the tank, whichever way is cheapest. Or "single" (order 1), "convolution" (the paper's light field in
        infinite space, lit volume and lines of sight cut to the tank), "tank", "diffuse", "montecarlo".
    tolerance
        Relative L2 error of the image to aim for, 0 < tolerance ≤ 1.
    max_order
        Sum orders of scattering 1 … max_order only; None for all.
    seed
        Of the random numbers, where the model uses any.
    budget_s
        Seconds that the tank's model may take to keep the tolerance; then the best image so far is returned. The other
        models take what they take.
    progress
        Called with the share of the work that is done, 0 … 1, again and again by the tank's model; an exception that it
        raises ends the work.

    Returns
    -------
    Prediction
        Its `error` is what it states, and its `missed` says where that is more than the tolerance.

    Raises
    ------
    SceneError
        When the model is unknown or cannot treat the scene, or a tolerance, order, seed or budget is out of range.

    Warns
    -----
    UserWarning
        When the tolerance isn't kept: `Prediction.missed`.

    Examples
    --------
    >>> from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank
    >>> light = Projector("collimated", (Beam((-2.0, 2.0), (58.0, 62.0)),))
    >>> scene = Scene(Tank(), Medium(0.0002, 0.0198, 0.5), light, Camera("orthographic", (80, 120), 2.0))
    >>> prediction = predict(scene, model="single")
    >>> prediction.image.shape, prediction.skipped[0].what
    ((80, 120), 'orders above 1')
    """
    if not 0.0 < tolerance <= 1.0:
        raise SceneError(f"tolerance = {tolerance} is outside 0 … 1; give a relative error such as 0.01")
    if max_order is not None and max_order < 1:
        raise SceneError(f"max_order = {max_order} is below 1; give the highest order of scattering to sum")
    if not budget_s > 0.0:
        raise SceneError(f"budget_s = {budget_s} is not positive; give the seconds that a prediction may take")
    if not 0 <= seed <= MOST_SEED:
        raise SceneError(f"seed = {seed} is no seed; give a whole number from 0 to {MOST_SEED}")
    name = "tank" if model is None else model
    if name in BLACK_WALLS and not scene.tank.faces.dark:
        raise SceneError(
            f'tank.faces reflect, which model = "{name}" cannot treat; use model = "tank" or "montecarlo", or leave '
            "the faces out"
        )
    began = time.perf_counter()
    if name == "tank":
        from tankrig.light.tank import tank_image

        prediction = tank_image(scene, tolerance, max_order, seed, budget_s=budget_s, progress=progress)
    else:
        prediction = _through_lenses(scene, name, tolerance, max_order, seed)
    if prediction.error > tolerance:
        spent = name == "tank" and time.perf_counter() - began >= budget_s
        why = f"it took all of budget_s = {budget_s:g}" if spent else why_missed(prediction, tolerance)
        do = "a longer budget" if spent else "another model"
        missed = (
            f'the image of model = "{name}" may be wrong by {prediction.error:.2g} of its L2 norm, more than the '
            f"tolerance of {tolerance:g} ({why}); give {do} or a larger tolerance"
        )
        warnings.warn(missed, UserWarning, stacklevel=2)
        return replace(prediction, missed=missed)
    return prediction


def why_missed(prediction: Prediction, tolerance: float) -> str:
    """The largest part of a prediction's stated error that alone is more than the tolerance; else its noise.

    Examples
    --------
    >>> dark = Prediction(np.zeros((2, 2)), "tank", skipped=(Skipped("tables", 0.001), Skipped("all light", 1.0)))
    >>> why_missed(dark, 0.01)
    'left out: all light'
    """
    finite = [part for part in prediction.skipped if tolerance < part.bound < math.inf]
    if not finite:
        return "its noise and what was left out together"
    # Of equal ones the last: that no light is seen at all is told after which orders are not.
    return f"left out: {max(reversed(finite), key=lambda part: part.bound).what}"


def _by_model(
    scene: Scene, name: str, tolerance: float, max_order: int | None, seed: int, coarsen: int = 1
) -> Prediction:
    if name == "single":
        return _single(scene)
    if name == "convolution":
        return _convolution(scene, tolerance, max_order)
    if name == "diffuse":
        return _diffuse(scene, max_order)
    if name == "montecarlo":
        return _montecarlo(scene, tolerance, max_order, seed, coarsen)
    raise SceneError(f'model = "{name}" is unknown; use one of {", ".join(MODELS)}')


def _through_lenses(scene: Scene, name: str, tolerance: float, max_order: int | None, seed: int) -> Prediction:
    """By a model, of which all but single scattering know sharp beams and an ideal camera only: the sum over what the
    projector's lens makes of its light, seen through the camera's."""
    from tankrig.light.entering import entering, is_plain, through_lens
    from tankrig.light.leaving import CameraLens

    lens = CameraLens.of(scene)
    if name == "single" or (lens is None and is_plain(scene)):
        return _by_model(scene, name, tolerance, max_order, seed)
    lit = scene if lens is None else lens.fine
    coarsen = 1 if lens is None else min(lens.parts)
    parts = [
        (share, _by_model(one, name, tolerance, max_order, seed + number, coarsen))
        for number, (share, one) in enumerate(through_lens(entering(lit, fine=True), fine=True))
    ]
    shares, found = np.array([share for share, _ in parts]), [one for _, one in parts]

    def seen(images: list[Image], weights: NDArray[np.float64]) -> NDArray[np.float64]:
        image = np.tensordot(weights, np.array(images, float), 1)
        return image if lens is None else lens.of_fine(image)

    orders = {key: seen([one.orders[key] for one in found], shares) for key in found[0].orders}
    image = seen([one.image for one in found], shares)
    noise = [one.stderr**2 for one in found if one.stderr is not None]
    stderr = np.sqrt(np.maximum(seen(noise, shares**2), 0.0)) if noise else None
    return replace(found[0], image=image, orders=MappingProxyType(orders), stderr=stderr)


def _single(scene: Scene) -> Prediction:
    from tankrig.light.tank import low_orders

    image = low_orders(scene, 1.0, highest=1)
    bound = float("inf") if scene.medium.sigma_s > 0.0 else 0.0
    return Prediction(image, "single", MappingProxyType({1: image}), None, (Skipped("orders above 1", bound),))


def _convolution(scene: Scene, tolerance: float, max_order: int | None) -> Prediction:
    from tankrig.light.lightfield import left_out, lightfield_orders

    orders = lightfield_orders(scene, max_order, tolerance)
    skipped = tuple(Skipped(*item) for item in left_out(scene, tolerance))
    return Prediction(np.sum(list(orders.values()), axis=0), "convolution", MappingProxyType(orders), None, skipped)


def _diffuse(scene: Scene, max_order: int | None) -> Prediction:
    from tankrig.light.diffuse import diffuse_image

    if max_order is not None:
        raise SceneError(
            f'max_order = {max_order} has no meaning for model = "diffuse", which has no orders; leave it out'
        )
    skipped = (Skipped("how light's directions differ from nearly even", float("inf")),)
    return Prediction(diffuse_image(scene), "diffuse", skipped=skipped)


def _montecarlo(scene: Scene, tolerance: float, max_order: int | None, seed: int, coarsen: int) -> Prediction:
    from tankrig.montecarlo import simulate_to

    tally = simulate_to(scene, tolerance, seed=seed, max_order=max_order, coarsen=coarsen)
    return Prediction(tally.image, "montecarlo", MappingProxyType(tally.orders), tally.stderr)
