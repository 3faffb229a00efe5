"""`tankrig compare`: the same image explained by single scattering, more and more orders, and other models."""

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tankrig.errors import ImageError
from ui.cli.fit import LEVEL
from ui.cli.options import FINITE, FreeOrNumber, json_option
from ui.cli.stages import stages_shown
from ui.cli.tables import tell_table

if TYPE_CHECKING:
    from tankrig.estimation.comparison import Compared, Comparison
    from tankrig.live.exposures import Photograph

SHOWN = {"sigma_s": "σs, 1/mm", "g": "g", "sigma_a": "σa, 1/mm"}
UNKNOWN = 10.0
"""Times a coefficient that is not zero: beyond that it says nothing by how much it is unknown."""
LEAST = {"sigma_s": 1e-3, "g": 1.0, "sigma_a": 1e-3}
"""What a coefficient counts as for that, however small it is; 1/mm, g has no unit."""


@click.command(epilog="Example: tankrig compare tank.npz --scene scene.toml")
@click.argument("given", metavar="RUN|IMAGE", type=click.Path(path_type=Path))
@click.option("--scene", "scene_file", type=click.Path(path_type=Path), metavar="FILE",
              help="Scene file (TOML) of what IMAGE shows; a run knows its own.")  # fmt: skip
@click.option("--array", metavar="NAME", help='Which array of an .npz; default: the only image, or "total".')
@click.option("--scale", type=FINITE, default=1.0, show_default=True, help="Radiance per count, W/mm²/sr.")
@click.option("--gain", type=FreeOrNumber(), default="free", show_default=True, help="Image per radiance.")
@click.option("--offset", type=FreeOrNumber(), default="free", show_default=True, help="Added to it.")
@click.option("--noise", type=FINITE, help="Standard deviation of a pixel; default: as seen.")
@click.option("--dose-ml", type=FINITE, help="Which dose of a run; default: the last.")
@click.option("--pattern", metavar="NAME", help="Which pattern of a run; default: its first.")
@click.option(
    "--phases", is_flag=True, help="Compare families of phase functions, all orders each, in place of models."
)
@json_option
def compare(
    given: Path, scene_file: Path | None, array: str | None, scale: float, gain: Any, offset: Any,
    noise: float | None, dose_ml: float | None, pattern: str | None, phases: bool, as_json: bool,
) -> None:  # fmt: skip
    """Fit RUN or IMAGE by several models and compare them in one table.

    Single scattering, orders 1 … 3 and 1 … 20, all orders in the tank, the paper's infinite medium, and the diffuse
    limit: what each leaves over, the coefficients it finds, and how far above the best its information criterion is.
    With --phases the same for families of phase functions, of which a free one counts each of its shapes.
    """
    import tankrig
    from tankrig.estimation.comparison import PHASES, compare_models
    from tankrig.image.reading import read_image
    from tankrig.scene.outline import blurred_pixels

    image: Any
    sigma: Any = noise
    mask: Any = None
    if given.is_dir():
        photograph = _photograph(given, dose_ml, pattern)
        shown = f"{photograph.pattern} at {photograph.dose_ml:g} ml"
        image, scene, mask = photograph.image, photograph.scene, photograph.mask
        sigma = photograph.noise if noise is None else noise
        offset = photograph.offset if offset == "free" else offset
    elif not given.exists():
        raise tankrig.ImageError(f"{given}: does not exist; give an image, or the folder of a run")
    elif scene_file is None:
        raise click.UsageError("an image needs --scene FILE")
    else:
        scene, image, shown = tankrig.load_scene(scene_file), read_image(given, array, scale), str(given)
        mask = blurred_pixels(scene)
    with stages_shown() as told:
        try:
            families = {"contenders": PHASES} if phases else {}
            found = compare_models(image, scene, gain, offset, sigma, progress=told, mask=mask, **families)
        except tankrig.ImageError as error:
            raise tankrig.ImageError(f"{given}: {error}") from error
    if as_json:
        rows = [_row(row) for row in found.rows]
        click.echo(json.dumps({"pixels": found.pixels, "effective_pixels": found.effective, "models": rows}))
    else:
        click.echo(shown)
        _tell(found)


