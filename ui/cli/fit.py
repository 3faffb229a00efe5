"""`tankrig fit`: from an image of the tank to the coefficients of the liquid in it."""

import json
import math
import time
import warnings
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ui.cli.options import FINITE, FiniteRange, FreeOrNumber, json_option, out_option, scene_option
from ui.cli.raw_picture import Measured, RawPicture, picture_for_fit
from ui.cli.stages import stages_shown
from ui.cli.tables import tell_table

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tankrig.estimation.estimate import Estimate
    from tankrig.estimation.phase_result import Scattering
    from tankrig.estimation.result import Reconstruction
    from tankrig.live.one_picture import Picture
    from tankrig.scene import Medium

LEVEL = 0.95
"""Of the intervals that are printed."""

NOTHING = 10.0
"""Times a value from which on a standard deviation says nothing, its digits neither: they would make the value 0."""

FORMAT = "tankrig fit 1"
"""Of the JSON, whose schema is fit-1.schema.json beside this file: keys may be added, and none changes its meaning."""


def _print_schema(ctx: click.Context, _: click.Parameter, asked: bool) -> None:
    if asked and not ctx.resilient_parsing:
        click.echo(Path(__file__).with_name("fit-1.schema.json").read_text(encoding="utf-8").rstrip())
        ctx.exit()


class Edges(click.ParamType[Any]):
    """The words "auto" or "none", or mm."""

    name = "auto|none|MM"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Text to None (what the scene says), or mm; 0 for none."""
        if value is None or isinstance(value, float):
            return value
        if value in ("auto", "none"):
            return None if value == "auto" else 0.0
        try:
            number = float(value)
        except ValueError:
            number = math.nan
        if not number > 0.0 or math.isinf(number):
            self.fail(f'{value!r} is neither "auto" nor "none" nor a length in mm', param, ctx)
        return number


class Nuisance(click.ParamType[Any]):
    """NAME=SD, such as z_mm=0.5."""

    name = "NAME=SD"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Text to (name, standard deviation)."""
        if isinstance(value, tuple):
            return value
        name, _, text = value.partition("=")
        try:
            number = float(text)
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            self.fail(f"{value!r} is not NAME=SD, such as z_mm=0.5", param, ctx)
        return name, number


