"""How long light takes from a swap to the tank, seen by the camera in flips between black and white."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tankrig.calibration.file import Calibration
from tankrig.devices import CameraDevice, CameraSettings, Flip, Projector
from tankrig.errors import DeviceError
from tankrig.pattern import Pattern

_FULL, _HALF, _NONE = 0.9, 0.5, 0.1
_CLOSE = 0.03
"""Exposures with a pause of less than this part of them between are taken to follow each other."""
_FIRST_MS = 20.0
_LONGEST_S = 1.0
_PATIENCE_S = 5.0
_FAR_MS = 50.0
_LEAST_CONTRAST, _UNSATURATED, _NEARLY = 0.02, 0.25, 0.98


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
    projector: Projector,
    camera: CameraDevice,
    flips: int = 50,
    exposure_ms: float | None = None,
    seed: int = 0,
    tell: Callable[[int], object] = lambda _: None,
) -> Latency:
    """Flip between black and white and see when the picture follows.

    Frames that saw part of the change tell when it was: the new light's part of the exposures, counted back from the
    end of the last. Where the camera pauses between exposures and the change falls into the pause, it is put at the
    start of the first frame with all of the new light, so never too early.

    Parameters
    ----------
    projector, camera
        Open; the camera sees the projector's light.
    flips
        How many.
    exposure_ms
        Of the camera's frames; None: as long as leaves no pause between them.
    seed
        Of the pauses between flips, which let them fall anywhere between two frames.
    tell
        Called with the number of flips done.

    Raises
    ------
    DeviceError
        When the camera sees no difference, is saturated, or a flip does not show within a second.
    """
    wanted_ms = _without_pause(camera) if exposure_ms is None else exposure_ms
    exposure_ns = round(camera.configure(CameraSettings(wanted_ms)).exposure_ms * 1e6)
    black, white, lit, means = _black_and_white(projector, camera)
    pause, samples, patterns = np.random.default_rng(seed), [], (black, white)
    for number in range(flips):
        time.sleep(pause.uniform(0.0, 2e-9 * exposure_ns))
        new = number % 2
        flip = projector.show(patterns[new])
        changed_ns = _changed_ns(camera, flip, exposure_ns, lit, (means[1 - new], means[new]))
        samples.append((changed_ns - flip.settled_ns) / 1e6)
        tell(number + 1)
    return Latency(tuple(samples))


def latency_calibration(
    measured: Latency, projector: Projector, believed_ms: float | None = None, period_ms: float = 0.0
) -> Calibration:
    """Results, uncertainties and doubts, to be saved.

    Parameters
    ----------
    measured
        What was measured.
    projector
        Of which.
    believed_ms, period_ms
        Latency that the rig file says, None where it says none, and the projector's period. Frames are taken for a
        pattern's from the sum of both after its swap on, so a 99th percentile beyond that is a doubt.
    """
    samples = np.array(measured.samples_ms)
    median_sd = 1.2533 * float(samples.std(ddof=1)) / float(np.sqrt(samples.size))
    far = samples > np.median(samples) + _FAR_MS
    doubts = []
    if far.mean() > 0.05:
        doubts.append(
            f"{int(far.sum())} of {samples.size} flips took {_FAR_MS:g} ms longer than the median; leave the computer "
            f"alone meanwhile, and check the projector's picture processing"
        )
    if believed_ms is not None and measured.p99_ms > believed_ms + period_ms:
        doubts.append(
            f"99 % of the flips took up to {measured.p99_ms:.1f} ms, and the rig file says latency_ms = "
            f"{believed_ms:g}: with that, frames would have been taken for a pattern while the one before was still "
            f"seen; switch the projector's picture processing off, or set latency_ms = {measured.p99_ms:.1f} in "
            f"[projector]"
        )
    return Calibration(
        kind="latency",
        device=projector.name,
        shape=projector.shape,
        result={
            "median_ms": measured.median_ms,
            "p99_ms": measured.p99_ms,
            "least_ms": float(samples.min()),
            "most_ms": float(samples.max()),
            "samples_ms": np.round(samples, 3).tolist(),
        },
        sd={"median_ms": median_sd},
        how_well={"median_sd_ms": median_sd, "flips": float(samples.size)},
        doubts=tuple(doubts),
    )


def _without_pause(camera: CameraDevice) -> float:
    """An exposure that fills the time from frame to frame."""
    exposure_ms = camera.configure(CameraSettings(_FIRST_MS)).exposure_ms
    for _ in range(3):
        frames = [camera.capture(time.monotonic_ns(), _PATIENCE_S)]
        for _ in range(4):
            frames.append(camera.capture(frames[-1].exposure_start_ns, _PATIENCE_S))
        apart_ms = min(
            (late.exposure_start_ns - early.exposure_start_ns) / (late.sequence - early.sequence) / 1e6
            for early, late in pairwise(frames)
        )
        if apart_ms <= (1.0 + _CLOSE) * exposure_ms:
            break
        exposure_ms = camera.configure(CameraSettings(apart_ms)).exposure_ms
    return exposure_ms


def _black_and_white(
    projector: Projector, camera: CameraDevice
) -> tuple[Pattern, Pattern, NDArray[np.bool_], tuple[float, float]]:
    """Patterns that differ, the pixels that see it without being saturated, and their mean with either."""
    black, dark = _settled(projector, camera, 0)
    for level in (255, 160, 100, 60, 36):
        white, bright = _settled(projector, camera, level)
        difference = bright - dark
        if difference.max() < _LEAST_CONTRAST * camera.saturation:
            break
        lit = difference > _HALF * difference.max()
        usable = lit & (bright < _NEARLY * camera.saturation)
        if usable.sum() > _UNSATURATED * lit.sum():
            return black, white, usable, (float(dark[usable].mean()), float(bright[usable].mean()))
    else:
        raise DeviceError(
            f"{camera.name}: is saturated by {projector.name} even at level 36; close its aperture, or put a filter "
            f"before it"
        )
    raise DeviceError(
        f"{camera.name}: sees no difference between black and white of {projector.name}, as with clear water; put ink "
        f"into the tank or a sheet of paper where the light falls, or open the aperture"
    )


def _settled(projector: Projector, camera: CameraDevice, level: int) -> tuple[Pattern, NDArray[np.float64]]:
    pattern = Pattern(f"level {level}", np.full(projector.shape, level, np.uint8))
    flip = projector.show(pattern)
    later_ns = flip.settled_ns + round(_LONGEST_S * 1e9 / 2)
    return pattern, camera.capture(max(flip.bound_ns, later_ns), _PATIENCE_S).pixels.astype(float)


def _changed_ns(
    camera: CameraDevice, flip: Flip, exposure_ns: int, lit: NDArray[np.bool_], means: tuple[float, float]
) -> float:
    """When the camera saw the mean of the `lit` pixels go from one to the other of `means`."""
    old, new = means
    after_ns = flip.settled_ns - exposure_ns
    before_ns, before = 0, 0.0  # the frame before: its start, and its part of the new light
    while after_ns < flip.settled_ns + _LONGEST_S * 1e9:
        frame = camera.capture(after_ns, _PATIENCE_S)
        after_ns = frame.exposure_start_ns
        part = (float(frame.pixels[lit].mean()) - old) / (new - old)
        if part > _HALF:
            if after_ns - before_ns < (1.0 + _CLOSE) * exposure_ns:
                changed_ns = after_ns + exposure_ns * (1.0 - part - before)
            elif before > _NONE:
                changed_ns = before_ns + exposure_ns * (1.0 - before)
            else:
                changed_ns = after_ns + exposure_ns * (1.0 - part if part < _FULL else 0.0)
            return max(changed_ns, flip.settled_ns)
        before_ns, before = after_ns, part
    raise DeviceError(
        f"{camera.name}: saw no light change within {_LONGEST_S:g} s of a flip; let nothing be in its way"
    )
