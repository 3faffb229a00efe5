"""What a model of the liquid says of separated light, order by order, and whether order 1 agrees with it."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from tankrig.bench import Bench
from tankrig.errors import ImageError
from tankrig.pattern.kinds import Sheet, Wave, draw
from tankrig.prediction import Prediction
from tankrig.scene.description import Camera, Medium, Scene
from tankrig.separation.order_one import OrderOne
from tankrig.separation.waves import Array, Waves, demodulated

BEYOND = 3.0
"""Standard deviations from which on order 1 and a fit are said to disagree."""


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
    sigma_t, of_liquid
        σt by how order 1 decays, and the liquid's, each with its standard deviation, 1/mm; None where order 1 is lost
        in its own uncertainty.
    """

    ratio: float
    sd: float
    sigma_t: tuple[float, float] | None = None
    of_liquid: tuple[float, float] = (0.0, 0.0)

    @property
    def doubt(self) -> str:
        """A sentence where they disagree beyond three standard deviations; else empty.

        Examples
        --------
        >>> Agreement(1.01, 0.02, (0.0120, 0.0001), (0.0105, 0.0002)).doubt.split(";")[0]
        'by its decay order 1 has σt 0.012 ± 0.0001 /mm and the fitted liquid 0.0105 ± 0.0002 /mm'
        >>> Agreement(1.01, 0.02).doubt
        ''
        """
        found = []
        if abs(self.ratio - 1.0) > BEYOND * self.sd:
            more = "brighter" if self.ratio > 1.0 else "fainter"
            found.append(
                f"order 1 is {100.0 * abs(self.ratio - 1.0):.2g} % {more} than the fitted liquid has it, more than "
                f"three times its {100.0 * self.sd:.2g} %"
            )
        if self.sigma_t is not None:
            (seen, sd), (fitted, fitted_sd) = self.sigma_t, self.of_liquid
            if abs(seen - fitted) > BEYOND * float(np.hypot(sd, fitted_sd)):
                found.append(
                    f"by its decay order 1 has σt {seen:.3g} ± {sd:.2g} /mm and the fitted liquid {fitted:.3g} ± "
                    f"{fitted_sd:.2g} /mm"
                )
        end = "; the fit has the wrong liquid, or light that is none of its orders"
        return " and ".join(found) + end if found else ""


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
