"""Reading a run: what was acknowledged, and nothing else."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tankrig.devices import Delivered, Pixels
from tankrig.errors import StoreError
from tankrig.pattern import Pattern
from tankrig.run.conditions import Conditions, with_conditions
from tankrig.run.facts import read_journal, read_settings
from tankrig.run.journal import Event

if TYPE_CHECKING:
    import xarray


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
        Its events, in order.
    """

    path: Path
    settings: Mapping[str, Any] = field(repr=False)
    journal: tuple[Event, ...] = field(repr=False)

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
        return self.journal[-1] if self.journal and self.journal[-1].kind == "end" else None

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
        """The pictures that were to be projected, by hash."""
        import zarr

        if not (self.path / "patterns").is_dir():
            return {}
        array = zarr.open_array(self.path / "patterns", mode="r")
        names, hashes = array.attrs["names"], array.attrs["hashes"]
        return {key: Pattern(name, array[i]) for i, (name, key) in enumerate(zip(names, hashes, strict=True))}

    @cached_property
    def frames(self) -> "xarray.DataArray":
        """The acknowledged frames.

        (frame, y, x) uint8 or uint16 counts, read from disk as they are used; with the coordinates `step`, `pattern`
        (name), `pattern_hash`, `exposure_start_ns`, `utc`; `delivered_ul`, the ink that the tank held when the frame
        was exposed, with its bounds `delivered_low_ul` and `delivered_high_ul`; and `exposure_ms` and `gain`, as they
        were read back from the camera (NaN where a run does not say).
        """
        import xarray

        array = xarray.open_zarr(self.path, drop_variables="patterns")["frames"]
        rows = [(event, then) for event, then in with_conditions(self.journal) if event.kind == "frame"]
        array = array.isel(frame=[event["index"] for event, _ in rows])
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
        labelled: xarray.DataArray = array.assign_coords({name: ("frame", values) for name, values in columns.items()})
        return labelled


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
    settings = read_settings(folder)
    journal, _, _ = read_journal(folder)
    return Run(folder, settings, tuple(journal))


def raw_frame(path: Path, index: int) -> Pixels:
    """The pixels of frame `index` as they lie on disk.

    Raises
    ------
    StoreError
        When they cannot be read.
    """
    import zarr

    try:
        array = zarr.open_array(path / "frames", mode="r")
        if not (path / "frames" / f"c.{index}.0.0").is_file():
            raise StoreError(f"{path}: frame {index} is missing; restore it from a copy of the run")
        pixels: Pixels = array[index]
    except (OSError, RuntimeError, ValueError) as error:
        raise StoreError(
            f"{path}: frame {index} cannot be read ({error}); restore it from a copy of the run"
        ) from error
    return pixels
