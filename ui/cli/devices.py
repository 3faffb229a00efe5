"""`tankrig devices`: what is connected."""

import json
from dataclasses import asdict

import click

from ui.cli.options import json_option


@click.command(epilog="Example: tankrig devices")
@json_option
def devices(as_json: bool) -> None:
    """List what is connected (serial ports, cameras, screens, USB), with the lines to put in a rig file."""
    from rich.console import Console

    from drivers.health import Found, find_devices
    from drivers.registry import driver_names

    with Console(stderr=True).status("looking"):
        found = list(find_devices())
    if as_json:
        listed = [asdict(item) if isinstance(item, Found) else {"trouble": str(item)} for item in found]
        click.echo(json.dumps({"found": listed, "drivers": driver_names()}, ensure_ascii=False))
        return
    for item in found:
        if isinstance(item, Found):
            click.echo(item.what)
            click.echo("".join(f"    {line}\n" for line in item.lines.splitlines()), nl=False)
        else:
            click.echo(f"({item})")
    if not found:
        click.echo("nothing is connected")
    click.echo(f"drivers: {', '.join(driver_names())}")
