"""Which V4L2 cameras are connected, and whether one of them is fit."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from drivers.check import Check, failed
from drivers.health import Found
from tankrig.errors import DeviceError

from .node import NoCameraError, Node, explained
from .pixels import FORMATS


def find() -> Iterator[Found]:
    """Cameras, by the path that stays theirs."""
    named = {link.resolve(): link for link in sorted(Path("/dev/v4l/by-id").glob("*"))}
    for device in sorted(Path("/dev").glob("video*")):
        try:
            yield found(device, named.get(device.resolve(), device))
        except NoCameraError:
            continue  # other nodes are a camera's metadata, encoders and the like
        except DeviceError as error:
            yield Found(str(error))


def found(device: Path, path: Path) -> Found:
    """A camera, and the lines that a rig file wants for its best format.

    Parameters
    ----------
    device
        Its node.
    path
        A name of that node which stays.

    Raises
    ------
    DeviceError
        When it does not answer; `NoCameraError` when it is none.
    """
    node = Node(path)
    try:
        formats = node.formats
        best = next((name for name in FORMATS if name in formats), None)
        if best is None:
            return Found(f"camera {node.card} at {device}: {', '.join(formats)}, of which tankrig reads none")
        shape = max(node.shapes(FORMATS[best].code), default=(480, 640))
        lines = f'[camera]\ndriver = "v4l2-camera"\ndevice = "{path}"\nformat = "{best}"\nshape = {list(shape)}'
        return Found(f"camera {node.card} at {device}: {', '.join(formats)}", lines)
    except OSError as error:
        raise explained(path, error) from error
    finally:
        node.close()


def checks(settings: Mapping[str, Any], device: Any) -> Iterator[Check]:
    """That its path stays the same, and what else can be set."""
    path = str(settings.get("device", ""))
    stable = not path.startswith("/dev/video")
    yield Check(
        "camera is named by its identity", stable, path, "use its path below /dev/v4l/by-id (tankrig devices lists it)"
    )
    if device is not None:
        yield _follows(device)
        return
    try:
        yield from _offered(Path(path))
    except DeviceError:
        return  # that it does not open has been said


def _follows(camera: Any) -> Check:
    """That no frame with old settings is taken for one with new ones."""
    what = "camera follows its settings within the frames that are passed over"
    try:
        frames = camera.frames_to_follow()
    except DeviceError as error:
        return failed(what, error)
    allowed = camera.settle_frames
    if frames is None:
        return Check(what, None, "too dark or too bright to tell", "light the tank, or dim the light, and ask again")
    return Check(
        what,
        frames <= allowed,
        f"{frames} frames after a change of exposure had the old one, {allowed} are passed over",
        f"set settle_frames = {frames + 1} in [camera]",
    )


def _offered(path: Path) -> Iterator[Check]:
    node = Node(path)
    try:
        formats = ", ".join(node.formats)
        controls = ", ".join(
            f"{control.name} = {node.read(control)} ({control.least} to {control.most})"
            for control in node.controls().values()
        )
    except OSError as error:
        raise explained(path, error) from error
    finally:
        node.close()
    yield Check("camera offers formats", None, formats, "choose camera.format among them")
    yield Check("camera has controls", None, controls, "choose camera.controls among them")