def _photograph(folder: Path, dose_ml: float | None, pattern: str | None) -> "Photograph":
    """One of a run's photographs."""
    from tankrig.live.exposures import exposures_of
    from tankrig.run.reading import open_run

    photographs = exposures_of(open_run(folder)).photographs()
    doses = sorted({one.dose_ml for one in photographs})
    dose = min(doses, key=lambda one: abs(one - (dose_ml or doses[-1])), default=0.0)
    here = [one for one in photographs if one.dose_ml == dose and pattern in (None, one.pattern)]
    if not here or (dose_ml is not None and abs(dose - dose_ml) > 0.01 * dose):
        there = ", ".join(sorted({f"{one.pattern} at {one.dose_ml:g} ml" for one in photographs})) or "none"
        raise ImageError(f"{folder}: has no such photograph of ink; there is {there}")
    return here[0]


def _row(row: "Compared") -> dict[str, Any]:
    fit, contender = row.estimate, row.contender
    head = {"name": contender.name, "model": contender.model, "max_order": contender.max_order}
    if fit is None:
        return {**head, "error": row.refusal, "seconds": round(row.seconds, 3)}
    return {
        **head,
        "medium": {name: getattr(fit.medium, name) for name in SHOWN},
        "interval": {"level": LEVEL, **fit.interval(LEVEL)},
        "identifiable": fit.identifiable,
        "gain": fit.gain,
        "offset": fit.offset,
        "rmse": fit.rmse,
        "phase": contender.phase,
        "aic": row.aic,
        "bic": row.bic,
        "seconds": round(row.seconds, 3),
        "verdict": fit.verdict,
    }


def _tell(found: "Comparison") -> None:
    rows: list[tuple[str, ...]] = []
    styles: list[str | None] = []
    for row in found.rows:
        styles.append("dim" if row.estimate is None else "bold" if row.bic == 0.0 else None)
        if row.estimate is None:
            rows.append((row.contender.name, "–", "", "", "", "", "", f"{row.seconds:.1f}"))
            continue
        numbers = f"{row.aic:.0f}", f"{row.bic:.0f}", f"{row.seconds:.1f}"
        rows.append((row.contender.name, f"{row.estimate.rmse:.3g}", *_cells(row), *numbers))
    tell_table(("model", "RMSE", *SHOWN.values(), "ΔAIC", "ΔBIC", "s"), rows, styles=styles)
    click.echo(
        f"RMSE in the image's unit; ± half of the {LEVEL:.0%} interval; a coefficient in brackets is not determined; "
        f"criteria count {found.effective:.0f} independent pixels of {found.pixels}"
    )
    best = next((row for row in found.rows if row.bic == 0.0), None)
    if best is not None and best.estimate is not None:
        click.echo(f"{best.contender.name}, by this image alone: {best.estimate.verdict}")
    for row in found.rows:
        if row.refusal:
            click.echo(f"{row.contender.name}: {row.refusal}")


def _cells(row: "Compared") -> list[str]:
    assert row.estimate is not None
    cells = []
    for name, (low, high) in row.estimate.interval(LEVEL).items():
        text = _with_half(getattr(row.estimate.medium, name), 0.5 * (high - low), LEAST[name])
        cells.append((name, text if row.estimate.identifiable[name] else f"({text})"))
    return [dict(cells)[name] for name in SHOWN]


def _with_half(value: float, half: float, least: float) -> str:
    """A coefficient with half of its interval, to two digits of that; `least` is one of `LEAST`.

    >>> _with_half(0.0198001, 0.00000213, 1e-3), _with_half(0.015, 87801.0, 1e-3), _with_half(0.2, 3.0, 1.0)
    ('0.0198001±0.0000021', '0.015±> 999 %', '0.2±3.0')
    """
    if not half < UNKNOWN * max(abs(value), least):
        return f"{value:.3g}±> 999 %"
    digits = min(9, max(0, 1 - math.floor(math.log10(half)))) if half > 0.0 else 6
    return f"{value:.{digits}f}±{half:.{digits}f}"
