"""What a rig file says about the rig's own doser."""

from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field


class RigDoserSettings(BaseModel):
    """The `[doser]` table of a rig file.

    Parameters
    ----------
    port
        Serial port; best one that names the device (`/dev/serial/by-id/…`).
    steps_per_ul
        Motor steps that deliver one µl (`tankrig calibrate pump`).
    serial
        If given, the only serial number that is accepted.
    dose_limit_ul
        Most for one dose; the firmware's own cap holds besides.
    calibration
        File written by `tankrig calibrate pump`; corrects steps_per_ul.
    time_scale
        All of the driver's waits are multiplied by this (tests with a fast emulator).
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    port: str = Field(min_length=1)
    steps_per_ul: float = Field(gt=0, le=1e5, allow_inf_nan=False)
    serial: str | None = None
    dose_limit_ul: float | None = Field(default=None, gt=0, allow_inf_nan=False)
    calibration: Path | None = None
    time_scale: float = Field(default=1.0, gt=0, le=10)


class SimulatedDoserSettings(BaseModel):
    """The `[doser]` table of a rig file for the simulated doser.

    Parameters
    ----------
    folder
        Where its memory and its link live: one per simulated tank.
    steps_per_ul
        Motor steps that deliver one µl, exactly.
    rate, acceleration
        Of the motor, steps/s and steps/s².
    dose_limit_ul
        As for the real one.
    linger_s
        The emulator outlives a killed program for so long, as a real doser would.
    faults, seed
        What goes wrong from the start, and the seed it is drawn from (firmware_notes/rig_doser.md).
    time_scale
        All times are multiplied by this (tests).
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    folder: Path
    steps_per_ul: float = Field(default=10.0, gt=0, le=1e5, allow_inf_nan=False)
    rate: float = Field(default=2000.0, gt=0, le=65535)
    acceleration: float = Field(default=8000.0, gt=0, allow_inf_nan=False)
    dose_limit_ul: float | None = Field(default=None, gt=0, allow_inf_nan=False)
    linger_s: float = Field(default=30.0, ge=0)
    faults: dict[str, float | bool] = Field(default_factory=dict)
    seed: int = 0
    time_scale: float = Field(default=1.0, gt=0, le=10)
