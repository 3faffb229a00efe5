"""How long light takes from a swap to the tank, seen by the camera in flips between black and white."""

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tankrig.devices import Camera, CameraSettings, Flip, Projector
from tankrig.errors import DeviceError
from tankrig.pattern import Pattern

_FULL, _NONE = 0.9, 0.1
_LONGEST_S = 1.0
_LEAST_CONTRAST = 0.02


@dataclass(frozen=True)
class Latency:
    """Time from swap to light.

    Parameters
    ----------
    samples_ms
        One for each flip.
    """

    samples_ms: tuple[float, ...]

    @property
    def median_ms(self) -> float:
        """Half of the flips took less."""
        return float(np.median(self.samples_ms))

    @property
    def p99_ms(self) -> float:
        """99 % of the flips took less; with fewer than 100 of them, all.

        >>> Latency(tuple(range(1, 201))).p99_ms
        199.0
        """
        return float(np.quantile(self.samples_ms, 0.99, method="higher"))


def measure_latency(
    projector: Projector, camera: Camera, flips: int = 50, exposure_ms: float = 5.0, seed: int = 0
) -> Latency:
    """Flip between black and white and see when the picture follows.

    A frame that saw part of the change tells when it was: at exposure start + exposure · (1 − part of the new light).
    Where none did, the change is put at the start of the first frame with all of the new light, so never too early.

    Parameters
    ----------
    projector, camera
        Open; the camera sees the projector's light.
    flips
        How many.
    exposure_ms
        Of the camera's frames.
    seed
        Of the pauses between flips, which let them fall anywhere between two frames.

    Raises
    ------
    DeviceError
        When the camera sees no difference, or a flip does not show within a second.
    """
    exposure_ns = round(camera.configure(CameraSettings(exposure_ms)).exposure_ms * 1e6)
    patterns = [Pattern(f"level {level}", np.full(projector.shape, level, np.uint8)) for level in (0, 255)]
    levels = [_settled(projector, camera, pattern) for pattern in patterns]
    difference = levels[1] - levels[0]
    if difference.max() < _LEAST_CONTRAST * camera.saturation:
        raise DeviceError(
            f"{camera.name}: sees no difference between black and white of {projector.name}; point it at the light, or "
            f"open its aperture"
        )
    lit = difference > 0.5 * difference.max()
    means = [float(level[lit].mean()) for level in levels]
    pause, samples = np.random.default_rng(seed), []
    for number in range(flips):
        time.sleep(pause.uniform(0.0, 2e-9 * exposure_ns))
        new = number % 2
        flip = projector.show(patterns[new])
        changed_ns = _changed_ns(camera, flip, exposure_ns, lit, (means[1 - new], means[new]))
        samples.append((changed_ns - flip.settled_ns) / 1e6)
    return Latency(tuple(samples))


def _settled(projector: Projector, camera: Camera, pattern: Pattern) -> NDArray[np.float64]:
    flip = projector.show(pattern)
    later_ns = flip.settled_ns + round(_LONGEST_S * 1e9 / 2)
    return camera.capture(max(flip.bound_ns, later_ns), 5.0).pixels.astype(float)


def _changed_ns(
    camera: Camera, flip: Flip, exposure_ns: int, lit: NDArray[np.bool_], means: tuple[float, float]
) -> float:
    """When the camera saw the mean of the `lit` pixels go from one to the other of `means`."""
    old, new = means
    after_ns = flip.settled_ns - exposure_ns
    while after_ns < flip.settled_ns + _LONGEST_S * 1e9:
        frame = camera.capture(after_ns, 5.0)
        after_ns = frame.exposure_start_ns
        part = (float(frame.pixels[lit].mean()) - old) / (new - old)
        if part > _FULL:
            return max(after_ns, flip.settled_ns)
        if part > _NONE:
            return after_ns + exposure_ns * (1.0 - part)
    raise DeviceError(
        f"{camera.name}: saw no light change within {_LONGEST_S:g} s of a flip; let nothing be in its way"
    )
