"""`tankrig calibrate pump`: weigh doses."""

import csv
import json
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tankrig.errors import DeviceError
from ui.cli.options import FINITE, FiniteRange, json_option, out_option, rig_option
from ui.guide import ask, confirm, emit, guided, number, somebody

if TYPE_CHECKING:
    from drivers.rig import RigFile
    from tankrig.calibration.pump import PumpCalibration
    from tankrig.devices import Doser
    from tankrig.dosing import GuardedDoser

BASIS = ("diameter_mm", "syringe_ul", "steps_per_ul")
_TUBE = "its tube hangs in a vessel on the balance, not in the tank"


@click.command(epilog="Example: tankrig calibrate pump --rig rig.toml --volumes 50,250,500 --temperature 21.5")
@rig_option
@click.option(
    "--weights",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="CSV with a header and the columns volume_ul and mass_mg, weighed already; nothing is dosed.",
)
@click.option("--volumes", metavar="µl,µl,…", help="What to dose; default: 10, 50 and 100 % of the largest dose.")
@click.option("--repeats", type=click.IntRange(1, 100), default=10, show_default=True, help="Doses of each volume.")
@click.option("--temperature", "temperature_c", type=FINITE, default=20.0, show_default=True, help="Of the liquid, °C.")
@click.option(
    "--density", "density_g_per_ml", type=FINITE, help="Of the liquid, g/ml; default: water at that temperature."
)
@click.option(
    "--evaporation", "evaporation_mg", type=FINITE, default=0.0, show_default=True, help="Lost from each dose, mg."
)
@click.option(
    "--delivered-ul",
    type=FiniteRange(min=0.0),
    metavar="X",
    help="Ink that the tank holds in all, where only a person can say before the pump may move.",
)
@click.option(
    "--initialise", is_flag=True, help="Only let a pump with a valve find its zero, which empties its syringe."
)
@out_option(None, "File to write; default: pump-DATE.toml beside the rig file.")
@json_option
def pump(rig: Path | None, weights: Path | None, out: Path | None, as_json: bool, initialise: bool, **how: Any) -> None:
    """Weigh doses and find what a nominal µl of the pump really is.

    Doses into a vessel on a balance and asks for the weight of each, or takes the weights from a file. The file it
    writes goes into the rig file: calibration = "./pump-….toml" in the table [doser]. The tank's ledger notes what was
    dosed as not in the tank.
    """
    from tankrig.calibration.pump import calibrate_pump, save_pump_calibration

    path = out or (rig or Path("rig.toml")).with_name(f"pump-{datetime.now():%Y-%m-%dT%H-%M-%S}.toml")
    if path.exists():
        raise click.BadParameter(
            f"{path} is there already and is not overwritten; give another name", param_hint="--out"
        )
    volumes, repeats = how.pop("volumes"), how.pop("repeats")
    delivered_ul = how.pop("delivered_ul")
    measured = _read(weights) if weights else None
    if measured is None and not somebody():
        raise click.UsageError("there is no terminal to ask for weights on; give --weights FILE")
    description = _rig_file(rig)
    limit_ul = description.limits.dose_ul
    with _doser(description) as doser:
        if initialise:
            _initialise(doser)
            return
        if measured is None:
            chosen = _chosen(doser, _volumes(volumes, limit_ul), limit_ul)
            with closing(_guarded(doser, description, delivered_ul)) as guard:
                measured = _weigh(guard, chosen, repeats)
        basis = {key: float(value) for key, value in description.doser.items() if key in BASIS}
        found = calibrate_pump(
            *measured, doser=doser.identity, basis=basis, nominal_increment_ul=doser.increment_ul, **how
        )
    save_pump_calibration(found, path)
    if guided():
        rows = {"weighed": _told(found, path).replace("\n", "; ")}
        emit("kept", {"path": str(path), "in_use": False, "doubts": [], "rows": rows})
    else:
        click.echo(json.dumps({**asdict(found), "path": str(path)}) if as_json else _told(found, path))


def _rig_file(rig: Path | None) -> "RigFile":
    from drivers.rig import load_rig_file, simulated_rig

    return load_rig_file(rig) if rig else simulated_rig(Path())


