"""The runs of an archive as one table: a row for each fit, or for a run that has none, with the words of the field."""

import csv
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from fnmatch import fnmatchcase
from pathlib import Path
from statistics import fmean, median, stdev
from typing import Any

from tankrig.archive.results import Results
from tankrig.archive.runs import runs_in
from tankrig.archive.task import about
from tankrig.errors import ImageError, StoreError, TankrigError
from tankrig.estimation.coordinates import NAMES
from tankrig.files import whole_file
from tankrig.live.recorded import fits_that_hold
from tankrig.live.results import DoseFit, Fit, SeriesFit, fits_in, from_fields, last_of_each
from tankrig.run.reading import open_run

COLUMNS = (
    "run", "utc", "rig", "material", "name", "ending", "frames", "fit", "dose_ml",
    *NAMES, *(f"sd_{name}" for name in NAMES), *(f"determined_{name}" for name in NAMES),
    "gain", "rmse", "model", "verdict", "made", "disagreement", *(f"old_{name}" for name in NAMES), "failed",
)  # fmt: skip
"""`fit` is "dose" (the liquid in the tank, per mm), "series" (the ink, per mm and ml) or empty; `made` "live", as the
run's journal has it, or "refit"; `disagreement` how far a refit is from what the journal has, in sd."""
DISAGREES = 3.0
"""Standard deviations from which on a refit disagrees with what was found before."""

Record = dict[str, Any]


def table_of(
    archive: Path, results: Path | None = None, progress: Callable[[int, int], object] = lambda *_: None
) -> list[Record]:
    """Every run of an archive with its fits: those of the refit where there are results, else those of its journal.

    Parameters
    ----------
    archive
        The folder of the runs; a run that cannot be read is a row that says so in `failed`.
    results
        The folder of a refit of it.
    progress
        Told how many runs are read, of how many.

    Returns
    -------
    list
        Dictionaries with the keys of `COLUMNS`, in the order of time.

    Raises
    ------
    StoreError
        When there is no run, or no result in `results`.
    """
    refits: dict[str, Record] = {}
    if results is not None:
        refits = {row["run"]: row for row in Results(results).rows()}
        if not refits:
            raise StoreError(f"{results}: there is no result of a refit in it; give the folder of tankrig refit --out")
    paths, top = runs_in(archive), archive
    records: list[Record] = []
    for number, path in enumerate(paths, 1):
        name = path.name if path == top else str(path.relative_to(top))
        records += _records(path, name, refits.get(name))
        progress(number, len(paths))
    return sorted(records, key=lambda one: (one["utc"], one["run"]))


def _records(path: Path, name: str, refit: Record | None) -> Iterator[Record]:
    try:
        run = open_run(path)
        said = about(run)
        lines = [event.fields for event in fits_that_hold(run)]
        doses, series = fits_in(lines)
    except (TankrigError, KeyError, TypeError, ValueError) as error:
        yield _record({"run": name, "failed": str(error)}, None)
        return
    old: list[Fit] = [*doses, *([series] if series else [])]
    head = {**said, "run": name, "made": "live" if old else "", "failed": "" if run.journal else _nothing_of(path)}
    if refit is None:
        yield from (_record(head, fit) for fit in old) if old else [_record(head, None)]
        return
    if "fits" not in refit:
        yield _record({**head, "made": "refit", "failed": refit.get("failed", "")}, None)
        return
    # Earlier refits kept a dose's fit without single scattering too.
    for fit in last_of_each(from_fields(fields) for fields in refit["fits"]):
        before = next((one for one in old if _of(one) == _of(fit)), None)
        yield _record({**head, "made": "refit", "failed": ""}, fit, before)


def _nothing_of(path: Path) -> str:
    """Of a run whose settings can be read and whose journal holds no event, as where it is cut off in its first."""
    return (
        f"{path}: its journal has not one whole line: nothing was recorded, or its beginning is damaged; tankrig "
        "recover tells what is there"
    )


def _of(fit: Fit) -> object:
    return round(fit.dose_ml, 6) if isinstance(fit, DoseFit) else type(fit).__name__


