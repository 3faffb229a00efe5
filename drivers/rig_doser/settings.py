"""What a rig file says about the rig's own doser."""

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
    time_scale
        All of the driver's waits are multiplied by this (tests with a fast emulator).
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    port: str = Field(min_length=1)
    steps_per_ul: float = Field(gt=0, le=1e5, allow_inf_nan=False)
    serial: str | None = None
    dose_limit_ul: float | None = Field(default=None, gt=0, allow_inf_nan=False)
    time_scale: float = Field(default=1.0, gt=0, le=10)
