"""A live fit tied to a run: frames in, `fit` lines into the journal, and an end that both agree on."""

import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache

from tankrig.bench import Bench
from tankrig.errors import SceneError, SequenceError, StoreError
from tankrig.live.exposures import PhotographPlan
from tankrig.live.light_seen import require_light_seen
from tankrig.live.live_fit import LiveFit
from tankrig.live.results import DoseFit, Fit, to_fields
from tankrig.run.reading import open_run
from tankrig.run.runner import Runner
from tankrig.sequence import Sequence

PATIENCE_S = 240.0


def require_fittable(sequence: Sequence, bench: Bench) -> None:
    """Refuse a sequence whose photographs could not be fitted, before anything is made or moves.

    Raises
    ------
    SequenceError
        When a pattern cannot be drawn, what it lights cannot be modelled, or the camera sees nothing of its light.
    """
    require_light_seen(sequence, bench)
    for name, pattern in sequence.drawn(bench.wall).items():
        try:
            _ = PhotographPlan.of(bench, sequence, [pattern]).scenes
        except SceneError as error:
            raise SequenceError(f'{sequence.name}: pattern "{name}" cannot be fitted: {error}') from error


@contextmanager
def fitted_live(runner: Runner, patience_s: float = PATIENCE_S) -> Iterator[LiveFit]:
    """Fit a run's frames while it goes on; enter before `Runner.run` and leave after it.

    What is found stands in the journal, once frames have stopped to come for a moment, and `Runner.latest_fit` is the
    last of all. Frames and fits of a run that goes on are taken in first.

    Parameters
    ----------
    runner
        Of the run, new or resumed.
    patience_s
        How long the run's end waits for the last fits; those that come later are lost, and `tankrig report` makes them.
    """
    run = open_run(runner.path)

    def record(fit: Fit) -> None:
        if isinstance(fit, DoseFit) and fit.passing:
            runner.latest_fit = to_fields(fit)
            return
        with suppress(StoreError):  # it has come after the end
            runner.record("fit", **to_fields(fit))

    @cache
    def latest_s() -> float:
        return time.monotonic() + patience_s

    def tell(sentence: str) -> None:
        with suppress(StoreError):
            runner.record("note", text=sentence, warning=True)

    with LiveFit(PhotographPlan.of_run(run), record, run, tell) as fit:
        runner.fitted = True
        runner.latest_fit = next((event.fields for event in reversed(run.fits)), None)
        runner.listen(fit.see)
        runner.before_end.append(lambda: fit.finished or time.monotonic() > latest_s())
        yield fit