def _record(head: Mapping[str, Any], fit: Fit | None, before: Fit | None = None) -> Record:
    record: Record = dict.fromkeys(COLUMNS) | {"utc": "", "rig": "", "material": "", "failed": ""}
    record |= {key: value for key, value in head.items() if key in COLUMNS}
    if isinstance(fit, DoseFit | SeriesFit):
        dose = isinstance(fit, DoseFit)
        record |= {"fit": "dose" if dose else "series", "gain": fit.gain, **_values(fit)}
        record |= {f"sd_{name}": sd for name, sd in zip(NAMES, fit.sd, strict=False)}
        record |= {f"determined_{name}": fit.identifiable.get(name) for name in NAMES}
        record |= (
            {"dose_ml": fit.dose_ml, "rmse": fit.rmse, "model": fit.model, "verdict": _verdict(fit)}
            if isinstance(fit, DoseFit)
            else {"rmse": fmean(fit.rmse) if fit.rmse else None, "verdict": fit.verdict}
        )
        if isinstance(before, DoseFit | SeriesFit):
            record |= {f"old_{name}": value for name, value in _values(before).items()}
            record["disagreement"] = disagreement(fit, before)
    elif fit is not None:
        record |= {"dose_ml": fit.dose_ml, "failed": fit.error}
    return record


def _values(fit: DoseFit | SeriesFit) -> dict[str, float]:
    liquid = fit.medium if isinstance(fit, DoseFit) else fit.ink
    return dict(zip(NAMES, liquid.coefficients, strict=True))


def _verdict(fit: DoseFit) -> str:
    unsure = [name for name in NAMES if not fit.identifiable.get(name, True)]
    words = [f"{' and '.join(unsure)} not determined"] if unsure else []
    words += [f"{100.0 * fit.structure:.2g} % of the light is not as the model has it"] if fit.structure else []
    return "; ".join(words) or "determined"


def disagreement(fit: DoseFit | SeriesFit, before: DoseFit | SeriesFit) -> float | None:
    """How far two fits of the same photographs are apart: the coefficient that moved most, by the larger of both
    standard deviations. They saw the same noise, so that even one standard deviation is much.

    None where there are no standard deviations.
    """
    moved = []
    for (name, value), index in zip(_values(fit).items(), range(len(NAMES)), strict=True):
        sds = [one.sd[index] for one in (fit, before) if len(one.sd) > index]
        if sds and max(sds) > 0.0:
            moved.append(abs(value - _values(before)[name]) / max(sds))
    return max(moved, default=None)


@dataclass(frozen=True)
class Filter:
    """Which rows of the table are wanted.

    Parameters
    ----------
    materials, rigs, names
        Patterns with * and ?, of which one has to fit; none: any.
    since, until
        ISO dates or times, UTC; a year or a month alone count whole.
    between
        Column of numbers, from, to.
    verdict
        Words that the verdict has to hold.
    fit
        "dose", "series" or any.
    failed, disagreeing
        Only what failed, or only what disagrees with what was found before.
    """

    materials: tuple[str, ...] = ()
    rigs: tuple[str, ...] = ()
    names: tuple[str, ...] = ()
    since: str = ""
    until: str = ""
    between: tuple[tuple[str, float, float], ...] = ()
    verdict: str = ""
    fit: str = ""
    failed: bool = False
    disagreeing: bool = False

    def __post_init__(self) -> None:
        for name, text in (("since", self.since), ("until", self.until)):
            if text and not _is_date(text):
                raise StoreError(f"{name} = {text} is no date; give one such as 2026-03-01 or 2026-03-01T09:30, UTC")
        for name, low, high in self.between:
            if name not in COLUMNS:
                raise StoreError(f"there is no column {name}; there are {', '.join(COLUMNS)}")
            if math.isnan(low) or math.isnan(high):  # infinity is an end that does not matter
                raise StoreError(f"the range {low:g} … {high:g} of {name} has an end that is no number; give numbers")

    def __call__(self, record: Record) -> bool:
        """Whether a row is wanted."""
        texts = (self.materials, "material"), (self.rigs, "rig"), (self.names, "run")
        return (
            all(not wanted or any(fnmatchcase(str(record[name]), one) for one in wanted) for wanted, name in texts)
            and (not self.since or str(record["utc"]) >= self.since)
            and (not self.until or str(record["utc"])[: len(self.until)] <= self.until)
            and all(_number(record[name]) and low <= record[name] <= high for name, low, high in self.between)
            and self.verdict.lower() in str(record["verdict"] or "").lower()
            and (not self.fit or record["fit"] == self.fit)
            and (not self.failed or bool(record["failed"]))
            and (not self.disagreeing or (record["disagreement"] or 0.0) > DISAGREES)
        )


