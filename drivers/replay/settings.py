"""What a rig file says about a camera that replays."""

from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class ReplayCameraSettings(BaseModel):
    """The `[camera]` table of a rig file for driver `replay-camera`.

    Parameters
    ----------
    source
        Folder of a run, or of PNG or TIFF images (grey, 8 or 16 bits), which are taken in the order of their names.
    pace
        "recorded": a stream in which each frame comes when it came, and who is late misses some; "full": every frame,
        one after the other, as fast as they are asked for.
    interval_ms
        From image to image, where `source` is a folder of images.
    exposure_ms
        Of the images; of a run it is known.
    bits
        Significant bits of the images; all they have where left out.
    loop
        Begin again after the last frame.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    source: Path
    pace: Literal["recorded", "full"] = "recorded"
    interval_ms: float = Field(default=1000.0 / 30.0, gt=0.0)
    exposure_ms: float = Field(default=20.0, gt=0.0)
    bits: int | None = Field(default=None, ge=8, le=16)
    loop: bool = False
