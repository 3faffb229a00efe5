"""What a rig file says about a New Era pump."""

from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class NewEraSettings(BaseModel):
    """The `[doser]` table of a rig file.

    Parameters
    ----------
    port
        Serial port; best one that names the adapter (`/dev/serial/by-id/…`).
    diameter_mm
        Inside diameter of the syringe; set on the pump. Up to 14 mm the pump counts in 0.1 µl, above in 1 µl.
    rate_ml_per_min
        How fast it pumps.
    count_file
        Where the driver keeps what the pump's counter means; one per pump and syringe.
    address
        Of the pump on its network.
    baud
        As set on the pump.
    watchdog_s
        The pump stops when it hears nothing for so long.
    power_failure_mode
        "off" where the pump cannot tell (firmware without the command `PF`): a person has seen that it does not begin
        again by itself after a power failure.
    dose_limit_ul
        Most for one dose.
    calibration
        File written by `tankrig calibrate pump`.
    time_scale
        All of the driver's waits are multiplied by this (tests with a fast emulator).
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    port: str = Field(min_length=1)
    diameter_mm: float = Field(ge=0.1, le=50.0)
    rate_ml_per_min: float = Field(gt=0, le=100.0)
    count_file: Path
    address: int = Field(default=0, ge=0, le=99)
    baud: int = Field(default=19200, gt=0)
    watchdog_s: int = Field(default=3, ge=2, le=10)
    power_failure_mode: Literal["off"] | None = None
    dose_limit_ul: float | None = Field(default=None, gt=0, allow_inf_nan=False)
    calibration: Path | None = None
    time_scale: float = Field(default=1.0, gt=0, le=10)
