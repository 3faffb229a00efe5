"""Refit one run of an archive: the same question twice is answered once, and the answer is kept whole or not at all."""

import fcntl
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tankrig.archive.key import Refitting, refit_key
from tankrig.archive.mark import refit_mark
from tankrig.archive.models import ModelsOnDemand
from tankrig.archive.results import FORMAT, Results, Row, made_now
from tankrig.errors import ImageError, StoreError, TankrigError
from tankrig.live.exposures import exposures_of
from tankrig.live.next_fit import Fitter, fit_all_there_is
from tankrig.live.photograph_plan import PhotographPlan
from tankrig.live.preparing import phases_prepared
from tankrig.live.refit import fits_made
from tankrig.live.results import DoseFit, FailedFit, Fit, last_of_each, to_fields
from tankrig.run.journal_io import JOURNAL
from tankrig.run.reading import Run, open_run
from tankrig.threads import one_blas_thread

MADE, THERE, FAILED, TAKEN = "made", "there", "failed", "taken"


@dataclass(frozen=True)
class Done:
    """What became of one run.

    Parameters
    ----------
    name
        Of the run, within its archive.
    outcome
        "made": fitted now; "there": it had been; "failed"; "taken": another process is at it, and was not waited for.
    sentence
        Why it failed.
    cpu_s
        That this took.
    """

    name: str
    outcome: str
    sentence: str = ""
    cpu_s: float = 0.0


class OtherCodeError(TankrigError):
    """A worker that runs other code than whoever asks it."""


def refit_run(path: Path, name: str, results: Results, refitting: Refitting, wait: bool = True) -> Done:
    """Fit a run anew, unless that has been done, and keep what was found.

    The run is only read. What it found before, and its name, play no part.

    Parameters
    ----------
    path
        Of the run.
    name
        Under which the result is kept.
    results
        Where to.
    refitting
        What it is fitted with.
    wait
        For another process that is fitting the same run, whose result then counts.

    Returns
    -------
    Done
        A run that cannot be read or fitted is a failure, with its sentence here and in the results.

    Raises
    ------
    OtherCodeError
        When this process runs other code than was asked for.
    StoreError
        When the results cannot be written.
    """
    if refit_mark() != refitting.mark:
        raise OtherCodeError(
            f"the worker on {os.uname().nodename} (process {os.getpid()}) runs other code than this program; install "
            "the same tankrig and the same Python there, and ask again"
        )
    began_s, cpu_s = time.perf_counter(), time.process_time()
    with results.claimed(name, wait) as had:
        if not had:
            return Done(name, TAKEN)
        try:
            run = opened(path)
            key = refit_key(run, refitting)
            if results.has(name, key):
                return Done(name, THERE)
            with one_blas_thread():  # sums by more threads round otherwise, and whoever fits it finds the same bytes
                found = [to_fields(fit) for fit in fits_of_archived(run, refitting)]
        except (TankrigError, OSError, MemoryError, ArithmeticError, LookupError, TypeError, ValueError) as error:
            sentence = str(error) if isinstance(error, TankrigError) else f"{path}: {type(error).__name__}: {error}"
            results.put_failed(name, {"format": FORMAT, "failed": sentence, "made": made_now()})
            return Done(name, FAILED, sentence, time.process_time() - cpu_s)
        took = {"cpu_s": time.process_time() - cpu_s, "wall_s": time.perf_counter() - began_s}
        for fields in found:
            fields.pop("seconds", None)  # the same fits, whoever makes them, are the same bytes
        row = {**about(run), "key": key, "model": refitting.model, "mark": refitting.mark, "fits": found}
        results.put(name, key, {"format": FORMAT, **row, "made": made_now(**took)})
        return Done(name, MADE, cpu_s=took["cpu_s"])


def fits_of_archived(run: Run, refitting: Refitting, progress: Callable[[str], None] = lambda _: None) -> list[Fit]:
    """All fits of a run, by the live fit's own decisions, made anew.

    Raises
    ------
    StoreError
        When it cannot be read, or shows no ink.
    ImageError
        When nothing of it can be fitted.
    """
    exposures = exposures_of(run)
    if not exposures.photographs():
        raise StoreError(
            f"{run.path}: has no photograph of a lit pattern with ink in the tank, so there is no fit of it"
        )
    if refitting.model == "tank":
        fits = list(fits_made(run, everything=True, model="tank", further=False))
    else:
        plan = PhotographPlan.of_run(run)
        fitter = Fitter((), ModelsOnDemand(progress, phases_prepared(plan) or "hg"), plan, progress)
        made = fit_all_there_is(fitter, lambda: (exposures, True), _nothing_to_wait_for)
        fits = last_of_each(fit for fit in made if not (isinstance(fit, DoseFit) and fit.passing))
    failed = [fit for fit in fits if isinstance(fit, FailedFit)]
    if len(failed) == len(fits):
        why = f": {failed[0].error}" if failed else ""
        raise ImageError(f"{run.path}: nothing of it can be fitted{why}")
    return fits


def opened(path: Path) -> Run:
    """A run that nobody is recording.

    Raises
    ------
    StoreError
        When it cannot be read, or is being recorded.
    """
    run = open_run(path)
    if _is_being_recorded(path):
        raise StoreError(f"{path}: is being recorded; it can be fitted once that has ended")
    return run


def about(run: Run) -> Row:
    """What a row says of a run whatever its fits are."""
    settings = run.settings
    journal = run.journal
    return {
        "name": str(settings.get("name", run.path.name)),
        "rig": str(settings.get("rig", "")),
        "material": str(settings.get("material", "")),
        "utc": journal[0].moment.utc if journal else "",
        "ending": str(run.end["reason"]) if run.end else "unfinished",
        "frames": len(run.events("frame")),
        "damage": [str(one) for one in run.lost],
        "calibrations": dict(settings.get("calibrations", {})),
    }


def _is_being_recorded(path: Path) -> bool:
    try:
        handle = os.open(path / JOURNAL, os.O_RDONLY)
    except OSError:
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False  # a place that knows no locks, where nobody can be recording
    finally:
        os.close(handle)
    return False


def _nothing_to_wait_for(_: float | None) -> bool:
    raise RuntimeError("all frames and models are there")
