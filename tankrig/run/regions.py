"""Rectangles of a run's frames, and what is counted in them over time, kept beside the run as `regions.csv`.

The file has a line for each region and frame, so that a spreadsheet reads it as it is, and so that the regions
themselves can be read back from it.
"""

import csv
import io
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from tankrig.devices import Pixels
from tankrig.errors import StoreError
from tankrig.files import whole_file

if TYPE_CHECKING:
    from tankrig.run.reading import Run

REGIONS = "regions.csv"
_PLACE = ("first_row", "row_after_last", "first_column", "column_after_last")
COLUMNS = (
    "region", *_PLACE, "frame", "time_s", "pattern", "ink_ul", "exposure_ms", "gain", "mean_counts", "sd_counts",
    "smallest_counts", "largest_counts",
)  # fmt: skip
MOST_BYTES = 200_000_000
"""A larger file was not written by tankrig."""


@dataclass(frozen=True)
class Region:
    """A rectangle of pixels with a name.

    Parameters
    ----------
    name
        What it is called.
    rows, columns
        The first, and the one after the last.

    Examples
    --------
    >>> Region("wall", (0, 4), (2, 3)).size
    (4, 1)
    """

    name: str
    rows: tuple[int, int]
    columns: tuple[int, int]

    @property
    def size(self) -> tuple[int, int]:
        """(rows, columns)."""
        return self.rows[1] - self.rows[0], self.columns[1] - self.columns[0]

    def of(self, pixels: Pixels) -> Pixels:
        """Its part of a frame; empty where it lies beside the frame."""
        return pixels[slice(*self.rows), slice(*self.columns)]


@dataclass(frozen=True)
class Counted:
    """What was counted in one region of one frame.

    Parameters
    ----------
    region
        Which.
    frame
        Index of the frame.
    time_s
        From the run's first line to the frame.
    pattern
        Name of what the projector showed.
    ink_ul
        In the tank, as far as that is known.
    exposure_ms, gain
        Of the camera; NaN where the run does not say.
    mean, sd, smallest, largest
        Of the counts.
    """

    region: Region
    frame: int
    time_s: float
    pattern: str
    ink_ul: float
    exposure_ms: float
    gain: float
    mean: float
    sd: float
    smallest: int
    largest: int


def count_regions(
    run: "Run", regions: Sequence[Region], progress: Callable[[float], object] | None = None
) -> tuple[Counted, ...]:
    """Mean, standard deviation, smallest and largest count of each region in each frame of a run.

    Parameters
    ----------
    run
        Whose frames.
    regions
        Parts beyond the frame are left out; a region that lies beside it altogether is refused.
    progress
        Called with the share that is done, 0 … 1.

    Raises
    ------
    StoreError
        When a region holds no pixel, or a frame cannot be read.
    """
    frames, patterns = run.events("frame"), run.patterns
    begin = datetime.fromisoformat(run.journal[0].moment.utc) if run.journal else None
    found: list[Counted] = []
    for number, event in enumerate(frames):
        pixels, then = run.pixels(event), run.conditions[event["index"]]
        assert begin is not None
        time_s = (datetime.fromisoformat(event.moment.utc) - begin).total_seconds()
        known = patterns.get(event["pattern_hash"])
        for region in regions:
            part = region.of(pixels)
            if not part.size:
                raise StoreError(
                    f"{run.path}: the region {region.name} holds no pixel of its frames, which have "
                    f"{pixels.shape[0]} rows and {pixels.shape[1]} columns; move it onto the picture"
                )
            camera = then.camera
            found.append(Counted(
                region, int(event["index"]), time_s, known.name if known is not None else "", then.tank.volume_ul,
                camera.exposure_ms if camera else math.nan, camera.gain if camera else math.nan,
                float(part.mean()), float(part.std()), int(part.min()), int(part.max()),
            ))  # fmt: skip
        if progress is not None:
            progress((number + 1) / len(frames))
    return tuple(found)


def write_regions(run: Path, counted: Sequence[Counted]) -> Path:
    """Keep what was counted beside a run, in the place of what was kept before.

    Returns
    -------
    Path
        Of the file.

    Raises
    ------
    StoreError
        When it cannot be written; what was there is then as it was.
    """
    file, text = run / REGIONS, io.StringIO()
    lines = csv.writer(text, lineterminator="\n")
    lines.writerow(COLUMNS)
    for one in counted:
        lines.writerow((
            one.region.name, *one.region.rows, *one.region.columns, one.frame, f"{one.time_s:.6f}", one.pattern,
            f"{one.ink_ul:.6g}", f"{one.exposure_ms:.9g}", f"{one.gain:.9g}", f"{one.mean:.6f}", f"{one.sd:.6f}",
            one.smallest, one.largest,
        ))  # fmt: skip
    try:
        with whole_file(file) as unfinished:
            unfinished.write_text(text.getvalue(), encoding="utf-8")
    except OSError as error:
        raise StoreError(f"{file}: cannot be written ({error.strerror or error}); free the disk, then save") from error
    return file


def read_regions(run: Path) -> tuple[Counted, ...]:
    """What is kept beside a run; nothing where nobody has saved any.

    Raises
    ------
    StoreError
        When there is a file that cannot be read.
    """
    file = run / REGIONS
    if not file.is_file():
        return ()
    try:
        if file.stat().st_size > MOST_BYTES:
            raise ValueError(f"it has more than {MOST_BYTES} bytes")
        with file.open(encoding="utf-8", newline="") as text:
            return tuple(_counted(csv.DictReader(text)))
    except (OSError, ValueError, TypeError, KeyError, csv.Error) as error:
        raise StoreError(f"{file}: cannot be read ({error}); move it away, and save the regions again") from error


def _counted(lines: "csv.DictReader[str]") -> Iterator[Counted]:
    for line in lines:
        first, after, left, right = (int(line[key]) for key in _PLACE)
        yield Counted(
            Region(line["region"], (first, after), (left, right)), int(line["frame"]), float(line["time_s"]),
            line["pattern"], float(line["ink_ul"]), float(line["exposure_ms"]), float(line["gain"]),
            float(line["mean_counts"]), float(line["sd_counts"]), int(line["smallest_counts"]),
            int(line["largest_counts"]),
        )  # fmt: skip
