"""From radiance to counts: shot noise, dark current, saturation, read noise, rounding."""

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
    electrons = random.poisson((radiance * sensor.response + sensor.dark_current) * camera.exposure_ms)
    read_out = np.minimum(electrons, sensor.full_well) + sensor.read_noise * random.standard_normal(radiance.shape)
    values = sensor.black + _counts_per_electron(sensor, camera) * read_out
    return np.clip(np.round(values), 0, sensor.saturation).astype(np.uint16)


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
    return camera.gain * (sensor.saturation - sensor.black) / sensor.full_well
