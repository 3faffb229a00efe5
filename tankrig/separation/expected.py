"""What a model of the liquid says of separated light, order by order, and what order 1 says of the liquid."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from scipy.optimize import minimize_scalar

from tankrig.bench import Bench
from tankrig.errors import ImageError
from tankrig.pattern.kinds import Sheet, Wave, draw
from tankrig.prediction import Prediction
from tankrig.scene.description import Camera, Medium, Scene
from tankrig.separation.order_one import OrderOne
from tankrig.separation.waves import Array, Waves, demodulated

EXTINCTION_PER_MM = (1e-4, 0.5)
"""In which σt is looked for."""
FAINT = 0.03
"""Of the brightest column's order 1: what is fainter tells more of higher orders than of its decay."""


def sheet_scene(wave: Wave, bench: Bench, camera: Camera, medium: Medium) -> Scene:
    """The scene of a wave's whole sheet, as a camera sees it."""
    seen = replace(bench, camera=camera)
    y_mm = wave.y_mm or (min(bench.wall.y_mm), max(bench.wall.y_mm))
    return seen.scene(draw(Sheet(y_mm, wave.z_mm, level=wave.level), bench.wall), medium)


def expected_separation(
    wave: Wave, bench: Bench, camera: Camera, medium: Medium, tolerance: float = 0.01, shifts: int = 4
) -> Mapping[int | str, Waves]:
    """What the tank model says that waves in a liquid look like, by order of scattering.

    Parameters
    ----------
    wave
        Its shift does not matter.
    bench, camera
        Of the rig, the camera as its pictures are binned.
    medium
        The liquid.
    tolerance
        Of each prediction, relative L2 of its image.
    shifts
        In which the wave is shown.

    Returns
    -------
    mapping
        By class of orders (`tankrig.prediction.ORDER_CLASSES`), and all of them under "all". Light is linear, so that
        the complex waves of the orders add up to that of all; their moduli don't.
    """
    from tankrig.image.predict import predict

    seen = replace(bench, camera=camera)
    shown: list[Prediction] = [
        predict(seen.scene(draw(replace(wave, shift=number / shifts), bench.wall), medium), "tank", tolerance=tolerance)
        for number in range(shifts)
    ]
    none = np.zeros((shifts, 1, 1))
    noise = np.stack(
        [np.zeros(one.image.shape) if one.stderr is None else one.stderr.astype(np.float64) for one in shown]
    )
    found: dict[int | str, Waves] = {
        order: demodulated(np.stack([one.orders[order] for one in shown]), none) for order in shown[0].orders
    }
    found["all"] = demodulated(np.stack([one.image for one in shown]), noise)
    return MappingProxyType(found)


@dataclass(frozen=True)
class Agreement:
    """Order 1 as measured, over order 1 of a liquid.

    Parameters
    ----------
    ratio, sd
        Of the two images, and its standard deviation.
    """

    ratio: float
    sd: float

    @property
    def doubt(self) -> str:
        """A sentence where they disagree beyond three standard deviations; else empty."""
        if abs(self.ratio - 1.0) <= 3.0 * self.sd:
            return ""
        more = "brighter" if self.ratio > 1.0 else "fainter"
        return (
            f"order 1 is {100.0 * abs(self.ratio - 1.0):.2g} % {more} than the fitted liquid has it, more than three "
            f"times its {100.0 * self.sd:.2g} %: the fit has the wrong liquid, or light that is none of its orders"
        )


def agreement(measured: OrderOne, of_liquid: Array) -> Agreement:
    """Compare order 1 with a model's, in brightness.

    Parameters
    ----------
    measured
        In the unit of the pictures.
    of_liquid
        (rows, columns) the model's, in the same unit.

    Raises
    ------
    ImageError
        When order 1 is not known anywhere.
    """
    known = measured.known & (of_liquid > 0.0)
    if not known.any():
        raise ImageError("order 1 is not known anywhere, so there is nothing to compare; see its doubts")
    seen, image, noise, model = (one[known] for one in (of_liquid, measured.image, measured.noise, measured.model))
    weight = seen / (noise**2 + model**2)
    total = float(weight @ seen)
    by_noise = float(np.sqrt(measured.alike * np.sum((weight * noise) ** 2))) / total
    return Agreement(float(weight @ image) / total, float(np.hypot(by_noise, float(weight @ model) / total)))


def extinction(measured: OrderOne, scene: Scene) -> tuple[float, float]:
    """σt of the liquid from how order 1 decays along the beams, by no more than geometry.

    Parameters
    ----------
    measured
        Order 1, in any unit.
    scene
        Of its sheet; the medium does not matter but for its phase function, over the few angles that are seen.

    Returns
    -------
    float, float
        σt, 1/mm, and its standard deviation: by noise, and by what carrying on to a period of 0 leaves unsure, as one
        change alike in all of the picture and as one along the beams.

    Raises
    ------
    ImageError
        When order 1 is not known anywhere.
    """
    from tankrig.light.single import single_scattering

    known = measured.known
    if not known.any():
        raise ImageError("order 1 is not known anywhere, so its decay is not either; see its doubts")
    along = np.where(known, measured.image, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    known = known & (along > FAINT * float(along.max()))
    sd = measured.sd[known]

    def scaled(log_sigma_t: float) -> Array:
        medium = replace(scene.medium, sigma_a=0.0, sigma_s=float(np.exp(log_sigma_t)))
        image = single_scattering(replace(scene, medium=medium))[known] / sd
        return np.asarray(image / max(float(np.linalg.norm(image)), 1e-300))

    def found(image: Array) -> float:
        seen = image[known] / sd
        low, high = np.log(EXTINCTION_PER_MM)
        coarse = np.linspace(low, high, 25)
        best = coarse[np.argmax([float(scaled(one) @ seen) for one in coarse])]
        step = coarse[1] - coarse[0]
        result = minimize_scalar(
            lambda one: -float(scaled(one) @ seen), bounds=(best - step, best + step), method="bounded"
        )
        return float(result.x)

    at = found(measured.image)
    here, change = scaled(at), 1e-3
    slope = (scaled(at + change) - here) / change
    amount = float(here @ (measured.image[known] / sd))
    noise = measured.noise[known] / sd
    by_noise = float(
        np.sqrt(measured.alike * np.sum((slope * noise) ** 2)) / (amount * max(float(slope @ slope), 1e-300))
    )
    moved = [abs(found(measured.image + part) - at) for part in _doubted(measured)]
    return float(np.exp(at)), float(np.exp(at) * np.hypot(by_noise, max(moved)))


def _doubted(measured: OrderOne) -> tuple[Array, Array]:
    """(rows, columns) changes that `model` allows: all of it everywhere, and from less to more along the rows."""
    columns = np.linspace(-1.0, 1.0, measured.image.shape[1])
    return measured.model, measured.model * columns