_DATE = re.compile(r"\d{4}(-\d\d(-\d\d(T\d\d(:\d\d(:\d\d)?)?)?)?)?")


def _is_date(text: str) -> bool:
    """Whether a text can be compared with a run's time, letter by letter.

    >>> [_is_date(one) for one in ("2026-03-01", "2026-03", "2026-03-01T09:30", "2026-13-77", "yesterday")]
    [True, True, True, False, False]
    """
    if _DATE.fullmatch(text) is None:
        return False
    try:
        datetime.fromisoformat(text + "2026-01-01"[len(text) :])
    except ValueError:
        return False
    return True


def compared(records: Iterable[Record], by: str) -> list[Record]:
    """What the fits of each material, rig or whatever else have in common, dose by dose.

    Parameters
    ----------
    records
        Rows of the table; those without a fit do not count.
    by
        A column.

    Returns
    -------
    list
        Of each group: how many fits, and of each coefficient its mean, how far the fits scatter, and what standard
        deviation they state (the median), and whether all of them determined it.
    """
    if by not in COLUMNS:
        raise StoreError(f"there is no column {by}; there are {', '.join(COLUMNS)}")
    groups: dict[tuple[str, str, float], list[Record]] = {}
    for one in records:
        if one["fit"]:
            groups.setdefault((str(one[by]), one["fit"], round(one["dose_ml"] or 0.0, 6)), []).append(one)
    found = []
    for (name, fit, dose_ml), rows in sorted(groups.items()):
        row: Record = {by: name, "fit": fit, "dose_ml": dose_ml if fit == "dose" else None, "fits": len(rows)}
        for coefficient in NAMES:
            values = [one[coefficient] for one in rows]
            stated = [one[f"sd_{coefficient}"] for one in rows if one[f"sd_{coefficient}"] is not None]
            row |= {
                coefficient: fmean(values),
                f"scatter_{coefficient}": stdev(values) if len(values) > 1 else None,
                f"sd_{coefficient}": median(stated) if stated else None,
                f"determined_{coefficient}": all(one[f"determined_{coefficient}"] is not False for one in rows),
            }
        found.append(row)
    return found


def write_table(records: Sequence[Record], file: Path) -> None:
    """Write rows as CSV or Parquet, by the name of the file, whole or not at all.

    Raises
    ------
    StoreError
        When the name is of neither, the file cannot be written, or Parquet's library is not installed.
    ImageError
        When there are no rows.
    """
    if not records:
        raise ImageError(f"{file}: there is nothing to write; ask for less")
    if file.suffix == ".csv":
        with whole_file(file) as unfinished, unfinished.open("w", newline="", encoding="utf-8") as text:
            rows = csv.DictWriter(text, list(records[0]))
            rows.writeheader()
            rows.writerows(records)
    elif file.suffix == ".parquet":
        try:
            import pyarrow
            import pyarrow.parquet
        except ImportError as error:
            raise StoreError(
                f'{file}: Parquet needs pyarrow: pip install "tankrig[archive]"; or write a .csv'
            ) from error
        with whole_file(file) as unfinished:
            pyarrow.parquet.write_table(pyarrow.Table.from_pylist(list(records)), unfinished)
    else:
        raise StoreError(f"{file}: is neither .csv nor .parquet; give a file with one of these endings")


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and math.isfinite(value)
