"""`tankrig benchmark-estimates`: error, scatter, coverage and robustness of estimates, as one page."""

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ui.cli.options import json_option, out_option

if TYPE_CHECKING:
    from tankrig.benchmark_estimates.section import Section

PARTS = ("reference", "scatter", "coverage", "robustness", "starts")
BUNDLED = Path(__file__).parents[2] / "tests" / "data" / "reference"
"""In a checkout; an installed program hasn't got it."""


@click.command("benchmark-estimates", epilog="Example: tankrig benchmark-estimates --quick --out estimates")
@click.option(
    "--parts", metavar="NAMES", default=",".join(PARTS), show_default=True, help="What to measure, separated by commas."
)
@click.option(
    "--reference",
    type=click.Path(path_type=Path),
    metavar="FOLDER",
    help="Cases NAME.toml and NAME.npz; default: the checkout's.",
)
@click.option("--cases", metavar="NAMES", default="", help="Only these cases, separated by commas.")
@click.option("--quick", is_flag=True, help="Few cases and draws, and a model prepared for few liquids: some minutes.")
@out_option(
    "benchmark-estimates",
    "Folder for report.html and every fit's numbers; what is there already is not measured again.",
)
@json_option
def benchmark_estimates(parts: str, reference: Path | None, cases: str, quick: bool, out: Path, as_json: bool) -> None:
    """Measure how good estimates are: an hour or more, which may be interrupted; the next call goes on."""
    from rich.console import Console

    from tankrig.benchmark_estimates.page import write_page
    from tankrig.errors import ImageError
    from tankrig.files import require_writable

    asked = [name.strip() for name in parts.split(",") if name.strip()]
    unknown = sorted(set(asked) - set(PARTS))
    if unknown or not asked:
        raise click.UsageError(f"--parts {parts!r} names what is not measured; use {', '.join(PARTS)}")
    folder = reference or BUNDLED
    names = [name.strip() for name in cases.split(",") if name.strip()] or (["pub02", "pub08"] if quick else [])
    files = [folder / f"{name}.npz" for name in names] or sorted(folder.glob("*.npz"))
    missing = [file for file in files if not file.is_file()]
    if "reference" in asked and (missing or not files):
        raise ImageError(
            f"{missing[0] if missing else folder}: no reference case is there; name their folder with --reference"
        )
    require_writable(out)
    with Console(stderr=True).status("starting") as status:
        sections = _measured(asked, files, quick, out / ("quick" if quick else "full"), status.update)
    write_page(sections, out / "report.html")
    if as_json:
        click.echo(
            json.dumps(
                {
                    part.title: {"result": part.result, "missed": part.missed, "numbers": part.numbers}
                    for part in sections
                },
                ensure_ascii=False,
            )
        )
        return
    for part in sections:
        click.echo(
            f"{part.title}: {part.result}{f' {part.missed} figures outside their bounds.' if part.missed else ''}"
        )
    click.echo(f"written  {out / 'report.html'}")


def _measured(asked: list[str], cases: list[Path], quick: bool, folder: Path, progress: Any) -> "list[Section]":
    import warnings

    import tankrig
    from tankrig.benchmark_estimates import coverage, reference, robustness, scatter, starts
    from tankrig.benchmark_estimates.records import Records
    from tankrig.benchmark_estimates.scenes import LIQUIDS, STRIPES
    from tankrig.light.prepared.box import Box

    records = Records(folder, progress)
    found = []
    if "reference" in asked:
        found.append(reference.reference_section(records, cases))
    if "scatter" in asked:
        found.append(scatter.scatter_section(records, 20 if quick else 1000, quick))
    if {"coverage", "robustness", "starts"} & set(asked):
        progress("preparing a model")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # its error is stated, and is what is measured here
            box = Box((0.014, 0.03), (0.85, 0.99), (0.65, 0.9)) if quick else None
            prepared = tankrig.prepare(replace(STRIPES, source=""), box=box)
        liquids = ("medium",) if quick else tuple(LIQUIDS)
        if "coverage" in asked:
            found.append(coverage.coverage_section(records, prepared, 4 if quick else 60, 5 if quick else 17))
        if "robustness" in asked:
            found.append(robustness.robustness_section(records, prepared, liquids, 2 if quick else 5))
        if "starts" in asked:
            found.append(starts.starts_section(records, prepared, liquids, 20 if quick else 200))
    return found
