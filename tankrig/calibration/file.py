"""Calibration files: dated, never overwritten, and referred to by what is in them."""

import os
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tankrig import bounded_reading
from tankrig.calibration.how_well import figure
from tankrig.errors import DecisionError, StoreError
from tankrig.extras import needing_extra
from tankrig.files import whole_file

FORMAT = 1
"""Version of the files' layout; a program refuses layouts newer than its own."""
FOLDER = "calibration"
"""Beside the rig file."""
SET_ASIDE = "set-aside"
"""Folder in the calibration folder for results that are kept and not used."""
MUCH_WORSE = 1.5
"""A result is set aside when its error is this many times that of the one in use."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """What was measured of one device, and how well.

    Parameters
    ----------
    kind
        "camera", "projector", "tank", "radiometry", "stray", "latency".
    device
        Name of the device that it holds for, as the device gives it.
    shape
        (rows, columns) of that device.
    result
        Numbers, text, lists and tables of them, with units in the names.
    sd
        Standard deviations, under the same names.
    how_well
        Figures of its quality; the first decides which of two is better, and smaller is better.
    doubts
        Why it should not be believed, in sentences; a result with doubts is set aside.
    rests_on
        By kind, the hashes of the calibrations that it was measured with.
    arrays
        What is too large for text; kept in an .npz file beside.
    rig
        Name of the rig that it is of, as its file says; empty where it was written before that was kept.
    date
        ISO 8601, UTC.
    program
        That made it.
    path, hash
        Of the file, and of its content; set by `save` and `load`.
    """

    kind: str
    device: str
    shape: tuple[int, int]
    result: Mapping[str, Any]
    sd: Mapping[str, Any] = field(default_factory=dict)
    how_well: Mapping[str, float] = field(default_factory=dict)
    doubts: tuple[str, ...] = ()
    rests_on: Mapping[str, str] = field(default_factory=dict)
    arrays: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    rig: str = ""
    date: str = field(default_factory=lambda: datetime.now(UTC).isoformat(timespec="seconds"))
    program: str = field(default_factory=lambda: f"tankrig {version('tankrig')}")
    path: Path | None = None
    hash: str = ""

    @property
    def in_use(self) -> bool:
        """Whether it counts, rather than lying with those that were set aside."""
        return self.path is not None and self.path.parent.name != SET_ASIDE

    @property
    def age_days(self) -> float:
        """Since it was measured."""
        return (datetime.now(UTC) - datetime.fromisoformat(self.date)).total_seconds() / 86400.0

    def require_for(self, device: str, shape: tuple[int, int]) -> None:
        """Refuse to be used for another device.

        Raises
        ------
        StoreError
            When the device or its resolution is another one than was calibrated.
        """
        again = f"calibrate anew (tankrig calibrate {self.kind})"
        if self.device != device:
            raise StoreError(f"{self.path}: was measured with {self.device} and the rig has {device}; {again}")
        if tuple(self.shape) != tuple(shape):
            raise StoreError(
                f"{self.path}: was measured with {list(self.shape)} pixels (rows, columns) and {device} has "
                f"{list(shape)}; set that resolution, or {again}"
            )


def save(calibration: Calibration, folder: Path, accept: bool = False) -> Calibration:
    """Keep a calibration under its kind and date; never over another file.

    One that has doubts, or is much worse than the one in use, is kept in a folder aside and not used; move it out of
    there to use it all the same.

    Parameters
    ----------
    calibration
        What to keep.
    folder
        Of the rig's calibrations.
    accept
        Use it whatever speaks against it.

    Returns
    -------
    Calibration
        With its path and hash, and with the reason added to its doubts where it was set aside.

    Raises
    ------
    StoreError
        When the files cannot be written.
    """
    doubts = (*calibration.doubts, *_worse(calibration, newest(folder, calibration.kind)))
    place = folder if accept or not doubts else folder / SET_ASIDE
    kept = replace(calibration, doubts=doubts, path=_unused(place, calibration))
    assert kept.path is not None
    table = _table(kept)
    if kept.arrays:
        table["arrays"] = _saved_arrays(kept.arrays, kept.path.with_suffix(".npz"))
    with needing_extra("writing a calibration file"):
        import tomlkit

    text = tomlkit.dumps(table)
    hashed = sha256(text.encode()).hexdigest()
    with whole_file(kept.path) as unfinished:
        unfinished.write_text(f'sha256 = "{hashed}"\n{text}', encoding="utf-8")
    return replace(kept, hash=hashed)


def load(path: Path) -> Calibration:
    """Read a calibration file.

    Raises
    ------
    StoreError
        When it cannot be read, is cut off or changed, is none, or was written by a newer program.
    """
    again = "restore it, or calibrate anew"
    try:
        first, _, text = bounded_reading.text(path).partition("\n")
        table = bounded_reading.parsed_toml(text)
        hashed = bounded_reading.parsed_toml(first)["sha256"]
        layout = int(table.pop("format", 0))
    except OSError as error:
        raise StoreError(f"{path}: cannot be read ({error.strerror}); {again}") from error
    except (ArithmeticError, KeyError, TypeError, ValueError) as error:
        raise StoreError(f"{path}: is no whole calibration file ({str(error)[:200]}); {again}") from error
    if layout > FORMAT:
        raise StoreError(
            f"{path}: was written by {table.get('program', 'a newer tankrig')} in format {layout}, and this "
            f"program reads formats up to {FORMAT}; update tankrig"
        )
    if sha256(text.encode()).hexdigest() != hashed:
        raise StoreError(f"{path}: was cut off or changed since it was written; {again}")
    try:
        arrays = _loaded_arrays(path.with_suffix(".npz"), table.pop("arrays", ""))
        table["shape"], table["doubts"] = tuple(table["shape"]), tuple(table["doubts"])
        return Calibration(**table, arrays=arrays, path=path, hash=hashed)
    except (KeyError, TypeError, ValueError) as error:
        raise StoreError(f"{path}: is no calibration file ({str(error)[:200]}); {again}") from error


def copy_to(calibration: Calibration, folder: Path) -> None:
    """Keep a copy of a calibration's files, so that what rests on it can be read wherever it goes.

    Raises
    ------
    StoreError
        When they cannot be written.
    """
    assert calibration.path is not None
    for path in (calibration.path, calibration.path.with_suffix(".npz")):
        if path.exists():
            with whole_file(folder / path.name) as unfinished:
                unfinished.write_bytes(path.read_bytes())


def all_in(folder: Path, kind: str = "*") -> Iterator[Calibration | StoreError]:
    """Calibrations of a kind that count, the newest first; in place of a file that cannot be used, why not."""
    for _, one in _read(folder, kind):
        yield one


def newest(folder: Path, kind: str) -> Calibration | None:
    """The newest calibration of a kind that can be read, if there is one."""
    return next((one for one in all_in(folder, kind) if isinstance(one, Calibration)), None)


@dataclass(frozen=True)
class UnusableCalibration:
    """A calibration file that cannot be used although it is the newest of its kind, so that an older one would count.

    Parameters
    ----------
    path
        Of the file.
    why
        It cannot be used.
    instead
        What would count; None where there is nothing older.
    """

    path: Path
    why: StoreError
    instead: Calibration | None

    @property
    def kind(self) -> str:
        """Of what."""
        return _kind(self.path)

    @property
    def question(self) -> str:
        """What a person has to decide."""
        if self.instead is None:
            return (
                f"{self.why}; there is no other calibration of the {self.kind}, and a person has to decide whether to "
                f"go on as if there had never been one"
            )
        return (
            f"{self.why}; it is the newest calibration of the {self.kind}, and a person has to decide whether to go on "
            f"with the older one in {self.instead.path}"
        )

    @property
    def remedy(self) -> str:
        """How to go on all the same."""
        if self.instead is None:
            return f"move {self.path.name} to another folder"
        return f'name the older one in the rig file, calibration.{self.kind} = "{self.instead.hash[:12]}"'

    def __str__(self) -> str:
        return f"{self.question}: {self.remedy}"


def usable(folder: Path, named: Mapping[str, str] | None = None) -> dict[str, Calibration]:
    """Of each kind the calibration that can be used: the one that the rig file names, else the newest that can be read.

    Parameters
    ----------
    folder
        Of the rig's calibrations.
    named
        By kind, the beginning of a hash.

    Raises
    ------
    StoreError
        When one that is named cannot be found or used.
    """
    found: dict[str, Calibration] = {}
    named = named or {}
    for one in all_in(folder):
        if isinstance(one, Calibration) and one.hash.startswith(named.get(one.kind, "")):
            found.setdefault(one.kind, one)
    for kind in named.keys() - found.keys():
        raise StoreError(
            f"{folder}: has no calibration file that can be used with the hash of the rig file, calibration.{kind} = "
            f'"{named[kind]}"; restore that file, or take the line out to use the newest'
        )
    return found


def passed_over(folder: Path, named: Mapping[str, str] | None = None) -> list[UnusableCalibration]:
    """Files that cannot be used, of kinds that nobody has named one of, and are newer than what would count instead."""
    found = usable(folder, named)
    over = []
    for path, one in _read(folder):
        instead = found.get(_kind(path))
        older = instead is not None and instead.path is not None and path.stem < instead.path.stem
        if isinstance(one, StoreError) and not older and _kind(path) not in (named or {}):
            over.append(UnusableCalibration(path, one, instead))
    return over


def left_aside(folder: Path, named: Mapping[str, str] | None = None) -> dict[str, Calibration]:
    """By kind the newest result that was set aside, where nothing newer counts and the rig file names none.

    Parameters
    ----------
    folder, named
        As for `usable`.

    Raises
    ------
    StoreError
        When one that is named cannot be found or used, or the folder not be read.
    """
    found, named = usable(folder, named), named or {}
    aside = {}
    for kind in {_kind(path) for path in (folder / SET_ASIDE).glob("*-*.toml")} - named.keys():
        one = newest(folder / SET_ASIDE, kind)
        instead = found.get(kind)
        if one is None or one.path is None:
            continue
        if instead is None or instead.path is None or one.path.stem > instead.path.stem:
            aside[kind] = one
    return aside


def use_all_the_same(aside: Path) -> Path:
    """Have a result that was set aside count, doubts and all; returns its new place.

    Raises
    ------
    StoreError
        When its files cannot be moved.
    """
    place = aside.parent.parent
    try:
        # The file itself last: what lies beside it must be there once it counts.
        for path in sorted(aside.parent.glob(f"{aside.stem}.*"), key=lambda one: one == aside):
            path.rename(place / path.name)
    except OSError as error:
        raise StoreError(f"{aside}: cannot be moved to where it is used ({error.strerror}); move it by hand") from error
    return place / aside.name


def in_force(
    folder: Path, named: Mapping[str, str] | None = None, kinds: Collection[str] | None = None
) -> dict[str, Calibration]:
    """Of each kind the calibration that counts, once nothing about that is left to decide; see `usable`.

    Parameters
    ----------
    folder, named
        As for `usable`.
    kinds
        That are needed; all where left out.

    Raises
    ------
    StoreError
        When one that is named cannot be found or used.
    DecisionError
        When the newest of a kind is damaged: whether an older one is good enough, a person has to say, by naming it.
    """
    for over in passed_over(folder, named):
        if kinds is None or over.kind in kinds:
            raise DecisionError(str(over))
    return usable(folder, named)


def _read(folder: Path, kind: str = "*") -> Iterator[tuple[Path, Calibration | StoreError]]:
    try:
        paths = sorted(folder.glob(f"{kind}-*.toml"), key=lambda path: path.stem, reverse=True)
    except OSError as error:
        raise StoreError(f"{folder}: cannot be read ({error.strerror}); give another folder of calibrations") from error
    for path in paths:
        try:
            yield path, load(path)
        except StoreError as error:
            yield path, error


def _kind(path: Path) -> str:
    return path.stem.partition("-")[0]


def _worse(new: Calibration, old: Calibration | None) -> Iterator[str]:
    """Why the new one should not take the place of the old one."""
    if old is None or not old.how_well or not new.how_well:
        return
    name, value = next(iter(new.how_well.items()))
    before = old.how_well.get(name)
    if before is not None and not value <= MUCH_WORSE * before:
        yield (
            f"{figure(new.kind, name, value)}, much worse than the {before:.3g} of {old.path and old.path.name}, which "
            "stays"
        )


def _unused(folder: Path, calibration: Calibration) -> Path:
    stem = f"{calibration.kind}-{datetime.fromisoformat(calibration.date).astimezone(UTC):%Y-%m-%dT%H-%M-%S}"
    names = (stem, *(f"{stem}-{number}" for number in range(2, 100)))
    return next(path for name in names if not (path := folder / f"{name}.toml").exists())


def _table(calibration: Calibration) -> dict[str, Any]:
    plain = ("kind", "device", "shape", "rig", "date", "program", "doubts", "result", "sd", "how_well", "rests_on")
    return {"format": FORMAT, **{name: _plain(getattr(calibration, name)) for name in plain}}


def _plain(value: Any) -> Any:
    """In types that TOML has."""
    if isinstance(value, Mapping):
        return {str(key): _plain(one) for key, one in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    return value


def _saved_arrays(arrays: Mapping[str, NDArray[Any]], path: Path) -> str:
    """Write arrays; returns the hash of the file."""
    with whole_file(path) as unfinished:
        columns: dict[str, Any] = dict(arrays)
        np.savez_compressed(unfinished, **columns)
        return sha256(unfinished.read_bytes()).hexdigest()


def _loaded_arrays(path: Path, hashed: str) -> dict[str, NDArray[Any]]:
    if not hashed:
        return {}
    try:
        if sha256(bounded_reading.whole_bytes(path, bounded_reading.MOST_ARRAY_BYTES)).hexdigest() != hashed:
            raise StoreError(f"{path}: was cut off or changed since it was written; restore it, or calibrate anew")
        return bounded_reading.arrays(path)
    except StoreError:
        raise
    except OSError as error:
        raise StoreError(f"{path}: cannot be read ({os.strerror(error.errno or 0)}); restore it") from error
