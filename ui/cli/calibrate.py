"""`tankrig calibrate …`: measure what the rig file rests on."""

import importlib
from typing import Any

import click

CALIBRATIONS = ("camera", "stray", "tank", "projector", "radiometry", "latency", "pump")
"""`ui/cli/calibrate_NAME.py` holds the click command `NAME`."""


class Calibrations(click.Group):
    """The commands of `CALIBRATIONS`, imported on use."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names in the order of `CALIBRATIONS`."""
        return [*CALIBRATIONS, *super().list_commands(ctx)]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Load the command, or None when there is none of this name."""
        if cmd_name not in CALIBRATIONS:
            return super().get_command(ctx, cmd_name)
        found: Any = getattr(importlib.import_module(f"ui.cli.calibrate_{cmd_name}"), cmd_name)
        command: click.Command = found
        return command


@click.group(cls=Calibrations, epilog="Example: tankrig calibrate radiometry --rig rig.toml")
def calibrate() -> None:
    """Measure the devices of a rig, and write dated files of what was found.

    `tankrig doctor` says which of them are missing, out of date, or do not fit the rig.
    """
