"""What can be replayed: frames with the times at which they were exposed."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tankrig import bounded_reading
from tankrig.errors import DeviceError, StoreError

from .settings import ReplayCameraSettings

Pixels = NDArray[np.uint8] | NDArray[np.uint16]

_SUFFIXES = (".png", ".tif", ".tiff")


@dataclass(frozen=True)
class Recording:
    """Frames in the order in which they were taken.

    Parameters
    ----------
    starts_ns
        When the exposure of each began, from 0 on, rising.
    pixels
        Reads one of them, (rows, columns) uint8 or uint16.
    exposure_ms, gain
        Of all of them.
    saturation
        Their highest count.
    """

    starts_ns: tuple[int, ...]
    pixels: Callable[[int], Pixels]
    exposure_ms: float
    gain: float
    saturation: int


def read_recording(settings: ReplayCameraSettings) -> Recording:
    """The run or the images that `settings` name.

    Raises
    ------
    DeviceError
        When there is nothing to replay.
    """
    source = settings.source
    if (source / "journal.jsonl").exists():
        return _of_run(source)
    names = sorted(source.iterdir(), key=_numbered) if source.is_dir() else []
    files = [file for file in names if file.suffix.lower() in _SUFFIXES]
    if not files:
        raise DeviceError(f"{source}: is neither a run nor a folder of PNG or TIFF images; correct camera.source")
    interval_ns = round(settings.interval_ms * 1e6)
    first = _image(files[0])
    bits = settings.bits or 8 * first.dtype.itemsize
    return Recording(
        starts_ns=tuple(i * interval_ns for i in range(len(files))),
        pixels=lambda index: _like(_image(files[index]), first, files[index]),
        exposure_ms=settings.exposure_ms,
        gain=1.0,
        saturation=2**bits - 1,
    )


def _of_run(source: Path) -> Recording:
    from tankrig.run.reading import open_run

    try:
        run = open_run(source)
        frames = run.events("frame")
        cameras = [event for event in run.events("note") if event.fields.get("text") == "camera"]
        if not frames or not cameras:
            raise DeviceError(f"{source}: this run has no frames; give another as camera.source")
        first = run.pixels(frames[0])
    except StoreError as error:
        raise DeviceError(f"{source}: cannot be replayed: {error}") from error
    if len({(event["exposure_ms"], event["gain"]) for event in cameras}) > 1:
        raise DeviceError(f"{source}: its frames have several exposures or gains; replay a run that has one")

    def pixels(index: int) -> Pixels:
        try:
            return run.pixels(frames[index])
        except StoreError as error:
            raise DeviceError(f"{source}: {error}") from error

    return Recording(
        starts_ns=_rising([frame["exposure_start_ns"] for frame in frames]),
        pixels=pixels,
        exposure_ms=cameras[0]["exposure_ms"],
        gain=cameras[0]["gain"],
        saturation=int(run.settings.get("saturation") or np.iinfo(first.dtype).max),
    )


def _rising(times_ns: list[int]) -> tuple[int, ...]:
    """From 0 on; where a restart of the computer set the clock back, the next frame comes after a usual interval."""
    steps = [after - before for before, after in pairwise(times_ns)]
    usual = int(np.median([step for step in steps if step > 0] or [1]))
    return tuple(np.concatenate([[0], np.cumsum([step if step > 0 else usual for step in steps])]).astype(int).tolist())


def _image(file: Path) -> Pixels:
    try:
        image: Any = bounded_reading.picture(file)
    except (OSError, ValueError) as error:
        why = bounded_reading.reason(error)
        raise DeviceError(f"{file}: is no image that can be read ({why}); take it out of the folder") from error
    if image.ndim != 2 or image.dtype not in (np.uint8, np.uint16):
        raise DeviceError(f"{file}: is no grey image of 8 or 16 bits; take it out of the folder")
    pixels: Pixels = image
    return pixels


def _like(pixels: Pixels, first: Pixels, file: Path) -> Pixels:
    if pixels.shape != first.shape or pixels.dtype != first.dtype:
        raise DeviceError(f"{file}: differs from the first image in size or depth; take it out of the folder")
    return pixels


def _numbered(file: Path) -> tuple[int, str]:
    """Orders img9 before img10."""
    digits = "".join(character for character in file.stem if character.isdigit())
    return int(digits or 0), file.name
