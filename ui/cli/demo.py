"""`tankrig demo`: a whole dilution experiment on the simulated rig, fitted while it runs, with a report at its end."""

import json
import time
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from shlex import join
from typing import TYPE_CHECKING

import click

from tankrig.errors import SceneError
from ui.cli.options import FINITE, json_option, out_option

if TYPE_CHECKING:
    from drivers.rig import RigFile
    from tankrig.materials.dosing import DosePlan
    from tankrig.sequence import Sequence

DOSES_UL = (100.0, 200.0, 400.0, 800.0, 1600.0)
TRUTH = """
[camera.truth]                  # an ink that is thin at the first dose and five mean free paths long at the last
water = { sigma_a = 1.0e-4, sigma_s = 1.9e-6, g = 0.0 }
ink = { sigma_a = 4.0e-4, sigma_s = 0.012, g = 0.71 }
mixing_s = 0.7
"""
"""What is in the demo's tank, and a stirrer in a hurry: what its rig file says beyond the one that ships."""
DENSEST = 0.01
"""σs that a reference liquid is dosed to, 1/mm."""
THINNEST = 1e-4
"""σs that no photograph of the demo's tank would show, 1/mm."""
LIGHT_MM = (58.0, 62.0)
MATERIAL_DOSES = 3
"""The densest of those planned: each is fitted with its own phase function, by light paths."""
BENCH_DOSES = 3
"""Of the sequence that ships for the simulated bench."""


@click.command(epilog="Example: tankrig demo --bench --out bench")
@click.option("--doses", type=click.IntRange(2, len(DOSES_UL)),
              help=f"How many doses; default: {len(DOSES_UL)}, {BENCH_DOSES} with --bench or --material.")  # fmt: skip
@click.option("--bench", is_flag=True, help="On a bench that has to be calibrated first, from lens cap to report.")
@click.option("--seed", type=click.IntRange(0), help="That the bench is drawn from; default: 0.")
@click.option(
    "--wide-lens",
    is_flag=True,
    help="Give the bench's projector a lens that is sharp at one depth only; takes half as long again.",
)
@click.option(
    "--walls",
    is_flag=True,
    help="Give it a tank of glass whose floor reflects, and its projector a halo; takes far longer.",
)
@click.option(
    "--emulsion",
    is_flag=True,
    help="Give it an ink of oil droplets in water, whose phase function nobody says; takes far longer.",
)
@click.option("--by-hand", is_flag=True, help="Only make the bench's folder, and say what to type.")
@click.option("--material", metavar="NAME", help="Pump a reference liquid (tankrig materials), and validate the run.")
@click.option("--wavelength", "wavelength_nm", type=FINITE, default=633.0, show_default=True, metavar="NM",
              help="Of the light, for the reference liquid.")  # fmt: skip
@out_option(None, "Folder of the run, or of the bench; default: runs/ and the time.")
@json_option
def demo(
    doses: int | None, bench: bool, seed: int | None, wide_lens: bool, walls: bool, emulsion: bool, by_hand: bool,
    material: str | None, wavelength_nm: float, out: Path | None, as_json: bool,
) -> int:  # fmt: skip
    """Run a dilution series on the simulated rig, fit it while it runs, and write a report.

    At each dose the tank is photographed dark, under a sheet, stripes and three beams. Nothing here knows what the
    simulated ink is: its coefficients are found from the photographs, and shown beside the truth at the end.

    With --bench it walks the whole way on a simulated bench with hidden lenses, glass, water and light: calibrate
    radiometry, camera, tank, projector and latency, doctor, prepare, dry run, run, report. Each command is told before
    it is carried out; all is kept in one folder, and what was stopped goes on when the same folder is given again.

    With --material the pump holds a reference liquid in place of ink, and what is found of it is compared with what is
    published, as tankrig validate does.
    """
    if bench and material is not None:
        raise click.UsageError("--material is for the rig that needs no calibration; leave --bench out")
    if bench:
        return _bench(
            doses, seed, {"wide_lens": wide_lens, "walls": walls, "emulsion": emulsion}, by_hand, out, as_json
        )
    if seed is not None or by_hand or wide_lens or walls or emulsion:
        raise click.UsageError(
            "--seed, --wide-lens, --walls, --emulsion and --by-hand are for the bench; give --bench too"
        )
    liquid = None if material is None else liquid_planned(material, wavelength_nm)
    return _series(doses or (len(DOSES_UL) if liquid is None else MATERIAL_DOSES), liquid, out, as_json)