@contextmanager
def _doser(description: "RigFile") -> "Iterator[Doser]":
    """The rig's doser, without the calibration it has, while no other program uses the rig."""
    from drivers.registry import open_device
    from tankrig.run.rig import RigLock

    lock = RigLock(description.lock, description.name)
    try:
        settings = {key: value for key, value in description.doser.items() if key != "calibration"}
        doser: Doser = open_device(settings.pop("driver"), settings)
        try:
            yield doser
        finally:
            doser.close()
    finally:
        lock.close()


def _guarded(doser: "Doser", description: "RigFile", delivered_ul: float | None) -> "GuardedDoser":
    """The doser with the tank's ledger, which is told what does not go into the tank; a person's word is taken first.

    Raises
    ------
    UndecidedError
        When a person has to say first what the tank holds.
    """
    from tankrig.dosing import GuardedDoser, NoRun, TankLedger
    from tankrig.errors import UndecidedError

    guard = GuardedDoser(doser, description.limits, TankLedger(description.ledger), NoRun(), "calibrating the pump")
    try:
        if delivered_ul is not None:
            guard.resolve(delivered_ul)
        if guard.undecided:
            raise UndecidedError(guard.undecided)
    except BaseException:
        guard.close()
        raise
    return guard


def _initialise(doser: "Doser") -> None:
    act = getattr(doser, "initialise", None)
    if act is None:
        raise DeviceError(f"{doser.name}: needs no initialising; leave --initialise out")
    confirm(f"{doser.name}: is its tube in a waste vessel? It will push out what the syringe holds.")
    act()  # it empties the syringe into the vessel and counts nothing, so that the tank's ledger has nothing to note
    click.echo(f"{doser.name}: initialised")


def _volumes(text: str | None, limit_ul: float) -> list[float]:
    if text is None:
        return [part * limit_ul for part in (0.1, 0.5, 1.0)]
    try:
        return [float(word) for word in text.split(",")]
    except ValueError:
        raise click.BadParameter(f"{text!r} is no list of volumes such as 50,250,500", param_hint="--volumes") from None


def _read(path: Path) -> tuple[list[float], list[float]]:
    """Volumes and weights of a file."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = list(csv.DictReader(file, skipinitialspace=True))
        return [float(row["volume_ul"]) for row in rows], [float(row["mass_mg"]) for row in rows]
    except OSError as error:
        raise click.BadParameter(f"{path} cannot be read ({error.strerror})", param_hint="--weights") from error
    except (KeyError, TypeError, ValueError, csv.Error) as error:
        wanted = "a CSV file with a header and numbers in the columns volume_ul and mass_mg"
        raise click.BadParameter(f"{path} is not {wanted} ({error})", param_hint="--weights") from error


def _chosen(doser: "Doser", volumes: list[float], limit_ul: float) -> list[float]:
    for volume_ul in volumes:
        if not doser.increment_ul <= volume_ul <= limit_ul:
            raise click.BadParameter(
                f"{volume_ul:g} µl is not between {doser.increment_ul:g} and the rig file's dose_ul = {limit_ul:g}",
                param_hint="--volumes",
            )
    return volumes


def _weigh(guard: "GuardedDoser", volumes: list[float], repeats: int) -> tuple[list[float], list[float]]:
    """Dose, and ask for the weight of each dose."""
    confirm(f"{guard.name}: {_TUBE}?")
    if guard.stopped:
        guard.clear_stop()
    nominal: list[float] = []
    mass: list[float] = []
    for volume_ul in volumes * repeats:
        which = f"dose {len(mass) + 1} of {len(volumes) * repeats}, {volume_ul:g} µl"
        ask(f"{which}: tare the balance.")
        nominal.append(guard.dose_aside(volume_ul, "weighed to calibrate the pump"))
        mass.append(number(f"  {which}: weight in mg"))
    return nominal, mass


def _told(found: "PumpCalibration", path: Path) -> str:
    lines = [
        f"a nominal µl is {found.correction:.5f} ± {found.correction_sd:.5f} µl "
        f"({len(found.mass_mg)} doses, scatter {found.scatter_ul:.3g} µl)",
        f"smallest step {found.increment_ul:.5g} ± {found.increment_sd_ul:.2g} µl; "
        f"each dose has {found.offset_ul:+.3g} ± {found.offset_sd_ul:.2g} µl besides; each ± is a standard deviation",
    ]
    if found.diameter_mm is not None:
        lines.append(f"as if the syringe measured {found.diameter_mm:.4g} mm inside")
    return "\n".join([*lines, f'written to {path}; in the rig file, table [doser]: calibration = "./{path.name}"'])
