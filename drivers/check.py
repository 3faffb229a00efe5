"""A thing that was looked at on a rig, and what to do about it."""

from dataclasses import dataclass, field

from tankrig.errors import TankrigError


@dataclass(frozen=True)
class Check:
    """Something that was looked at.

    Parameters
    ----------
    what
        Was looked at.
    passed
        None where it could not be told.
    finding
        What was found.
    remedy
        What to do, unless it passed; in a command "--rig FILE" stands for the rig file, see `typed`.
    part
        Step on the way to a run that it belongs to: "devices", "light", "exposure", "rig file", or the kind of a
        calibration.
    """

    what: str
    passed: bool | None
    finding: str
    remedy: str = ""
    part: str = field(default="", compare=False)


def failed(what: str, error: TankrigError) -> Check:
    """What went wrong and, after the last semicolon of its sentence, what to do."""
    finding, _, remedy = str(error).rpartition("; ")
    return Check(what, False, finding or remedy, remedy if finding else "see what the device says")


RIG = "--rig FILE"


def typed(remedy: str, rig: str) -> str:
    """A remedy whose commands can be typed as they stand.

    Parameters
    ----------
    remedy
        Of a check.
    rig
        The option that names the rig file; empty where none is configured.

    Examples
    --------
    >>> typed("tankrig calibrate tank --rig FILE, or look", "--rig lab.toml")
    'tankrig calibrate tank --rig lab.toml, or look'
    """
    return remedy.replace(RIG, rig) if rig else remedy.replace(f" {RIG}", "")
