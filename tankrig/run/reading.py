"""Reading a run: what was acknowledged, and nothing else."""

import hashlib
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tankrig.checked_toml import checked
from tankrig.devices import Delivered, Pixels
from tankrig.errors import StoreError
from tankrig.pattern import Pattern
from tankrig.run.conditions import Conditions, with_conditions
from tankrig.run.damage import Lost
from tankrig.run.journal import Event
from tankrig.run.journal_io import read_journal, read_settings
from tankrig.scene.description import Scene

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure

_LIT, _DARK = np.full((1, 1), 255, np.uint8), np.zeros((1, 1), np.uint8)
"""Patterns of which nobody knows the pixels."""

LEFT_OUT = "left out"
"""Text of the note that names, as `frames`, those that a person has left out because they are damaged."""


@dataclass(frozen=True)
class Run:
    """A recorded run, finished or not.

    Parameters
    ----------
    path
        Its folder.
    settings
        What it was made with.
    journal
        Its events, in order; without the frames that a person has left out.
    lost
        Where lines of the journal are damaged or missing.
    unverified
        How many events have no checksum, being from before there were any.
    left_out
        Numbers of the frames that a person has left out because they are damaged (`tankrig recover --leave-out`).
    """

    path: Path
    settings: Mapping[str, Any] = field(repr=False)
    journal: tuple[Event, ...] = field(repr=False)
    lost: tuple[Lost, ...] = field(default=(), repr=False)
    unverified: int = 0
    left_out: tuple[int, ...] = ()

    def events(self, *kinds: str) -> tuple[Event, ...]:
        """The events of these kinds, in order."""
        return tuple(event for event in self.journal if event.kind in kinds)

    @property
    def fits(self) -> tuple[Event, ...]:
        """What was fitted while the run went on."""
        return self.events("fit")

    @property
    def end(self) -> Event | None:
        """How the run ended; None while it goes on or when it was cut off."""
        last = next((event for event in reversed(self.journal) if event.kind not in ("note", "fit")), None)
        return last if last is not None and last.kind == "end" else None

    @property
    def tank(self) -> Delivered | None:
        """What the tank held when the run last knew; None when it never did."""
        known = [then for event, then in with_conditions(self.journal) if event.kind in ("session", "dose_done")]
        return known[-1].tank if known else None

    @cached_property
    def conditions(self) -> dict[int, Conditions]:
        """What was true of each acknowledged frame when it was exposed, by its number."""
        return {event["index"]: then for event, then in with_conditions(self.journal) if event.kind == "frame"}

    @cached_property
    def patterns(self) -> dict[str, Pattern]:
        """The pictures that were to be projected, by hash; of an imported run one pixel each, lit or dark."""
        from tankrig.run.folder import array_for_reading

        if "scenes" in self.settings:
            return {key: Pattern(one["name"], _LIT if one["scene"] else _DARK) for key, one in self._told_scenes}
        if not (self.path / "patterns").is_dir():
            return {}
        array = array_for_reading(self.path, "patterns")
        try:
            if array.ndim != 3 or array.dtype != np.uint8:
                raise ValueError(f"{array.ndim} axes of {array.dtype}")
            names, hashes = array.attrs["names"], array.attrs["hashes"]
            return {
                str(key): Pattern(str(name), array[i]) for i, (name, key) in enumerate(zip(names, hashes, strict=True))
            }
        except Exception as error:  # Zarr and its codecs raise what their metadata and their bytes lead them to
            raise StoreError(
                f"{self.path}: its patterns are damaged and cannot be read ({type(error).__name__}); restore the "
                f"folder patterns from a copy of the run"
            ) from error

    @cached_property
    def scenes(self) -> dict[str, Scene]:
        """What was lit in an imported run, by the names of the patterns; of other runs nothing, for they have a bench.

        Raises
        ------
        StoreError
            When they are not what they should be.
        """
        lit = [one for _, one in self._told_scenes if one["scene"]]
        return {one["name"]: checked(Scene, one["scene"], f"{self.path}: its scene", StoreError) for one in lit}

    @property
    def _told_scenes(self) -> list[tuple[str, Mapping[str, Any]]]:
        return list(dict(self.settings.get("scenes", {})).items())

    def require_sequence(self) -> Mapping[str, Any]:
        """The sequence that the run followed.

        Raises
        ------
        StoreError
            When it followed none: it was imported.
        """
        if "sequence" not in self.settings:
            raise StoreError(f"{self.path}: was imported and has no sequence; this needs a run of a rig")
        found: Mapping[str, Any] = self.settings["sequence"]
        return found

    @cached_property
    def frames(self) -> "xarray.DataArray":
        """The acknowledged frames.

        (frame, y, x) uint8 or uint16 counts, read from disk as they are used: `frames[3]` reads one, and
        `frames.chunk(frame=1)`, where dask is installed, computes with more than memory holds. With the coordinates
        `step`, `pattern` (name), `pattern_hash`, `exposure_start_ns`, `utc`; `delivered_ul`, the ink that the tank held
        when the frame was exposed, with its bounds `delivered_low_ul` and `delivered_high_ul`; and `exposure_ms` and
        `gain`, as they were read back from the camera (NaN where a run does not say). Reading the pixels of a frame
        that is missing or damaged raises `StoreError` with its number.
        """
        import xarray

        from tankrig.run.stack import lazy_stack

        rows = [(event, then) for event, then in with_conditions(self.journal) if event.kind == "frame"]
        events, stored = [event for event, _ in rows], self._stored
        shape = (len(events), *stored.array.shape[1:])
        pictures = lazy_stack(lambda place: stored.read(events[place]), shape, stored.array.dtype)
        array = xarray.DataArray(pictures, name="frames")
        names = {key: pattern.name for key, pattern in self.patterns.items()}
        columns: dict[str, Any] = {
            "step": np.array([event["step"] for event, _ in rows], int),
            "pattern": np.array([names.get(event["pattern_hash"], "") for event, _ in rows], object),
            "pattern_hash": np.array([event["pattern_hash"] for event, _ in rows], object),
            "exposure_start_ns": np.array([event["exposure_start_ns"] for event, _ in rows], np.int64),
            "utc": np.array([event.moment.utc.split("+")[0] for event, _ in rows], "datetime64[us]").astype(
                "datetime64[ns]"
            ),
            "delivered_ul": np.array([then.tank.volume_ul for _, then in rows], float),
            "delivered_low_ul": np.array([then.tank.low_ul for _, then in rows], float),
            "delivered_high_ul": np.array([then.tank.high_ul for _, then in rows], float),
            "exposure_ms": np.array([then.camera.exposure_ms if then.camera else np.nan for _, then in rows], float),
            "gain": np.array([then.camera.gain if then.camera else np.nan for _, then in rows], float),
        }
        unsure = np.array([event["index"] in self.unsure_doses for event, _ in rows], bool)
        for name in ("delivered_ul", "delivered_low_ul", "delivered_high_ul"):
            columns[name] = np.where(unsure, np.nan, columns[name])
        labelled: xarray.DataArray = array.assign_coords({name: ("frame", values) for name, values in columns.items()})
        return labelled

    @cached_property
    def unsure_doses(self) -> frozenset[int]:
        """Numbers of the frames of which nobody knows what the tank held.

        A line before them may have been about a dose and is lost, and their own lines, being from before frames told
        it themselves, do not say. Their `delivered_ul` is NaN, and they are not fitted.
        """
        lost = [one.after_seq for one in self.lost if one.may_be_dose]
        unsure, found = False, set[int]()
        for before, event in zip((-1, *(event.seq for event in self.journal)), self.journal, strict=False):
            unsure |= any(before <= seq < event.seq for seq in lost)
            if event.kind in ("session", "dose_done") and "delivered_ul" in event.fields:
                unsure = False
            elif event.kind == "frame" and unsure and "delivered_ul" not in event.fields:
                found.add(event["index"])
        return frozenset(found)

    def pixels(self, frame: Event) -> Pixels:
        """The pixels of a frame of the journal, checked.

        Raises
        ------
        StoreError
            When they are missing or not what was recorded.
        """
        return self._stored.read(frame)

    def plot(self) -> "Figure":
        """The last frame of each pattern at each dose, as many as fit, in false colour; a figure of matplotlib."""
        from tankrig.notebook import MOST_SHOWN, pictures

        names = {key: pattern.name for key, pattern in self.patterns.items()}
        newest = {}
        for event in self.events("frame"):
            tank_ul = self.conditions[event["index"]].tank.volume_ul
            newest[f"{names.get(event['pattern_hash'], '?')}, {tank_ul:g} µl"] = event
        shown = {title: self.pixels(event) for title, event in list(newest.items())[-MOST_SHOWN:]}
        return pictures(shown, unit="counts")

    def _repr_html_(self) -> str:
        """For notebooks: what was recorded, what was fitted last, and the figure."""
        from tankrig.notebook import page

        frames, end = self.events("frame"), self.end
        said = [
            ("folder", str(self.path)),
            ("sequence", str(self.settings.get("name", ""))),
            ("frames", f"{len(frames)}" + (f", and {len(self.left_out)} left out" if self.left_out else "")),
            ("ink in the tank", f"{self.tank.volume_ul:g} µl" if self.tank else "not known"),
            ("end", "it goes on, or was cut off" if end is None else str(end["reason"])),
        ]
        said += [("lost", str(one)) for one in self.lost]
        last = {fit["dose_ml"]: fit for fit in self.fits if fit.get("dose_ml") is not None and "sigma_s" in fit.fields}
        for dose_ml, fit in sorted(last.items()):
            values = ", ".join(f"{name} {fit[name]:.4g}" for name in ("sigma_a", "sigma_s", "g"))
            said.append((f"fitted at {dose_ml:g} ml", values))
        return page("run", said, self.plot() if frames else None)

    @cached_property
    def _stored(self) -> "StoredFrames":
        return StoredFrames(self.path)


