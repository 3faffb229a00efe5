"""`tankrig run`: carry out a sequence on a rig."""

import json
import math
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext, suppress
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING

import click

from ui.cli.fits import fits_of, tell_fits
from ui.cli.options import FiniteRange, json_option, out_option, phase_option, rig_option
from ui.cli.stages import AGAIN_S, stages_shown

if TYPE_CHECKING:
    from drivers.rig import RigFile
    from tankrig.live.live_fit import LiveFit
    from tankrig.run.journal import Event
    from tankrig.run.runner import Outcome, Runner
    from tankrig.sequence import DryRun, Sequence
    from tankrig.sequence.sequence import Phase

_POLL_S = 0.1
_SHOWN = 1000
"""Steps of a plan; a table of a hundred thousand takes minutes to draw."""


@click.command(epilog="Example: tankrig run dilution.toml --dry-run")
@click.argument("sequence_file", metavar="[SEQUENCE]", required=False, type=click.Path(path_type=Path))
@click.option("--dry-run", is_flag=True, help="Check the limits and tell time, ink and disk; nothing moves.")
@click.option("--resume", metavar="RUN", type=click.Path(path_type=Path), help="Go on with an interrupted run.")
@click.option(
    "--delivered-ul",
    type=FiniteRange(min=0.0),
    metavar="X",
    help="Ink that the tank holds in all, where a dose was interrupted and only a person can say.",
)
@click.option("--fit/--no-fit", default=True, show_default=True, help="Fit the model while frames arrive, and report.")
@phase_option
@rig_option
@out_option(None, "Folder of the run, which must not exist; default: runs/ and the time.")
@json_option
def run(
    sequence_file: Path | None,
    dry_run: bool,
    resume: Path | None,
    delivered_ul: float | None,
    fit: bool,
    phase: "Phase | None",
    rig: Path | None,
    out: Path | None,
    as_json: bool,
) -> int:
    """Carry out SEQUENCE (TOML) on the rig: project, dose, photograph, and record every frame safely.

    Meanwhile a process of its own fits σa, σs and g; at the end they are told, and a report is written into the run.
    Ctrl-C stops the doser at once and ends the run, which can then be resumed.
    """
    from tankrig.run.runner import UNFITTED
    from tankrig.run.start import require_resumable
    from tankrig.sequence import load_sequence

    if (sequence_file is None) == (resume is None):
        raise click.UsageError("give a sequence file, or --resume and the folder of an interrupted run")
    if resume is not None and phase is not None:
        raise click.UsageError("a run goes on as it was begun; give --phase to tankrig refit")
    path = resume or out or Path("runs") / datetime.now(UTC).strftime("%Y-%m-%dT%H-%M-%S")
    if dry_run and sequence_file is None:
        raise click.UsageError("--dry-run needs a sequence file; leave out --resume")
    description = _described(rig, path)
    sequence = None
    if sequence_file is None:
        require_resumable(path)
    else:
        sequence = load_sequence(sequence_file)
        if phase is not None:
            sequence = replace(sequence, phase=phase)
        plan = planned(sequence, description, path, fit)
        notes = tell_what_is_cut_off(sequence, description)
        if dry_run:
            if rig is None:
                click.echo("no rig is configured, so this is the simulated rig", err=True)
            _tell_plan(plan, notes, as_json)
            return 0
    runner = open_runner(sequence, path, description, delivered_ul)
    if not fit and any(step.at_most for step in runner.plan.dry_run.steps):
        click.echo(UNFITTED, err=True)
    if rig is None:
        click.echo("no rig is configured, so this is the simulated rig", err=True)
    return tell(carry_out(runner, fit), description, fit, as_json)


def _described(rig: Path | None, run_folder: Path) -> "RigFile":
    """What the rig file says; without one, a simulated rig of the run's own."""
    from drivers.rig import load_rig_file, simulated_rig

    if rig is not None:
        return load_rig_file(rig)
    named = Path(os.path.abspath(run_folder))  # "." has no name of its own  # noqa: PTH100 - links are not followed
    if not named.name:
        raise click.UsageError(f"{run_folder} is no folder that a run could have; give another")
    return simulated_rig(named.with_name(f"{named.name}.rig"))


