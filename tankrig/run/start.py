"""From a sequence and a rig, or from an interrupted run, to a runner; everything is checked before anything moves."""

import json
import shutil
import uuid
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path

import numpy as np

from tankrig.calibration.file import FOLDER, copy_to
from tankrig.dosing import DoseDone, GuardedDoser, TankLedger
from tankrig.errors import StoreError, UndecidedError
from tankrig.files import require_writable
from tankrig.pattern import Pattern
from tankrig.run.announcer import Announcer
from tankrig.run.folder import create_run, require_new
from tankrig.run.reading import Run, open_run
from tankrig.run.recovery import dose_doubt, open_dose
from tankrig.run.rig import Rig
from tankrig.run.runner import Plan, RunJournal, Runner
from tankrig.run.state import FinishReason
from tankrig.run.writer import RunWriter
from tankrig.sequence import Sequence, dry_run
from tankrig.sequence.loading import sequence_from_table, sequence_table


def new_run(sequence: Sequence, rig: Rig, path: Path, delivered_ul: float | None = None) -> Runner:
    """Get a new run ready: nothing moves before `Runner.run`.

    Parameters
    ----------
    sequence
        What to do.
    rig
        With what; closed when the run ends, or when it cannot be made.
    path
        Of the run's folder, which must not exist.
    delivered_ul
        A person's word on what the tank holds, where a dose before this run was left undecided.

    Raises
    ------
    SequenceError
        When the sequence breaks a budget or cannot be shown by the projector.
    StoreError
        When the folder cannot be made or the disk is too small.
    UndecidedError
        When a person has to say first what the tank holds.
    """
    with ExitStack() as undo:
        undo.callback(rig.close)
        patterns = sequence.drawn(rig.bench.wall)
        run_id = f"{path.name}-{uuid.uuid4().hex[:8]}"
        doser, journal = _guarded(rig, run_id, undo)
        _settled(doser, None, delivered_ul, path)
        took = dry_run(sequence, rig.limits, rig.pace, _frame_bytes(rig), doser.delivered())
        require_place(path, took.disk_bytes)
        settings = {
            "name": sequence.name,
            "id": run_id,
            "rig": rig.name,
            "saturation": rig.camera.saturation,
            "bench": asdict(rig.bench),
            "sequence": sequence_table(sequence),
            "calibrations": {kind: one.hash for kind, one in rig.calibrations.items()},
        }
        create_run(path, rig.camera.shape, _dtype(rig), sequence.frames, settings, list(patterns.values()))
        undo.callback(shutil.rmtree, path, ignore_errors=True)  # nothing is recorded in it yet
        for calibration in rig.calibrations.values():
            copy_to(calibration, path / FOLDER)
        runner = _runner(rig, doser, journal, path, Plan(sequence, patterns, took), undo)
        undo.pop_all()
        return runner


def resumed_run(path: Path, rig: Rig, delivered_ul: float | None = None) -> Runner:
    """Get an interrupted run ready to go on where it stopped: what was done is not done again.

    Parameters
    ----------
    path
        Of the run's folder.
    rig
        The rig that it was begun with; closed when the run ends, or cannot go on.
    delivered_ul
        A person's word on what the tank holds, where the run was interrupted in a dose.

    Raises
    ------
    StoreError
        When the folder is no run, has come to its end, or was made with another rig.
    UndecidedError
        When it was interrupted in a dose, and nobody has said what that delivered.
    """
    with ExitStack() as undo:
        undo.callback(rig.close)
        run = require_resumable(path)
        sequence = sequence_from_table(run.settings["sequence"], str(path))
        patterns = sequence.drawn(rig.bench.wall)
        _require_same(run, rig, patterns)
        first_step, frames_taken = _where(run)
        doser, journal = _guarded(rig, run.settings["id"], undo)
        done = _settled(doser, open_dose(run), delivered_ul, path, dose_doubt(run))
        took = dry_run(sequence, rig.limits, rig.pace, _frame_bytes(rig), doser.delivered(), resume_at=first_step)
        _require_room(path, took.disk_bytes - len(run.events("frame")) * _frame_bytes(rig))
        runner = _runner(rig, doser, journal, path, Plan(sequence, patterns, took, first_step, frames_taken), undo)
        if done:
            journal.dose_done(done)
        undo.pop_all()
        return runner


