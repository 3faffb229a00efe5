"""`tankrig gui`: the bench window."""

from pathlib import Path

import click

from tankrig.errors import MissingExtraError
from ui.cli.options import rig_option


@click.command(epilog="Example: tankrig gui dilution.toml --rig rig.toml")
@click.argument("sequence_file", metavar="[SEQUENCE]", required=False, type=click.Path(path_type=Path))
@click.option("--runs", type=click.Path(path_type=Path), default="runs", show_default=True, metavar="FOLDER",
              help="Where runs are recorded and looked for.")  # fmt: skip
@rig_option
def gui(sequence_file: Path | None, runs: Path, rig: Path | None) -> int:
    """Open the bench window: camera, projector, doser, sequence, live fit and runs in one place.

    Without a rig file it opens on the simulated rig, and says so. F1 lists the keys; F12 stops the doser.
    """
    try:
        from ui.window.app import run_window
    except ModuleNotFoundError:
        raise
    except ImportError as error:  # a library of the system that Qt's own need
        raise MissingExtraError(
            f"the window needs a library of the system that is missing ({error}); on Debian or Ubuntu run: "
            f"sudo apt install libegl1 libgl1 libxkbcommon0 libdbus-1-3 libfontconfig1 libxcb-cursor0"
        ) from error

    return run_window(rig, runs, sequence_file)
