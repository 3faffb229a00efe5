"""Exposure brackets that a run has recorded, merged into one picture of more range than a frame has."""

import numpy as np

from tankrig.calibration.hdr import Merged, merge
from tankrig.devices import CameraSettings
from tankrig.errors import StoreError
from tankrig.live.photograph_plan import PhotographPlan
from tankrig.run.reading import Run


def merged_of_run(run: Run, pattern: str, delivered_ul: float) -> Merged:
    """All frames of a pattern at a dose, whatever their exposures and gains, merged.

    Parameters
    ----------
    run
        Whose camera was calibrated (`tankrig calibrate radiometry`) when it was recorded; its sequence captures the
        pattern several times with different `exposure_ms`.
    pattern
        Its name.
    delivered_ul
        Ink in the tank.

    Raises
    ------
    StoreError
        When the run has no such frames, or its camera was not calibrated at their gains.
    """
    plan = PhotographPlan.of_run(run)
    if plan.radiometry is None:
        raise StoreError(
            f"{run.path}: was recorded without a radiometric calibration for its gains, so exposures cannot be merged; "
            f"calibrate (tankrig calibrate radiometry), and record anew"
        )
    frames = run.frames
    wanted = frames[(frames.pattern == pattern).values & (frames.delivered_ul == delivered_ul).values]
    if not wanted.size:
        raise StoreError(f'{run.path}: has no frames of pattern "{pattern}" at {delivered_ul:g} µl; name others')
    settings = [
        CameraSettings(float(one.exposure_ms), float(one.gain))
        if np.isfinite(one.exposure_ms)
        else plan.settings[int(one.step)]
        for one in wanted
    ]
    return merge([(frame.values, one) for frame, one in zip(wanted, settings, strict=True)], plan.radiometry)
