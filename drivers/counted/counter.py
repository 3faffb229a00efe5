"""What a driver for a pump with a counter has to provide."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

from drivers.dosing.pump import Count


class Trust(Enum):
    """What a pump's counter is worth when it has come to rest."""

    EXACT = "the counter is right"
    UNWITNESSED = "replies were lost in which it may have said that it stalled"
    TIMED_OUT = "its watchdog has acted; what it may have said before that was not heard"
    STALLED = "it stalled: it delivered at most what it counted"
    RESTARTED = "it lost its count"


@dataclass(frozen=True)
class Reading:
    """The counter of a pump at rest; `stopped`: whether a stop may have been sent since it set off."""

    count: Count
    trust: Trust = Trust.EXACT
    why: str = "it was stopped"
    stopped: bool = True


class Counter(Protocol):
    """A pump with a counter, on its line. Ticks are its smallest unit of volume."""

    model: str
    tick_ul: float
    ticks_per_ul: float
    order: int
    """Ticks that an order is a multiple of."""
    margin: int
    """Ticks by which an order stays below the target, so that what the counter does not show cannot pass it."""
    most_doubt: int
    """Ticks of doubt in the count beyond which it must be begun anew."""
    increment: int
    """Ticks of the smallest dose that makes sense."""
    lost_by_stopping: int
    """Ticks that a stop in motion may have cost."""
    stroke: int
    """Ticks it can deliver without counting beyond a renewal."""
    counter_restarts: bool
    """Whether the counter begins at 0 again when the power fails."""
    on_its_own: int
    """Ticks it surely delivers when nobody is heard any more, until its watchdog stops it; 0 without a watchdog."""
    repeats: bool
    """Whether it begins its last order anew by itself when its power comes back (found so when it was greeted)."""

    def greet(self) -> None:
        """Find out whether the right pump answers; moves nothing."""

    def answers(self) -> bool:
        """Whether it answers one question that changes nothing, asked once."""

    def read(self) -> Reading:
        """Bring it to rest if it moves, and read the counter beyond doubt about which reply is which."""

    def stale(self) -> bool:
        """Whether the counter must be renewed before anything else (settings that it forgets the count with)."""

    def set_up(self) -> None:
        """Have it take the settings that hold for every dose, so that one it cannot do is told now; moves nothing.

        Raises
        ------
        DeviceError
            If it refuses one.
        """

    def room(self, count: Count) -> int:
        """Ticks it can deliver before its counter must be renewed."""

    def renew(self) -> None:
        """Make room, without anything leaving the tube: clear the counter, or refill."""

    def prepare(self, ticks: int, count: Count) -> None:
        """Make ready to deliver so much, and see that it is; moves nothing."""

    def go(self, unless: Callable[[], bool]) -> bool:
        """Set off, sent once, unless that holds; False if it certainly did not."""

    def poll(self) -> tuple[bool, Count | None]:
        """Whether it moves, and what it counts meanwhile; feeds its watchdog."""

    def duration_s(self, ticks: int) -> float:
        """How long it takes for that."""

    def stop(self) -> None:
        """Put a stop on the wire now; never raises, waits for nobody."""

    def leave_alone(self) -> None:
        """Nothing will be asked of it for a while: it must not miss being asked."""

    def close(self) -> None:
        """Leave it as a person would want to find it, and let go of the port."""
