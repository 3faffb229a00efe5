"""New Era NE-500 and NE-1000 syringe pumps, and an emulator of one (firmware_notes/new_era.md)."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .doser import NewEraDoser


def open_new_era(settings: Mapping[str, Any]) -> "NewEraDoser":
    """Driver `new-era`: the pump on a serial port (settings: `NewEraSettings`)."""
    from drivers.registry import checked

    from .doser import NewEraDoser
    from .settings import NewEraSettings

    return NewEraDoser(checked(NewEraSettings, "new-era", settings))
