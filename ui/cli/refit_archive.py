"""`tankrig refit ARCHIVE --out RESULTS`: all runs of an archive fitted anew, here or by workers."""

import json
import os
import signal
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from tankrig.archive.refit import Progress, RunToRefit
    from tankrig.archive.task import Done

SHOWN_FAILURES = 20
THREADS = ("TANKRIG_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


class Share(click.ParamType[Any]):
    """I/N: the I-th, from 0, of N programs."""

    name = "I/N"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Text to (I, N)."""
        if isinstance(value, tuple):
            return value
        index, _, count = str(value).partition("/")
        if not (index.isdecimal() and count.isdecimal() and int(index) < int(count)):
            self.fail(f"{value!r} is not I/N with I from 0 to N − 1, such as 0/4", param, ctx)
        return int(index), int(count)


@dataclass(frozen=True)
class Work:
    """Who refits an archive.

    Parameters
    ----------
    workers
        Processes on this machine; None: this one.
    scheduler, tls
        Address of Dask's scheduler; files of the authority, the certificate and its key.
    slurm, jobs
        Options of sbatch, and how many jobs.
    share
        Which of how many programs this one is, that share the archive.
    worker_minutes, worker_memory
        After which, and beyond which, a worker is replaced.
    """

    workers: int | None = None
    scheduler: str | None = None
    tls: tuple[Path, Path, Path] | None = None
    slurm: str | None = None
    jobs: int = 4
    share: tuple[int, int] | None = None
    worker_minutes: float | None = None
    worker_memory: str | None = None

    def require_one(self) -> None:
        """Refuse two at once."""
        given = [name for name in ("workers", "scheduler", "slurm", "share") if getattr(self, name) is not None]
        if len(given) > 1:
            raise click.UsageError(f"--{given[0]} and --{given[1]} are two ways; give one of them")


def refit_archive(archive: Path, out: Path, model: str, work: Work, as_json: bool) -> int:
    """Refit an archive, and say what became of it; exit status 1 where a run failed."""
    work.require_one()
    if work.slurm is not None:
        from tankrig.archive.runs import runs_in
        from tankrig.archive.slurm import submit

        count = len(runs_in(archive))
        job = submit(archive, out, model, min(work.jobs, count), work.slurm)
        click.echo(json.dumps({"job": job}) if as_json else f"job {job} fits {count} runs into {out}; squeue shows it")
        return 0
    for name in THREADS:  # before NumPy is loaded, which asks once
        os.environ.setdefault(name, os.environ.get("TANKRIG_THREADS", "1"))
    from tankrig.archive.key import Refitting
    from tankrig.archive.mark import refit_mark
    from tankrig.archive.refit import beside_others, followed, runs_to_refit
    from tankrig.archive.results import Results

    refitting = Refitting(refit_mark(), "tank" if model == "tank" else "prepared")
    wanted = runs_to_refit(archive, Results(out), refitting)
    began_s = time.monotonic()
    with _asked_to_end(), ExitStack() as undo:
        do, wanted = _who(work, wanted, undo)
        told = undo.enter_context(_shown(len(wanted)))
        progress = followed(beside_others(do, wanted), len(wanted), told)
    seconds = time.monotonic() - began_s
    failed = [{"run": one.name, "error": one.sentence} for one in progress.failed]
    numbers = {"made": progress.made, "there": progress.there, "failed": failed, "seconds": round(seconds, 1)}
    if as_json:
        click.echo(json.dumps({"results": str(out), "runs": len(wanted), **numbers}, ensure_ascii=False))
    else:
        for one in progress.failed[:SHOWN_FAILURES]:
            click.echo(f"{one.name}: {one.sentence}")
        if len(failed) > SHOWN_FAILURES:
            click.echo(
                f"… and {len(failed) - SHOWN_FAILURES} more; tankrig archive {archive} --results {out} lists them"
            )
        more = f", {len(failed)} failed" if failed else ""
        click.echo(f"{progress.made} runs fitted, {progress.there} were there{more}: {out}")
    return 1 if failed else 0


def _who(
    work: Work, wanted: "list[RunToRefit]", undo: ExitStack
) -> "tuple[Callable[[Sequence[RunToRefit]], Iterator[Done]], list[RunToRefit]]":
    """Who refits the runs, and in what order they are begun."""
    from functools import partial

    from tankrig.archive.refit import from_share, in_this_process

    if work.share is not None:
        return in_this_process, from_share(wanted, *work.share)
    if work.workers is None and work.scheduler is None:
        return in_this_process, wanted
    from tankrig.archive.farm import Certificates, by_workers, require_dask, workers_elsewhere, workers_here

    require_dask()
    if work.scheduler is not None:
        client = workers_elsewhere(work.scheduler, None if work.tls is None else Certificates(*work.tls))
    else:
        limit_s = None if work.worker_minutes is None else 60.0 * work.worker_minutes
        threads = int(os.environ["TANKRIG_THREADS"])
        client = workers_here(work.workers or 1, threads, limit_s, work.worker_memory)
    return partial(by_workers, undo.enter_context(client)), wanted


@contextmanager
def _asked_to_end() -> Iterator[None]:
    """A request to end (SIGTERM) ends as Ctrl-C does, workers included."""

    def end(*_: object) -> None:
        raise KeyboardInterrupt  # which no run's failure is mistaken for

    before = {one: signal.signal(one, end) for one in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield
    except KeyboardInterrupt:
        click.echo("what was fitted is kept, and the same command goes on", err=True)
        raise
    finally:
        for one, handler in before.items():
            signal.signal(one, handler)


@contextmanager
def _shown(total: int) -> "Iterator[Callable[[Progress], None]]":
    """How far it is, on stderr: a bar on a terminal, a line every half minute elsewhere."""
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn
    from rich.progress import Progress as Bar

    console = Console(stderr=True)
    last_s = time.monotonic()
    columns = BarColumn(), TextColumn("{task.description}", markup=False)
    with Bar(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(f"0 of {total} runs", total=total)

        def told(progress: "Progress") -> None:
            nonlocal last_s
            if console.is_terminal:
                bar.update(task, completed=progress.done, description=str(progress))
            elif time.monotonic() - last_s > 30.0:
                last_s = time.monotonic()
                console.print(str(progress), highlight=False, markup=False)

        yield told
