"""Whether a LightCrafter 4500 is connected, and fit."""

from collections.abc import Iterator, Mapping
from typing import Any

from drivers.check import Check, failed
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
    """That its USB answers, that it shows its video input, and what it warns of."""
    if device is None:
        yield _answers()
        return
    try:
        device.confirm()
    except DeviceError as error:
        yield failed("LightCrafter shows its video input", error)
    else:
        yield Check("LightCrafter shows its video input", True, "its sequencer runs, and it is locked to the video")
    yield Check(
        "LightCrafter has no reserve about its settings", not device.warnings or None,
        "; ".join(device.warnings) or "it warns of nothing",
        "nothing has to be done while pictures are as they should be; exposure_us at least 230 µs below the period "
        "makes room for black",
    )  # fmt: skip


def _answers() -> Check:
    what = "LightCrafter answers on USB"
    try:
        UsbLink().close()
    except DeviceError as error:
        return failed(what, error)
    return Check(what, True, NAME)
