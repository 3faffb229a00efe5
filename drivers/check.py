"""A thing that was looked at on a rig, and what to do about it."""

from dataclasses import dataclass

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
        What to do, unless it passed.
    """

    what: str
    passed: bool | None
    finding: str
    remedy: str = ""


def failed(what: str, error: TankrigError) -> Check:
    """What went wrong and, after the last semicolon of its sentence, what to do."""
    finding, _, remedy = str(error).rpartition("; ")
    return Check(what, False, finding or remedy, remedy if finding else "see what the device says")
