"""The whole way on a simulated bench, from lens cap to report, by the commands that a person would type."""

import json
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, redirect_stdout
from dataclasses import asdict, dataclass
from pathlib import Path
from shlex import join
from typing import TYPE_CHECKING, Any

import click

from ui.calibration_way import CALIBRATIONS

if TYPE_CHECKING:
    from drivers.rig import RigFile

RIG, SEQUENCE, RUN = "rig.toml", "bench_dilution.toml", "run"
"""What the folder of a bench holds, besides what the commands put there."""
GLASS = ("entry", "far", "left", "right")
"""Walls of a tank of glass."""
GLASS_MIXED_S = 1800.0
"""Waited at most until ink has mixed in a tank of glass, whose pictures take the simulated bench a minute each: with
300 s a busy computer has seen two of them."""
TIME_SCALE = 0.02
"""Of all waiting for projector and camera; light is gathered as in the whole exposure."""
MIXING_S, STEPS_PER_S = 0.3, 200.0
"""A stirrer in a hurry; ink comes at 20 µl/s as on a bench, since models are prepared while it does."""
OIL_IN_WATER = {"particle_index": 1.465, "water_index": 1.333, "wavelength_nm": 532.0}
"""What the droplets of an emulsion are, and the green light that they are seen in."""
_SET_ASIDE = 3
"""Exit status of a calibration with doubts."""
_TOO_BUSY = (
    "this computer is too busy to time the light of a bench that is in such a hurry; the latency of the rig file is "
    "believed, as it would be at a bench where nobody has measured it"
)


@dataclass(frozen=True)
class Part:
    """A command that was carried out, and what it took."""

    command: str
    wall_s: float
    cpu_s: float
    status: int


def make(
    folder: Path, seed: int, doses: int, wide_lens: bool = False, walls: bool = False, emulsion: bool = False
) -> None:
    """Make the folder of a bench that is drawn from a seed: its rig file, and a sequence for it.

    With `wide_lens` its projector is sharp at one depth only, as real ones are. With `walls` its tank is of glass, as
    the rig file says, its floor reflects and its projector has a halo, which nobody is told. With `emulsion` its ink's
    phase function is none of Henyey–Greenstein's, which nobody is told either.

    Raises
    ------
    click.BadParameter
        When there is something at that place already.
    """
    import tomlkit

    from drivers.rig import SIMULATED

    if folder.exists():
        raise click.BadParameter(f"{folder} exists and holds no bench; give another folder", param_hint="--out")
    shipped = SIMULATED.with_name("bench.toml").read_text(encoding="utf-8")
    rig: Any = tomlkit.parse(shipped)
    rig["name"] = f"simulated bench {seed}"
    for device in ("projector", "camera"):
        rig[device]["time_scale"] = TIME_SCALE
    rig["camera"]["boards"]["seed"] = seed
    truth = {"mixing_s": MIXING_S, "ink": _ink(seed, emulsion), **_optics(seed, wide_lens, walls)}
    rig["camera"].setdefault("truth", tomlkit.table()).update(truth)
    rig["doser"]["rate"] = STEPS_PER_S
    rig.setdefault("exposure", tomlkit.table()).setdefault("period_ms", 0.0)
    if walls:
        rig["bench"]["tank"]["faces"] = {wall: {"kind": "glass"} for wall in GLASS}
    sequence: Any = tomlkit.parse(SIMULATED.with_name(SEQUENCE).read_text(encoding="utf-8"))
    series = next(step for step in sequence["steps"] if step["do"] == "series")
    series["total_ul"] = series["total_ul"][:doses]
    if walls:
        next(step for step in series["steps"] if step["do"] == "mix")["timeout_s"] = GLASS_MIXED_S
    folder.mkdir(parents=True)
    (folder / SEQUENCE).write_text(tomlkit.dumps(sequence), encoding="utf-8")
    (folder / RIG).write_text(tomlkit.dumps(rig), encoding="utf-8")


def _ink(seed: int, emulsion: bool) -> dict[str, Any]:
    """An ink, per mm and ml, which the sequence makes thin, medium and thick: of Henyey–Greenstein's phase function, or
    droplets of oil of many sizes, as Intralipid has."""
    import numpy as np

    random = np.random.default_rng((seed, 16))
    drawn = {
        "sigma_a": random.uniform(2e-4, 8e-4),
        "sigma_s": random.uniform(0.018, 0.022),
        "g": random.uniform(0.5, 0.85),
    }
    ink: dict[str, Any] = {name: round(value, 6) for name, value in drawn.items()}
    if emulsion:
        del ink["g"]
        droplets = {"diameter_um": random.uniform(0.16, 0.28), "spread": random.uniform(0.3, 0.4)}
        ink["phase"] = {"kind": "mie", **{name: round(value, 6) for name, value in droplets.items()}, **OIL_IN_WATER}
    return ink