def planned(sequence: "Sequence", description: "RigFile", run_folder: Path | None = None, fit: bool = True) -> "DryRun":
    """The dry run, which checks all that can be checked before a device is touched.

    Parameters
    ----------
    sequence
        To be carried out.
    description
        Of the rig.
    run_folder
        Where the run is to be made; None: nowhere yet.
    fit
        Whether the run is to be fitted.
    """
    from drivers.rig import calibrated_bench, tank_ledger
    from tankrig.devices import Delivered
    from tankrig.run.start import require_place
    from tankrig.sequence import dry_run

    bench = calibrated_bench(description)
    rows, columns = bench.camera.shape
    frame_bytes = rows * columns * 2
    if run_folder is not None:
        require_place(run_folder, sequence.frames * frame_bytes)
    if fit:
        from tankrig.live.attached import require_fittable  # it brings numba along, which a run without fits spares

        require_fittable(sequence, bench)
    else:
        sequence.drawn(bench.wall)
    with tank_ledger(description) as ledger:
        tank = Delivered(0.0, 0.0, 0.0) if ledger is None else ledger.tank
    rule = description.exposure_rule
    return dry_run(sequence, description.limits, description.pace, frame_bytes, tank, exposure=rule)


def tell_what_is_cut_off(sequence: "Sequence", description: "RigFile") -> tuple[str, ...]:
    """Say what light a sequence asks for that misses the tank: it is recorded and fitted without it."""
    from drivers.rig import calibrated_bench

    bench = calibrated_bench(description)
    notes = sequence.cut_off(bench.wall, bench.tank)
    for note in notes:
        click.echo(f"note: {note}", err=True)
    return notes


def _tell_plan(plan: "DryRun", notes: tuple[str, ...], as_json: bool) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    totals = {"seconds": plan.seconds, "ink_ul": plan.ink_ul, "frames": plan.frames, "disk_bytes": plan.disk_bytes}
    if as_json:
        steps = [
            {"label": step.label, "seconds": step.seconds, "ink_ul": step.ink_ul, "frames": step.frames,
             "at_most": step.at_most}
            for step in plan.steps
        ]  # fmt: skip
        told = {**totals, "at_most": plan.at_most, "steps": steps, "notes": notes}
        click.echo(json.dumps(told, ensure_ascii=False))
        return
    table = Table("step", "time", "ink", "frames", box=None, show_footer=False)
    for step in plan.steps[:_SHOWN]:
        ink = f"{step.ink_ul:g} µl" if step.ink_ul else ""
        bound = "≤ " if step.at_most else ""
        frames = f"{bound}{step.frames}" if step.frames else ""
        table.add_row(Text(step.label), f"{bound}{step.seconds:.1f} s", ink, frames)
    if len(plan.steps) > _SHOWN:
        table.add_row(f"… and {len(plan.steps) - _SHOWN} more (--json lists them all)", "", "", "")
    Console().print(table)
    most = "at most " if plan.at_most else ""
    click.echo(
        f"in all: {most}{_duration(plan.seconds)}, {plan.ink_ul:g} µl of ink, {most}{plan.frames} frames, "
        f"{plan.disk_bytes / 1e6:.1f} MB at most; nothing has moved"
    )


def open_runner(
    sequence: "Sequence | None", path: Path, description: "RigFile", delivered_ul: float | None = None
) -> "Runner":
    """For a new run or, without a sequence, the one at `path`; on a terminal, what only a person can say is asked."""
    from drivers.rig import open_rig
    from tankrig.errors import UndecidedError
    from tankrig.run.start import new_run, resumed_run

    while True:
        devices = open_rig(description)
        try:
            if sequence is None:
                return resumed_run(path, devices, delivered_ul)
            return new_run(sequence, devices, path, delivered_ul)
        except UndecidedError as question:
            if not sys.stdin.isatty():
                raise
            click.echo(str(question), err=True)
            delivered_ul = click.prompt("ink in the tank in all, µl", type=FiniteRange(min=0.0), err=True)


def carry_out(runner: "Runner", fit: bool) -> "Outcome":
    """Run in a thread of its own, so that progress is drawn and signals heard while a device is waited for.

    Whatever happens meanwhile, the run has ended when this returns or raises, and its thread too.
    """
    outcomes: list[Outcome | BaseException] = []

    def work() -> None:
        try:
            outcomes.append(runner.run())
        except BaseException as error:
            outcomes.append(error)

    thread = threading.Thread(target=work, name="run")
    fitting: AbstractContextManager[LiveFit | None] = nullcontext()
    if fit:
        from tankrig.live.attached import fitted_live

        fitting = fitted_live(runner)
    with _aborting_on_signals(runner), _given_up_unless_begun(runner), fitting as live:
        thread.start()
        try:
            _draw(runner, thread, live)
        except BaseException:
            _abort(runner)  # nobody sees any more what it does
            _wait_for(thread)
            with suppress(OSError):  # a terminal that is gone
                click.echo(f"the display failed, so the run was ended; {_how_to_resume(runner.path)}", err=True)
            raise
    (outcome,) = outcomes
    if isinstance(outcome, BaseException):
        raise outcome
    return outcome


