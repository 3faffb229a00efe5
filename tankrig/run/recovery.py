"""After a crash, or on a damaged disk: say what a run still holds and what is lost, and make it fit to go on."""

import errno
import os
from dataclasses import dataclass
from pathlib import Path

from tankrig.errors import StoreError
from tankrig.run import disk
from tankrig.run.damage import Lost
from tankrig.run.derived import damaged_derived
from tankrig.run.folder import chunk_numbers, mend_metadata, require_no_links, storing
from tankrig.run.journal import Event, Moment
from tankrig.run.journal_io import JOURNAL, read_journal, read_settings
from tankrig.run.reading import LEFT_OUT, Run, StoredFrames, open_run
from tankrig.run.writer import lock_journal, set_torn_end_aside

_UNWRITABLE = (errno.EROFS, errno.EACCES, errno.EPERM)


@dataclass(frozen=True)
class Recovery:
    """What `recover` found.

    Parameters
    ----------
    path
        The run.
    frames
        How many acknowledged frames are there, bit by bit.
    damaged
        Numbers of acknowledged frames whose pixels are not what was recorded; without those that are left out.
    torn_bytes
        Bytes behind the last line of the journal; they were never acknowledged and lie in `journal.jsonl.torn`.
    finished
        Whether the run had come to its end.
    open_dose_ul
        Target of a dose that was begun and not seen to end, or None; a person has to say what it delivered.
    lost
        Where lines of the journal are damaged or missing, and what they said, as far as the others tell.
    unverified_lines
        How many lines have no checksum, being from before there were any.
    unlisted_frames
        Numbers of chunks that no line of the journal speaks of: they were not acknowledged when the run was cut off, or
        their line is lost.
    left_out
        Numbers of frames that a person has left out.
    dose_doubt
        Why a person has to say what the tank holds before the run can go on, or None.
    mended
        What was put right.
    unsure_doses
        Numbers of frames of which nobody knows what the tank held, a line that may have been about a dose being lost.
    read_only
        Whether the run cannot be written, so that nothing was put right.
    damaged_derived
        Names of files with arrays that were calculated from the frames and are damaged; nothing is lost with them.
    """

    path: Path
    frames: int
    damaged: tuple[int, ...]
    torn_bytes: int
    finished: bool
    open_dose_ul: float | None
    lost: tuple[Lost, ...] = ()
    unverified_lines: int = 0
    unlisted_frames: tuple[int, ...] = ()
    left_out: tuple[int, ...] = ()
    dose_doubt: str | None = None
    mended: tuple[str, ...] = ()
    unsure_doses: tuple[int, ...] = ()
    read_only: bool = False
    damaged_derived: tuple[str, ...] = ()

    @property
    def whole(self) -> bool:
        """Whether all that was acknowledged is there."""
        return not self.damaged and not any(one.seqs for one in self.lost)


def recover(path: str | os.PathLike[str], leave_out: bool = False) -> Recovery:
    """Verify each acknowledged frame of a run and each line of its journal, and put right what surely can be.

    A torn end of the journal is set aside, and damaged metadata of the frames are written anew from their copy. Damaged
    lines and chunks stay as they are. Where the run cannot be written it is only looked at.

    Parameters
    ----------
    path
        The run's folder.
    leave_out
        Note in the journal that damaged frames are left out from now on, by everything that reads the run.

    Raises
    ------
    StoreError
        When the folder is no run, is being recorded, or holds a symbolic link.
    """
    folder = Path(path)
    read_settings(folder)
    require_no_links(folder)
    lock, writable = _locked(folder)
    try:
        text = read_journal(folder)
        torn, mended = text.size - text.good, []
        if writable:
            with storing(folder, "mend it"):
                set_torn_end_aside(folder, text)
                if mend_metadata(folder, max(chunk_numbers(folder), default=-1) + 1):
                    mended.append("frames/zarr.json, from its copy in zarr.json")
        run = open_run(folder)
        damaged = _damaged(run)
        if damaged and leave_out:
            if not writable:
                raise StoreError(
                    f"{folder}: cannot be written, so no frame can be left out; make a copy and recover that"
                )
            _leave_out(folder, damaged)
            run, damaged = open_run(folder), ()
    finally:
        os.close(lock)
    frames = run.events("frame")
    listed = {event["index"] for event in frames} | set(run.left_out)
    return Recovery(
        folder,
        len(frames) - len(damaged),
        damaged,
        torn,
        run.end is not None,
        open_dose(run),
        run.lost,
        run.unverified,
        tuple(sorted(chunk_numbers(folder) - listed)),
        run.left_out,
        dose_doubt(run),
        tuple(mended),
        tuple(sorted(run.unsure_doses)),
        not writable,
        damaged_derived(folder),
    )


def _locked(folder: Path) -> tuple[int, bool]:
    """The journal's lock, and whether the run can be written."""
    with storing(folder, "open it"):
        try:
            lock = lock_journal(folder)
        except OSError as error:
            if isinstance(error, StoreError) or error.errno not in _UNWRITABLE:
                raise
            return lock_journal(folder, change=False), False
    return lock, os.access(folder, os.W_OK)


def _damaged(run: Run) -> tuple[int, ...]:
    stored = StoredFrames(run.path)
    return tuple(event["index"] for event in run.events("frame") if not _intact(stored, event))


def _intact(stored: StoredFrames, event: Event) -> bool:
    try:
        stored.read(event, thoroughly=True)
    except StoreError:
        return False
    return True


def _leave_out(folder: Path, damaged: tuple[int, ...]) -> None:
    text = read_journal(folder)
    note = Event(text.next_seq, "note", Moment.now(), {"text": LEFT_OUT, "frames": list(damaged)})
    with storing(folder, "note what is left out"):
        disk.append(folder / JOURNAL, (b"" if text.ended else b"\n") + note.line())


def open_dose(run: Run) -> float | None:
    """Target, µl in the run, of a dose with intent and no completion; None when there is none."""
    doses = run.events("dose_intent", "dose_done")
    return float(doses[-1]["total_ul"]) if doses and doses[-1].kind == "dose_intent" else None


def dose_doubt(run: Run) -> str | None:
    """Why the journal cannot tell what the run put into the tank; None where it can.

    Either a dose was begun and not seen to end, or a line that is damaged or missing may have been about a dose. A
    whole `dose_done` after it says what the tank held then, and ends the doubt.
    """
    target_ul = open_dose(run)
    if target_ul is not None:
        return f"it was interrupted in a dose to {target_ul:g} µl"
    known = max((event.seq for event in run.events("dose_done")), default=-1)
    doubts = [lost for lost in run.lost if lost.may_be_dose and lost.after_seq >= known]
    return str(doubts[-1]) if doubts else None
