"""`tankrig refit`: the fits that a run lacks, or all of them anew, into its journal; or those of a whole archive."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ui.cli.fits import fits_of, tell_fits
from ui.cli.options import FiniteRange, json_option, phase_option, rig_option
from ui.cli.refit_archive import Share, Work, refit_archive
from ui.cli.stages import stages_shown

if TYPE_CHECKING:
    from tankrig.live.refit import Told


@click.command(epilog="Example: tankrig refit runs --out refitted --workers 4")
@click.argument("run", metavar="RUN", type=click.Path(path_type=Path))
@click.option("--all", "everything", is_flag=True, help="Fit every dose and the series anew, fitted or not.")
@click.option(
    "--model",
    type=click.Choice(["prepared", "tank"]),
    default="prepared",
    show_default=True,
    help="As the live fit does, or by following light paths at every step, which takes longer.",
)
@phase_option
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    metavar="RESULTS",
    help="RUN is an archive: fit all runs in it anew, into this folder, and write nothing into them.",
)
@click.option("--workers", type=click.IntRange(1, 512), metavar="N", help="Of an archive: processes on this machine.")
@click.option("--scheduler", metavar="ADDRESS", help="Of an archive: Dask's scheduler, such as tls://node7:8786.")
@click.option(
    "--tls", nargs=3, type=click.Path(path_type=Path), metavar="CA CERT KEY", help="Certificates for --scheduler, PEM."
)
@click.option("--slurm", metavar="OPTIONS", help='Of an archive: hand it to SLURM, such as "--time=2:00:00".')
@click.option("--jobs", type=click.IntRange(1, 1000), default=4, show_default=True, help="Of SLURM, at a time.")
@click.option("--share", type=Share(), help="Be the I-th, from 0, of N programs that share an archive and a RESULTS.")
@click.option("--worker-minutes", type=FiniteRange(0.5), help="After which a worker is replaced by a new one.")
@click.option("--worker-memory", metavar="SIZE", help='Beyond which a worker is replaced, such as "2GiB".')
@rig_option
@json_option
def refit(
    run: Path,
    everything: bool,
    model: str,
    phase: str | None,
    out: Path | None,
    workers: int | None,
    scheduler: str | None,
    tls: tuple[Path, Path, Path] | None,
    slurm: str | None,
    jobs: int,
    share: tuple[int, int] | None,
    worker_minutes: float | None,
    worker_memory: str | None,
    rig: Path | None,
    as_json: bool,
) -> int:
    """Fit what RUN lacks, and record it in RUN: doses whose frames were not all fitted, and the series.

    Where all doses or the series show that the ink has another phase function than Henyey–Greenstein's, and nobody has
    said which, the series is fitted with others: a free one, families of them, and spheres of any size, as beads and
    droplets are. That takes ten minutes and more, in a tank of glass up to an hour.

    Each fit is recorded as soon as it is made. Ctrl-C ends it, and the next call goes on: models that were prepared, or
    begun, are kept on disk. With --phase everything is fitted anew. --rig names the simulated rig of the run, whose
    truth is then told beside the fits.

    With --out all runs below the folder RUN are fitted anew, each once for its frames, its calibrations, the model and
    the code, and what they find goes into RESULTS; the same command goes on where it was stopped. tankrig archive shows
    what was found.
    """
    work = Work(workers, scheduler, tls, slurm, jobs, share, worker_minutes, worker_memory)
    if out is not None and phase is not None:
        raise click.UsageError("--phase is for one run; those of an archive are fitted with what their sequences say")
    if out is not None:
        return refit_archive(run, out, model, work, as_json)
    if any(one is not None for one in (workers, scheduler, tls, slurm, share, worker_minutes, worker_memory)):
        raise click.UsageError("workers, schedulers and shares are for an archive, which needs --out RESULTS")
    from drivers.rig import load_rig_file
    from tankrig.live.refit import refit as fit_again
    from tankrig.live.results import FailedFit

    description = None if rig is None else load_rig_file(rig)
    with progress_shown() as told:
        made = fit_again(run, everything or phase is not None, model, told, phase)
    failed = [one for one in made if isinstance(one, FailedFit)]
    found = fits_of(run, description)
    if as_json:
        errors = [{"dose_ml": one.dose_ml, "error": one.error} for one in failed]
        click.echo(json.dumps({"run": str(run), "fits": len(made), **found, "failed": errors}, ensure_ascii=False))
        return 1 if failed else 0
    if found["doses"]:
        tell_fits(found)
    for one in failed:
        click.echo(f"{'the series' if one.dose_ml is None else f'{one.dose_ml:g} ml'} cannot be fitted: {one.error}")
    done = len(made) - len(failed)
    click.echo(f"{done} fits recorded in {run}" if made else f"{run}: everything is fitted; --all fits it anew")
    if done and (run / "report.html").exists():
        click.echo(f"its report does not have them yet; to write it anew: tankrig report {run}")
    return 1 if failed else 0


@contextmanager
def progress_shown() -> "Iterator[Told]":
    """What is being fitted, and for how long models are still prepared, on stderr."""
    from tankrig.live.formatting import preparation_in_words
    from tankrig.live.preparing import Preparation

    with stages_shown() as shown:

        def told(words: str, left: Preparation) -> None:
            shown(words, preparation_in_words(left))

        yield told
