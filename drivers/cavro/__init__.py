"""Tecan Cavro XCalibur and XLP syringe pumps with a valve, and an emulator of one (firmware_notes/cavro.md)."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .doser import CavroDoser


def open_cavro(settings: Mapping[str, Any]) -> "CavroDoser":
    """Driver `cavro`: the pump on a serial port (settings: `CavroSettings`)."""
    from drivers.registry import checked

    from .doser import CavroDoser
    from .settings import CavroSettings

    return CavroDoser(checked(CavroSettings, "cavro", settings))
