"""A live fit tied to a run: frames in, `fit` lines into the journal, and an end that both agree on."""

import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import cache

from tankrig.bench import Bench
from tankrig.errors import SceneError, SequenceError, StoreError
from tankrig.live.light_seen import require_light_seen
from tankrig.live.live_fit import LiveFit
from tankrig.live.photograph_plan import PhotographPlan
from tankrig.live.recorded import fits_that_hold
from tankrig.live.results import DoseFit, Fit, fits_in, to_fields
from tankrig.run.journal_io import read_settings
from tankrig.run.reading import Run, open_run
from tankrig.run.runner import Runner
from tankrig.scene.description import Medium
from tankrig.sequence import Sequence

PATIENCE_S = 240.0
LOOKED_BACK = 5
"""Runs beside one, the latest first, among which its ink is looked for."""


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
            PhotographPlan.of(bench, sequence, [pattern]).require_left()
        except SceneError as error:
            where = f"{sequence.called}: {sequence.first_with(name)}"
            raise SequenceError(f'{where}: pattern "{name}" cannot be fitted: {error}') from error


@contextmanager
def fitted_live(runner: Runner, patience_s: float = PATIENCE_S) -> Iterator[LiveFit | None]:
    """Fit a run's frames while it goes on; enter before `Runner.run` and leave after it.

    What is found stands in the journal, once frames have stopped to come for a moment, and `Runner.latest_fit` is the
    last of all. Frames and fits of a run that goes on are taken in first. Where a run lights nothing that could be
    fitted, no process is started, and what is yielded is None.

    Parameters
    ----------
    runner
        Of the run, new or resumed.
    patience_s
        How long the run's end waits for the last fits; `tankrig refit` makes those that would come later.
    """
    run = open_run(runner.path)
    plan = PhotographPlan.of_run(run)
    if not plan.lights_anything:
        yield None
        return

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

    plan = replace(plan, ink=plan.ink or ink_before(run))
    with LiveFit(plan, record, run, tell) as fit:
        runner.fitted = True
        runner.latest_fit = next((event.fields for event in reversed(run.fits)), None)
        runner.listen(fit.see)
        runner.while_mixing.append(fit.watch)
        runner.before_end.append(lambda: fit.finished or time.monotonic() > latest_s())
        yield fit


def ink_before(run: Run) -> Medium | None:
    """What the latest run beside this one, on the same rig, found of its ink, per mm and ml; None where none did.

    The next run is likely to have the same ink: models for its doses are then prepared, or found prepared, before its
    first dose. If it has another, that costs time and nothing else.
    """
    beside = (mark.parent for mark in run.path.parent.glob("*/zarr.json") if mark.parent != run.path)
    latest = sorted(beside, key=lambda path: (path / "zarr.json").stat().st_mtime, reverse=True)
    for path in latest[:LOOKED_BACK]:
        with suppress(StoreError, OSError, KeyError, TypeError):  # damaged, or no run at all
            if read_settings(path).get("rig") != run.settings.get("rig"):
                continue
            _, series = fits_in([event.fields for event in fits_that_hold(open_run(path))])
            if series is not None:
                return series.ink
    return None