def _bench(
    doses: int | None, seed: int | None, kinds: dict[str, bool], by_hand: bool, out: Path | None, as_json: bool
) -> int:
    """Make a bench of the kinds that are asked for, see `make`, or go on with the one that is there, and walk it."""
    from ui.cli.demo_bench import is_there, make, walk, way_of

    folder = out or Path("runs") / datetime.now(UTC).strftime("bench-%Y-%m-%dT%H-%M-%S")
    if is_there(folder):
        if doses is not None or seed is not None or any(kinds.values()) or by_hand:
            raise click.UsageError(f"{folder} holds a bench already; give only --bench --out {folder} to go on with it")
    else:
        if doses is not None and doses > BENCH_DOSES:
            raise click.UsageError(f"the bench's sequence has {BENCH_DOSES} doses; give --doses 2 or {BENCH_DOSES}")
        make(folder, seed or 0, doses or BENCH_DOSES, **kinds)
    if not by_hand:
        click.echo("a simulated bench, in a hurry; nothing real moves", err=True)
        return walk(folder, as_json)
    commands = [f"tankrig {join(words)}" for words in way_of(folder)]
    if as_json:
        click.echo(json.dumps({"folder": str(folder), "commands": commands}))
    else:
        click.echo("\n".join([f"{folder} holds a rig file and a sequence; the way to a fitted run:", *commands]))
    return 0


def liquid_planned(name: str, wavelength_nm: float) -> "DosePlan":
    """Doses of a reference liquid that make the demo's tank about as dense as its ink does."""
    from drivers.rig import SIMULATED, load_rig_file
    from tankrig.materials.dosing import planned, tank_volume_ml
    from ui.cli.materials import optics_of

    description, optics = load_rig_file(SIMULATED), optics_of(name, wavelength_nm)
    tank_ml = tank_volume_ml(description.bench.tank)
    most_ml = 0.99e-3 * min(description.limits.run_ul, description.limits.tank_ul)
    reachable = optics.sigma_s.value * most_ml / tank_ml
    if reachable < THINNEST:
        raise SceneError(
            f"{optics.material.title} makes the demo's tank scatter {reachable:.2g}/mm at most, which no photograph "
            "shows; choose another liquid (tankrig materials)"
        )
    return planned(optics, min(DENSEST, reachable), tank_ml, limits=description.limits)


def _series(doses: int, liquid: "DosePlan | None", out: Path | None, as_json: bool) -> int:
    """On the ideal rig."""
    from tankrig.run.start import require_place
    from tankrig.run.state import FinishReason
    from tankrig.scene.description import Medium
    from ui.cli.run import carry_out, open_runner, tell

    began = time.perf_counter()
    path = out or Path("runs") / datetime.now(UTC).strftime("demo-%Y-%m-%dT%H-%M-%S")
    if liquid is None:
        sequence = sequence_of(DOSES_UL[:doses])
    else:
        # What leads up to the doses that are photographed is pumped in steps that the pump may take, too.
        totals_ul = liquid.totals_ul[1:]
        sequence = sequence_of(totals_ul[-doses:], totals_ul[:-doses])
        optics = liquid.optics
        by = 1.0 / (liquid.tank_ml * liquid.dilution)
        ink = Medium(by * optics.medium.sigma_a, by * optics.medium.sigma_s, optics.medium.g)
        sequence = replace(sequence, material=optics.material.name, wavelength_nm=optics.wavelength_nm, ink=ink)
    require_place(path, 0)
    description = rig_beside(path, TRUTH if liquid is None else truth_of(liquid))
    runner = open_runner(sequence, path, description)
    click.echo("a dilution series on the simulated rig; nothing real moves", err=True)
    outcome = carry_out(runner, fit=True)
    if liquid is None:
        status = tell(outcome, description, fit=True, as_json=as_json)
    elif outcome.error is not None:
        raise outcome.error
    else:
        status = 0 if outcome.reason is FinishReason.COMPLETED else 1
        if status == 0:
            _validate(path, description, liquid, as_json)
    click.echo(f"took {time.perf_counter() - began:.0f} s", err=True)
    return status


