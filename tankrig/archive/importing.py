"""Make a run of somebody else's frames: pictures in a folder, a scene for what each shows, a table of doses."""

import csv
import hashlib
import json
import uuid
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tankrig.bench import KnownScenes
from tankrig.devices import CameraSettings, Delivered, Frame
from tankrig.errors import ImageError, StoreError
from tankrig.image.reading import NUMPY_SUFFIXES, PICTURE_SUFFIXES, read_any
from tankrig.run.conditions import Conditions
from tankrig.run.folder import create_run, require_new
from tankrig.run.writer import RunWriter
from tankrig.scene.description import Medium, Scene

DARK = "dark"
"""Name of the pattern of a frame without light."""
COLUMNS = ("file", "pattern", "dose_ml", "dose_sd_ml", "exposure_ms", "gain")
UNIFORM = 12.0**0.5
"""Width of a range by its standard deviation, where anywhere in it is alike."""


@dataclass(frozen=True)
class Picture:
    """One frame, and what was true when it was taken.

    Parameters
    ----------
    file
        The picture.
    pattern
        Name of what was shown.
    dose_ml, dose_sd_ml
        Ink in the tank, and its standard deviation.
    exposure_ms, gain
        Of the camera.
    """

    file: Path
    pattern: str
    dose_ml: float
    dose_sd_ml: float = 0.0
    exposure_ms: float = 1.0
    gain: float = 1.0

    @property
    def conditions(self) -> Conditions:
        """As the journal has them."""
        half_ul = 1000.0 * self.dose_sd_ml * UNIFORM / 2.0
        held_ul = 1000.0 * self.dose_ml
        tank = Delivered(held_ul, max(0.0, held_ul - half_ul), held_ul + half_ul)
        return Conditions(tank, CameraSettings(self.exposure_ms, self.gain))


def pictures_in(
    folder: Path,
    patterns: Sequence[str],
    table: Path | None = None,
    dose_ml: float | None = None,
    exposure_ms: float | None = None,
) -> list[Picture]:
    """What there is to import, in the order of the table, or of the files' names where there is none.

    Parameters
    ----------
    folder
        Of the pictures: .png, .tif, .npy or .npz.
    patterns
        Names of those whose scenes are known; "dark" is known always.
    table
        CSV with a heading: `file` (in the folder), `dose_ml`, `exposure_ms`, and where they differ `pattern`, `gain`
        and `dose_sd_ml`; None: `table.csv` in the folder, where it is there.
    dose_ml, exposure_ms
        Of all pictures whose row does not say.

    Raises
    ------
    ImageError
        When there are no pictures, or a row says too little or something that cannot be.
    """
    if not folder.is_dir():
        raise ImageError(f"{folder}: is not a folder; give the one that the pictures lie in")
    beside = folder / "table.csv"
    table = table or (beside if beside.is_file() else None)
    if table is None:
        files = sorted(one for one in folder.iterdir() if one.suffix.lower() in (*PICTURE_SUFFIXES, *NUMPY_SUFFIXES))
        if not files:
            raise ImageError(f"{folder}: there is no .png, .tif, .npy or .npz in it; give the folder of the pictures")
        rows: list[tuple[str, Mapping[str, str]]] = [(str(folder), {"file": file.name}) for file in files]
    else:
        rows = _rows(table)
    common = {"dose_ml": dose_ml, "exposure_ms": exposure_ms, "gain": 1.0, "dose_sd_ml": 0.0}
    return [_picture(folder, where, row, patterns, common) for where, row in rows]


def _rows(table: Path) -> list[tuple[str, Mapping[str, str]]]:
    try:
        with table.open(newline="", encoding="utf-8-sig") as text:
            reader = csv.DictReader(text)
            rows: list[tuple[str, Mapping[str, str]]] = [(f"{table}, line {reader.line_num}", row) for row in reader]
            heads = reader.fieldnames or []
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ImageError(f"{table}: cannot be read as a table ({error}); give a CSV file") from error
    unknown = [name for name in heads if name not in COLUMNS]
    if "file" not in heads or unknown:
        wrong = f'column "{unknown[0]}" is unknown' if unknown else "has no column file"
        raise ImageError(f"{table}: {wrong}; the columns are {', '.join(COLUMNS)}")
    if not rows:
        raise ImageError(f"{table}: has no rows; give one for each picture")
    return rows


def _picture(
    folder: Path, where: str, row: Mapping[str, str], patterns: Sequence[str], common: Mapping[str, float | None]
) -> Picture:
    numbers = {}
    name = (row.get("file") or "").strip()
    for key, otherwise in common.items():
        text = (row.get(key) or "").strip()
        try:
            value = float(text) if text else otherwise
        except ValueError:
            value = np.nan
        if value is None:
            raise ImageError(
                f"{where}: nothing says {key} of {name or 'a picture'}; give --{key.replace('_', '-')} or such a column"
            )
        least = 0.0 if key.startswith("dose") else np.nextafter(0.0, 1.0)
        if not (np.isfinite(value) and value >= least):
            raise ImageError(f'{where}: {key} = "{text}" is no {"volume" if least == 0.0 else "positive number"}')
        numbers[key] = value
    pattern = (row.get("pattern") or "").strip() or (patterns[0] if len(patterns) == 1 else "")
    if pattern != DARK and pattern not in patterns:
        known = ", ".join([*patterns, DARK])
        raise ImageError(
            f'{where}: the scene of pattern "{pattern}" of {name} is not known; give it as --scene {pattern or "NAME"}'
            f"=FILE, or one of {known} in the column pattern"
        )
    file = folder / name
    if not name or not file.is_file():
        raise ImageError(f"{where}: there is no file {file}; put it there, or leave its row out")
    return Picture(file, pattern, **numbers)


