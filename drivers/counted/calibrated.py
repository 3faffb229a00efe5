"""The gravimetric correction of a doser's volumes, from the file that its settings name."""

from pathlib import Path


def correction(calibration: Path | None, name: str, increment_ul: float) -> float:
    """True volume of a nominal µl; 1 where no calibration is named.

    Parameters
    ----------
    calibration
        File written by `tankrig calibrate pump`, or None.
    name
        Of the doser, for messages.
    increment_ul
        Nominal increment with these settings; the file's must be the same, else it is for another syringe.
    """
    if calibration is None:
        return 1.0
    from tankrig.calibration.pump import load_pump_calibration

    return load_pump_calibration(calibration).correction_for(name, increment_ul)
