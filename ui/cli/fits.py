"""What a run's fits found, as numbers for `--json` and as a table for people, beside the truth where that is known."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from drivers.rig import RigFile
    from tankrig.scene import Medium

NAMES = ("sigma_a", "sigma_s", "g")
SHOWN = ("sigma_s", "g", "sigma_a")


def fits_of(run: Path, description: "RigFile | None") -> dict[str, Any]:
    """The last fits that a run recorded: by dose, and per ml; with the truth where its rig is simulated.

    `unfitted` says, in words, what has been recorded and not fitted, and how to fit it; empty where nothing.
    """
    from drivers.rig import true_liquids
    from drivers.simulated.tank import mixture
    from tankrig.live.refit import unfitted
    from tankrig.report.results import recorded
    from tankrig.run.reading import open_run

    opened = open_run(run)
    doses, series = recorded(opened)
    truth = true_liquids(description) if description else None
    missing = unfitted(opened)
    rows = []
    for fit in doses:
        row = {
            "dose_ml": fit.dose_ml,
            "fitted": _named(fit.medium),
            "sd": dict(zip(NAMES, fit.sd, strict=True)),
            "determined": dict(fit.identifiable),
            "structure": fit.structure,
            "order_one": fit.order_one,
        }
        sigma_t = fit.medium.sigma_t
        if truth:
            liquid = mixture(*truth, fit.dose_ml)
            row["truth"], sigma_t = _named(liquid), liquid.sigma_t
        rows.append({**row, "single_sigma_t_ratio": None if fit.single is None else fit.single.sigma_t / sigma_t})
    found: dict[str, Any] = {"doses": rows, "unfitted": missing.sentence(run) if missing else ""}
    if series is not None:
        found |= {"ink_per_ml": _named(series.ink), "ink_sd": list(series.sd), "verdict": series.verdict}
        found["ink_determined"] = dict(series.identifiable)
        found |= {"truth_per_ml": _named(truth[1])} if truth else {}
    return found


def tell_fits(found: dict[str, Any]) -> None:
    """Coefficients in 1/m, which makes them short, and how wrong single scattering is."""
    from rich.console import Console
    from rich.table import Table

    known = any("truth" in row for row in found["doses"])
    table = Table(box=None, pad_edge=False, collapse_padding=True, header_style="bold")
    headings = [heading for name in ("σs, 1/m", "g", "σa, 1/m") for heading in ((name, "truth") if known else (name,))]
    for heading in ("ink", *headings, "single\nscatt. σt"):
        table.add_column(heading, justify="right", no_wrap=True)
    for row in found["doses"]:
        cells = _cells(row["fitted"], row["sd"], row.get("truth"), row["determined"])
        by = row["single_sigma_t_ratio"]
        table.add_row(f"{row['dose_ml']:.3g} ml", *cells, "–" if by is None else f"{100.0 * (by - 1.0):+.0f} %")
    if "ink_per_ml" in found:
        sd = dict(zip(NAMES, found["ink_sd"], strict=False))
        table.add_row("")
        cells = _cells(found["ink_per_ml"], sd, found.get("truth_per_ml"), found["ink_determined"])
        table.add_row("per ml", *cells, style="bold")
    console = Console()
    console.print(table)
    unsure = [row for row in (*found["doses"], {"determined": found.get("ink_determined", {})}) if _unsure(row)]
    if unsure:
        console.print("? not determined by these photographs", highlight=False)
    for row in found["doses"]:
        if row["structure"]:
            console.print(
                f"{row['dose_ml']:.3g} ml: {100.0 * row['structure']:.2g} % of the light is not as the model has it, "
                "and counted in the errors",
                highlight=False,
            )
        if row["order_one"]:
            console.print(f"{row['dose_ml']:.3g} ml: {row['order_one']}", highlight=False, markup=False)
    if "verdict" in found:
        console.print(f"\n{found['verdict']}", highlight=False, markup=False)
    click.echo()


def _unsure(row: dict[str, Any]) -> bool:
    return any(not row["determined"].get(name, True) for name in NAMES)


def _cells(
    found: dict[str, float], sd: dict[str, float], truth: dict[str, float] | None, determined: dict[str, bool]
) -> Iterator[str]:
    for name in SHOWN:
        mark = "" if determined.get(name, True) else "?"
        by = 1.0 if name == "g" else 1000.0
        digits = max(0, 1 - math.floor(math.log10(by * sd[name]))) if sd[name] > 0.0 else 4
        yield f"{by * found[name]:.{digits}f}±{by * sd[name]:.{digits}f}{mark}"
        if truth:
            yield f"{by * truth[name]:.3f}"


def _named(medium: "Medium") -> dict[str, float]:
    return {name: getattr(medium, name) for name in NAMES}
