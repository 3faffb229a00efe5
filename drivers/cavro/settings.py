"""What a rig file says about a Cavro pump."""

from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

_STROKE = {"xcalibur": 3000, "xlp": 6000}
PULSES_PER_STROKE = 6000
FINER = 8


class CavroSettings(BaseModel):
    """The `[doser]` table of a rig file.

    Parameters
    ----------
    port
        Serial port; best one that names the adapter (`/dev/serial/by-id/…`).
    syringe_ul
        Volume of a full stroke of the syringe.
    count_file
        Where the driver keeps what the plunger's position means; one per pump and syringe.
    model
        Which decides how many increments a stroke has; compared with the firmware that the pump tells.
    firmware
        What the pump tells of its firmware (`&`), where tankrig does not know that as the model's: a person who gives
        it has seen on the pump's label that it is the model.
    fine
        Eight times as many increments.
    speed_ul_per_s
        Of the plunger, both ways.
    address
        Set with the switch on the pump, 1 to 15.
    baud
        Set with the jumpers on the pump.
    initialise_with
        Which way round the valve is fitted: "Z" with the output on the right, "Y" on the left.
    dose_limit_ul
        Most for one dose.
    calibration
        File written by `tankrig calibrate pump`.
    time_scale
        All of the driver's waits are multiplied by this (tests with a fast emulator).
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    port: str = Field(min_length=1)
    syringe_ul: float = Field(ge=10, le=50_000)
    count_file: Path
    model: Literal["xcalibur", "xlp"] = "xcalibur"
    firmware: str | None = Field(default=None, min_length=1)
    fine: bool = True
    speed_ul_per_s: float = Field(gt=0, allow_inf_nan=False)
    address: int = Field(default=1, ge=1, le=15)
    baud: Literal[9600, 38400] = 9600
    initialise_with: Literal["Z", "Y"] = "Z"
    dose_limit_ul: float | None = Field(default=None, gt=0, allow_inf_nan=False)
    calibration: Path | None = None
    time_scale: float = Field(default=1.0, gt=0, le=10)

    @property
    def finer(self) -> int:
        """Increments in one of the coarse ones."""
        return FINER if self.fine else 1

    @property
    def stroke(self) -> int:
        """Increments of a full stroke."""
        return _STROKE[self.model] * self.finer

    @property
    def increment_ul(self) -> float:
        """Nominal volume of an increment."""
        return self.syringe_ul / self.stroke

    @property
    def pulses_per_s(self) -> int:
        """The speed as the pump takes it: a stroke has as many pulses on every model."""
        return round(self.speed_ul_per_s / self.ul_per_pulse)

    @property
    def ul_per_pulse(self) -> float:
        """Nominal volume of a pulse, in which speeds count."""
        return self.syringe_ul / PULSES_PER_STROKE

    @property
    def increments_per_pulse(self) -> float:
        """Increments of the plunger's position in a pulse."""
        return self.stroke / PULSES_PER_STROKE
