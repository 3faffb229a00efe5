"""Options that several commands share, so that they are spelt and explained the same everywhere."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

Command = TypeVar("Command", bound=Callable[..., Any])


class Finite(click.types.FloatParamType):
    """A finite number: click's own floats are also nan and inf, which no quantity of a rig is."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Text to a finite float."""
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value!r} is not a finite number", param, ctx)
        return number


FINITE = Finite()


class FiniteRange(click.FloatRange):
    """A finite number in a range: nan is neither below nor above one, so click's own ranges let it in."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Text to a finite float in the range."""
        return super().convert(FINITE.convert(value, param, ctx), param, ctx)


class FreeOrNumber(click.ParamType[Any]):
    """The word "free", or a finite number."""

    name = "free|NUMBER"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Text to "free" or float."""
        if value == "free" or isinstance(value, float):
            return value
        try:
            number = float(value)
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            self.fail(f'{value!r} is neither "free" nor a finite number', param, ctx)
        return number


def _rig_option(otherwise: str) -> Callable[[Command], Command]:
    return click.option(
        "--rig",
        type=click.Path(path_type=Path),
        envvar="TANKRIG_RIG",
        metavar="FILE",
        help=f"Rig file (TOML) that names the devices; default: $TANKRIG_RIG, else the simulated {otherwise}.",
    )


rig_option = _rig_option("rig")

bench_option = _rig_option("bench")
"""The same for commands that calibrate: of the simulated rig nothing can be calibrated, of the simulated bench all."""

scene_option = click.option(
    "--scene",
    "scene_file",
    type=click.Path(path_type=Path),
    required=True,
    metavar="FILE",
    help="Scene file (TOML) of what the image shows.",
)

json_option = click.option("--json", "as_json", is_flag=True, help="Print one line of JSON instead of text.")


def out_option(default: str | None, what: str) -> Callable[[Command], Command]:
    """`--out PATH`, with what is written there in the words of the command's help."""
    return click.option(
        "--out",
        type=click.Path(path_type=Path),
        default=default,
        show_default=default is not None,
        metavar="PATH",
        help=what,
    )


phase_option = click.option(
    "--phase",
    type=click.Choice(["hg", "two-term", "reynolds-mccormick", "fournier-forand", "free", "any"]),
    help="How one scattering turns light, as fits search it; default: what the sequence says by its phase, material or "
    "ink, else hg.",
)