def _optics(seed: int, wide_lens: bool, walls: bool) -> dict[str, Any]:
    """What lenses do besides being ideal, as on a usual bench, and by how much a dark picture is none."""
    import numpy as np

    random = np.random.default_rng((seed, 19))
    stray = {
        "camera_blur_corner": random.uniform(1.0, 1.5),
        "camera_halo": random.uniform(0.005, 0.025),
        "camera_halo_mm": random.uniform(20.0, 40.0),
        "veil": random.uniform(0.0, 0.02),
    }
    leak = round(random.uniform(5e-4, 2e-3), 6)
    if wide_lens:
        stray |= {"projector_lens_mm": random.uniform(8.0, 20.0), "projector_focus_mm": random.uniform(60.0, 180.0)}
    if walls:
        random = np.random.default_rng((seed, 20))
        stray |= {
            "projector_halo": random.uniform(0.003, 0.02),
            "projector_halo_mm": random.uniform(15.0, 30.0),
            "floor": random.uniform(0.0, 0.05),
        }
    glass = {"glass": list(GLASS)} if walls else {}
    return {"leak": leak, "stray": {name: round(value, 6) for name, value in stray.items()} | glass}


def is_there(folder: Path) -> bool:
    """Whether `make` has made a bench there."""
    return (folder / RIG).is_file() and (folder / SEQUENCE).is_file()


def way_of(folder: Path) -> Iterator[list[str]]:
    """All commands from a new bench to its report, word by word."""
    rig, sequence, run = (str(folder / name) for name in (RIG, SEQUENCE, RUN))
    for kind in CALIBRATIONS:
        yield ["calibrate", kind, "--rig", rig]
    yield ["doctor", rig, "--sequence", sequence]
    yield ["prepare", "--sequence", sequence, "--rig", rig]
    yield ["run", sequence, "--rig", rig, "--dry-run"]
    yield ["run", sequence, "--rig", rig, "--out", run]


def left_of(folder: Path) -> Iterator[list[str]]:
    """The commands that are still to be carried out, each asked for once those before it are done."""
    from drivers.rig import load_rig_file
    from tankrig.calibration.file import usable
    from tankrig.live.refit import unfitted
    from tankrig.run.journal_io import JOURNAL
    from tankrig.run.reading import open_run

    description = load_rig_file(folder / RIG)
    calibrations, run = Path(description.calibration_folder), folder / RUN
    for words in way_of(folder):
        measured = words[0] == "calibrate" and words[1] in usable(calibrations)
        if not (measured or run.exists()):
            yield words
    end = open_run(run).end
    if end is None or end["reason"] != "completed":
        yield ["run", "--resume", str(run), "--rig", str(folder / RIG)]
    if unfitted(open_run(run)):
        yield ["refit", str(run), "--rig", str(folder / RIG)]
    report = run / "report.html"
    if not report.exists() or report.stat().st_mtime < (run / JOURNAL).stat().st_mtime:  # later fits are not in it
        yield ["report", str(run)]


def walk(folder: Path, as_json: bool) -> int:
    """Carry out what is left of the way, and show what was found beside the truth.

    Parameters
    ----------
    folder
        Of the bench.
    as_json
        One line of JSON at the end; what the commands say then goes to stderr.

    Returns
    -------
    int
        Exit status: of the command that failed, else 0.
    """
    parts: list[Part] = []
    status = 0
    try:
        for words in left_of(folder):
            status = _tried(words, parts, as_json)
            if status:
                break
    except KeyboardInterrupt:
        status = 1
    if status:
        where = f"stopped at: {parts[-1].command}; " if parts else "stopped; "
        click.echo(f"{where}to go on where it stopped: tankrig demo --bench --out {folder}", err=True)
        return status
    _tell(folder, parts, as_json)
    return 0


def _tried(words: list[str], parts: list[Part], as_json: bool) -> int:
    """Carry out a command and give its exit status, for which a latency that was set aside does not count."""
    parts.append(_carried_out(words, as_json))
    if words[:2] == ["calibrate", "latency"] and parts[-1].status == _SET_ASIDE:
        click.echo(_TOO_BUSY, err=True)
        return 0
    return parts[-1].status


