"""Calibrations that a run was made with; copies of their files are in its folder."""

from tankrig.calibration.file import FOLDER, Calibration, usable
from tankrig.calibration.radiometry import Radiometry
from tankrig.run.reading import Run


def calibrations_of(run: Run) -> dict[str, Calibration]:
    """By kind, those that were in force when it was recorded.

    Raises
    ------
    StoreError
        When the file of one of them is gone or changed.
    """
    named = {str(kind): str(hashed) for kind, hashed in dict(run.settings.get("calibrations", {})).items()}
    if not named:
        return {}
    return {kind: one for kind, one in usable(run.path / FOLDER, named).items() if kind in named}


def radiometry_of_run(run: Run) -> Radiometry | None:
    """The radiometric calibration that was in force when a run was recorded; its file is in the run's folder.

    Raises
    ------
    StoreError
        When there was one, and its file is gone or changed.
    """
    named = run.settings.get("calibrations", {})
    if "radiometry" not in named:
        return None
    return Radiometry.of(usable(run.path / FOLDER, {"radiometry": named["radiometry"]})["radiometry"])