@click.command(
    epilog="Example: tankrig fit tank.png --scene scene.toml --rig rig.toml --exposure-ms 40 --dark dark.png"
)
@click.argument("image_file", metavar="IMAGE", type=click.Path(path_type=Path))
@scene_option
@click.option("--array", metavar="NAME", help='Which array of an .npz; default: the only image, or "total".')
@click.option("--scale", type=FINITE, default=1.0, show_default=True, help="Radiance per count, W/mm²/sr.")
@click.option(
    "--gain", type=FreeOrNumber(), default="free", show_default=True, help="Image per radiance, after --scale."
)
@click.option("--offset", type=FreeOrNumber(), default="free", show_default=True, help="Added to it, after --scale.")
@click.option("--noise", type=FINITE, help="Standard deviation of a pixel, after --scale; default: seen in the image.")
@click.option(
    "--model",
    default="tank",
    show_default=True,
    metavar="NAME",
    help="tank, prepared, single, convolution, diffuse, montecarlo.",
)
@click.option(
    "--phase",
    metavar="NAME",
    help="How one scattering turns light: hg, two-term, reynolds-mccormick, fournier-forand, free, mie or table (the "
    "scene's), any (weighed by evidence); default: the scene's, or hg, and any where that does not hold.",
)
@click.option(
    "--nuisance",
    type=Nuisance(),
    multiple=True,
    help="Fit along what may be off, with its standard deviation: z_mm, y_mm, tilt_mrad, scale; halo, "
    "halo_width, veil, blur_mm2, floor, pane, black_level, projector_halo.",
)
@click.option(
    "--rig",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Rig file of the bench: the radiometry in force makes radiance of raw frames.",
)
@click.option(
    "--exposure-ms", type=FiniteRange(min=0.0, min_open=True), help="IMAGE is a raw frame with this exposure."
)
@click.option(
    "--gain-setting",
    type=FiniteRange(min=0.0, min_open=True),
    default=1.0,
    show_default=True,
    help="Gain that the camera was set to.",
)
@click.option("--dark", type=click.Path(path_type=Path), metavar="FILE", help="Raw frame without light, subtracted.")
@click.option(
    "--dark-pattern",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Raw frame of the projector's dark picture, subtracted: its black level and the room's light go with it.",
)
@click.option("--mask", type=click.Path(path_type=Path), metavar="FILE", help="Image; where it is not 0 is left out.")
@click.option(
    "--edges",
    type=Edges(),
    default="auto",
    show_default=True,
    help="Leave out what lenses blur at the sides of beams: as the scene's blur says, none, or so far to either side.",
)
@click.option("--max-order", type=click.IntRange(min=1), help="Fit orders of scattering 1 … N only.")
@out_option("out", "Folder for the picture (.png), the numbers (.json) and the images (.npz).")
@json_option
@click.option(
    "--schema",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_print_schema,
    help="Print the JSON schema of what --json prints, and end.",
)
def fit(
    image_file: Path,
    scene_file: Path,
    array: str | None,
    scale: float,
    gain: Any,
    offset: Any,
    noise: float | None,
    model: str,
    phase: str | None,
    nuisance: tuple[tuple[str, float], ...],
    rig: Path | None,
    exposure_ms: float | None,
    gain_setting: float,
    dark: Path | None,
    dark_pattern: Path | None,
    mask: Path | None,
    edges: float | None,
    max_order: int | None,
    out: Path,
    as_json: bool,
) -> None:
    """Fit σa, σs and g to IMAGE, a picture of the lit tank.

    IMAGE is .npz, .npy, or a 16-bit or floating-point .png or .tif whose pixels are those of the scene's camera. With
    --exposure-ms it is a raw frame, counts of 8 or 16 bits, and becomes radiance by --rig and --dark or
    --dark-pattern. A calibrated camera's pixels are put together to bins, and what lenses blur at the sides of beams is
    left out.

    Prints the coefficients with intervals, a verdict, and how well 1, 3, 20 and all orders of scattering rebuild the
    image; writes a picture of that beside the observation.
    """
    import tankrig
    from tankrig.estimation.result import by_order
    from tankrig.estimation.stated_errors import FINE
    from tankrig.files import require_writable, whole_file
    from tankrig.image.prediction_file import error_of_prediction
    from tankrig.live.one_picture import brighter_far

    if dark is not None and dark_pattern is not None:
        raise click.UsageError("--dark-pattern holds what --dark does; give one of them")
    for name, given in (("--dark", dark), ("--dark-pattern", dark_pattern), ("--rig", rig)):
        if exposure_ms is None and given is not None:
            raise click.UsageError(f"{name} belongs to a raw frame; give its --exposure-ms too")
    measured = None if rig is None else Measured.of(rig)
    subtracted = dark_pattern or dark
    raw = None
    if exposure_ms is not None:
        raw = RawPicture(exposure_ms, gain_setting, subtracted, measured, dark_pattern is not None)
    try:
        picture = picture_for_fit(image_file, scene_file, array, scale, raw, edges, mask)
    except tankrig.ImageError as error:
        raise error if str(image_file) in str(error) else tankrig.ImageError(f"{image_file}: {error}") from error
    notes = [] if raw is None else raw.notes(picture.scene, scene_file)
    if (times := brighter_far(picture)) > 1.0:
        notes.append(
            f"{image_file} is {times:.2g} times as bright at the far end as where light enters, at column 0; if it is "
            "mirrored or turned by half a turn, no liquid explains it"
        )
    for note in notes:
        click.echo(f"note: {note}", err=True)
    told = len(notes)
    require_writable(out)
    if raw is not None and subtracted is not None and offset == "free":
        offset = 0.0
    scene, image, stem = picture.scene, picture.image, out / f"{image_file.stem}-fit"
    asked: dict[str, Any] = {"gain": gain, "offset": offset, "noise": noise, "nuisance": dict(nuisance)}
    own_error = error_of_prediction(image_file, scale) if raw is None and array is None else None
    if own_error is not None and picture.bins is not None:
        own_error = picture.bins.means(own_error)
    seen: dict[str, Any] = {**asked, "mask": picture.mask if picture.mask.any() else None, "image_error": own_error}
    fitted = None
    with stages_shown() as tell:
        started = time.perf_counter()
        if model == "prepared":
            tell("preparing a model of the scene, once")
        try:
            with warnings.catch_warnings(record=True) as warned:
                warnings.simplefilter("always", UserWarning)
                fitted = tankrig.estimate(
                    image, scene, **seen, model=model, max_order=max_order, phase=phase, progress=tell
                )
            notes += [str(one.message) for one in warned]
            seconds = time.perf_counter() - started
            tell("rebuilding by order")
            whole = "tank" if model == "prepared" else model  # a prepared model doesn't tell orders apart
            prediction = tankrig.predict(replace(scene, medium=fitted.medium), whole, FINE, max_order)
            rebuilt = by_order(fitted, prediction)
            tell("comparing with single scattering")
            single = tankrig.estimate(image, scene, **seen, model="single", phase="hg") if model != "single" else None
        except tankrig.ImageError as error:
            raise tankrig.ImageError(f"{image_file}: {error}") from error
        except KeyboardInterrupt:
            if fitted is None:
                raise
            found = {
                "format": FORMAT,
                "image": str(image_file),
                "scene": str(scene_file),
                **asked,
                **_numbers(fitted, (), None),
            }
            with whole_file(stem.with_name(f"{stem.name}.json")) as file:
                text = json.dumps({**found, "unfinished": True}, ensure_ascii=False, indent=1)
                file.write_text(text + "\n", encoding="utf-8")
            raise tankrig.TankrigError(
                f"stopped on request; the coefficients had been found and are in {stem}.json, said to be unfinished: "
                "without picture, orders and single scattering"
            ) from None
        tell("drawing")
        numbers = {
            "format": FORMAT,
            "image": str(image_file),
            "scene": str(scene_file),
            **asked,
            **_numbers(fitted, rebuilt, single),
            **_left_out(picture, fitted),
            "radiometry": None if measured is None else measured.radiometry_file,
            "notes": notes,
            "seconds": round(seconds, 2),
            "picture": f"{stem}.png",
            "arrays": f"{stem}.npz",
        }
        _write(stem, numbers, scene, fitted, rebuilt, single, max_order)
    for note in notes[told:]:
        click.echo(f"note: {note}", err=True)
    if as_json:
        click.echo(json.dumps(numbers, ensure_ascii=False))
    else:
        _tell(fitted, rebuilt, single, seconds, max_order)
        _tell_left_out(picture, fitted)
        if measured is not None:
            click.echo(f"by       {measured.radiometry_file}")
        click.echo(f"written  {stem}.png, .json, .npz")


