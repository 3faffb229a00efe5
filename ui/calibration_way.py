"""What of a rig is calibrated and what is missing, in the order in which calibrations rest on each other."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.check import RIG, Check

if TYPE_CHECKING:
    from drivers.rig import RigFile

GEOMETRY = ("camera", "tank", "projector")
CALIBRATIONS = ("radiometry", "stray", *GEOMETRY, "latency")
"""In the order in which they rest on each other."""
EXACT_PUMP, WHY_EXACT = "simulated-doser", "it is simulated, and its steps are exact"


@dataclass(frozen=True)
class Step:
    """A step on the way.

    Parameters
    ----------
    what
        Is true once it is done.
    done
        None: not done, and a run can begin all the same.
    finding
        What was found.
    command
        To be typed, or in words where no command does it; empty where nothing is to be done.
    wanted
        Whether the run's figures are worth less without it.
    """

    what: str
    done: bool | None
    finding: str
    command: str = ""
    wanted: bool = True


def calibration_steps(description: "RigFile", checks: Iterable[Check]) -> dict[str, Step]:
    """The calibrations of a rig by what they calibrate, in the order in which they rest on each other; the pump last.

    Parameters
    ----------
    description
        Of the rig.
    checks
        What `drivers.calibration_health.calibration_checks` has found, among others.
    """
    by_part: dict[str, list[Check]] = {}
    for check in checks:
        by_part.setdefault(check.part, []).append(check)
    steps = {kind: _calibration(kind, by_part, description) for kind in CALIBRATIONS}
    return {**steps, "pump": _pump(description)}


def _calibration(kind: str, by_part: dict[str, list[Check]], description: "RigFile") -> Step:
    what = "the camera's stray light is measured" if kind == "stray" else f"the {kind} is calibrated"
    command = f"tankrig calibrate {kind} {RIG}"
    checks = [*by_part.get("calibration", []), *by_part.get(kind, [])]
    wrong = next((check for check in checks if check.passed is False), None)
    if wrong is not None:
        return Step(what, False, wrong.finding, command)
    good = next((check for check in checks if check.passed), None)
    if good is not None:
        return Step(what, True, good.finding)
    from drivers.calibration_health import why_none  # takes time to load

    if why := why_none(kind, description):
        thing = "camera's stray light" if kind == "stray" else kind
        return Step(f"the {thing} needs no calibration", True, why)
    finding = next((check.finding for check in checks), "was not looked at")
    return Step(what, None, finding, command)


def _pump(description: "RigFile") -> Step:
    what = "the pump is calibrated"
    if file := description.doser.get("calibration"):
        return Step(what, True, Path(str(file)).name)
    if description.doser["driver"] == EXACT_PUMP:
        return Step(what, True, WHY_EXACT)
    finding = "nobody has weighed its doses; its nominal volume is believed"
    return Step(what, None, finding, f"tankrig calibrate pump {RIG}")
