"""An archive as one page that needs nothing but itself."""

from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

from tankrig.archive import curves
from tankrig.archive.table import DISAGREES, Record, compared
from tankrig.errors import ImageError, StoreError
from tankrig.figures.tank_image import STYLE
from tankrig.files import whole_file
from tankrig.report.inlined import inlined, rendered
from tankrig.run.journal_io import read_settings

MOST_ROWS = 200
"""Rows of each list on the page; the rest is counted."""


def write_page(archive: Path, records: Sequence[Record], file: Path) -> None:
    """Write what an archive has found as one HTML file.

    Parameters
    ----------
    archive
        Where the runs are.
    records
        Rows of its table, as they were filtered.
    file
        To be written, whole or not at all.

    Raises
    ------
    ImageError
        When no row has a fit.
    StoreError
        When the file cannot be written.
    """
    import matplotlib as mpl

    fitted = [one for one in records if one["fit"]]
    if not fitted:
        raise ImageError(f"{archive}: none of these runs is fitted, so there is nothing to draw; ask for others")
    kind = "dose" if any(one["fit"] == "dose" for one in fitted) else "series"
    drawn = [one for one in fitted if one["fit"] == kind]
    far = sorted((one for one in fitted if (one["disagreement"] or 0.0) > DISAGREES), key=_distance, reverse=True)
    failed = [one for one in records if one["failed"]]
    with mpl.rc_context(STYLE):
        pictures = {
            "over_time": inlined(curves.over_time(drawn)),
            "side_by_side": inlined(curves.side_by_side(drawn)),
            "drift": inlined(curves.drift(drawn, calibration_changes(archive, records))),
        }
        if any(one["disagreement"] is not None for one in fitted):
            pictures["disagreements"] = inlined(curves.disagreements(fitted))
    runs = len({one["run"] for one in records})
    text = rendered(
        "page.html",
        "tankrig.archive",
        title=archive.resolve().name,
        subtitle=f"{runs} runs, {len(fitted)} fits, {records[0]['utc'][:10]} to {records[-1]['utc'][:10]}",
        kind=kind,
        pictures=pictures,
        groups=compared(fitted, "material")[:MOST_ROWS],
        limit=DISAGREES,
        far=far[:MOST_ROWS],
        more_far=max(0, len(far) - MOST_ROWS),
        failed=failed[:MOST_ROWS],
        more_failed=max(0, len(failed) - MOST_ROWS),
        footer=f"made by tankrig {version('tankrig')}",
    )
    with whole_file(file) as unfinished:
        unfinished.write_text(text, encoding="utf-8")


def calibration_changes(archive: Path, records: Sequence[Record]) -> list[tuple[str, str, str]]:
    """When a calibration came into force on a rig: time of the first run with it, rig, kind.

    What a rig's first run had is no change.
    """
    known: dict[tuple[str, str], str] = {}
    changes, seen = [], set()
    for one in records:
        if one["run"] in seen or not one["utc"]:
            continue
        seen.add(one["run"])
        path = archive / one["run"] if (archive / one["run"]).is_dir() else archive
        try:
            named = read_settings(path).get("calibrations", {})
        except StoreError:
            continue
        for kind, hashed in dict(named).items():
            before = known.get((one["rig"], kind))
            if before is not None and before != hashed:
                changes.append((one["utc"], one["rig"], kind))
            known[one["rig"], kind] = hashed
    return changes


def _distance(record: Record) -> float:
    return float(record["disagreement"] or 0.0)
