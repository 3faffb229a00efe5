"""What a driver has to provide so that its pump is a doser."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from tankrig.errors import DeviceError


class Count(NamedTuple):
    """An amount in the pump's ticks: best value and hard bounds.

    >>> Count.exactly(7) + Count(1, 0, 2) - Count.exactly(3)
    Count(best=5, low=4, high=6)
    """

    best: int
    low: int
    high: int

    @classmethod
    def exactly(cls, ticks: int) -> "Count":
        """An amount without doubt."""
        return cls(ticks, ticks, ticks)

    def __add__(self, other: "Count") -> "Count":  # type: ignore[override]
        return Count(self.best + other.best, self.low + other.low, self.high + other.high)

    def __sub__(self, other: "Count") -> "Count":
        return Count(self.best - other.best, self.low - other.high, self.high - other.low)


@dataclass(frozen=True)
class Standing:
    """What a pump at rest has delivered since the doser's zero.

    Parameters
    ----------
    total
        Best value and hard bounds, ticks.
    known
        False if only a person can say where between the bounds it is.
    reached
        Whether the last leg ended where it should.
    stopped
        Whether the device itself, or its memory, holds a stop that a person has to clear.
    why
        Why it came to rest.
    trouble
        Why it cannot dose now though its count is known, and what to do; None if it can.
    """

    total: Count
    known: bool
    reached: bool
    stopped: bool
    why: str
    trouble: str | None = None


@dataclass(frozen=True)
class Leg:
    """A part of a dose that is made ready: it ends by itself, at `end` ticks in all, after `duration_s`."""

    end: int
    duration_s: float


class NotSetOffError(DeviceError):
    """Nothing of this leg has moved, and nothing will."""


class Pump(Protocol):
    """A pump on its line, which counts what it has delivered since the doser's zero, in ticks.

    A tick is its smallest unit of volume. Times are those of its `drivers.clock.Clock`. `stop` is called from any
    thread; everything else by one thread at a time.
    """

    name: str
    """For messages; may say more once it has been greeted."""
    ticks_per_ul: float
    """Nominal."""
    increment: int
    """Ticks of the smallest dose that makes sense."""
    most: int
    """Ticks beyond which no total goes."""

    def greet(self) -> Standing:
        """Find out whether the right pump answers and what it has delivered; delivers nothing."""

    @property
    def identity(self) -> str:
        """Which count this is."""

    @property
    def dose_cap(self) -> int | None:
        """Ticks that the device itself allows for one dose."""

    def answers(self) -> bool:
        """Whether it answers one question that changes nothing, asked once."""

    def rest(self, leg: Leg | None = None) -> Standing:
        """Bring it to rest if it moves, and have it tell what it has delivered; `leg` is the one it was on."""

    def refusal(self, target: int, now: Count) -> str | None:
        """Why a dose to `target` ticks is refused, to follow "asked to dose …, but"; None if it is not."""

    def prepare(self, target: int) -> Leg | None:
        """Make the next leg of a dose to `target` ticks ready; None if there is none left. Delivers nothing."""

    def set_off(self, target: int, leg: Leg, unless: Callable[[], bool]) -> None:
        """Begin the leg, unless that holds; the order is given once.

        Raises
        ------
        NotSetOffError
            If it has certainly not begun. After any other error it may have.
        """

    def poll(self) -> tuple[bool, Count | None]:
        """Whether it moves, and what it counts meanwhile, but for a stall that it tells of next; feeds its watchdog."""

    def stop(self) -> None:
        """Put a stop on the wire now; never raises and waits for nobody.

        What goes on the wire must not keep a pump running that it does not stop.
        """

    def clear(self) -> None:
        """Clear a stop that the device itself has latched and told of."""

    def remember_unknown(self, low: int, high: int) -> None:
        """Keep for the next program that only the pump, when it answers again, or a person can say how much it was."""

    def assign(self, total: Count) -> None:
        """From now on this is what it has delivered: a person has said so."""

    def leave_alone(self) -> None:
        """It rests, and nothing will be asked of it for a while: it must not miss being asked."""

    def close(self) -> None:
        """Leave it as a person would want to find it, and let go of the port."""
