"""A burst: patterns that the projector shows by itself, each with a trigger for the camera, and the frames of them.

Nobody tells which frame belongs to which pattern but their order. So a burst counts only as a whole: as many frames as
patterns, none lost on the way, and each in its time.
"""

import time
from collections.abc import Sequence

from tankrig.devices import BurstProjector, BurstTiming, CameraDevice, Frame, Projector, TriggeredCamera
from tankrig.errors import DeviceError
from tankrig.pattern import Pattern

_FIRST_S = 2.0
"""Until the first frame has come, besides its exposure."""
_CALLED_S = 10.0
"""Until the next frame has come where somebody else's trigger calls for it."""
_NEXT_S = 1.0
_NO_MORE_S = 0.05


class IncompleteBurstError(DeviceError):
    """Frames of a burst are missing, or are too many; the burst can be taken again."""


def can_burst(projector: Projector, camera: CameraDevice) -> bool:
    """Whether the projector triggers and the camera can be triggered."""
    return isinstance(projector, BurstProjector) and isinstance(camera, TriggeredCamera)


def take_burst(
    projector: Projector, camera: CameraDevice, patterns: Sequence[Pattern], exposure_ms: float
) -> tuple[list[Frame], BurstTiming]:
    """Take one frame of each pattern, in one burst.

    Parameters
    ----------
    projector, camera
        Of a rig that can (`can_burst`); the camera is set to `exposure_ms` already.
    patterns
        In their order; one may come several times.
    exposure_ms
        Of the camera.

    Returns
    -------
        The frames, one for each pattern in their order, and when the patterns came.

    Raises
    ------
    IncompleteBurstError
        Unless there is exactly one frame for each pattern, in its time.
    DeviceError
        If the devices cannot do it, or fail.
    """
    if not (isinstance(projector, BurstProjector) and isinstance(camera, TriggeredCamera)):
        raise DeviceError(
            f"{projector.name} and {camera.name}: take no bursts, since one of them has no trigger; write capture steps"
        )
    timing = projector.load_burst(patterns, exposure_ms)
    camera.arm()
    try:
        played_ns = time.monotonic_ns()
        projector.play_burst()
        frames = _collected(camera, len(patterns), timing, exposure_ms)
    finally:
        camera.disarm()
    _require_whole(frames, len(patterns), timing, played_ns, camera)
    return frames, timing


def _collected(camera: TriggeredCamera, number: int, timing: BurstTiming, exposure_ms: float) -> list[Frame]:
    """Frames until none comes any more, one too many at most."""
    frames: list[Frame] = []
    while len(frames) <= number:
        if len(frames) == number:
            wait_s = _NO_MORE_S
        elif timing.period_ms is None:
            wait_s = _CALLED_S
        else:
            wait_s = _NEXT_S if frames else _FIRST_S
        frame = camera.triggered(wait_s + 1e-3 * exposure_ms)
        if frame is None:
            break
        frames.append(frame)
    return frames


def _require_whole(frames: list[Frame], number: int, timing: BurstTiming, played_ns: int, camera: CameraDevice) -> None:
    if len(frames) != number:
        more = "more" if len(frames) > number else "only"
        told = f"{number} patterns and {more} {min(len(frames), number)} frames"
        raise IncompleteBurstError(
            f"{camera.name}: a burst of {told}, so that nobody knows which frame is of which; check the trigger's cable"
        )
    counts = [frame.sequence for frame in frames]
    if counts != list(range(counts[0], counts[0] + number)):
        lost = counts[-1] - counts[0] + 1 - number
        raise IncompleteBurstError(f"{camera.name}: lost {lost} frames of a burst; give it a faster link")
    for frame in frames:
        if frame.pixels.shape != camera.shape:
            raise DeviceError(
                f"{camera.name}: gave a frame of shape {list(frame.pixels.shape)} rather than {list(camera.shape)}; "
                f"set its format again, and check its cable"
            )
    starts = [frame.exposure_start_ns for frame in frames]
    if starts[0] < played_ns or sorted(set(starts)) != starts:
        raise IncompleteBurstError(
            f"{camera.name}: gave frames of a burst that were exposed before it, or out of order; check its timestamps "
            f"(tankrig doctor)"
        )
    if timing.period_ms is None:
        return
    for at, start_ns in enumerate(starts):
        off_ms = (start_ns - starts[0]) / 1e6 - at * timing.period_ms
        if abs(off_ms) > timing.period_ms / 2:
            raise IncompleteBurstError(
                f"{camera.name}: frame {at + 1} of a burst is {off_ms:.1f} ms off its pattern's time; check the "
                f"trigger's cable and the camera's timestamps"
            )
