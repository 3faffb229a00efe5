"""`tankrig advise`: which dose and pattern to take next, by what they are expected to tell."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from ui.cli.options import FINITE, FiniteRange, json_option, rig_option
from ui.cli.tables import tell_table

if TYPE_CHECKING:
    from drivers.rig import RigFile
    from tankrig.advice.expected import Expected, Known, Shot
    from tankrig.advice.next_pictures import NextPictures
    from tankrig.advice.ranking import Advice
    from tankrig.live.photograph_plan import PhotographPlan
    from tankrig.pattern.kinds import Cells
    from tankrig.sequence.until import Until

SHOWN = {"sigma_s": "σs", "g": "g", "sigma_a": "σa"}
OF_DESIGNS = ("wishes", "pictures", "heights_mm", "sheet_mm", "y_mm", "cells")
"""Arguments that a ranking of usual pictures has no use for."""


@click.command(epilog="Example: tankrig advise runs/2026-11-20T10-00-00 --for sigma_a")
@click.argument("run_folder", metavar="[RUN]", required=False, type=click.Path(path_type=Path))
@click.option("--sequence", "sequence_file", type=click.Path(path_type=Path), metavar="FILE",
              help="Patterns to choose from, without a run: those of a sequence file; needs --ink.")  # fmt: skip
@click.option("--ink", type=(FINITE, FINITE, FINITE), metavar="σa σs g",
              help="A guess of the ink, per mm and ml, without a run.")  # fmt: skip
@click.option("--noise", type=FiniteRange(0.0, 1.0, min_open=True), default=0.005, show_default=True,
              help="Of a frame, as a share of its peak, without a run.")  # fmt: skip
@click.option("--dose-ul", "doses_ul", type=FiniteRange(min=0.0, min_open=True), multiple=True, metavar="UL",
              help="Ink in the tank in all, to be compared; may be given several times.")  # fmt: skip
@click.option("--frames", type=click.IntRange(min=1), default=4, show_default=True, help="That are averaged.")
@click.option("--for", "wanted", type=click.Choice(["all", *SHOWN]), default="all", show_default=True,
              help="The coefficient to learn about, or all three.")  # fmt: skip
@click.option("--by", type=click.Choice(["minute", "ul", "all"]), default="minute", show_default=True,
              help="Rank by information per minute, per µl of ink, or in all.")  # fmt: skip
@click.option("--limit", type=click.IntRange(min=1), default=12, show_default=True, help="Candidates to show.")
@click.option("--design", type=click.Path(path_type=Path, dir_okay=False), metavar="FILE",
              help="Design pictures for one dose, and write a sequence that shows them.")  # fmt: skip
@click.option("--pictures", type=click.IntRange(1, 6), default=2, show_default=True, help="That are designed.")
@click.option("--height-mm", "heights_mm", type=FINITE, multiple=True, metavar="MM",
              help="Middle of a sheet of their cells; up to three. Default: half the tank's height.")  # fmt: skip
@click.option("--sheet-mm", type=FiniteRange(0.0, min_open=True), default=4.0, show_default=True,
              help="Thickness of their sheets.")  # fmt: skip
@click.option("--y-mm", "y_mm", type=(FINITE, FINITE), metavar="LOW HIGH",
              help="Width of their sheets. Default: three quarters of the tank's.")  # fmt: skip
@click.option("--cells", type=click.IntRange(2, 40), default=24, show_default=True, help="Of each sheet, along y.")
@click.option("--until", "wishes", type=(click.Choice(list(SHOWN)), str), multiple=True, metavar="NAME SIZE",
              help='What ends their run, such as "sigma_s 1%"; may be given several times.')  # fmt: skip
@rig_option
@json_option
def advise(
    run_folder: Path | None,
    sequence_file: Path | None,
    ink: tuple[float, float, float] | None,
    noise: float,
    doses_ul: tuple[float, ...],
    frames: int,
    wanted: str,
    by: Any,
    limit: int,
    design: Path | None,
    pictures: int,
    heights_mm: tuple[float, ...],
    sheet_mm: float,
    y_mm: tuple[float, float] | None,
    cells: int,
    wishes: tuple[tuple[str, str], ...],
    rig: Path | None,
    as_json: bool,
) -> None:
    """Rank what to photograph next by the information expected per minute and per µl of ink.

    From what RUN has photographed and fitted so far, or from a guess of the ink. The standard deviations are those
    that a fit of everything, the candidate included, is expected to state.

    With --design pictures are invented: cells in one to three sheets, lit so that a fit of their frames alone is
    expected to learn most about the liquid at one dose (--dose-ul, or what RUN's tank holds). tankrig run FILE shows
    them.
    """
    from rich.console import Console
    from rich.progress import Progress

    from drivers.rig import load_rig_file, simulated_rig
    from tankrig.advice.candidates import beginning_of, candidates_of
    from tankrig.advice.ranking import answer_by_paths, prepared_answer, ranked

    if (run_folder is None) == (sequence_file is None):
        raise click.UsageError("give the folder of a run, or --sequence and --ink")
    if design is None and (given := _given(*OF_DESIGNS)):
        raise click.UsageError(f"{given[0]} is about pictures that are designed; give --design FILE too")
    if sequence_file is not None and ink is None:
        raise click.UsageError("--sequence needs --ink: a guess of the ink's σa, σs per mm and ml, and g")
    description = load_rig_file(rig) if rig else simulated_rig(Path("rig"))
    if run_folder is not None:
        known, taken, plan, exposure_ms = beginning_of(run_folder)
    else:
        assert sequence_file is not None
        assert ink is not None
        known, taken, plan, exposure_ms = _of_guess(sequence_file, ink, noise, description)
    most_ul = description.limits.tank_ul
    if design is not None:
        lit, asked = Lit(heights_mm, sheet_mm, y_mm, cells), Asked(pictures, frames, wanted, wishes)
        held_ul = 1000.0 * max((shot.dose_ml for shot in taken), default=0.0)
        _design(known, _dose(doses_ul, held_ul, most_ul), plan, exposure_ms, lit, asked, design, as_json)
        return
    candidates = candidates_of(taken, plan, exposure_ms, description.pace, most_ul, doses_ul, frames)
    shots = [*taken, *(one.shot for one in candidates)]
    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("preparing models", total=1.0)
        answer = answer_by_paths(known.family) if known.family is not None else prepared_answer(
            known, [one.scene for one in shots], [one.dose_ml for one in shots],
            lambda done: bar.update(task, completed=done),
        )  # fmt: skip
        bar.update(task, description="comparing", completed=1.0)
        before, found = ranked(known, taken, candidates, answer, by, None if wanted == "all" else wanted)
    if as_json:
        rows = [_row(advice) for advice in found[:limit]]
        click.echo(json.dumps({"now": before and before.relative_sd, "candidates": rows}, ensure_ascii=False))
    else:
        _tell(before, found[:limit])


def _given(*names: str) -> list[str]:
    """Those of the options, by the names of their arguments, that a person has given, as they are spelt."""
    context = click.get_current_context()
    options = {one.name: one.opts[0] for one in context.command.params}
    return [options[name] for name in names if context.get_parameter_source(name) is ParameterSource.COMMANDLINE]


@dataclass(frozen=True)
class Lit:
    """Where the cells of designed pictures are, as a person says it."""

    heights_mm: tuple[float, ...]
    sheet_mm: float
    y_mm: tuple[float, float] | None
    count: int

    def cells(self, size_mm: tuple[float, float, float]) -> "Cells":
        """In a tank."""
        from tankrig.advice.cells import cells_in

        return cells_in(size_mm, self.heights_mm, self.sheet_mm, self.y_mm, self.count)


@dataclass(frozen=True)
class Asked:
    """Of designed pictures: how many, frames of each, what is to be known, and what ends their run."""

    pictures: int
    frames: int
    wanted: Any
    wishes: tuple[tuple[str, str], ...]

    @property
    def until(self) -> "Until | None":
        """As a sequence has it."""
        from tankrig.sequence.until import Until

        if not self.wishes:
            return None
        try:
            return Until(**{name: size if "%" in size else float(size) for name, size in self.wishes})
        except ValueError as error:
            raise click.UsageError(f'--until wants a share such as "1%" or a number, not {self.wishes}') from error


def _dose(doses_ul: tuple[float, ...], held_ul: float, most_ul: float) -> float:
    """The one dose that pictures are designed for."""
    total_ul = doses_ul[0] if doses_ul else held_ul
    if len(doses_ul) > 1 or not 0.0 < total_ul <= most_ul or total_ul < held_ul:
        raise click.UsageError(
            f"--design needs one dose that the tank may hold: give one --dose-ul, from {held_ul:g} to {most_ul:g} µl"
        )
    return total_ul


def _design(
    known: "Known", total_ul: float, plan: "PhotographPlan", exposure_ms: float, lit: Lit, asked: Asked, file: Path,
    as_json: bool,
) -> None:  # fmt: skip
    from rich.console import Console
    from rich.progress import Progress

    from tankrig.advice.next_pictures import as_sequence, next_pictures
    from tankrig.bench import Bench
    from tankrig.files import require_writable

    if not isinstance(plan.bench, Bench):
        raise click.UsageError("RUN was imported, and nobody knows which projector could show pictures for it")
    until = asked.until
    require_writable(file.parent)
    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("light of each cell", total=1.0)
        found = next_pictures(
            known, total_ul / 1000.0, (), plan.bench, plan.camera, lit.cells(plan.bench.tank.size_mm),
            asked.pictures, asked.frames, asked.wanted,
            None if plan.saturation is None else plan.saturation / exposure_ms,
            progress=lambda done: bar.update(task, completed=done),
        )  # fmt: skip
    file.write_text(as_sequence(found, total_ul, exposure_ms, until), encoding="utf-8")
    after = found.design.after.relative_sd
    if as_json:
        usual = {name: one.relative_sd for name, one in found.usual.items()}
        told = {"file": str(file), "relative_sd": after, "bits": found.bits, "best": found.best, "usual": usual}
        click.echo(json.dumps(told | {"seconds": found.design.seconds}, ensure_ascii=False))
        return
    _tell_design(found)
    click.echo(f"written  {file}: show it with tankrig run {file}")


def _tell_design(found: "NextPictures") -> None:
    rows = [("designed", *_errors(found.design.after))]
    rows += [(name, *_errors(found.usual[name])) for name in list(found.usual)[:4]]
    headings = (f"{found.total} frames", *(f"{symbol} ±" for symbol in SHOWN.values()))
    tell_table(headings, rows, styles=["bold", *[None] * (len(rows) - 1)])
    click.echo(
        f"± standard deviations expected of a fit of these frames alone. Designed pictures tell {found.bits:.2f} bits "
        f"more than the best usual ones ({found.best})"
    )


def _of_guess(
    file: Path, ink: tuple[float, float, float], noise: float, description: "RigFile"
) -> "tuple[Known, list[Shot], PhotographPlan, float]":
    from tankrig.advice.starting import from_guess
    from tankrig.live.photograph_plan import PhotographPlan
    from tankrig.scene import Medium
    from tankrig.sequence import load_sequence
    from ui.cli.run import tell_what_is_cut_off

    sequence = load_sequence(file)
    patterns = list(sequence.drawn(description.bench.wall).values())
    tell_what_is_cut_off(sequence, description)
    plan = PhotographPlan.of(description.bench, sequence, patterns)
    return from_guess(Medium(*ink), 1.0, noise), [], plan, sequence.exposure_ms


def _row(advice: "Advice") -> dict[str, Any]:
    candidate = advice.candidate
    return {
        "dose_ul": 1000.0 * candidate.shot.dose_ml,
        "volume_ul": candidate.volume_ul,
        "pattern": candidate.shot.pattern,
        "frames": candidate.shot.frames,
        "minutes": candidate.minutes,
        "relative_sd": advice.after.relative_sd,
        "bits": advice.bits,
        "bits_per_minute": advice.bits_per_minute,
        "bits_per_ul": advice.bits_per_ul,
    }


def _tell(before: "Expected | None", found: "list[Advice]") -> None:
    headings = ("next", "+µl", "min", *(f"{symbol} ±" for symbol in SHOWN.values()), "bits", "bits/min", "bits/ml")
    rows: list[tuple[str, ...]] = []
    if before is not None:
        rows.append(("as it is now", "", "", *_errors(before), "", "", ""))
    for advice in found:
        candidate = advice.candidate
        per_ml = "–" if advice.bits_per_ul is None else f"{1000.0 * advice.bits_per_ul:.2f}"
        rows.append((
            f"{candidate.shot.pattern} × {candidate.shot.frames}", f"{candidate.volume_ul:g}",
            f"{candidate.minutes:.2g}", *_errors(advice.after), f"{advice.bits:.2f}",
            f"{advice.bits_per_minute:.2f}", per_ml,
        ))  # fmt: skip
    tell_table(headings, rows, styles=["dim" if row[0] == "as it is now" else None for row in rows])
    click.echo(
        "± standard deviations expected: σs and σa relative, per ml of ink; g absolute. Bits below zero: a photograph "
        "in which the model's error outweighs what it tells. Fits of a real bench state larger ones: they count "
        "what no model describes"
    )


def _errors(found: "Expected") -> list[str]:
    sd = found.relative_sd
    return [f"{sd[name]:.5f}" if name == "g" else _percent(sd[name]) for name in SHOWN]


def _percent(share: float) -> str:
    """A relative standard deviation, to two digits; by how much what is unknown is unknown says nothing.

    >>> [_percent(one) for one in (0.0123, 0.996, 3.14, 1e5)]
    ['1.2 %', '100 %', '314 %', '> 999 %']
    """
    percent = 100.0 * share
    if percent < 99.5:
        return f"{percent:.2g} %"
    return f"{percent:.0f} %" if percent < 999.5 else "> 999 %"