@dataclass(frozen=True)
class StoredFrames:
    """The frames of a run as they lie on disk; each is checked as it is read.

    Chunks with a checksum are checked by that; older ones by the SHA-256 of their pixels in the journal.
    """

    path: Path

    @cached_property
    def array(self) -> Any:
        """As Zarr sees it."""
        from tankrig.run.folder import frames_for_reading, storing

        with storing(self.path, "read how its frames are stored"):
            return frames_for_reading(self.path)

    @cached_property
    def _checked(self) -> bool:
        from tankrig.run.folder import has_checksums

        return has_checksums(self.array)

    def read(self, frame: Event, thoroughly: bool = False) -> Pixels:
        """The pixels of a frame of the journal.

        Parameters
        ----------
        frame
            Its event.
        thoroughly
            Compare the SHA-256 too where there is a checksum.

        Raises
        ------
        StoreError
            When they are missing or not what was recorded.
        """
        index = frame["index"]
        remedy = f"restore it from a copy of the run, or leave it out: tankrig recover {self.path} --leave-out"
        if not (self.path / "frames" / f"c.{index}.0.0").is_file():
            raise StoreError(f"{self.path}: frame {index} is missing; {remedy}")
        try:
            pixels: Pixels = self.array[index]
        except StoreError:
            raise
        except Exception as error:  # codecs raise what damaged bytes lead them to, SystemError among it
            raise StoreError(f"{self.path}: frame {index} is damaged and cannot be read ({error}); {remedy}") from error
        if (thoroughly or not self._checked) and digest(pixels) != frame["sha256"]:
            raise StoreError(f"{self.path}: frame {index} is damaged: it is not what was recorded; {remedy}")
        return pixels


