"""What a rig file says about a V4L2 camera."""

from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from .pixels import FORMATS, Cells


class V4l2CameraSettings(BaseModel):
    """The `[camera]` table of a rig file for driver `v4l2-camera`.

    Parameters
    ----------
    device
        The camera's path; one below /dev/v4l/by-id is the same wherever it is plugged in.
    format
        Pixel format, one of `drivers.v4l2.pixels.FORMATS`: grey (Y16, Y16_BE, Y12, Y12P, Y10, Y10P, Y10B, GREY),
        YUYV, of which the luminance is used, or the mosaic of a colour sensor (SRGGB8, SGRBG10, SGBRG12P, …). MJPG is
        not among them, because it loses counts.
    shape
        (rows, columns) of the sensor's picture, before it is turned.
    bayer
        Of a colour sensor each 2×2 cell is one grey pixel: the sum of its two green pixels ("green") or of all four
        ("all"). A picture then has half the rows and columns.
    fps
        Frames per second; the camera's own choice where left out.
    bits
        Significant bits of a pixel, where they are fewer than the format has (a 12-bit sensor sent as Y16).
    timestamps
        What the camera's time stamps mark, where the kernel says it wrong: "start" of the exposure or "end" of the
        frame. `tankrig doctor` shows it as latency.
    card
        If given, the only model name that is accepted.
    gain_one
        Value of the gain control that amplifies by 1; its least value where left out.
    controls
        Further controls by their V4L2 names (`tankrig devices` lists them), set on opening and read back.
    settle_frames
        How many of the frames that begin after a change of settings may still have the old ones; where left out, three
        and one for each buffer of the kernel's. `tankrig doctor` counts them.
    turn_deg, mirror
        The picture is turned counter-clockwise, then mirrored left to right, so that row 0 is y = −Ly/2 and column 0
        is x = 0.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    device: Path
    format: str
    shape: tuple[int, int]
    bayer: Cells = "green"
    fps: float | None = Field(default=None, gt=0.0)
    bits: int | None = Field(default=None, ge=8, le=16)
    timestamps: Literal["start", "end"] | None = None
    card: str | None = None
    gain_one: int | None = Field(default=None, gt=0)
    controls: dict[str, int | bool] = Field(default_factory=dict)
    settle_frames: int | None = Field(default=None, ge=0)
    turn_deg: Literal[0, 90, 180, 270] = 0
    mirror: bool = False

    @field_validator("format")
    @classmethod
    def _uncompressed(cls, name: str) -> str:
        if name in FORMATS:
            return name
        if name in ("MJPG", "JPEG", "H264", "HEVC"):
            raise ValueError(f"{name} is compressed, which loses counts; choose one of {', '.join(FORMATS)}")
        raise ValueError(f"{name} is not known; choose one of {', '.join(FORMATS)}")

    @model_validator(mode="after")
    def _fits_16_bits(self) -> "V4l2CameraSettings":
        if self.saturation > 65535:
            added = FORMATS[self.format].added(self.bayer)
            raise ValueError(
                f"the sum of {added} pixels of {self.pixel_bits} bits does not fit 16 bits; give camera.bits, the "
                f"significant bits of a pixel, at most {17 - added.bit_length()}"
            )
        return self

    @property
    def pixel_bits(self) -> int:
        """Significant bits of a pixel of the sensor."""
        return self.bits or FORMATS[self.format].bits

    @property
    def saturation(self) -> int:
        """Highest count of a picture's pixel."""
        return int(2**self.pixel_bits - 1) * FORMATS[self.format].added(self.bayer)
