"""From a sequence and a rig, or from an interrupted run, to a runner; everything is checked before anything moves."""

import json
import os
import shutil
import uuid
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from tankrig.bench import Bench
from tankrig.calibration.file import FOLDER, copy_to
from tankrig.calibration.places import measured_places
from tankrig.calibration.witness import require_no_board, require_seen
from tankrig.checked_toml import checked
from tankrig.devices import BurstProjector, Delivered
from tankrig.dosing import DoseDone, GuardedDoser, TankLedger
from tankrig.dosing.evidence import Account
from tankrig.dosing.records import COUNT_KEYS, NotedCount
from tankrig.errors import SequenceError, StoreError, UndecidedError
from tankrig.files import require_writable
from tankrig.pattern import Pattern
from tankrig.run.burst import can_burst
from tankrig.run.event_dispatcher import EventDispatcher
from tankrig.run.folder import create_run, require_new
from tankrig.run.reading import Run, open_run
from tankrig.run.recovery import dose_doubt, open_dose
from tankrig.run.rig import Rig
from tankrig.run.runner import RunJournal, Runner, RunPlan
from tankrig.run.state import FinishReason
from tankrig.run.writer import RunWriter
from tankrig.sequence import Burst, Sequence, dry_run
from tankrig.sequence.exposure import require_camera_keeps
from tankrig.sequence.loading import sequence_from_table, sequence_table


def new_run(sequence: Sequence, rig: Rig, path: str | os.PathLike[str], delivered_ul: float | None = None) -> Runner:
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
    ImageError
        When a calibration's board is before the camera.
    StoreError
        When the folder cannot be made or the disk is too small.
    UndecidedError
        When a person has to say first what the tank holds.
    """
    with ExitStack() as undo:
        undo.callback(rig.close)
        path = Path(path)
        patterns = sequence.drawn(rig.bench.wall)
        run_id = f"{path.name}-{uuid.uuid4().hex[:8]}"
        doser, journal = _guarded(rig, run_id, undo)
        _settled(doser, None, delivered_ul)
        took = dry_run(
            sequence, rig.limits, rig.pace, _frame_bytes(rig), doser.delivered(), exposure=rig.exposure
        )  # fmt: skip
        require_place(path, took.disk_bytes)
        require_camera_keeps(sequence, rig.exposure, rig.camera)
        _require_bursts(sequence, rig, patterns)
        _require_seen(rig)
        settings = {
            "name": sequence.name,
            "id": run_id,
            "rig": rig.name,
            "saturation": rig.camera.saturation,
            "bench": asdict(rig.bench),
            "sequence": sequence_table(sequence),
            "exposure": asdict(rig.exposure),
            "calibrations": {kind: one.hash for kind, one in rig.calibrations.items()},
            "measured": [asdict(one) for one in measured_places(rig.calibrations)],
        }
        create_run(path, rig.camera.shape, _dtype(rig), sequence.frames, settings, list(patterns.values()))
        undo.callback(shutil.rmtree, path, ignore_errors=True)  # nothing is recorded in it yet
        for calibration in rig.calibrations.values():
            copy_to(calibration, path / FOLDER)
        runner = _runner(rig, doser, journal, path, RunPlan(sequence, patterns, took), undo)
        undo.pop_all()
        return runner


def resumed_run(path: str | os.PathLike[str], rig: Rig, delivered_ul: float | None = None) -> Runner:
    """Get an interrupted run ready to go on where it stopped: what was done is not done again.

    Parameters
    ----------
    path
        Of the run's folder.
    rig
        The rig that it was begun with; closed when the run ends, or cannot go on.
    delivered_ul
        A person's word on what the tank holds, where it is asked for.

    Raises
    ------
    StoreError
        When the folder is no run, has come to its end, or was made with another rig.
    UndecidedError
        When a person has to say first what the tank holds: it was interrupted in a dose, or its journal, the tank's
        ledger and the doser do not agree.
    """
    with ExitStack() as undo:
        undo.callback(rig.close)
        path = Path(path)
        run = require_resumable(path)
        sequence = sequence_from_table(dict(run.require_sequence()), str(path))
        patterns = sequence.drawn(rig.bench.wall)
        _require_same(run, rig, patterns)
        first_step, frames_taken = _where(run)
        doser, journal = _guarded(rig, run.settings["id"], undo, run)
        done = _settled(doser, open_dose(run), delivered_ul, dose_doubt(run) is not None)
        tank, used_ul = doser.delivered(), doser.used_ul
        _require_bursts(sequence, rig, patterns)
        _require_seen(rig)
        took = dry_run(sequence, rig.limits, rig.pace, _frame_bytes(rig), tank, used_ul, resume_at=first_step)
        _require_room(path, took.disk_bytes - len(run.events("frame")) * _frame_bytes(rig))
        runner = _runner(rig, doser, journal, path, RunPlan(sequence, patterns, took, first_step, frames_taken), undo)
        if done:
            journal.dose_done(done)
        undo.pop_all()
        return runner


def _require_bursts(sequence: Sequence, rig: Rig, patterns: Mapping[str, Pattern]) -> None:
    """Have every burst of a sequence loaded once, so that what cannot be shown is refused before anything moves."""
    loaded = set()
    for task in sequence.tasks:
        if not isinstance(task.action, Burst):
            continue
        if not isinstance(rig.projector, BurstProjector) or not can_burst(rig.projector, rig.camera):
            raise SequenceError(
                f"{sequence.called}: {task.label}: {rig.projector.name} and {rig.camera.name} take no bursts, since "
                f"one of them has no trigger; write capture steps"
            )
        asked = (task.action.patterns, sequence.camera_settings(task.action))
        if asked not in loaded:
            loaded.add(asked)
            exposure_ms = rig.camera.configure(asked[1]).exposure_ms
            rig.projector.load_burst([patterns[name] for name in asked[0]], exposure_ms)


def _require_seen(rig: Rig) -> None:
    """What the camera can tell of the light before anything moves."""
    if rig.flash_before_run:
        require_seen(rig.projector, rig.camera, rig.exposure)
    if rig.bench.light == "calibrated":  # where boards are held before the camera
        require_no_board(rig.projector, rig.camera, rig.exposure)


def _guarded(rig: Rig, run_id: str, undo: ExitStack, run: Run | None = None) -> tuple[GuardedDoser, RunJournal]:
    ledger = TankLedger(rig.ledger)
    undo.callback(ledger.close)
    journal = RunJournal()
    doser = GuardedDoser(rig.doser, rig.limits, ledger, journal, run_id, known_by_journal(run) if run else None)
    undo.callback(doser.close)
    return doser, journal


def known_by_journal(run: Run) -> Account | None:
    """What a run's journal knew last of the tank; None if it was never begun."""
    told, target_ul = run.events("session", "dose_done"), open_dose(run)
    doubt = dose_doubt(run) if target_ul is None else None
    if not told:
        return None if doubt is None else Account(Delivered(0.0, 0.0, 0.0), doubt=doubt)
    last = told[-1]
    session = next((event for event in reversed(told) if event.kind == "session"), None)
    doser = last.get("doser") or (session["devices"]["doser"] if session else "")
    return Account(
        Delivered(last["delivered_ul"], last["delivered_low_ul"], last["delivered_high_ul"]),
        None if last.get(COUNT_KEYS[0]) is None else NotedCount(doser, Delivered(*(last[key] for key in COUNT_KEYS))),
        target_ul=target_ul,
        begun_with=run.events("dose_intent")[-1]["doser"] if target_ul is not None else None,
        filled_utc=session.get("filled_utc") if session else None,
        used_ul=_used_ul(run),
        doubt=doubt,
    )