def _carried_out(words: list[str], as_json: bool) -> Part:
    """A command, by the function that carries it out when it is typed."""
    from ui.cli import main

    command = f"tankrig {join(words)}"
    click.secho(f"\n$ {command}", bold=True, err=as_json)
    began_s, cpu_s = time.perf_counter(), _cpu_s()
    with redirect_stdout(sys.stderr) if as_json else nullcontext():
        status = main(words)
    return Part(command, time.perf_counter() - began_s, _cpu_s() - cpu_s, status)


def _cpu_s() -> float:
    """Of this process, and of those that it has started and waited for."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def _tell(folder: Path, parts: list[Part], as_json: bool) -> None:
    from drivers.rig import load_rig_file
    from ui.cli.fits import fits_of

    description = load_rig_file(folder / RIG)
    geometry = measured_beside_true(description)
    if as_json:
        found = {
            "folder": str(folder),
            "report": str(folder / RUN / "report.html"),
            "parts": [asdict(part) for part in parts],
            "geometry": geometry,
            **fits_of(folder / RUN, description),
        }
        click.echo(json.dumps(found, ensure_ascii=False))
        return
    from rich.console import Console
    from rich.table import Table

    table = Table("", "measured", "truth", "off by", box=None, pad_edge=False, header_style="bold")
    for row in geometry:
        off = (row["measured"] - row["truth"]) / row["sd"] if row["sd"] else float("nan")
        table.add_row(
            row["what"],
            f"{row['measured']:.6g} ± {row['sd']:.2g} {row['unit']}",
            f"{row['truth']:.6g}",
            f"{off:+.1f} sd",
        )
    took = Table("command", "wall", "CPU", box=None, pad_edge=False, header_style="bold")
    for part in parts:
        took.add_row(part.command, f"{part.wall_s:.0f} s", f"{part.cpu_s:.0f} s")
    took.add_row("in all", f"{sum(one.wall_s for one in parts):.0f} s", f"{sum(one.cpu_s for one in parts):.0f} s")
    console = Console(soft_wrap=True)
    with _spaced():
        console.print(table)
    with _spaced():
        console.print(took)
    click.echo(f"all of it is in {folder}; go on with it by hand: tankrig doctor {folder / RIG}")


@contextmanager
def _spaced() -> Iterator[None]:
    click.echo()
    yield
    click.echo()


def measured_beside_true(description: "RigFile") -> list[dict[str, Any]]:
    """What was calibrated, with its stated standard deviation, beside what is true of a simulated bench."""
    from drivers.rig import true_bench
    from tankrig.calibration.file import usable

    truth = true_bench(description)
    if truth is None:
        return []
    found = usable(Path(description.calibration_folder), description.calibration)
    astray = description.camera.get("truth", {}).get("stray", {})
    wanted: list[tuple[str, str, tuple[str | int, ...], float, str]] = [
        ("camera's focal length", "camera", ("fx",), truth.camera.matrix[0, 0], "px"),
        ("projector's focal length", "projector", ("fx",), truth.projector.matrix[0, 0], "px"),
        ("water level", "tank", ("level_mm",), truth.level_mm, "mm"),
        ("camera's halo", "stray", ("halo_share",), astray.get("camera_halo", 0.0), "of the light"),
        ("camera's veil", "stray", ("veil",), astray.get("veil", 0.0), "of the light"),
        ("projector's lens", "projector", ("lens_mm",), astray.get("projector_lens_mm", 0.0), "mm"),
        ("projector's focus, x", "projector", ("focus_mm",), astray.get("projector_focus_mm", 0.0), "mm"),
    ]
    for axis, name in enumerate("xyz"):
        camera_mm, projector_mm = truth.camera.centre_mm[axis], truth.projector.centre_mm[axis]
        wanted += [
            (f"camera's {name}", "tank", ("camera_position_mm", axis), camera_mm, "mm"),
            (f"projector's {name}", "projector", ("position_mm", axis), projector_mm, "mm"),
        ]
    return [
        {
            "what": what,
            "unit": unit,
            "measured": _at(found[kind].result, place),
            "sd": _at(found[kind].sd, place),
            "truth": float(true),
        }
        for what, kind, place, true, unit in sorted(wanted)
        if kind in found and (place != ("focus_mm",) or "focus_mm" in found[kind].result)
    ]


def _at(table: Any, place: tuple[str | int, ...]) -> float:
    """A number of a calibration file; 0 where it has none."""
    for part in place:
        if isinstance(part, str) and part not in table:
            return 0.0
        table = table[part]
    return float(table)
