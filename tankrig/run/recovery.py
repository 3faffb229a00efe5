"""After a crash: check what a run holds and make it fit to go on."""

import os
from dataclasses import dataclass
from pathlib import Path

from tankrig.errors import StoreError
from tankrig.run.facts import read_journal, read_settings
from tankrig.run.folder import storing
from tankrig.run.reading import Run, open_run, raw_frame
from tankrig.run.writer import digest, lock_journal, set_torn_end_aside


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
        Indices of acknowledged frames whose pixels are not what was recorded.
    torn_bytes
        Bytes behind the last whole line of the journal; they were never acknowledged and lie in `journal.jsonl.torn`.
    finished
        Whether the run had come to its end.
    open_dose_ul
        Target of a dose that was begun and not seen to end, or None; a person has to say what it delivered.
    """

    path: Path
    frames: int
    damaged: tuple[int, ...]
    torn_bytes: int
    finished: bool
    open_dose_ul: float | None


def recover(path: str | os.PathLike[str]) -> Recovery:
    """Verify each acknowledged frame of a run against its checksum, and set a torn end of the journal aside.

    Parameters
    ----------
    path
        The run's folder.

    Raises
    ------
    StoreError
        When the folder is no run, is being recorded, or cannot be written.
    """
    folder = Path(path)
    read_settings(folder)
    torn = 0
    with storing(folder, "mend its journal"):
        lock = lock_journal(folder)
        try:
            _, good, size = read_journal(folder)
            if good < size:
                torn = set_torn_end_aside(folder, good)
        finally:
            os.close(lock)
    run = open_run(folder)
    frames = run.events("frame")
    damaged = tuple(event["index"] for event in frames if not _intact(folder, event["index"], event["sha256"]))
    return Recovery(folder, len(frames) - len(damaged), damaged, torn, run.end is not None, open_dose(run))


def _intact(folder: Path, index: int, sha256: str) -> bool:
    try:
        return digest(raw_frame(folder, index)) == sha256
    except StoreError:
        return False


def open_dose(run: Run) -> float | None:
    """Target, µl in the run, of a dose with intent and no completion; None when there is none."""
    doses = run.events("dose_intent", "dose_done")
    return float(doses[-1]["total_ul"]) if doses and doses[-1].kind == "dose_intent" else None
