"""An archive of runs from the twin: many media and many draws of the noise, for trying what works on archives.

`python -m drivers.simulated.archive FOLDER` makes 5,000 runs of small pictures: 20 media around one, which one prepared
model holds, each with 250 draws of the camera's noise. Their light is the Monte Carlo's, as the simulated camera's is.
Days and rigs are made up, so that there is something to list and to draw: runs of two rigs over a year.
"""

import json
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray

from tankrig.bench import Bench
from tankrig.devices import CameraSettings, Pixels
from tankrig.errors import StoreError
from tankrig.image.predict import predict
from tankrig.pattern import Pattern
from tankrig.pattern.wall import Wall
from tankrig.run.folder import create_run, require_new, write_frame
from tankrig.run.journal import Event, Moment
from tankrig.run.journal_io import JOURNAL, MARK
from tankrig.run.reading import digest
from tankrig.scene.description import Camera, Medium, Tank
from tankrig.sequence.loading import sequence_from_table, sequence_table

from .sensor import counts
from .settings import Sensor

BENCH = Bench(Tank(), Wall((60, 80), (-80.0, 80.0), (0.0, 120.0)), "collimated", Camera("orthographic", (40, 60), 4.0))
INK = Medium(2e-4, 0.0098, 0.7)
"""What the sequence says to expect of 1 ml in the tank; all media are near it."""
NEAR = {"sigma_t": (0.9, 1.1), "albedo": (0.955, 0.995), "g": (0.66, 0.74)}
"""Of the media: factors of the extinction expected, and ranges of albedo and g."""
DOSE_UL, FRAMES, PATTERN = 1000.0, 4, "rays"
EXPOSURE_MS = 25.0
RIGS = "bench A", "bench B"
FIRST_DAY, DAYS = datetime(2025, 11, 1, 9, 0, tzinfo=UTC), 365
SEQUENCE = {
    "name": "twin",
    "exposure_ms": EXPOSURE_MS,
    "ink": asdict(INK),
    "patterns": {PATTERN: {"kind": "rays", "y_mm": [-40.0, 0.0, 40.0], "width_mm": 8.0, "z_mm": [56.0, 64.0]}},
    "steps": [
        {"do": "dose", "total_ul": DOSE_UL},
        {"do": "capture", "pattern": "dark"},
        {"do": "capture", "pattern": PATTERN, "frames": FRAMES},
    ],
}


@dataclass(frozen=True)
class Twin:
    """One run that is made up.

    Parameters
    ----------
    medium, seed
        Number of its medium, and of its draw of the noise.
    truth
        The liquid with 1 ml in the tank.
    """

    medium: int
    seed: int
    truth: Medium

    @property
    def name(self) -> str:
        """Of its folder: the medium's number, then the seed's."""
        return f"twin-{self.medium:02d}-{self.seed:03d}"

    @property
    def rig(self) -> str:
        """Whose it is said to be."""
        return RIGS[self.seed % len(RIGS)]


def media(count: int, seed: int = 22) -> list[Medium]:
    """So many liquids near `INK`, the same for the same seed."""
    random = np.random.default_rng(seed)
    found = []
    for _ in range(count):
        factor, albedo, g = (float(random.uniform(*NEAR[name])) for name in ("sigma_t", "albedo", "g"))
        sigma_t = factor * INK.sigma_t
        found.append(Medium((1.0 - albedo) * sigma_t, albedo * sigma_t, g))
    return found


def make_archive(
    folder: Path,
    media_count: int = 20,
    seeds: int = 250,
    tolerance: float = 0.003,
    progress: Callable[[int, int], object] = lambda *_: None,
) -> list[Twin]:
    """Make an archive of runs from the twin; runs that are there already are kept, so that a second call goes on.

    Parameters
    ----------
    folder
        Of the archive.
    media_count, seeds
        Of which, and draws of the noise for each: so many runs in all as their product.
    tolerance
        Of the Monte Carlo's images, relative L2.
    progress
        Told how many runs there are, and how many there will be.

    Returns
    -------
    list
        What each run is of.

    Raises
    ------
    StoreError
        When a run cannot be made.
    """
    made = []
    for number, truth in enumerate(media(media_count)):
        light: NDArray[np.float64] | None = None
        for seed in range(seeds):
            twin = Twin(number, seed, truth)
            if not (folder / twin.name).exists():
                light = _light(truth, tolerance, number) if light is None else light
                _record(folder / twin.name, twin, light)
            made.append(twin)
            progress(len(made), media_count * seeds)
    return made


def _light(truth: Medium, tolerance: float, seed: int) -> NDArray[np.float64]:
    """(rows, columns) W/mm²/sr, by the Monte Carlo."""
    image = predict(BENCH.scene(_patterns()[PATTERN], truth), "montecarlo", tolerance, seed=seed).image
    return np.maximum(image, 0.0)


