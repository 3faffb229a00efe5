"""What a rig file says about a V4L2 camera."""

from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

PixelFormat = Literal["GREY", "Y10", "Y12", "Y16", "YUYV"]
"""Uncompressed luminance; MJPG is not among them, because it loses counts."""

_BITS: dict[PixelFormat, int] = {"GREY": 8, "YUYV": 8, "Y10": 10, "Y12": 12, "Y16": 16}


class V4l2CameraSettings(BaseModel):
    """The `[camera]` table of a rig file for driver `v4l2-camera`.

    Parameters
    ----------
    device
        The camera's path; one below /dev/v4l/by-id is the same wherever it is plugged in.
    format
        Pixel format; of YUYV the luminance is used.
    shape
        (rows, columns) of the sensor's picture, before it is turned.
    fps
        Frames per second; the camera's own choice where left out.
    bits
        Significant bits of a pixel, where they are fewer than the format has (a 12-bit sensor sent as Y16).
    card
        If given, the only model name that is accepted.
    gain_one
        Value of the gain control that amplifies by 1; its least value where left out.
    controls
        Further controls by their V4L2 names (`tankrig devices` lists them), set on opening and read back.
    settle_frames
        How many frames after a change of settings may still have the old ones.
    turn_deg, mirror
        The picture is turned counter-clockwise, then mirrored left to right, so that row 0 is y = −Ly/2 and column 0
        is x = 0.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    device: Path
    format: PixelFormat
    shape: tuple[int, int]
    fps: float | None = Field(default=None, gt=0.0)
    bits: int | None = Field(default=None, ge=8, le=16)
    card: str | None = None
    gain_one: int | None = Field(default=None, gt=0)
    controls: dict[str, int | bool] = Field(default_factory=dict)
    settle_frames: int = Field(default=3, ge=0)
    turn_deg: Literal[0, 90, 180, 270] = 0
    mirror: bool = False

    @property
    def saturation(self) -> int:
        """Highest count."""
        return int(2 ** (self.bits or _BITS[self.format]) - 1)
