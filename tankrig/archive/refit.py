"""Refit an archive: which runs, in what order, and how far it is; who does the work is somebody else's concern."""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from tankrig.archive.key import Refitting
from tankrig.archive.results import Results
from tankrig.archive.runs import runs_in
from tankrig.archive.task import FAILED, MADE, TAKEN, THERE, Done, refit_run

Told = Callable[["Progress"], object]
"""Told after each run; what it raises ends the refit, and what is made stays."""

RECENT_S = 60.0
"""The rate is that of so long."""


@dataclass(frozen=True)
class RunToRefit:
    """One run to be fitted: what a worker is told, short enough to be sent a hundred thousand times."""

    path: str
    name: str
    results: str
    refitting: Refitting
    wait: bool = True

    def run(self) -> Done:
        """Do it, in this process."""
        return refit_run(Path(self.path), self.name, Results(Path(self.results)), self.refitting, self.wait)


@dataclass
class Progress:
    """How far a refit is.

    Parameters
    ----------
    total
        Runs in the archive.
    clock
        Seconds.
    """

    total: int
    clock: Callable[[], float] = time.monotonic
    made: int = 0
    there: int = 0
    failed: list[Done] = field(default_factory=list)
    _at: list[tuple[float, int]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._at.append((self.clock(), 0))

    @property
    def done(self) -> int:
        """Runs of which it is known what became of them."""
        return self.made + self.there + len(self.failed)

    def add(self, one: Done) -> None:
        """Count what became of a run."""
        self.made += one.outcome == MADE
        self.there += one.outcome == THERE
        self.failed += [one] if one.outcome == FAILED else []
        now_s = self.clock()
        if one.outcome in (MADE, FAILED):
            self._at.append((now_s, self.made + len(self.failed)))
        while len(self._at) > 2 and self._at[1][0] < now_s - RECENT_S:
            self._at.pop(0)

    @property
    def per_minute(self) -> float | None:
        """Runs fitted in a minute, lately; None where nothing tells yet."""
        (since_s, before), (_, after) = self._at[0], self._at[-1]
        passed_s = self.clock() - since_s
        return 60.0 * (after - before) / passed_s if after > before and passed_s > 0.0 else None

    @property
    def seconds_left(self) -> float | None:
        """At that rate; None where it is not known."""
        rate = self.per_minute
        return None if rate is None else 60.0 * (self.total - self.done) / rate

    def __str__(self) -> str:
        """In words.

        >>> progress = Progress(10, clock=iter([0.0, 6.0, 6.0, 6.0]).__next__)
        >>> progress.add(Done("a", "made"))
        >>> str(progress)
        '1 of 10 runs, 10 per minute, 54 s left'
        """
        rate, failed = self.per_minute, f", {len(self.failed)} failed" if self.failed else ""
        if rate is None:
            return f"{self.done} of {self.total} runs{failed}"
        left_s = 60.0 * (self.total - self.done) / rate
        return f"{self.done} of {self.total} runs{failed}, {rate:.3g} per minute, {in_words(left_s)} left"


def in_words(seconds: float) -> str:
    """A time for people.

    >>> in_words(54.2), in_words(600), in_words(9000)
    ('54 s', '10 min', '2.5 h')
    """
    if seconds < 100.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 6000.0 else f"{seconds / 3600.0:.1f} h"


def runs_to_refit(archive: Path, results: Results, refitting: Refitting) -> list[RunToRefit]:
    """What there is to do in an archive, by the names of the runs; whether it was done is seen when it is begun.

    Raises
    ------
    StoreError
        When there are no runs, or the results cannot be written.
    """
    results.require_place()
    top, out = archive.resolve(), str(results.folder.resolve())
    return [RunToRefit(str(path), _name(path, top), out, refitting) for path in runs_in(top)]


def _name(path: Path, top: Path) -> str:
    return path.name if path == top else str(path.relative_to(top))


def followed(outcomes: Iterable[Done], total: int, told: Told) -> Progress:
    """Count outcomes as they come."""
    progress = Progress(total)
    for one in outcomes:
        progress.add(one)
        told(progress)
    return progress


def in_this_process(wanted: Iterable[RunToRefit]) -> Iterator[Done]:
    """One run after the other."""
    for one in wanted:
        yield one.run()


def beside_others(do: Callable[[Sequence[RunToRefit]], Iterable[Done]], wanted: Sequence[RunToRefit]) -> Iterator[Done]:
    """Refit runs where other programs may be at the same archive.

    What another one is at is left for the end, and then waited for: so both are busy until all is done, no run is
    fitted twice, and what one of them leaves behind when it is killed the other does.

    Parameters
    ----------
    do
        Who does them.
    wanted
        In the order in which they are begun.
    """
    asked = {one.name: one for one in wanted}
    taken = []
    for done in do([replace(one, wait=False) for one in wanted]):
        if done.outcome == TAKEN:
            taken.append(asked[done.name])
        else:
            yield done
    yield from do(taken)


def from_share(wanted: Sequence[RunToRefit], share: int, shares: int) -> list[RunToRefit]:
    """The whole list, begun at another place by each of several programs that know nothing of each other.

    >>> from_share([1, 2, 3, 4], 1, 2)
    [3, 4, 1, 2]
    """
    begin = share * len(wanted) // shares
    return [*wanted[begin:], *wanted[:begin]]
