"""What a rig file says about a LightCrafter 4500."""

from typing import Literal

from pydantic import Field, model_validator

from drivers.hdmi.settings import HdmiProjectorSettings

_DARK_US = 230
_LEAST_8_BIT_US = 8333


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
    """

    shape: tuple[int, int] = (1140, 912)
    led: Literal["red", "green", "blue", "white"] = "white"
    exposure_us: int | None = Field(default=None, ge=_LEAST_8_BIT_US)

    @property
    def period_us(self) -> int:
        """From refresh to refresh."""
        return round(1e6 / self.refresh_hz)

    @model_validator(mode="after")
    def _exposure_fits(self) -> "LightcrafterSettings":
        if self.period_us < _LEAST_8_BIT_US:
            raise ValueError(f"an 8-bit picture takes {_LEAST_8_BIT_US} µs; give refresh_hz 120 or less")
        if self.exposure_us not in (None, self.period_us) and self.exposure_us > self.period_us - _DARK_US:
            raise ValueError(f"exposure_us is the period, {self.period_us}, or at most {self.period_us - _DARK_US}")
        return self
