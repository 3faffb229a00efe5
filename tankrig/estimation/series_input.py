"""What was given for a dilution series, checked: doses, images, gain."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tankrig.errors import ImageError
from tankrig.estimation.joint import Array, Doses
from tankrig.estimation.observation import Observation, observe
from tankrig.scene import Scene


def doses_of(doses_ml: ArrayLike, doses_sd_ml: ArrayLike, count: int) -> Doses:
    """Check the doses and group the images by them."""
    ml = _numbers("doses_ml", doses_ml)
    if ml.shape != (count,) or count == 0:
        raise ImageError(f"{count} images but doses_ml has shape {list(ml.shape)}; give one dose for each image")
    if (np.diff(ml) < 0.0).any():
        raise ImageError("doses_ml falls from one image to the next; doses are cumulative, give them as they rose")
    if ml[0] <= 0.0:
        raise ImageError(f"doses_ml begins with {ml[0]:g}, where nothing scatters; leave images without ink out")
    different, first, group = np.unique(ml, return_index=True, return_inverse=True)
    if different.size < 2:
        raise ImageError(
            f"all images are at one dose, {ml[0]:g} ml, which cannot tell ink from water and gain; "
            "give two doses or more, or use estimate"
        )
    sd = _numbers("doses_sd_ml", doses_sd_ml)
    if sd.shape not in ((), (count,)) or (sd < 0.0).any():
        raise ImageError("doses_sd_ml is not a standard deviation for all or one for each image; give zero or more")
    return Doses(different, np.broadcast_to(sd, ml.shape)[first].copy(), np.asarray(group, int))


def observed(
    images: Sequence[ArrayLike], scenes: Sequence[Scene], noise: ArrayLike | Sequence[ArrayLike] | None
) -> list[Observation]:
    """Check the images, each against its scene."""
    one_for_all = noise is None or isinstance(noise, float | int | np.number)
    noises: list[Any] = [noise] * len(images) if one_for_all else list(noise)  # type: ignore[arg-type]
    if len(noises) != len(images):
        raise ImageError(f"{len(images)} images but {len(noises)} noises; give one for all or one for each image")
    observations = []
    for number, (image, scene, sigma) in enumerate(zip(images, scenes, noises, strict=True), start=1):
        try:
            observations.append(observe(image, scene.camera.shape, sigma))
        except ImageError as error:
            raise ImageError(f"image {number} of {len(images)}: {error}") from error
    return observations


def _numbers(name: str, values: ArrayLike) -> Array:
    try:
        array = np.asarray(values, dtype=float)
    except (TypeError, ValueError) as error:
        raise ImageError(f"{name} is not made of numbers; give ml") from error
    if not np.isfinite(array).all():
        raise ImageError(f"{name} holds a number that is not finite; give ml")
    return array


def known(name: str, value: object) -> float | None:
    """A number, or None where free."""
    if isinstance(value, str) and value == "free":
        return None
    if not isinstance(value, float | int | np.number) or not math.isfinite(value) or (name == "gain" and value <= 0.0):
        wanted = "a positive finite number" if name == "gain" else "a finite number"
        raise ImageError(f'{name} = {value!r} cannot be; give "free" or {wanted}')
    return float(value)
