"""What was true of a frame when it was exposed: the ink in the tank, and how the camera was set.

Frames carry it in their own lines of the journal. Runs of earlier versions do not; of theirs it is told from the lines
before: what a `session` found in the tank, what a `dose_done` left there, and how a note `camera` says it was set.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from tankrig.devices import CameraSettings, Delivered
from tankrig.run.journal import Event

CLAMPED = 0.01
"""A camera that sets an exposure or a gain that differs by more than this share of what was asked for has not rounded
it: it has set another one, and a person is told."""

_TELLING = ("session", "dose_done", "frame")


@dataclass(frozen=True)
class Conditions:
    """What was true at one moment of a run.

    Parameters
    ----------
    tank
        Ink in the tank, µl, with hard bounds.
    camera
        Its settings as read back; None where nobody has set it yet.
    """

    tank: Delivered
    camera: CameraSettings | None

    def line(self) -> dict[str, float | None]:
        """Keys of a frame's line in the journal; a bound that is not known is None, since JSON has no infinity.

        >>> Conditions(Delivered(10.0, 9.0, math.inf), CameraSettings(20.0)).line()
        {'delivered_ul': 10.0, 'delivered_low_ul': 9.0, 'delivered_high_ul': None, 'exposure_ms': 20.0, 'gain': 1.0}
        """
        tank = {"delivered_ul": self.tank.volume_ul, "delivered_low_ul": self.tank.low_ul}
        high = {"delivered_high_ul": self.tank.high_ul if math.isfinite(self.tank.high_ul) else None}
        camera = {"exposure_ms": self.camera.exposure_ms, "gain": self.camera.gain} if self.camera else {}
        return {**tank, **high, **camera}


class JournalFollower:
    """Follows a journal, event by event in their order, and knows what was true at each.

    Examples
    --------
    >>> from tankrig.run.journal import Moment
    >>> held = {"delivered_ul": 100.0, "delivered_low_ul": 99.0, "delivered_high_ul": 101.0}
    >>> seen = JournalFollower()
    >>> _ = seen.at(Event(0, "session", Moment("", 0, ""), held))
    >>> seen.at(Event(1, "frame", Moment("", 0, ""), {"index": 0})).tank.volume_ul
    100.0
    """

    def __init__(self) -> None:
        self.now = Conditions(Delivered(0.0, 0.0, 0.0), None)

    def at(self, event: Event) -> Conditions:
        """What was true at the event that comes next; of a frame, when it was exposed."""
        tank, camera = self.now.tank, self.now.camera
        if event.kind in _TELLING and event.get("delivered_ul") is not None:
            tank = _tank(event)
        if event.get("exposure_ms") is not None and (event.kind == "frame" or is_camera_note(event)):
            camera = CameraSettings(float(event["exposure_ms"]), float(event.get("gain", 1.0)))
        self.now = Conditions(tank, camera)
        return self.now


def with_conditions(journal: Iterable[Event]) -> Iterator[tuple[Event, Conditions]]:
    """Each event of a journal with what was true at it."""
    seen = JournalFollower()
    for event in journal:
        yield event, seen.at(event)


def is_camera_note(event: Event) -> bool:
    """Whether the event says how the camera was set."""
    return event.kind == "note" and event.get("text") == "camera" and "exposure_ms" in event.fields


def spanning(before: Delivered, after: Delivered) -> Delivered:
    """What the tank held at some moment between two at which it was asked for: bounds that hold whenever that was.

    >>> spanning(Delivered(10.0, 9.0, 11.0), Delivered(30.0, 28.0, 31.0))
    Delivered(volume_ul=20.0, low_ul=9.0, high_ul=31.0)
    """
    if before == after:
        return after
    low_ul, high_ul = min(before.low_ul, after.low_ul), max(before.high_ul, after.high_ul)
    return Delivered((before.volume_ul + after.volume_ul) / 2.0, low_ul, high_ul)


def clamped(asked: CameraSettings, actual: CameraSettings) -> bool:
    """Whether the camera has set something else than was asked for, by more than rounding.

    >>> clamped(CameraSettings(20.0), CameraSettings(19.9)), clamped(CameraSettings(1000.0), CameraSettings(100.0))
    (False, True)
    """
    pairs = ((asked.exposure_ms, actual.exposure_ms), (asked.gain, actual.gain))
    return any(not abs(got - wanted) <= CLAMPED * wanted for wanted, got in pairs)


def _tank(event: Event) -> Delivered:
    volume_ul = float(event["delivered_ul"])
    return Delivered(volume_ul, _bound(event, "delivered_low_ul", 0.0), _bound(event, "delivered_high_ul", math.inf))


def _bound(event: Event, key: str, unknown: float) -> float:
    value: Any = event.get(key)
    return unknown if value is None else float(value)
