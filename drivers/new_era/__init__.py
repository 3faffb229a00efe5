"""New Era NE-500 and NE-1000 syringe pumps, and an emulator of one (firmware_notes/new_era.md)."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from drivers.counted.doser import CountedDoser


def open_new_era(settings: Mapping[str, Any]) -> "CountedDoser":
    """Driver `new-era`: the pump on a serial port (settings: `NewEraSettings`)."""
    from drivers.counted.calibrated import correction
    from drivers.counted.doser import CountedDoser
    from drivers.registry import checked

    from .pump import NewEraPump
    from .settings import NewEraSettings

    given = checked(NewEraSettings, "new-era", settings)
    name = f"New Era pump on {given.port}"
    factor = correction(given.calibration, name, {"diameter_mm": given.diameter_mm})
    return CountedDoser(
        NewEraPump(given, name),
        "new-era",
        given.count_file,
        dose_limit_ul=given.dose_limit_ul,
        correction=factor,
        name=name,
        time_scale=given.time_scale,
    )