def _draw(runner: "Runner", thread: threading.Thread, live: "LiveFit | None") -> None:
    """Show how far the run is until its thread ends, and what a person has to be told when it happens."""
    from rich.console import Console, Group
    from rich.live import Live
    from rich.progress import BarColumn, Progress, TextColumn
    from rich.text import Text

    from tankrig.live.formatting import fit_in_words, preparation_in_words
    from tankrig.live.results import from_fields

    warnings: SimpleQueue[str] = SimpleQueue()

    def hear(event: "Event", _: object) -> None:
        if event.kind == "note" and event.get("warning"):
            warnings.put(str(event["text"]))

    runner.listen(hear)
    console = Console(stderr=True)
    plain = TextColumn("{task.description}", markup=False)  # labels are people's words, brackets and all
    bar = Progress(BarColumn(), TextColumn("{task.completed}/{task.total}"), plain)
    task, beneath = bar.add_task("", total=runner.progress().steps), Text()
    with ExitStack() as shown:
        if console.is_terminal:
            shown.enter_context(Live(Group(bar, beneath), console=console, transient=True))
            told = None
        else:
            told = shown.enter_context(stages_shown("beginning", AGAIN_S))
        while thread.is_alive():
            thread.join(_POLL_S)
            now = runner.progress()
            over = now.step >= now.steps
            last = f"{now.label}, the last fits are made" if live is not None else now.label
            left = last if over else f"{now.label}, {_duration(now.remaining_s)} left"
            preparing = preparation_in_words(live.preparation) if live is not None else ""
            bar.update(task, completed=now.step, description=left)
            if told is not None:
                told(f"step {now.step} of {now.steps}, {left}", preparing if over else "")
            lines = [] if over else [f"waiting for {now.waiting_for or 'the rig'}"]
            if live is not None:
                lines.append(fit_in_words(from_fields(runner.latest_fit) if runner.latest_fit else None))
                lines.append(preparing)
            beneath.plain = "\n".join(lines)
            while not warnings.empty():
                console.print(Text(warnings.get()), soft_wrap=True)
    while not warnings.empty():
        click.echo(warnings.get(), err=True)


def _wait_for(thread: threading.Thread) -> None:
    while thread.is_alive():  # a join without an end would not hear signals
        thread.join(_POLL_S)


def _abort(runner: "Runner") -> None:
    with suppress(Exception):  # the run's own thread meets the same trouble, and tells it
        runner.abort()


@contextmanager
def _given_up_unless_begun(runner: "Runner") -> Iterator[None]:
    """A run that could not begin lets go of its devices, and its journal says why."""
    try:
        yield
    except BaseException as error:
        runner.give_up(error)
        raise


@contextmanager
def _aborting_on_signals(runner: "Runner") -> Iterator[None]:
    """Ctrl-C, a request to end and a terminal that goes away all abort the run; its thread then ends by itself."""
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = {number: signal.signal(number, lambda *_: _abort(runner)) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def tell(outcome: "Outcome", description: "RigFile", fit: bool, as_json: bool) -> int:
    """Say how a run ended and what it found, write its report, and give the exit status."""
    from tankrig.live.recorded import wave_names
    from tankrig.run.reading import open_run
    from tankrig.run.state import FinishReason

    path, completed = outcome.path, outcome.reason is FinishReason.COMPLETED
    run = open_run(path)
    frames, doses = len(run.events("frame")), run.events("dose_done")
    delivered_ul = run.tank.volume_ul if doses and run.tank else None
    said = {"run": str(path), "reason": outcome.reason.value, "frames": frames, "delivered_ul": delivered_ul}
    found = fits_of(path, description) if fit else {"doses": [], "unfitted": ""}
    report = _reported(path) if completed and found["doses"] else None
    if as_json:
        click.echo(json.dumps({**said, **found, "report": report} if fit else said, ensure_ascii=False))
    else:
        if found["doses"]:
            tell_fits(found)
        if found["unfitted"]:
            click.echo(found["unfitted"])
        ink = f", the tank holds {delivered_ul:g} µl" if delivered_ul is not None else ""
        click.echo(f"{outcome.reason.value}: {path}, {frames} frames{ink}")
        if not completed:
            click.echo(_how_to_resume(path))
        elif report:
            click.echo(f"report: {report}")
        elif frames:
            click.echo(f"for a report: tankrig report {path}")
        if wave_names(run):
            click.echo(f"light sorted by scattering: tankrig separate {path}")
    if outcome.error is not None:
        raise outcome.error
    return 0 if completed else 1


def _how_to_resume(path: Path) -> str:
    return f"resume with: tankrig run --resume {path}"


def _reported(path: Path) -> str:
    from tankrig.report import write_report

    with stages_shown("writing the report") as tell:
        return str(write_report(path, None, tell))


def _duration(seconds: float) -> str:
    if not math.isfinite(seconds):
        return "an unknown time"
    whole = round(seconds)
    return f"{whole // 60} min {whole % 60:02d} s" if whole >= 60 else f"{whole} s"
