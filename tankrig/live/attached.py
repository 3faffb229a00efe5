"""A live fit tied to a run: frames in, `fit` lines into the journal, and an end that both agree on."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from tankrig.errors import StoreError
from tankrig.live.exposures import Plan
from tankrig.live.live_fit import LiveFit
from tankrig.run.runner import Runner


@contextmanager
def fitted_live(runner: Runner, plan: Plan, patience_s: float = 120.0) -> Iterator[LiveFit]:
    """Fit a run's frames while it goes on; enter before `Runner.run` and leave after it.

    Parameters
    ----------
    runner
        Records what is found, as `fit` lines of its journal.
    plan
        Of the same run.
    patience_s
        How long the run's end waits for the last fits.
    """

    def record(table: dict[str, Any]) -> None:
        with suppress(StoreError):  # a fit that comes after the end is lost; `tankrig report` makes it again
            runner.record("fit", **table)

    with LiveFit(plan, record) as fit:
        runner.listen(fit.see)
        runner.before_end.append(lambda: fit.finish(patience_s))
        yield fit