def _used_ul(run: Run) -> float:
    """What the doses of a run that are done put into the tank, at most."""
    used_ul, low_ul, begun = 0.0, 0.0, False
    for event in run.events("session", "dose_intent", "dose_done"):
        if event.kind == "dose_intent":
            begun = True
            continue
        if begun and event.kind == "dose_done":
            used_ul += max(0.0, event["delivered_high_ul"] - low_ul)
            begun = False
        low_ul = event["delivered_low_ul"]
    return used_ul


def _settled(
    doser: GuardedDoser, target_ul: float | None, delivered_ul: float | None, doubted: bool = False
) -> DoseDone | None:
    """Have a person's word taken where one is needed; the entry that the journal lacks.

    That is the end of an open dose to `target_ul`, or what the tank holds where lines about doses are lost (`doubted`).
    """
    if delivered_ul is not None:
        doser.resolve(delivered_ul)
    if doser.undecided is not None:
        raise UndecidedError(doser.undecided)
    if target_ul is None and not doubted:
        return None
    return doser.account(doser.delivered().volume_ul if target_ul is None else target_ul)


def _runner(rig: Rig, doser: GuardedDoser, journal: RunJournal, path: Path, plan: RunPlan, undo: ExitStack) -> Runner:
    dispatcher = EventDispatcher()
    undo.callback(dispatcher.close)
    writer = RunWriter(path, dispatcher.dispatch, plan.sequence.frames)
    undo.callback(writer.close)
    journal.writer = writer
    return Runner(rig, doser, writer, dispatcher, journal, plan)


def _where(run: Run) -> tuple[int, int]:
    """Number of the first step that is not done, and how many of its frames were taken."""
    steps = [event["step"] for event in run.events("step") if event["state"] == "done"]
    first = max(steps, default=-1) + 1
    return first, sum(event["step"] == first for event in run.events("frame"))


def _require_same(run: Run, rig: Rig, patterns: Mapping[str, Pattern]) -> None:
    """Refuse to go on with what would not be the same experiment."""
    if not is_of(rig.bench, run.settings["bench"]):
        raise StoreError(f"{run.path}: was recorded on another bench than rig {rig.name} has; resume it on its own")
    for name, pattern in patterns.items():
        if pattern.hash not in run.patterns:
            raise StoreError(f'{run.path}: pattern "{name}" is not what it was; restore its file, or start a new run')


def is_of(bench: Bench, stored: Mapping[str, Any]) -> bool:
    """Whether a run's settings describe this bench; keys that its version did not have yet count at their defaults.

    How far light may be polarised does not count: it changes no picture that is taken, and may be measured meanwhile.
    """
    try:
        recorded = checked(type(bench), dict(stored), "bench", StoreError)
    except StoreError:
        return False
    same = (json.dumps(asdict(replace(one, polarisation=None))) for one in (recorded, bench))
    return next(same) == next(same)


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
