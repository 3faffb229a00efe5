"""What a rig file says about a LightCrafter 4500."""

from pathlib import Path
from typing import Literal

from pydantic import Field, model_validator

from drivers.hdmi.settings import HdmiProjectorSettings, ScreenIdentity

from .pattern_table import DARK_US, LEAST_EXPOSURE_US

_LEAST_8_BIT_US = LEAST_EXPOSURE_US[7]


class LightcrafterSettings(HdmiProjectorSettings):
    """The `[projector]` table of a rig file for driver `lightcrafter-4500`: that of `hdmi-projector`, and more.

    Parameters
    ----------
    shape
        (rows, columns) of its mirrors.
    led
        Which of its lamps are on.
    exposure_us
        For how much of each refresh; all of it where left out, else 230 µs less at least.
    flash
        Folder of the pictures that are in its flash, for bursts; without it there are none.
    burst_gap_ms
        Dark after each exposure of a burst, in which the camera gets ready for the next.
    burst_trigger
        What calls for each pattern of a burst: the board itself ("internal"), or an edge at its trigger input 1.
    """

    shape: tuple[int, int] = (1140, 912)
    led: Literal["red", "green", "blue", "white"] = "white"
    exposure_us: int | None = Field(default=None, ge=_LEAST_8_BIT_US)
    flash: Path | None = None
    burst_gap_ms: float = Field(default=1.0, ge=0.1, le=1000.0)
    burst_trigger: Literal["internal", "rising", "falling"] = "internal"

    @property
    def period_us(self) -> int:
        """From refresh to refresh."""
        return round(1e6 / self.refresh_hz)

    @model_validator(mode="after")
    def _exposure_fits(self) -> "LightcrafterSettings":
        if self.period_us < _LEAST_8_BIT_US:
            raise ValueError(f"an 8-bit picture takes {_LEAST_8_BIT_US} µs; give refresh_hz 120 or less")
        if self.exposure_us not in (None, self.period_us) and self.exposure_us > self.period_us - DARK_US:
            raise ValueError(f"exposure_us is the period, {self.period_us}, or at most {self.period_us - DARK_US}")
        return self


class SimulatedLightcrafterSettings(LightcrafterSettings):
    """The `[projector]` table of a rig file for driver `simulated-lightcrafter`: that of a real one, and more.

    Parameters
    ----------
    folder
        Of the simulated tank, the same for all three devices.
    in_standby
        Whether it has to be woken first.
    seed
        Of the latency of its video.
    """

    folder: Path
    screen: ScreenIdentity = ScreenIdentity(model="simulated")
    refresh_hz: float = Field(default=60.0, gt=0.0, le=1000.0)
    latency_ms: float = Field(default=35.0, gt=0.0)
    in_standby: bool = False
    seed: int = 0