def _left_out(picture: "Picture", fitted: "Estimate") -> dict[str, Any]:
    bins = picture.bins
    share = _share_left_out(fitted)
    return {
        "bins": None if bins is None else [bins.by, bins.along],
        "left_out": {
            "edges": picture.blurred,
            "saturated": picture.saturated,
            "by_fit": share - float(picture.mask.mean()),
            "all": share,
        },
    }


def _share_left_out(fitted: "Estimate") -> float:
    """Of the image that was fitted: what was masked before, and what the fit itself found to be specks or saturated."""
    import numpy as np

    return float(np.isnan(fitted.residual).mean())


def _tell_left_out(picture: "Picture", fitted: "Estimate") -> None:
    if picture.bins is not None:
        tall, wide = picture.scene.camera.sides_mm
        pixels = "pixel" if picture.bins.by * picture.bins.along == 1 else "pixels"
        click.echo(f"bins     {picture.bins.by} × {picture.bins.along} {pixels}, {tall:.3g} × {wide:.3g} mm")
    if (share := _share_left_out(fitted)) > 0.0:
        edges = f", {_share(picture.blurred)} of the pixels for blur or beside the water" if picture.blurred else ""
        click.echo(f"left out {_share(share)} of the image{edges}")
    if picture.saturated > 0.0:
        click.echo(
            f"         {100.0 * picture.saturated:.2g} % of the pixels are saturated, and left out with what adjoins "
            "them; a shorter exposure tells more"
        )


