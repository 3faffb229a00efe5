"""Whether a Cavro pump is fit to dose."""

from collections.abc import Iterator, Mapping
from typing import Any

from drivers.check import Check
from drivers.health import Found


def find() -> Iterator[Found]:
    """None: a pump behind a serial port is not asked who it is unless a rig file names it."""
    yield from ()


def checks(settings: Mapping[str, Any], device: Any) -> Iterator[Check]:  # noqa: ARG001
    """That it is initialised and has no overload, and how fast it moves; moves nothing."""
    if device is None:
        return
    finding, _, remedy = (device.trouble() or "it is").partition("; ")
    yield Check("doser is initialised", not remedy, finding, remedy)
    told = f"{device.what_moves()} (earlier versions drove an XCalibur at half the speed asked)"
    yield Check("doser is the model of the rig file", True, told)
