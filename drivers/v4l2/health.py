"""Which V4L2 cameras are connected, and whether one of them is fit."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from drivers.check import Check
from drivers.health import Found
from tankrig.errors import DeviceError

from .node import Node

_BEST = ("Y16", "Y12", "Y10", "GREY", "YUYV")


def find() -> Iterator[Found]:
    """Cameras, by the path that stays theirs."""
    named = {link.resolve(): link for link in sorted(Path("/dev/v4l/by-id").glob("*"))}
    for device in sorted(Path("/dev").glob("video*")):
        path = named.get(device.resolve(), device)
        try:
            node = Node(path)
        except DeviceError as error:
            if "usermod" in str(error):  # other nodes are a camera's metadata, encoders and the like
                yield Found(str(error))
            continue
        formats = node.formats
        best = next((name for name in _BEST if name in formats), None)
        node.close()
        lines = f'[camera]\ndriver = "v4l2-camera"\ndevice = "{path}"\nformat = "{best}"\nshape = [480, 640]'
        yield Found(f"camera {node.card} at {device}: {', '.join(formats)}", lines if best else "")


def checks(settings: Mapping[str, Any], device: Any) -> Iterator[Check]:
    """That its path stays the same, and what else can be set."""
    path = str(settings.get("device", ""))
    stable = not path.startswith("/dev/video")
    yield Check(
        "camera is named by its identity", stable, path, "use its path below /dev/v4l/by-id (tankrig devices lists it)"
    )
    if device is not None:
        return
    try:
        node = Node(Path(path))
    except DeviceError:
        return  # that it does not open has been said
    yield Check("camera offers formats", None, ", ".join(node.formats), "choose camera.format among them")
    controls = ", ".join(
        f"{name} = {value} ({least} to {most})" for name, (least, most, value) in node.controls.items()
    )
    yield Check("camera has controls", None, controls, "choose camera.controls among them")
    node.close()