def import_run(
    out: Path, pictures: Sequence[Picture], scenes: Mapping[str, Scene], about: Mapping[str, str] | None = None
) -> Path:
    """Make a run of pictures; it appears whole, or not at all.

    It has no sequence and no pixels of patterns, but the scene of each pattern, and is fitted, reported and archived
    like any other.

    Parameters
    ----------
    out
        Of the run's folder, which must not exist.
    pictures
        In the order in which they were taken.
    scenes
        What each pattern lights and the camera sees; the media do not matter.
    about
        `name`, `rig`, `material`: words for people.

    Returns
    -------
    Path
        Of the run.

    Raises
    ------
    ImageError
        When a picture cannot be read, or is of another shape or kind than the first or than the camera.
    SceneError
        When the scenes are of different cameras or tanks.
    StoreError
        When the run cannot be made.
    """
    require_new(out)
    bench = KnownScenes(scenes)
    frames = _frames(pictures, bench.camera.shape)
    shown = {name: _told(name, scenes.get(name)) for name in dict.fromkeys(one.pattern for one in pictures)}
    keys = {name: _hash(told) for name, told in shown.items()}
    dtype = frames[0].dtype
    settings: dict[str, Any] = {
        "name": out.name, "id": f"{out.name}-{uuid.uuid4().hex[:8]}", "rig": "", **(about or {}),
        "scenes": {keys[name]: told for name, told in shown.items()}, "calibrations": {},
        "imported": {"from": str(pictures[0].file.parent), "files": [one.file.name for one in pictures]},
    }  # fmt: skip
    if dtype.kind == "u":
        settings["saturation"] = int(np.iinfo(dtype).max)
    fresh = out.with_name(f".{out.name}.imported")
    _remove(fresh)
    try:
        create_run(fresh, bench.camera.shape, dtype, len(pictures), settings)
        _record(fresh, pictures, frames, keys)
        fresh.rename(out)
    except OSError as error:
        if isinstance(error, StoreError):
            raise
        raise StoreError(f"{out}: cannot be made ({error.strerror}); give another folder with --out") from error
    finally:
        _remove(fresh)
    return out


def _record(path: Path, pictures: Sequence[Picture], frames: Sequence[NDArray[Any]], keys: Mapping[str, str]) -> None:
    with RunWriter(path) as writer:
        first = pictures[0].conditions.line()
        held = {key: first[key] for key in ("delivered_ul", "delivered_low_ul", "delivered_high_ul")}
        writer.put("session", program=f"tankrig import {version('tankrig')}", devices={}, **held)
        for step, (picture, pixels) in enumerate(zip(pictures, frames, strict=True)):
            line = picture.conditions.line()
            now = {key: line[key] for key in held}
            if now != held:
                held = now
                writer.put("dose_done", complete=True, step=step, **held)
            writer.put_frame(Frame(pixels, 0, 0, 0, step), step, keys[picture.pattern], file=picture.file.name, **line)
        writer.finish(reason="completed", message="imported")


def _frames(pictures: Sequence[Picture], shape: tuple[int, int]) -> list[NDArray[Any]]:
    """Counts as they are, or numbers with a fraction as float32."""
    frames: list[NDArray[Any]] = []
    for picture in pictures:
        values = read_any(picture.file)
        if values.dtype.kind == "f":
            values = values.astype(np.float32)
        elif values.dtype.kind in "iu" and values.size and 0 <= values.min() <= values.max() < 2**16:
            values = values.astype(values.dtype if values.dtype == np.uint8 else np.uint16)
        else:
            raise ImageError(f"{picture.file}: holds {values.dtype}; give counts from 0 to 65535, or floating point")
        if values.shape != shape:
            raise ImageError(
                f"{picture.file}: has {values.shape[0]} × {values.shape[1]} pixels and the scene's camera {shape[0]} × "
                f"{shape[1]}; give the scene of these pictures"
            )
        if not np.isfinite(values).all():
            raise ImageError(f"{picture.file}: has pixels that are no number; leave the picture out or mend it")
        if frames and values.dtype != frames[0].dtype:
            raise ImageError(
                f"{picture.file}: is {values.dtype} and {pictures[0].file.name} is {frames[0].dtype}; a run has one "
                "kind of pixel, so save all alike"
            )
        frames.append(values)
    return frames


def _told(name: str, scene: Scene | None) -> dict[str, Any]:
    if scene is None:
        return {"name": name, "scene": None}
    table = asdict(replace(scene, medium=Medium(0.001, 0.01, 0.5)))  # what is in the tank is to be found
    table.pop("source")
    return {"name": name, "scene": json.loads(json.dumps(table, default=str))}


def _hash(told: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(told, sort_keys=True).encode()).hexdigest()


def _remove(folder: Path) -> None:
    import shutil

    shutil.rmtree(folder, ignore_errors=True)