def _share(part: float) -> str:
    """A share in percent, and never as none where there is some.

    >>> _share(0.124), _share(0.0031)
    ('12 %', '0.31 %')
    """
    return f"{100.0 * part:.2g} %" if part < 0.01 else f"{100.0 * part:.0f} %"


def _coefficients(medium: "Medium") -> dict[str, float]:
    return {"sigma_a": medium.sigma_a, "sigma_s": medium.sigma_s, "g": medium.g}


def _numbers(fitted: "Estimate", rebuilt: "Sequence[Reconstruction]", single: "Estimate | None") -> dict[str, Any]:
    numbers = {
        "model": fitted.model,
        "medium": _coefficients(fitted.medium),
        "standard_deviation": {
            name: math.sqrt(fitted.covariance[k, k]) for k, name in enumerate(("sigma_a", "sigma_s", "g"))
        },
        "covariance": fitted.covariance.tolist(),
        "interval": {"level": LEVEL, **fitted.interval(LEVEL)},
        "identifiable": fitted.identifiable,
        "gain": fitted.gain,
        "offset": fitted.offset,
        "noise": fitted.noise,
        "model_error": fitted.model_error,
        "rmse": fitted.rmse,
        "rmse_by_order": {one.orders: one.rmse for one in rebuilt},
        "nuisance_found": {name: {"value": value, "sd": sd} for name, (value, sd) in fitted.nuisance.items()},
        "verdict": fitted.verdict,
    }
    if fitted.scattering is not None:
        numbers |= _scattering_numbers(fitted.scattering)
    if single is not None:
        numbers["single"] = {"medium": _coefficients(single.medium), "rmse": single.rmse, "verdict": single.verdict}
    return numbers


def _scattering_numbers(scattering: "Scattering") -> dict[str, Any]:
    """Of the phase function: what it is described by, its curve with a band, and what follows from it."""
    from tankrig.estimation.phase_families import CONE_DEG

    curve = scattering.curve
    low, high = curve.band(LEVEL)
    pairs = {
        "sigma_s_p90": scattering.at_right_angle, "reduced_scattering": scattering.reduced,
        f"sigma_s_beyond_{CONE_DEG:g}deg": scattering.outside_cone,
    }  # fmt: skip
    per_m = {}
    if scattering.beta is not None:
        least, most = scattering.beta.band(LEVEL)
        per_m = {"beta": scattering.beta.value.tolist(), "beta_low": least.tolist(), "beta_high": most.tolist()}
    return {
        "phase": {
            "families": dict(scattering.families),
            "parameters": {name: {"value": value, "sd": sd} for name, (value, sd) in scattering.parameters.items()},
            "angle_deg": curve.angle_deg.tolist(),
            "value": curve.value.tolist(),
            "low": low.tolist(),
            "high": high.tolist(),
            **per_m,
            "level": LEVEL,
        },
        **{name: {"value": value, "sd": sd} for name, (value, sd) in pairs.items()},
    }


def _write(
    stem: Path,
    numbers: dict[str, Any],
    scene: Any,
    fitted: "Estimate",
    rebuilt: "Sequence[Reconstruction]",
    single: "Estimate | None",
    max_order: int | None,
) -> None:
    """Picture, numbers and images: all of them or none."""
    import numpy as np

    from tankrig.figures.fit_figure import write_fit_figure
    from tankrig.files import whole_file

    with ExitStack() as files:
        picture, text, arrays = (
            files.enter_context(whole_file(stem.with_name(stem.name + suffix))) for suffix in (".png", ".json", ".npz")
        )
        write_fit_figure(picture, scene, fitted, rebuilt, single, max_order)
        text.write_text(json.dumps(numbers, ensure_ascii=False, indent=1) + "\n", encoding="utf-8")
        images = {f"orders_{one.orders.replace('–', '_')}": one.image for one in rebuilt}
        images |= {} if fitted.structure is None else {"structure": fitted.structure}
        np.savez_compressed(arrays, allow_pickle=False, fitted=fitted.image, residual=fitted.residual, **images)


