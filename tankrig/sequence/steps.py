"""What a sequence is made of: frozen steps, the same from a file and from Python."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field

from tankrig.errors import SequenceError
from tankrig.pattern.kinds import Wave
from tankrig.ranges import Within, require_ranges
from tankrig.scene.description import CLOSED, Interval
from tankrig.sequence.until import Until

MOST_S = 1e8
"""Of any wait; three years."""
MOST_EXPOSURE_MS = 1e7
MOST_GAIN = 1e6
MOST_SHIFTS = 64
MOST_TASKS = 100_000
"""Of a sequence that is written out: more than a day of one each second."""
MOST_UL = 1e9
"""Of ink; a cubic metre."""
MOST_FRAMES = 10**7
MOST_TIMES = 10**12
"""More than `MOST_TASKS`, so that a sequence says how many actions it is written out."""

Exposure = Annotated[
    float,
    Within(
        0.0, MOST_EXPOSURE_MS, "is not positive, or has no end; give a positive number up to 1e+07", above=True
    ),
]  # fmt: skip
"""Of a frame, ms."""
Gain = Annotated[
    float, Within(0.0, MOST_GAIN, "is not positive, or has no end; give a positive number up to 1e+06", above=True)
]
Volume = Annotated[float, Within(0.0, MOST_UL, "is no volume; give zero or more µl")]
Frames = Annotated[int, Within(1, MOST_FRAMES, f"records nothing, or more than {MOST_FRAMES}; give 1 or more")]


def _require(condition: bool, message: str) -> None:
    if not condition:
        raise SequenceError(message)


@dataclass(frozen=True)
class Dose:
    """Dose ink until the tank holds `total_ul` in all since it was filled."""

    __pydantic_config__ = CLOSED
    total_ul: Volume
    do: Literal["dose"] = "dose"

    def __post_init__(self) -> None:
        require_ranges(self, SequenceError)


@dataclass(frozen=True)
class Mix:
    """Wait until pictures of the tank say that the ink has mixed.

    Parameters
    ----------
    pattern
        What to light the tank with meanwhile.
    tolerance
        Mixed when what is still to change is below this part of the picture (root mean square).
    every_s
        From picture to picture; they are looked at, not recorded.
    at_least_s
        Look for this long at least: ink that has not reached the light yet changes nothing.
    timeout_s
        Give up after this time.
    exposure_ms, gain
        Where they differ from the sequence's.
    """

    __pydantic_config__ = CLOSED
    pattern: str = "full"
    tolerance: Annotated[
        float, Within(0.0, 1.0, "is outside 0…1; give a part of the picture", above=True, below=True)
    ] = 0.01
    every_s: Annotated[float, Within(0.0, MOST_S, "is no time; give seconds")] = 0.25
    at_least_s: Annotated[float, Within(0.0, MOST_S, "is no time; give seconds")] = 3.0
    timeout_s: Annotated[float, Within(0.0, MOST_S, "is no time, or has no end; give seconds", above=True)] = 300.0
    exposure_ms: Exposure | None = None
    gain: Gain | None = None
    do: Literal["mix"] = "mix"

    def __post_init__(self) -> None:
        require_ranges(self, SequenceError)
        _require(
            self.at_least_s < self.timeout_s,
            f"at_least_s = {self.at_least_s}, timeout_s = {self.timeout_s} leaves no time to look; give a timeout that "
            f"is longer, up to {MOST_S:g} s",
        )


@dataclass(frozen=True)
class Capture:
    """Show a pattern and record frames of it.

    Parameters
    ----------
    pattern
        One of the sequence's, or "dark" or "full".
    frames
        How many; with `until`, at most.
    exposure_ms, gain
        Where they differ from the sequence's.
    until
        No more frames, and no more projecting, once the live fit knows the liquid so well.
    timeout_s
        With `until` only: the live fit is waited for, for so long at most, and then no more frames are taken either.
    """

    __pydantic_config__ = CLOSED
    pattern: str
    frames: Frames = 1
    exposure_ms: Exposure | None = None
    gain: Gain | None = None
    until: Until | None = None
    timeout_s: Annotated[float, Within(0.0, MOST_S, "is no time; give seconds", above=True)] | None = None
    do: Literal["capture"] = "capture"

    def __post_init__(self) -> None:
        require_ranges(self, SequenceError)
        if self.timeout_s is not None:
            _require(self.until is not None, f"timeout_s = {self.timeout_s} needs until; give both or neither")


@dataclass(frozen=True)
class Burst:
    """Have the projector show patterns one after the other by itself, and trigger the camera with each.

    Parameters
    ----------
    patterns
        Of the sequence, in the order in which they are shown; one may come several times.
    times
        How often all of them are shown.
    exposure_ms, gain
        Where they differ from the sequence's. Each pattern is lit within one exposure.
    """

    __pydantic_config__ = CLOSED
    patterns: tuple[str, ...]
    times: Annotated[int, Within(1, MOST_TIMES, "shows nothing; give 1 or more")] = 1
    exposure_ms: Exposure | None = None
    gain: Gain | None = None
    do: Literal["burst"] = "burst"

    def __post_init__(self) -> None:
        _require(len(self.patterns) > 0, "patterns is empty; name what to show")
        require_ranges(self, SequenceError)

    @property
    def frames(self) -> int:
        """How many it records: one of each pattern, each time."""
        return len(self.patterns) * self.times


@dataclass(frozen=True)
class Separate:
    """Record waves of light, from which `tankrig.separation` tells light that was scattered once from the rest.

    A sheet is lit by cosine waves along y of each period, each in several shifts. It is written out as captures: a dark
    one, and at each height, for each period, all shifts, those that are half a period apart one after the other.

    Parameters
    ----------
    z_mm
        (low, high) of the sheet.
    periods_mm
        Of the waves.
    shifts
        How many of each; a multiple of 4, so that pairs add up to the same light and tell what changed meanwhile.
    frames
        Of each.
    y_mm
        (low, high) of the sheet; the whole wall where left out.
    heights_mm
        Middles of sheets as thick as `z_mm`, in whose places it is done; in that of `z_mm` where there are none.
    exposure_ms, gain
        Where they differ from the sequence's.
    """

    __pydantic_config__ = CLOSED
    z_mm: Interval
    periods_mm: tuple[float, ...] = (4.0, 8.0, 16.0)
    shifts: Annotated[int, Within(4, MOST_SHIFTS, f"is not 4, 8, … {MOST_SHIFTS}")] = 4
    frames: Frames = 1
    y_mm: Interval | None = None
    heights_mm: tuple[float, ...] = ()
    exposure_ms: Exposure | None = None
    gain: Gain | None = None
    do: Literal["separate"] = "separate"

    def __post_init__(self) -> None:
        require_ranges(self, SequenceError)
        _require(len(self.periods_mm) > 0, "periods_mm is empty; give the period of each wave in mm")
        _require(
            all(0.0 < one < float("inf") for one in self.periods_mm)
            and len({*self.periods_mm}) == len(self.periods_mm),
            f"periods_mm = {list(self.periods_mm)} has one that is no length, or one twice; give different ones in mm",
        )
        _require(
            self.shifts % 4 == 0,
            f"shifts = {self.shifts} does not light every place equally often in pairs; give 4, 8, … {MOST_SHIFTS}",
        )
        _require(
            self.z_mm[0] < self.z_mm[1], f"z_mm = {list(self.z_mm)} is no sheet; give its lower and its upper edge"
        )
        _require(len({*self.heights_mm}) == len(self.heights_mm), "heights_mm has one twice; give different ones in mm")

    @property
    def sheets(self) -> tuple[Interval, ...]:
        """(low, high) of each sheet."""
        half = 0.5 * (self.z_mm[1] - self.z_mm[0])
        return tuple((middle - half, middle + half) for middle in self.heights_mm) or (self.z_mm,)

    @property
    def patterns(self) -> "dict[str, Wave]":
        """All waves by name, in the order in which they are shown."""
        half = self.shifts // 2
        order = [number for first in range(half) for number in (first, first + half)]
        return {
            f"wave-{period_mm:g}mm-z{z_mm[0]:g}-{z_mm[1]:g}-{number}of{self.shifts}": Wave(
                period_mm, z_mm, number / self.shifts, self.y_mm
            )
            for z_mm in self.sheets
            for period_mm in self.periods_mm
            for number in order
        }

    @property
    def captures(self) -> tuple[Capture, ...]:
        """What it is written out as."""
        dark = Capture("dark", self.frames, self.exposure_ms, self.gain)
        return dark, *(Capture(name, self.frames, self.exposure_ms, self.gain) for name in self.patterns)


@dataclass(frozen=True)
class Wait:
    """Do nothing for a while."""

    __pydantic_config__ = CLOSED
    seconds: Annotated[float, Within(0.0, MOST_S, f"is no time; give 0 to {MOST_S:g}")]
    do: Literal["wait"] = "wait"

    def __post_init__(self) -> None:
        require_ranges(self, SequenceError)


@dataclass(frozen=True)
class Note:
    """Write something into the journal."""

    __pydantic_config__ = CLOSED
    text: str
    do: Literal["note"] = "note"


@dataclass(frozen=True)
class Repeat:
    """Do the steps several times."""

    __pydantic_config__ = CLOSED
    times: Annotated[int, Within(1, MOST_TIMES, "does nothing; give 1 or more")]
    steps: "tuple[Step, ...]"
    do: Literal["repeat"] = "repeat"

    def __post_init__(self) -> None:
        require_ranges(self, SequenceError)
        _require(len(self.steps) > 0, "steps is empty; give what to repeat")


@dataclass(frozen=True)
class Series:
    """Dose to one total after the other, and do the steps at each.

    Parameters
    ----------
    total_ul
        Ink in the tank since it was filled, rising; 0 for clear water.
    steps
        What to do at each.
    """

    __pydantic_config__ = CLOSED
    total_ul: tuple[float, ...]
    steps: "tuple[Step, ...]"
    do: Literal["series"] = "series"

    def __post_init__(self) -> None:
        _require(len(self.total_ul) > 0, "total_ul is empty; give the ink in the tank at each dose")
        _require(len(self.steps) > 0, "steps is empty; give what to do at each dose")


Action = Dose | Mix | Capture | Burst | Wait | Note
"""What the runner does."""

Step = Annotated[Dose | Mix | Capture | Burst | Separate | Wait | Note | Repeat | Series, Field(discriminator="do")]
"""What a sequence is written in."""


@dataclass(frozen=True)
class Task:
    """One action of a sequence that has been written out, and where in the sequence it stands."""

    action: Action
    place: str = ""

    @property
    def label(self) -> str:
        """The task in words.

        >>> Task(Capture("sheet", frames=2), "dose 3 of 5, ").label
        'dose 3 of 5, capture sheet × 2'
        """
        match self.action:
            case Dose(total_ul):
                what = f"dose to {total_ul:g} µl"
            case Mix():
                what = "wait until mixed"
            case Capture(pattern, frames, until=until):
                what = f"capture {pattern}" + (f" × {frames}" if frames > 1 else "")
                what += f" at most until {until}" if until else ""
            case Burst(patterns, times):
                what = f"burst of {len(patterns)} patterns" + (f" × {times}" if times > 1 else "")
            case Wait(seconds):
                what = f"wait {seconds:g} s"
            case Note(text):
                what = f"note: {text}"
        return self.place + what


def task_count(steps: tuple[Step, ...]) -> int:
    """How many actions nested steps are when written out, which may be more than there is memory for.

    >>> task_count((Repeat(10**6, (Repeat(10**6, (Wait(1.0), Capture("full"))),)),))
    2000000000000
    """
    count = 0
    for step in steps:
        match step:
            case Repeat(times, inner):
                count += times * task_count(inner)
            case Series(totals, inner):
                count += len(totals) * (1 + task_count(inner))
            case Separate():
                count += 1 + len(step.sheets) * len(step.periods_mm) * step.shifts
            case _:
                count += 1
    return count


def separations(steps: "tuple[Step, ...]") -> Iterator[Separate]:
    """The `Separate` steps among nested ones, each once, in their order."""
    for step in steps:
        match step:
            case Separate():
                yield step
            case Repeat(steps=inner) | Series(steps=inner):
                yield from separations(inner)
            case _:
                pass


def written_out(steps: tuple[Step, ...], place: str = "") -> Iterator[Task]:
    """The actions of nested steps, one after the other.

    Examples
    --------
    >>> steps = (Series((0.0, 50.0), (Mix(), Capture("sheet"))),)
    >>> [task.label for task in written_out(steps)][3:]
    ['dose 2 of 2, dose to 50 µl', 'dose 2 of 2, wait until mixed', 'dose 2 of 2, capture sheet']
    """
    for step in steps:
        match step:
            case Repeat(times, inner):
                for time in range(times):
                    yield from written_out(inner, f"{place}time {time + 1} of {times}, ")
            case Series(totals, inner):
                for number, total_ul in enumerate(totals):
                    here = f"{place}dose {number + 1} of {len(totals)}, "
                    yield Task(Dose(total_ul), here)
                    yield from written_out(inner, here)
            case Separate():
                captures = step.captures
                for number, capture in enumerate(captures):
                    yield Task(capture, f"{place}separate {number + 1} of {len(captures)}, ")
            case _:
                yield Task(step, place)
