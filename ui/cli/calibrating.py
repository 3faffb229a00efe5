"""What the calibration commands share: asking for what goes before the lens, and keeping the result."""

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ui.guide import Feedback, ask, confirm, emit, guided, somebody

if TYPE_CHECKING:
    from drivers.rig import RigFile
    from tankrig.calibration.file import Calibration
    from tankrig.devices import CameraDevice

_REQUESTS = {
    "cap": "Cap the lens, so that no light gets in.",
    "diffuser": "Take the cap off, and put the diffuser before the lens where the projector's picture falls on it.",
    "diffuser turned": "Turn the diffuser by half a turn, in its own plane.",
    "nothing": "Take everything off the lens.",
}

_OVER_PICTURE = ("blur_middle_px", "blur_corner_px")

accept_option = click.option(
    "--accept", is_flag=True, help="Use the result even if it is doubtful or much worse than the one before."
)

clear_water_option = click.option(
    "--clear-water", is_flag=True, help="The water is clear, or there is none, whatever the tank's ledger says."
)


def require_clear_water(description: "RigFile", clear_water: bool) -> None:
    """Refuse to look at a board through ink.

    Parameters
    ----------
    description
        Of the rig, whose tank's ledger is asked.
    clear_water
        A person's word that there is none.

    Raises
    ------
    DecisionError
        When the ledger says that there may be ink in the tank.
    """
    from drivers.rig import tank_ledger
    from tankrig.errors import DecisionError

    with tank_ledger(description) as ledger:
        if clear_water or ledger is None or (ledger.tank.high_ul <= 0.0 and ledger.open_dose is None):
            return
        held = f"{ledger.tank.volume_ul:g} µl of ink" if ledger.open_dose is None else "ink of an interrupted dose"
    why = (
        f"{description.ledger}: says that the tank holds {held}, and a board is seen and lit truly through clear water "
        f"only"
    )
    if somebody():
        confirm(f"{why}. Is the water clear, or the tank empty?")
        return
    raise DecisionError(
        f"{why}; fill the tank with clear water and move that file away, or give --clear-water where there is no ink"
    )


def described(rig: Path | None) -> "RigFile":
    """What the rig file says; without one the simulated bench, all of which can be calibrated.

    A `rig.toml` in the working folder stands in for the bench that ships, as it does for the simulated rig.
    """
    from drivers.rig import SIMULATED, load_rig_file

    if rig is not None:
        return load_rig_file(rig)
    click.echo("no rig is configured, so this is the simulated bench", err=True)
    own = Path("rig.toml")
    return load_rig_file(own if own.exists() else SIMULATED.with_name("bench.toml"), beside=Path().absolute())


def asker(camera: "CameraDevice", shown: Feedback) -> Callable[[str], None]:
    """Ask a person to put something before the lens; a simulated camera does it by itself.

    Raises
    ------
    click.UsageError
        When there is nobody to ask.
    """
    put: Callable[[str], None] | None = getattr(camera, "put", None)
    if put is not None:
        return put
    if not somebody():
        raise click.UsageError("somebody has to handle the lens; run this on a terminal")

    def request(what: str) -> None:
        with shown.pause():
            ask(_REQUESTS[what])

    return request


def keep(
    calibration: "Calibration", description: "RigFile", accept: bool, draw: Callable[[Path], object] | None
) -> "Calibration":
    """Save a calibration beside the rig file, and its picture beside it."""
    from tankrig.calibration.file import save

    kept = save(replace(calibration, rig=description.name), Path(description.calibration_folder), accept)
    if draw is not None and kept.path is not None:
        draw(kept.path.with_suffix(".png"))
    return kept


def blurred(kept: "Calibration", unit: str) -> dict[str, str]:
    """What the lens spreads, in words; nothing where that was not measured."""
    if "blur_px" not in kept.result:
        return {"blurs by": "not measured; show more of the board's edges, in focus"}
    told = {"blurs by": f"{kept.result['blur_px']:.2f} ± {kept.sd['blur_px']:.2g} {unit} (standard deviation)"}
    if "blur_corner_px" in kept.result:
        middle, corner = (f"{kept.result[name]:.2f} ± {kept.sd[name]:.2g}" for name in _OVER_PICTURE)
        told["from middle to corners"] = f"{middle} to {corner} {unit}"
    return told


def left_out(kept: "Calibration") -> dict[str, str]:
    """Which errors the stated standard deviations do not hold; nothing where they hold all."""
    from tankrig.calibration.geometry_in_force import sd_without

    why = sd_without(kept)
    return {"not in the ±": why} if why else {}


def tell(kept: "Calibration", rows: Mapping[str, str], as_json: bool) -> int:
    """Say what was found, how well, where it is kept and whether it is used.

    Returns
    -------
    int
        Exit status: 3 when a person has to decide about a result that was set aside.
    """
    path = kept.path
    assert path is not None
    if any("±" in value for value in rows.values()):
        rows = {**rows, "each ±": "is a standard deviation"}
    found: dict[str, Any] = {
        "path": str(path), "sha256": kept.hash, "in_use": kept.in_use, "doubts": list(kept.doubts),
        "how_well": dict(kept.how_well),
    }  # fmt: skip
    if guided():
        emit("kept", {**found, "rows": dict(rows)})
    elif as_json:
        click.echo(json.dumps(found, ensure_ascii=False))
    if guided() or as_json:
        return 0 if kept.in_use else 3
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    table = Table(box=None, pad_edge=False, show_header=False)
    for name, value in rows.items():
        table.add_row(name, escape(value))
    Console().print(table)
    for doubt in kept.doubts:
        click.echo(f"doubt: {doubt}")
    picture = path.with_suffix(".png")
    click.echo(f"written to {path}" + (f"; look at {picture.name} before you believe it" if picture.exists() else ""))
    if not kept.in_use:
        click.echo(
            f"it was set aside and is not used; mend what the doubts say and calibrate again, or move {path.name} into "
            f"{path.parent.parent} to use it all the same"
        )
        return 3
    return 0
