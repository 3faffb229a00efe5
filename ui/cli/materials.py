"""`tankrig materials …`: reference liquids, what is published of them, and how much a tank needs."""

import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tankrig.errors import SceneError
from ui.cli.options import FINITE, FiniteRange, json_option, rig_option

if TYPE_CHECKING:
    from tankrig.materials.coefficients import Optics, Uncertain
    from tankrig.materials.dosing import DosePlan
    from tankrig.materials.library import Material
    from tankrig.materials.scalar_light import LeftOut


class LabelLine(click.ParamType[Any]):
    """KEY=VALUE or KEY=VALUE±SD, of what a bottle's label says."""

    name = "KEY=VALUE[±SD]"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Text to (key, (value, standard deviation or None))."""
        if isinstance(value, tuple):
            return value
        key, _, text = value.partition("=")
        numbers = text.replace("+-", "±").split("±")
        try:
            found = [float(one) for one in numbers]
        except ValueError:
            found = []
        if len(found) not in (1, 2) or not all(math.isfinite(one) for one in found):
            self.fail(f"{value!r} is not KEY=VALUE or KEY=VALUE±SD, such as diameter_um=0.994±0.010", param, ctx)
        if min(found) < 0.0:
            self.fail(f"{value!r} has a number below 0, which no label says; give {key} as it is printed", param, ctx)
        return key, (found[0], found[1] if len(found) == 2 else None)


wavelength_option = click.option(
    "--wavelength",
    "wavelength_nm",
    type=FiniteRange(min=0.0, min_open=True),
    metavar="NM",
    help="Of the projector's light, in vacuum.",
)
label_option = click.option(
    "--label",
    type=LabelLine(),
    multiple=True,
    help="What your bottle's label says: diameter_um, solids (g/ml), spread (share of the diameter).",
)
stock_option = click.option(
    "--stock",
    type=FiniteRange(min=1.0),
    metavar="PARTS",
    help="Parts that one part of the liquid was diluted to before it was put into the pump.",
)


def optics_of(
    name: str, wavelength_nm: float | None, label: tuple[tuple[str, Any], ...] = (), band_nm: float = 0.0
) -> "Optics":
    """A material of the library as a command line asks for it."""
    from tankrig.materials.coefficients import optics
    from tankrig.materials.library import material

    found = material(name).labelled(dict(label))
    return optics(found, _wavelength_of(found, wavelength_nm), band_nm)


def _wavelength_of(found: "Material", wavelength_nm: float | None) -> float:
    """That was asked for; one that the library does not know, or none, is refused with those that it knows."""
    if wavelength_nm is None:
        among = "" if found.range_nm is None else " from {:g} to {:g} nm".format(*found.range_nm)
        raise SceneError(f"{found.name}: its optics depend on the wavelength; give --wavelength{among}")
    found.require_known_at(wavelength_nm)
    return wavelength_nm


@click.group(
    invoke_without_command=True, epilog="Example: tankrig materials plan intralipid-20 --wavelength 633 --sigma-s 0.02"
)
@json_option
@click.pass_context
def materials(ctx: click.Context, as_json: bool) -> None:
    """List the reference liquids that are known, with their sources; `show` one, or `plan` its doses.

    Polystyrene beads of any diameter have a name: polystyrene-0.75 are those of 0.75 µm.
    """
    if ctx.invoked_subcommand is None:
        _list(as_json)


def _list(as_json: bool) -> None:
    from rich.console import Console
    from rich.table import Table

    from tankrig.materials.library import materials as all_materials

    rows = all_materials()
    if as_json:
        listed = [{key: getattr(one, key) for key in ("name", "title", "range_nm", "note", "sources")} for one in rows]
        click.echo(json.dumps(listed, ensure_ascii=False))
        return
    table = Table("name", "nm", "what to know", box=None, pad_edge=False, header_style="bold")
    for one in rows:
        table.add_row(one.name, _span(one.range_nm), one.note)
    Console().print(table)
    click.echo("\none of them, with sources, at a wavelength in nm: tankrig materials show NAME --wavelength NM")


def _span(range_nm: tuple[float, float] | None) -> str:
    return "–" if range_nm is None else f"{range_nm[0]:g} … {range_nm[1]:g}"


@materials.command(epilog="Example: tankrig materials show polystyrene-1.0 --wavelength 633")
@click.argument("name")
@wavelength_option
@label_option
@click.option("--band-nm", type=FiniteRange(min=0.0, min_open=True), default=20.0, show_default=True,
              help="Full width of the projector's colour, for what a band would change.")  # fmt: skip
@json_option
def show(
    name: str, wavelength_nm: float | None, label: tuple[tuple[str, Any], ...], band_nm: float, as_json: bool
) -> None:
    """Tell what is published of NAME at a wavelength: coefficients, mean cosine, p(90°), uncertainties, sources."""
    from tankrig.materials.library import material
    from tankrig.materials.scalar_light import left_out

    found = material(name)
    if found.sigma_s is None and found.beads is None:
        _tell_incomplete(found, wavelength_nm, as_json)
        return
    optics = optics_of(name, wavelength_nm, label)
    beads = optics.material.beads
    out = None if beads is None else left_out(beads.mie(optics.wavelength_nm), band_nm)
    if as_json:
        left = {} if out is None else {"left_out": asdict(out)}
        click.echo(json.dumps(_fields(optics) | left, ensure_ascii=False))
        return
    click.echo(f"{optics.material.title} at {optics.wavelength_nm:g} nm, undiluted\n")
    _tell_numbers(optics)
    if out is not None:
        _tell_left_out(out)
    click.echo("")
    _tell_sources(optics.material)


NUMBERS = {
    "sigma_s": ("σs", "/mm"),
    "g": ("g", ""),
    "reduced": ("σs(1−g)", "/mm"),
    "sideways": ("σs·p(90°)", "/mm/sr"),
}
"""Of a material: their symbols and units."""


def _fields(optics: "Optics") -> dict[str, Any]:
    """For `--json`."""
    numbers = {key: getattr(optics, key) for key in NUMBERS}
    return {
        "name": optics.material.name,
        "wavelength_nm": optics.wavelength_nm,
        "sigma_a": optics.medium.sigma_a,
        **{key: {"value": one.value, "sd": one.sd, "parts": dict(one.parts)} for key, one in numbers.items()},
        "sources": optics.material.sources,
    }


def _tell_numbers(optics: "Optics") -> None:
    for key, (symbol, unit) in NUMBERS.items():
        one = getattr(optics, key)
        parts = _parts(one)
        value = one.value if unit else round(one.value, 6) + 0.0  # the mean cosine of what scatters evenly is 0
        click.echo(f"{symbol:<11} {value:.4g}" + (f" ± {one.sd:.2g}{unit}   ({parts})" if parts else unit))
    if optics.medium.sigma_a:
        click.echo(f"σa          {optics.medium.sigma_a:.3g}/mm")


def _parts(number: "Uncertain") -> str:
    """What an uncertainty is made of, as shares of the number."""
    shares = {cause: 100.0 * abs(change / number.value) for cause, change in number.parts.items()}
    return ", ".join(f"{cause} {share:.1f} %" for cause, share in shares.items() if share > 0.05)


def _tell_left_out(out: "LeftOut") -> None:
    least, most = out.polarisation
    click.echo(
        f"\npolarised light changes order 1 by up to ± {100.0 * out.first_order():.0f} % "
        f"(P(80 … 100°) is {least:.2f} … {most:.2f});\n"
        f"order 2 differs from that of scalar light by {100.0 * out.second_order:+.1f} %, polarised by order 1;\n"
        f"a band of {out.band_nm:g} nm changes σs·p by up to {100.0 * out.band:.1f} %"
    )


def _tell_sources(found: "Material") -> None:
    click.echo(f"{found.title}: {found.note}")
    for what, source in found.sources.items():
        click.echo(f"  {what}: {source}")


def _tell_incomplete(found: "Material", wavelength_nm: float | None, as_json: bool) -> None:
    """Of a liquid of which only σs(1−g) is published, or nothing."""
    at_nm = wavelength_nm if found.reduced is None else _wavelength_of(found, wavelength_nm)
    reduced = None if found.reduced is None or at_nm is None else found.reduced.at(at_nm)
    if as_json:
        click.echo(json.dumps({"name": found.name, "wavelength_nm": at_nm, "reduced": reduced,
                               "note": found.note, "sources": found.sources}, ensure_ascii=False))  # fmt: skip
        return
    if found.reduced is not None and at_nm is not None:
        click.echo(f"{found.title} at {at_nm:g} nm, undiluted\n")
        click.echo(f"σs(1−g)     {reduced:.4g} ± {found.reduced.uncertainty(at_nm):.2g}/mm\n")
    _tell_sources(found)


@materials.command(epilog="Example: tankrig materials plan intralipid-20 --wavelength 633 --sigma-s 0.02")
@click.argument("name")
@wavelength_option
@click.option("--sigma-s", type=FINITE, required=True, metavar="PER_MM", help="Of the tank at the last dose.")
@label_option
@rig_option
@click.option("--tank-ml", type=FiniteRange(min=0.0, min_open=True), help="Water in the tank; default: the rig's.")
@click.option("--least-ul", type=FiniteRange(min=0.0, min_open=True), default=20.0, show_default=True,
              help="Smallest dose that your pump measures well.")  # fmt: skip
@json_option
def plan(
    name: str, wavelength_nm: float | None, sigma_s: float, label: tuple[tuple[str, Any], ...], rig: Path | None,
    tank_ml: float | None, least_ul: float, as_json: bool,
) -> None:  # fmt: skip
    """Say how much of NAME the rig's tank needs, in which doses, how sure that is, and what to expect.

    The doses keep to the rig's limits. Without a rig file they are for the simulated rig; with --tank-ml and no rig
    file, for a tank of that volume and a pump without limits.
    """
    from drivers.rig import SIMULATED, calibrated_bench, load_rig_file
    from tankrig.materials.dosing import planned, tank_volume_ml

    optics = optics_of(name, wavelength_nm, label)
    description = load_rig_file(rig or SIMULATED)
    tank = calibrated_bench(description).tank if rig else description.bench.tank
    bare = rig is None and tank_ml is not None
    limits = None if bare else description.limits
    found = planned(optics, sigma_s, tank_ml or tank_volume_ml(tank), limits=limits, least_ul=least_ul)
    if as_json:
        click.echo(json.dumps(_planned_fields(found)))
        return
    where = "" if rig or bare else " (the simulated rig)"
    click.echo(f"{optics.material.title} at {optics.wavelength_nm:g} nm into {found.tank_ml:.0f} ml{where}")
    _tell_plan(found, None if bare else tank.size_mm[0])
    more = "".join(f" --label {key}={value:g}" + ("" if sd is None else f"±{sd:g}") for key, (value, sd) in label)
    more += f" --stock {found.dilution}" if found.dilution > 1 else ""
    more += f" --tank-ml {tank_ml:g}" if tank_ml is not None else ""
    click.echo(f"afterwards   tankrig validate RUN --material {found.optics.material.name}{more}")


def _planned_fields(found: "DosePlan") -> dict[str, Any]:
    """For `--json`."""
    optics, reached = found.optics, found.sigma_s
    return {
        "name": optics.material.name,
        "wavelength_nm": optics.wavelength_nm,
        "tank_ml": found.tank_ml,
        "dilution": found.dilution,
        "totals_ul": list(found.totals_ul),
        "sigma_s": reached.value,
        "sigma_s_sd": reached.sd,
        "sigma_s_parts": dict(reached.parts),
        "sigma_s_per_ml": found.per_ml.value,
        "g": optics.medium.g,
        "p90": float(optics.medium.phase_function.at(0.0)),
    }


def _tell_plan(found: "DosePlan", length_mm: float | None) -> None:
    medium, reached = found.optics.medium, found.sigma_s
    if found.dilution > 1:
        click.echo(f"dilute       1 part of it with {found.dilution - 1} parts of water, well mixed, and dose that")
    total_ul, steps = found.totals_ul[-1], ", ".join(f"{one:g}" for one in found.totals_ul)
    p90 = float(medium.phase_function.at(0.0))
    click.echo(
        f"dose         {total_ul:g} µl in all, for σs {reached.value:.4g} ± {reached.sd:.2g}/mm ({_parts(reached)})\n"
        f"steps        total_ul = [{steps}]\n"
        "             0 is the tank before any dose: photograph it too, for water and dust scatter\n"
        f'in it        material = "{found.optics.material.name}", wavelength_nm = {found.optics.wavelength_nm:g}, in '
        "the sequence: fits then know it\n"
        f"to expect    σs {found.per_ml.value:.4g}/mm per ml, g {medium.g:.3f}, p(90°) {p90:.4f}/sr"
        + (
            ""
            if length_mm is None
            else f"; {reached.value * length_mm:.2g} scatterings along the tank at the last dose"
        )
    )
    share = found.volume_share
    if share is not None and share > 0.01:
        click.echo("             particles are more than 1 % of the volume and no longer scatter independently")
