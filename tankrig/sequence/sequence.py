"""A sequence: an experiment as data."""

import difflib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Literal

from pydantic import Field

from tankrig.devices import CameraSettings
from tankrig.errors import SequenceError
from tankrig.pattern import Pattern
from tankrig.pattern.cut_off import cut_off
from tankrig.pattern.kinds import AnyKind, Dark, Full, draw
from tankrig.pattern.wall import Wall
from tankrig.ranges import require_ranges
from tankrig.scene.description import CLOSED, Medium, Tank
from tankrig.sequence.steps import (
    MOST_TASKS,
    Burst,
    Capture,
    Dose,
    Exposure,
    Gain,
    Mix,
    Step,
    Task,
    separations,
    task_count,
    written_out,
)

Phase = Literal["hg", "two-term", "reynolds-mccormick", "fournier-forand", "free", "any"]
"""Families of phase functions that a fit can search without being told more."""
_ALWAYS: dict[str, AnyKind] = {"dark": Dark(), "full": Full()}


@dataclass(frozen=True)
class Sequence:
    """An experiment as data, checked as far as it can be without a rig.

    Parameters
    ----------
    name
        For people.
    steps
        What to do, in order.
    patterns
        What `Capture`, `Burst` and `Mix` can name, besides "dark" and "full".
    exposure_ms, gain
        Of the camera, where a step does not say otherwise.
    any_exposure
        A person's reason why exposures need not be whole numbers of the projector's periods; without one they must,
        where the rig file tells the period.
    ink
        What is expected of it, per mm and ml: models for the live fit are then prepared before the first dose. A wrong
        expectation costs time and nothing else; but a phase function that it has is what fits begin from, see `phase`.
    material, wavelength_nm
        A reference liquid that is dosed, as `tankrig materials` lists it, and the light's wavelength in vacuum: fits
        take beads for what this says of them, within a label's accuracy.
    phase
        Which phase functions fits search, as in `tankrig.estimate`; None: the material's or the ink's, and
        Henyey–Greenstein where neither says any.
    source
        The file that it came from, for messages.

    Raises
    ------
    SequenceError
        When a step names a pattern that is not there, or a dose takes ink out.

    Examples
    --------
    >>> from tankrig.pattern.kinds import Sheet
    >>> from tankrig.sequence import Series
    >>> sequence = Sequence(
    ...     "dilution",
    ...     steps=(Series((0.0, 50.0), (Mix(), Capture("sheet", frames=2))),),
    ...     patterns={"sheet": Sheet((-60.0, 60.0), (58.0, 62.0))},
    ... )
    >>> len(sequence.tasks), sequence.frames
    (6, 4)
    """

    __pydantic_config__ = CLOSED
    name: str
    steps: tuple[Step, ...]
    patterns: Mapping[str, Annotated[AnyKind, Field(discriminator="kind")]] = field(default_factory=dict)
    exposure_ms: Exposure = 20.0
    gain: Gain = 1.0
    any_exposure: str = ""
    ink: Medium | None = None
    material: str = ""
    wavelength_nm: float | None = None
    phase: Phase | None = None
    source: str = field(default="", repr=False, compare=False)

    def __post_init__(self) -> None:
        require_ranges(self, SequenceError)
        if self.material and self.wavelength_nm is None:
            raise SequenceError(f'material = "{self.material}" needs wavelength_nm; give that of the light, in vacuum')
        if (count := task_count(self.steps)) > MOST_TASKS:
            raise SequenceError(
                f"steps are {count} actions when they are written out, more than the {MOST_TASKS} that a run may have; "
                f"repeat less, or make several runs of it"
            )
        if not self.tasks:
            raise SequenceError("steps is empty; give at least one step")
        if taken := sorted(self.waves.keys() & {*self.patterns}):
            raise SequenceError(f'patterns."{taken[0]}" is the name of a wave of a separate step; give it another name')
        total_ul = 0.0
        for task in self.tasks:
            for pattern in _patterns_of(task):
                self._require_pattern(task, pattern)
            if isinstance(task.action, Dose):
                if task.action.total_ul < total_ul:
                    raise SequenceError(
                        f"{task.label}: the tank holds {total_ul:g} µl by then, and a dose cannot take ink out; "
                        f"let totals rise"
                    )
                total_ul = task.action.total_ul

    def _require_pattern(self, task: Task, name: str) -> None:
        known = [*_ALWAYS, *self.patterns, *self.waves]
        if name not in known:
            near = difflib.get_close_matches(name, known, n=1)
            advice = f'did you mean "{near[0]}"?' if near else f"known are {', '.join(known)}"
            raise SequenceError(f'{task.label}: pattern "{name}" is unknown; {advice}')

    @property
    def called(self) -> str:
        """What messages call it: by its file, or by its name where it has none."""
        return self.source or self.name

    @cached_property
    def tasks(self) -> tuple[Task, ...]:
        """The steps, written out."""
        return tuple(written_out(self.steps))

    @cached_property
    def waves(self) -> dict[str, AnyKind]:
        """Patterns of its `Separate` steps by name: what they light is not fitted, see `tankrig.separation`."""
        return {name: wave for step in separations(self.steps) for name, wave in step.patterns.items()}

    @cached_property
    def sheet_ends(self) -> frozenset[int]:
        """Numbers of the steps after which all waves of a sheet are recorded.

        Examples
        --------
        >>> from tankrig.sequence import Separate
        >>> step = Separate((58.0, 62.0), periods_mm=(4.0, 8.0), heights_mm=(30.0, 60.0))
        >>> sorted(Sequence("two sheets", (step,)).sheet_ends)
        [8, 16]
        """
        waves = [self.waves.get(getattr(task.action, "pattern", "")) for task in self.tasks]
        heights = [getattr(one, "z_mm", None) for one in waves]
        return frozenset(
            number
            for number, (here, after) in enumerate(zip(heights, [*heights[1:], None], strict=True))
            if here is not None and here != after
        )

    @property
    def frames(self) -> int:
        """How many frames it records."""
        return sum(task.action.frames for task in self.tasks if isinstance(task.action, Capture | Burst))

    @property
    def ink_ul(self) -> float:
        """What the tank holds when it is done."""
        return max((task.action.total_ul for task in self.tasks if isinstance(task.action, Dose)), default=0.0)

    def camera_settings(self, step: Capture | Mix | Burst) -> CameraSettings:
        """For one step."""
        return CameraSettings(step.exposure_ms or self.exposure_ms, step.gain or self.gain)

    def drawn(self, wall: Wall) -> dict[str, Pattern]:
        """The patterns that its steps use, by name, for the projector that lights `wall`.

        Raises
        ------
        SequenceError
            When one cannot be drawn with this projector.
        """
        patterns = {}
        for name, (kind, label) in self._used.items():
            try:
                patterns[name] = draw(kind, wall, name)
            except SequenceError as error:
                where = label if name in self.waves else f"patterns.{name} ({label})"
                raise SequenceError(f"{self.called}: {where}: {error}") from error
        return patterns

    def cut_off(self, wall: Wall, tank: Tank) -> tuple[str, ...]:
        """What light its steps ask for that misses the tank, in a sentence for each pattern.

        Parameters
        ----------
        wall
            Of the projector.
        tank
            Whose wall is lit.

        Examples
        --------
        >>> from tankrig.pattern.kinds import Sheet
        >>> sequence = Sequence("wide", (Capture("sheet"),), {"sheet": Sheet((-90.0, 60.0), (58.0, 62.0))})
        >>> print(*sequence.cut_off(Wall((120, 160), (-80.0, 80.0), (0.0, 120.0)), Tank()))
        pattern "sheet": y = -90 … 60 mm reaches beyond the tank's wall, -80 … 80 mm; what is beyond is cut off
        """
        found = []
        for name, (kind, _) in self._used.items():
            what = "waves of a separate step" if name in self.waves else f'pattern "{name}"'
            found += [f"{what}: {said}" for said in cut_off(kind, wall, tank)]
        return tuple(dict.fromkeys(found))

    @cached_property
    def _used(self) -> dict[str, tuple[AnyKind, str]]:
        """Patterns that its steps show by name, in their order, and the label of the first step that does."""
        kinds, found = _ALWAYS | dict(self.patterns) | self.waves, dict[str, tuple[AnyKind, str]]()
        for task in self.tasks:
            for name in _patterns_of(task):
                found.setdefault(name, (kinds[name], task.label))
        found.setdefault("dark", (_ALWAYS["dark"], "the dark between steps"))
        return found

    def first_with(self, pattern: str) -> str:
        """Label of the first step that shows a pattern, for messages."""
        return self._used[pattern][1]


def _patterns_of(task: Task) -> tuple[str, ...]:
    """Names of the patterns that a task shows, in their order."""
    match task.action:
        case Capture(pattern) | Mix(pattern):
            return (pattern,)
        case Burst(patterns):
            return patterns
        case _:
            return ()
