"""What a rig file says about a projector at a video output."""

from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field

_CLOSED = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class ScreenIdentity(BaseModel):
    """Which screen the projector is; what is given must hold for exactly one. Never a number: those change places.

    Parameters
    ----------
    serial, model, manufacturer
        As the screen itself says (EDID).
    output
        Of the graphics card, such as "HDMI-1"; for a projector that says nothing of itself.
    """

    model_config = _CLOSED

    serial: str | None = None
    model: str | None = None
    manufacturer: str | None = None
    output: str | None = None

    def __str__(self) -> str:
        return ", ".join(f"{key} {value}" for key, value in self if value is not None)


class HdmiProjectorSettings(BaseModel):
    """The `[projector]` table of a rig file for driver `hdmi-projector`.

    Parameters
    ----------
    screen
        Which one it is.
    shape
        (rows, columns) of the projector's own pixels; its video mode must have as many.
    refresh_hz
        Of that mode.
    latency_ms
        99th percentile of the time from swap to light (`tankrig doctor` measures it).
    response
        Text file of 256 rows, the values of red, green and blue (0 to 255) that make the brightness 0/255 … 255/255 of
        full light; without it, a level goes out as it is on all three.
    timeout_s
        How long to wait for a swap.
    accept_primary
        A person's word that the projector may be the desktop's main screen, on which windows, panels and messages
        appear.
    accept_compositor
        A person's word that a compositor may make the screen's picture; then nobody but the camera can tell whether it
        changes or delays it.
    """

    model_config = _CLOSED

    screen: ScreenIdentity
    shape: tuple[int, int]
    refresh_hz: float = Field(gt=0.0, le=1000.0)
    latency_ms: float = Field(gt=0.0)
    response: Path | None = None
    timeout_s: float = Field(default=2.0, gt=0.0)
    accept_primary: bool = False
    accept_compositor: bool = False
