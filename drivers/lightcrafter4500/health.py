"""Whether a LightCrafter 4500 is connected, and fit."""

from collections.abc import Iterator, Mapping
from typing import Any

from drivers.check import Check
from drivers.health import Found
from tankrig.errors import DeviceError

from .usb_link import NAME, PRODUCT, VENDOR, UsbLink


def find() -> Iterator[Found]:
    """The one on USB."""
    import usb.core

    try:
        found = list(usb.core.find(find_all=True, idVendor=VENDOR, idProduct=PRODUCT))
    except usb.core.NoBackendError as error:
        raise DeviceError(f"{NAME}: the USB library is missing; run: sudo apt install libusb-1.0-0") from error
    for device in found:
        yield Found(
            f"{NAME} on USB bus {device.bus}",
            '[projector]\ndriver = "lightcrafter-4500"\nscreen = { model = "…" }  # of its HDMI input\n'
            "refresh_hz = 60.0\nlatency_ms = 50.0  # tankrig doctor measures it",
        )


def checks(_settings: Mapping[str, Any], device: Any) -> Iterator[Check]:
    """That its USB answers."""
    if device is not None:
        return
    try:
        UsbLink().close()
    except DeviceError as error:
        finding, _, remedy = str(error).rpartition("; ")
        yield Check("LightCrafter answers on USB", False, finding, remedy)
    else:
        yield Check("LightCrafter answers on USB", True, NAME)
