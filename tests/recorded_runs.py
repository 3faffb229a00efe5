"""Small recorded runs, made line by line: each has numbers that no other run has, so that a mix-up shows."""

import json
import shutil
from collections.abc import Sequence
from pathlib import Path

from tankrig.live.results import DoseFit, Fit, SeriesFit, to_fields
from tankrig.run.journal import Event, Moment
from tankrig.run.journal_io import JOURNAL
from tankrig.scene import Medium

TEMPLATE = Path(__file__).parent / "data" / "stored" / "2" / "finished" / "run"
PATTERN = "rays"


def begin_run(path: Path, rig: str = "test rig") -> Path:
    """A run's folder without a line in its journal."""
    shutil.copytree(TEMPLATE, path, ignore=shutil.ignore_patterns("c.[0-9].0.0", JOURNAL))
    shutil.copytree(TEMPLATE / "patterns", path / "patterns", dirs_exist_ok=True)
    group = json.loads((path / "zarr.json").read_text())
    group["attributes"]["tankrig"]["settings"]["rig"] = rig
    (path / "zarr.json").write_text(json.dumps(group))
    (path / JOURNAL).write_bytes(b"")
    return path


def add(path: Path, kind: str, second: float, **fields: object) -> Event:
    """Record one more line, so many seconds after the run's first."""
    seq = (path / JOURNAL).read_bytes().count(b"\n")
    at = f"2026-11-20T10:{int(second) // 60 % 60:02d}:{second % 60:09.6f}+00:00"
    event = Event(seq, kind, Moment(at, int(1e9 * second), "boot"), fields)
    with (path / JOURNAL).open("ab") as journal:
        journal.write(event.line())
    return event


def dose_fit(run: Path, number: int, again: int = 0) -> DoseFit:
    """A fit whose numbers tell which run, dose and trial it is of."""
    own = sum(run.name.encode()) + 0.01 * number + 0.0001 * again
    known = {"sigma_a": number > 0, "sigma_s": True, "g": True}
    return DoseFit(
        round(0.1 * (number + 1), 3), Medium(1e-6 * own, 1e-4 * own, 0.5), (1e-8, 1e-6, 1e-3), known, gain=own,
        frames=4, patterns=(PATTERN,), newest=number,
    )  # fmt: skip


def series_fit(run: Path, doses: int) -> SeriesFit:
    """A fit of all doses so far."""
    fits = [dose_fit(run, number) for number in range(doses)]
    ink = Medium(1e-6 * fits[-1].gain, 1e-3 * fits[-1].gain, 0.6)
    return SeriesFit(
        tuple(fit.dose_ml for fit in fits), ink, Medium(1e-5, 0.0, 0.0), (1e-8, 1e-6, 1e-3, 1e-7),
        verdict=f"of {run.name}", identifiable={"sigma_a": True, "sigma_s": True, "g": True},
    )  # fmt: skip


def add_fit(path: Path, fit: Fit, second: float) -> Event:
    """Record a fit."""
    return add(path, "fit", second, **to_fields(fit))


def add_dose(path: Path, number: int, pattern_hash: str, series: bool = True) -> list[Event]:
    """Record a dose: its steps, one frame a minute after the last, its fit, and that of the series."""
    second, held = 60.0 * (number + 1), 100.0 * (number + 1)
    tank = {"delivered_ul": held, "delivered_low_ul": held, "delivered_high_ul": held}
    lines = [
        add(path, "step", second, step=number, state="begun", label="x"),
        add(path, "dose_done", second, step=number, **tank),
        add(
            path, "frame", second, index=number, step=number, pattern_hash=pattern_hash,
            exposure_start_ns=int(1e9 * second), sha256="0", exposure_ms=8.0, gain=1.0, **tank,
        ),
        add(path, "step", second, step=number, state="done"),
        add_fit(path, dose_fit(path, number), second + 5.0),
    ]  # fmt: skip
    if series and number:
        lines.append(add_fit(path, series_fit(path, number + 1), second + 6.0))
    return lines


def session(path: Path, second: float = 0.0) -> Event:
    """Record that a session begins."""
    held = {"delivered_ul": 0.0, "delivered_low_ul": 0.0, "delivered_high_ul": 0.0}
    return add(path, "session", second, first_step=0, devices={}, **held)


def recorded(path: Path, doses: int, ending: str = "completed", hashes: Sequence[str] = ("d" * 64,)) -> Path:
    """A whole run; an `ending` of "" leaves it without an end."""
    begin_run(path)
    session(path)
    for number in range(doses):
        add_dose(path, number, hashes[0])
    if ending:
        add(path, "end", 60.0 * (doses + 1), reason=ending)
    return path