def _guarded(rig: Rig, run_id: str, undo: ExitStack) -> tuple[GuardedDoser, RunJournal]:
    ledger = TankLedger(rig.ledger)
    undo.callback(ledger.close)
    journal = RunJournal()
    doser = GuardedDoser(rig.doser, rig.limits, ledger, journal, run_id)
    undo.callback(doser.close)
    return doser, journal


def _settled(
    doser: GuardedDoser, target_ul: float | None, delivered_ul: float | None, path: Path, doubt: str | None = None
) -> DoseDone | None:
    """Settle what the journal cannot tell (`dose_doubt`), by a person's word; its entry for the journal.

    That is a dose to `target_ul` that was not seen to end, or lines that may have been about one and are lost.
    """
    if doubt is None and doser.undecided is None and delivered_ul is None:
        return None
    held = doser.delivered()
    if delivered_ul is None:
        raise UndecidedError(
            doser.undecided
            or f"{doubt}; by {doser.name} the tank holds "
            f"{held.volume_ul:g} µl ({held.low_ul:g} to {held.high_ul:g}): say how much it is in all (--delivered-ul)"
        )
    if doubt is None or doser.undecided is not None:
        doser.resolve(delivered_ul)
    elif not held.low_ul - doser.increment_ul <= delivered_ul <= held.high_ul + doser.increment_ul:
        raise UndecidedError(
            f"{path}: by {doser.name} the tank holds {held.low_ul:g} to {held.high_ul:g} µl, and --delivered-ul says "
            f"{delivered_ul:g}; find out which is true"
        )
    return None if doubt is None else doser.account(delivered_ul if target_ul is None else target_ul)


def _runner(rig: Rig, doser: GuardedDoser, journal: RunJournal, path: Path, plan: Plan, undo: ExitStack) -> Runner:
    announcer = Announcer()
    undo.callback(announcer.close)
    writer = RunWriter(path, announcer.announce, plan.sequence.frames)
    undo.callback(writer.close)
    journal.writer = writer
    return Runner(rig, doser, writer, announcer, journal, plan)


def _where(run: Run) -> tuple[int, int]:
    """Number of the first step that is not done, and how many of its frames were taken."""
    steps = [event["step"] for event in run.events("step") if event["state"] == "done"]
    first = max(steps, default=-1) + 1
    return first, sum(event["step"] == first for event in run.events("frame"))


def _require_same(run: Run, rig: Rig, patterns: Mapping[str, Pattern]) -> None:
    """Refuse to go on with what would not be the same experiment."""
    if run.settings["bench"] != json.loads(json.dumps(asdict(rig.bench))):
        raise StoreError(f"{run.path}: was recorded on another bench than rig {rig.name} has; resume it on its own")
    for name, pattern in patterns.items():
        if pattern.hash not in run.patterns:
            raise StoreError(f'{run.path}: pattern "{name}" is not what it was; restore its file, or start a new run')


def _dtype(rig: Rig) -> str:
    return "uint8" if rig.camera.saturation < 2**8 else "uint16"


def _frame_bytes(rig: Rig) -> int:
    rows, columns = rig.camera.shape
    return rows * columns * np.dtype(_dtype(rig)).itemsize


def require_place(path: Path, disk_bytes: int) -> None:
    """Refuse a place where a run of that many bytes cannot be made.

    Raises
    ------
    StoreError
        When `path` exists, its folder cannot be written, or the disk is too small.
    """
    require_new(path)
    require_writable(path.parent)
    _require_room(path, disk_bytes)


def require_resumable(path: Path) -> Run:
    """The run at `path`, if it is one that can go on.

    Raises
    ------
    StoreError
        When it is no run, or has come to its end.
    """
    run = open_run(path)
    if run.end is not None and run.end["reason"] == FinishReason.COMPLETED.value:
        raise StoreError(f"{path}: has come to its end; there is nothing to resume")
    return run


def _require_room(path: Path, disk_bytes: int) -> None:
    place = next(folder for folder in path.absolute().parents if folder.exists())
    free = shutil.disk_usage(place).free
    if disk_bytes > free:
        raise StoreError(
            f"{path}: the run needs up to {disk_bytes / 1e6:.1f} MB and {free / 1e6:.1f} MB are free; "
            f"make room or give another folder with --out"
        )
