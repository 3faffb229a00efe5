"""From radiance to counts: vignetting, shot noise, dark current, saturation, non-linearity, read noise, rounding."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from tankrig.devices import CameraSettings

from .settings import Sensor


def counts(
    radiance: NDArray[np.float64], sensor: Sensor, camera: CameraSettings, random: np.random.Generator
) -> NDArray[np.uint16]:
    """A frame as it is read out.

    Parameters
    ----------
    radiance
        (rows, columns), W/mm²/sr.
    sensor
        What it is.
    camera
        Exposure and gain.
    random
        Of its noise.
    """
    response, dark_current = fixed_pattern(sensor, radiance.shape)
    electrons = random.poisson((radiance * response + dark_current) * camera.exposure_ms)
    held = np.minimum(electrons, sensor.full_well)
    read_out = transferred(held, sensor) + sensor.read_noise * random.standard_normal(radiance.shape)
    values = sensor.black + _counts_per_electron(sensor, camera) * read_out
    return np.clip(np.round(values), 0, sensor.saturation).astype(np.uint16)


def transferred(electrons: NDArray[np.float64], sensor: Sensor) -> NDArray[np.float64]:
    """Electrons that a pixel which holds so many seems to hold; fewer, the more it holds.

    >>> transferred(np.array([10_000.0, 30_000.0]), Sensor(nonlinear=0.06)).tolist()
    [9835.55..., 28200.0]
    """
    filled = electrons / sensor.full_well
    return electrons * (1.0 - sensor.nonlinear * filled * (0.8 + 0.2 * filled**2))


@lru_cache(maxsize=4)
def fixed_pattern(sensor: Sensor, shape: tuple[int, int]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(rows, columns) electrons per ms and W/mm²/sr, and in the dark, of each pixel."""
    random = np.random.default_rng((sensor.pattern_seed, 7))
    y, x = (np.linspace(-1.0, 1.0, count) for count in shape)
    falloff = 1.0 - sensor.vignetting * (x**2 + y[:, None] ** 2) / 2.0
    response = sensor.response * falloff * (1.0 + sensor.uneven * random.standard_normal(shape))
    dark = np.where(random.random(shape) < sensor.hot, sensor.hot_current, sensor.dark_current)
    return response, dark


def gain_and_offset(sensor: Sensor, camera: CameraSettings) -> tuple[float, float]:
    """What a frame is on average, as long as no pixel is full: gain · radiance + offset, counts.

    Examples
    --------
    >>> gain_and_offset(Sensor(response=1e9, bits=12, full_well=3995.0, dark_current=0.0), CameraSettings(10.0, 2.0))
    (20000000000.0, 100.0)
    """
    gain = _counts_per_electron(sensor, camera) * camera.exposure_ms
    return gain * sensor.response, sensor.black + gain * sensor.dark_current


def _counts_per_electron(sensor: Sensor, camera: CameraSettings) -> float:
    amplified = float(camera.gain ** (1.0 + sensor.gain_error))
    return amplified * (sensor.saturation - sensor.black) / (sensor.full_well * (1.0 - sensor.nonlinear))
