"""What a run's fits found, as numbers for `--json` and as a table for people, beside the truth where that is known."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ui.cli.tables import tell_table

if TYPE_CHECKING:
    from drivers.rig import RigFile
    from tankrig.scene import Medium

NAMES = ("sigma_a", "sigma_s", "g")
SHOWN = ("sigma_s", "g", "sigma_a")
TRUTH = "truth"


def fits_of(run: Path, description: "RigFile | None") -> dict[str, Any]:
    """The last fits that a run recorded: by dose, and per ml; with the truth where its rig is simulated.

    `unfitted` says, in words, what has been recorded and not fitted, and how to fit it; empty where nothing.
    """
    from drivers.rig import true_liquids
    from drivers.simulated.tank import mixture
    from tankrig.live.refit import unfitted
    from tankrig.report.results import known_sigma_t, recorded
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
        if truth:
            row["truth"] = _named(mixture(*truth, fit.dose_ml))
        ratio = None if fit.single is None else fit.single.sigma_t / known_sigma_t(fit, series)
        rows.append({**row, "single_sigma_t_ratio": ratio})
    found: dict[str, Any] = {"doses": rows, "unfitted": missing.sentence(run) if missing else ""}
    if series is not None:
        found |= {"ink_per_ml": _named(series.ink), "ink_sd": list(series.sd), "verdict": series.verdict}
        found["ink_determined"] = dict(series.identifiable)
        found |= {"truth_per_ml": _named(truth[1])} if truth else {}
    return found


def tell_fits(found: dict[str, Any]) -> None:
    """Coefficients, the truth beneath them where it is known, and how wrong single scattering is."""
    from rich.console import Console

    rows: list[tuple[str, ...]] = []
    for row in found["doses"]:
        by = row["single_sigma_t_ratio"]
        head, single = f"{row['dose_ml']:.3g} ml", "–" if by is None else f"{100.0 * (by - 1.0):+.0f} %"
        rows += _rows(head, row["fitted"], row["sd"], row["determined"], single, row.get("truth"))
    if "ink_per_ml" in found:
        sd = dict(zip(NAMES, found["ink_sd"], strict=False))
        per_ml = _rows("per ml", found["ink_per_ml"], sd, found["ink_determined"], "", found.get("truth_per_ml"))
        rows += [(), *per_ml]
    styles = ["bold" if row and row[0] == "per ml" else "dim" if row and row[0] == TRUTH else None for row in rows]
    tell_table(("ink", "σs, 1/mm", "g", "σa, 1/mm", "single\nscatt. σt"), rows, left=(1, 2, 3), styles=styles)
    console = Console()
    console.print(
        "each ± is one standard deviation; an interval of 95 % is twice as wide to either side", highlight=False
    )
    if any(row["single_sigma_t_ratio"] is not None for row in found["doses"]):
        console.print(
            "single scatt. σt: how far off σa + σs would be, had single scattering alone explained the photographs",
            highlight=False,
            soft_wrap=True,
        )
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


def _rows(
    head: str, found: dict[str, float], sd: dict[str, float], determined: dict[str, bool], single: str,
    truth: dict[str, float] | None,
) -> Iterator[tuple[str, ...]]:  # fmt: skip
    """A row of what was found, to two digits of its standard deviation, and one of the truth where it is known."""
    digits = {name: max(0, 1 - math.floor(math.log10(sd[name]))) if sd[name] > 0.0 else 6 for name in SHOWN}
    marks = {name: "" if determined.get(name, True) else "?" for name in SHOWN}
    yield (
        head,
        *(f"{found[one]:.{digits[one]}f}±{sd[one]:.{digits[one]}f}{marks[one]}" for one in SHOWN),
        single,
    )
    if truth:
        yield (TRUTH, *(f"{truth[name]:.4g}" for name in SHOWN), "")


def _named(medium: "Medium") -> dict[str, float]:
    return {name: getattr(medium, name) for name in NAMES}
