"""The gravimetric correction of a doser's volumes, from the file that its settings name."""

from collections.abc import Mapping
from pathlib import Path


def correction(calibration: Path | None, name: str, basis: Mapping[str, float]) -> float:
    """True volume of a nominal µl; 1 where no calibration is named.

    Parameters
    ----------
    calibration
        File written by `tankrig calibrate pump`, or None.
    name
        Of the doser, for messages.
    basis
        Settings that its nominal volumes rest on; a file measured with others is refused.
    """
    if calibration is None:
        return 1.0
    from tankrig.calibration.pump import load_pump_calibration

    return load_pump_calibration(calibration).correction_for(name, basis)


def calibrated(identity: str, correction: float) -> str:
    """The identity of a doser whose count is in corrected µl, which is another count than the nominal one.

    >>> calibrated("cavro 1f", 1.0), calibrated("cavro 1f", 1.02)
    ('cavro 1f', 'cavro 1f ×1.02')
    """
    return identity if correction == 1.0 else f"{identity} ×{correction:.6g}"