def _tell(
    fitted: "Estimate",
    rebuilt: "Sequence[Reconstruction]",
    single: "Estimate | None",
    seconds: float,
    max_order: int | None,
) -> None:
    from rich.console import Console

    from tankrig.estimation.phase_families import CONE_DEG
    from tankrig.estimation.result import ALL_ORDERS, light_of, told_apart

    rows: list[tuple[str, ...]] = []
    for k, (name, (low, high)) in enumerate(fitted.interval(LEVEL).items()):
        sd = math.sqrt(fitted.covariance[k, k])
        value = getattr(fitted.medium, name)
        unit = "" if name == "g" else "/mm"
        digits_of = math.nan if sd > NOTHING * abs(value) else sd
        shown = [_rounded(one, digits_of) for one in (value, sd, low, high)]
        known = "yes" if fitted.identifiable[name] else "no"
        rows.append((name, shown[0], shown[1], f"{shown[2]} … {shown[3]}", unit, known))
    scattering = fitted.scattering
    further = list(fitted.nuisance.items())
    if scattering is not None and fitted.medium.phase is not None:
        further += [(f"σs beyond {CONE_DEG:g}°", scattering.outside_cone)]
        further += [("σs(1−g)", scattering.reduced), ("σs p(90°)", scattering.at_right_angle)]
        # A family may call a parameter of its own g, which is not the liquid's mean cosine.
        likeliest = max(scattering.families, key=lambda family: scattering.families[family], default="")
        # What has no error was given, as a label's wavelength is, and is no result.
        further += [(f"{name} of {likeliest}", one) for name, one in scattering.parameters.items() if one[1] > 0.0]
    rows += [(name, _rounded(value, sd), _rounded(sd, sd), "", "", "") for name, (value, sd) in further]
    tell_table(("", "fitted", "±", f"{LEVEL:.0%} interval", "", "determined"), rows, left=(0, 4, 5))
    console = Console()
    if scattering is not None and fitted.medium.phase is not None:
        shares = ", ".join(f"{name} {100.0 * share:.3g} %" for name, share in scattering.families.items())
        of = "its mean cosine" if len(scattering.families) == 1 else "the mean cosine of what they make together"
        console.print(f"\nphase function  {shares}; g is {of}", highlight=False)
    console.print(f"\n{fitted.verdict}\n", highlight=False, markup=False)
    whole = light_of(fitted.model, max_order)
    last = "all" if whole.startswith(ALL_ORDERS) else whole.removeprefix("orders ")
    told = [(last if one.orders == "all" else one.orders, one.rmse) for one in told_apart(rebuilt, max_order)]
    by_order = f"{whole}: {told[0][1]:.3g}" if len(told) == 1 else "orders " + ",  ".join(
        f"{name}: {rmse:.3g}" for name, rmse in told
    )  # fmt: skip
    console.print(
        f"model    {fitted.model}, {seconds:.1f} s; gain {fitted.gain:.5g}, offset {fitted.offset:.3g}", highlight=False
    )
    console.print(f"RMSE     {by_order}", highlight=False)
    if single is not None:
        ratio = single.medium.sigma_t / fitted.medium.sigma_t
        text = f"         single scattering alone: {single.rmse:.3g}, with {ratio:.3g} times that σa + σs"
        console.print(text, highlight=False)


def _rounded(value: float, sd: float) -> str:
    """A value to two digits of its standard deviation; to three of its own where that is not known.

    >>> _rounded(0.0198, 0.00021), _rounded(0.0198, math.nan), _rounded(217414.2, math.nan)
    ('0.01980', '0.0198', '2.17e+05')
    """
    if math.isnan(sd):
        return f"{value:.3g}"
    if not math.isfinite(value) or sd <= 0.0:
        return f"{value:.4g}"
    return f"{value:.{max(0, 1 - math.floor(math.log10(sd)))}f}"