def _validate(path: Path, description: "RigFile", liquid: "DosePlan", as_json: bool) -> None:
    """As `tankrig validate` does."""
    from tankrig.live.refit import refit
    from tankrig.report import validation_of, write_validation
    from tankrig.run.reading import open_run
    from ui.cli.fits import fits_of, tell_fits
    from ui.cli.refit import progress_shown
    from ui.cli.validate import fields_of, tell

    with progress_shown() as told:
        refit(path, progress=told)  # what a slow machine had no time for while the run went on
    found = validation_of(open_run(path), liquid.optics, stock=liquid.dilution)
    file = write_validation(path, found)
    if as_json:
        click.echo(json.dumps(fields_of(found) | {"run": str(path), "report": str(file)}, ensure_ascii=False))
    else:
        tell_fits(fits_of(path, description))
        tell(found)
        click.echo(f"completed: {path}, compared with {liquid.optics.material.title} in {file}")
        stock = f" --stock {liquid.dilution}" if liquid.dilution > 1 else ""
        click.echo(f"to compare it again: tankrig validate {path} --material {liquid.optics.material.name}{stock}")


def truth_of(liquid: "DosePlan") -> str:
    """What is in the tank when the pump holds a reference liquid: its own phase function, as the library has it."""
    import tomlkit

    from tankrig.materials.library import material
    from tankrig.scene.writing import medium_table

    optics = liquid.optics
    by = 1.0 / (liquid.tank_ml * liquid.dilution)
    ink = replace(optics.medium, sigma_a=by * optics.medium.sigma_a, sigma_s=by * optics.medium.sigma_s)
    water = material("water")
    assert water.sigma_a is not None
    assert water.sigma_s is not None
    at = {name: one.at(optics.wavelength_nm) for name, one in (("sigma_a", water.sigma_a), ("sigma_s", water.sigma_s))}
    # Beads send most light straight on, which costs a Monte Carlo twenty times the photons of an ink.
    table = {"water": {**at, "g": 0.0}, "ink": medium_table(ink), "mixing_s": 0.7, "tolerance": 0.01, "coarsen": 2}
    return "\n" + tomlkit.dumps({"camera": {"truth": table}})


def rig_beside(path: Path, truth: str) -> "RigFile":
    """The simulated rig with what is in its tank; its rig file lies beside the run, for when that is resumed."""
    from drivers.rig import SIMULATED, simulated_rig

    folder = path.with_name(f"{path.name}.rig")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "rig.toml").write_text(SIMULATED.read_text(encoding="utf-8") + truth, encoding="utf-8")
    return simulated_rig(folder)


def sequence_of(totals_ul: tuple[float, ...], before_ul: tuple[float, ...] = ()) -> "Sequence":
    """The demo's series of doses: at each, dark frames and one photograph of each pattern; some doses before it."""
    from tankrig.pattern.kinds import AnyKind, Rays, Sheet, Stripes
    from tankrig.sequence import Capture, Dose, Mix, Sequence, Series
    from tankrig.sequence.steps import Step

    patterns: dict[str, AnyKind] = {
        "sheet": Sheet((-60.0, 60.0), LIGHT_MM),
        "stripes": Stripes(16.0, 0.5, (-60.0, 60.0), LIGHT_MM),
        "beams": Rays((-40.0, 0.0, 40.0), LIGHT_MM),
    }
    captures = [Capture(name, 4) for name in patterns]
    steps: tuple[Step, ...] = (
        Mix("sheet", tolerance=0.003, every_s=0.1, at_least_s=2.0, timeout_s=900.0),
        Capture("dark", 2),
        *captures,
    )
    return Sequence("demo", (*map(Dose, before_ul), Series(totals_ul, steps)), patterns, exposure_ms=20.0)