def _patterns() -> dict[str, Pattern]:
    return dict(sequence_from_table(SEQUENCE, "twin").drawn(BENCH.wall))


def _record(path: Path, twin: Twin, light: NDArray[np.float64]) -> None:
    """A run as a rig would have left it: it appears complete, or not at all."""
    require_new(path)
    fresh, sensor, camera = path.with_name(f".{path.name}.made"), Sensor(), CameraSettings(EXPOSURE_MS)
    random = np.random.default_rng((twin.medium, twin.seed))
    dark = np.zeros_like(light)
    frames = [counts(one, sensor, camera, random) for one in (dark, *[light] * FRAMES)]
    _lay_out(fresh, path.parent / ".empty-twin", twin, len(frames))
    for index, pixels in enumerate(frames):
        write_frame(fresh, True, index, pixels)
    (fresh / JOURNAL).write_bytes(b"".join(event.line() for event in _events(twin, frames)))
    fresh.rename(path)


def _lay_out(fresh: Path, empty: Path, twin: Twin, count: int) -> None:
    """The folder of a run without frames: all twins have the same one but for what their settings say of them."""
    if not empty.exists():
        settings = {"name": "twin", "saturation": Sensor().saturation, "bench": asdict(BENCH),
                    "sequence": sequence_table(sequence_from_table(SEQUENCE, "twin")), "calibrations": {}}  # fmt: skip
        create_run(empty, BENCH.camera.shape, "uint16", count, settings, list(_patterns().values()))
    shutil.rmtree(fresh, ignore_errors=True)
    shutil.copytree(empty, fresh)
    group = json.loads((fresh / "zarr.json").read_text(encoding="utf-8"))
    group["attributes"][MARK]["settings"] |= {
        "id": twin.name, "rig": twin.rig, "material": f"ink {twin.medium:02d}", "truth": asdict(twin.truth),
    }  # fmt: skip
    (fresh / "zarr.json").write_text(json.dumps(group), encoding="utf-8")


def _events(twin: Twin, frames: Sequence[Pixels]) -> Iterator[Event]:
    began = FIRST_DAY + timedelta(days=DAYS * (twin.seed + 0.5 * (twin.medium % 2)) / 250.0, minutes=20 * twin.medium)
    hashes = {name: pattern.hash for name, pattern in _patterns().items()}
    seq = 0

    def event(kind: str, **fields: Any) -> Event:
        nonlocal seq
        utc = (began + timedelta(seconds=seq)).isoformat(timespec="microseconds")
        seq += 1
        return Event(seq - 1, kind, Moment(utc, 10**9 * seq, "twin"), fields)

    empty, full = ({f"delivered{bound}_ul": held_ul for bound in ("", "_low", "_high")} for held_ul in (0.0, DOSE_UL))
    devices = {"projector": "twin", "camera": "twin", "doser": "twin"}
    yield event("session", program="tankrig twin", devices=devices, **empty)
    yield event("dose_intent", step=0, total_ul=DOSE_UL)
    yield event("dose_done", step=0, complete=True, total_ul=DOSE_UL, **full)
    for index, pixels in enumerate(frames):
        dark = index == 0
        yield event(
            "frame", index=index, step=1 if dark else 2, pattern_hash=hashes["dark" if dark else PATTERN],
            exposure_start_ns=10**9 * seq, device_ns=10**9 * seq, host_ns=10**9 * seq, sequence=index, **full,
            exposure_ms=EXPOSURE_MS, gain=1.0, sha256=digest(pixels),
        )  # fmt: skip
    yield event("end", reason="completed", message="")


@click.command(epilog="Example: python -m drivers.simulated.archive twins --media 4 --seeds 25")
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--media", "media_count", type=click.IntRange(min=1), default=20, show_default=True, help="How many.")
@click.option("--seeds", type=click.IntRange(min=1), default=250, show_default=True, help="Draws of noise for each.")
@click.option("--tolerance", type=click.FloatRange(0.001, 0.5), default=0.003, show_default=True, help="Of the light.")
def main(folder: Path, media_count: int, seeds: int, tolerance: float) -> None:
    """Make an archive of runs from the twin in FOLDER; what is there already is kept."""
    from rich.progress import Progress

    with Progress(transient=True) as shown:
        task = shown.add_task("making runs")
        try:
            twins = make_archive(
                folder, media_count, seeds, tolerance,
                lambda done, total: shown.update(task, completed=done, total=total),
            )  # fmt: skip
        except StoreError as error:
            raise click.ClickException(str(error)) from error
    click.echo(f"{len(twins)} runs in {folder}")


if __name__ == "__main__":
    main()