def digest(pixels: Pixels) -> str:
    """SHA-256 of the raw pixels, row by row, little-endian."""
    return hashlib.sha256(np.ascontiguousarray(pixels).data).hexdigest()


def open_run(path: str | os.PathLike[str]) -> Run:
    """Open a run that was recorded, is being recorded, or was cut off.

    Parameters
    ----------
    path
        The run's folder.

    Returns
    -------
    Run
        With `frames`, `journal`, `settings` and `fits`.

    Raises
    ------
    StoreError
        When the folder is not a run, cannot be read, or comes from a newer tankrig.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from tankrig.run.folder import create_run
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     create_run(Path(folder, "run"), (4, 6), "uint16", 3, {"name": "nothing yet"})
    ...     run = open_run(Path(folder, "run"))
    ...     run.settings["name"], run.frames.shape
    ('nothing yet', (0, 4, 6))
    """
    folder = Path(path)
    settings, text = read_settings(folder), read_journal(folder)
    notes = (event for event in text.events if event.kind == "note" and event.get("text") == LEFT_OUT)
    left_out = {int(index) for note in notes for index in note["frames"]}
    journal = tuple(event for event in text.events if event.kind != "frame" or event["index"] not in left_out)
    return Run(folder, settings, journal, text.lost, text.unverified, tuple(sorted(left_out)))
