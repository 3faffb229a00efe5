"""The command line: `tankrig COMMAND …`, one file per command, each loaded when it is asked for."""

import errno
import importlib
import keyword
import os
import sys
import tempfile
import traceback
from collections.abc import Sequence
from typing import Any

import click

from tankrig.errors import DecisionError, StoreError, TankrigError, UndecidedError

DONE, FAILURE, BAD_INPUT, DECISION = 0, 1, 2, 3

COMMANDS = (
    "demo",
    "run",
    "gui",
    "advise",
    "fit",
    "compare",
    "scene",
    "predict",
    "prepare",
    "benchmark",
    "benchmark-estimates",
    "devices",
    "doctor",
    "calibrate",
    "recover",
    "refit",
    "archive",
    "import",
    "export",
    "report",
    "materials",
    "validate",
    "export-medium",
)
"""In the order that help lists them; `ui/cli/NAME.py` holds the click command `NAME`, with _ for -, and one
behind a word of Python's own."""

DISK_FAILED = {errno.ENOSPC, errno.EDQUOT, errno.EIO}


class Commands(click.Group):
    """The commands of `COMMANDS`, imported on use so that none pays for another's libraries."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names in the order of `COMMANDS`."""
        return [*COMMANDS, *super().list_commands(ctx)]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Load the command, or None when there is none of this name."""
        if cmd_name not in COMMANDS:
            return super().get_command(ctx, cmd_name)
        name = cmd_name.replace("-", "_") + "_" * keyword.iskeyword(cmd_name)
        command: click.Command = getattr(importlib.import_module(f"ui.cli.{name}"), name)
        return command


@click.group(
    cls=Commands,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
    epilog="Example: tankrig predict scene.toml --out predicted",
)
@click.version_option(package_name="tankrig", message="tankrig %(version)s")
def tankrig() -> None:
    """Predict and measure how light scatters in a tank, and run the rig that does it.

    Exit status: 0 done, 1 failure, 2 bad input, 3 a person has to decide.
    """


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; whatever goes wrong becomes one sentence on stderr and an exit status.

    Parameters
    ----------
    arguments
        Without the program's name; None: those of the process.

    Returns
    -------
    int
        0 done, 1 failure, 2 bad input, 3 a person has to decide. With TANKRIG_DEBUG=1 in the environment an error
        that is not tankrig's own is raised instead.
    """
    try:
        result: Any = tankrig.main(arguments, prog_name="tankrig", standalone_mode=False)
    except click.exceptions.NoArgsIsHelpError as error:
        error.show()
        return BAD_INPUT
    except click.UsageError as error:
        where = error.ctx.command_path if error.ctx else "tankrig"
        return _say(f"{error.format_message().rstrip('.')}; see {where} --help", BAD_INPUT)
    except click.ClickException as error:
        return _say(error.format_message(), BAD_INPUT)
    except click.Abort:
        return _say("stopped on request", FAILURE)
    except TankrigError as error:
        return _say(str(error), _status(error))
    except Exception as error:
        if os.environ.get("TANKRIG_DEBUG") == "1":
            raise
        return _say(f"failed unexpectedly ({type(error).__name__}: {error}); {_kept_traceback()}", FAILURE)
    return result if isinstance(result, int) else DONE


def _status(error: TankrigError) -> int:
    if isinstance(error, UndecidedError | DecisionError):
        return DECISION
    cause = error.__cause__
    disk_failed = isinstance(error, StoreError) and isinstance(cause, OSError) and cause.errno in DISK_FAILED
    # A device or a scheduler that did not do what it was asked is a failure, whatever was typed.
    return FAILURE if isinstance(error, RuntimeError) or disk_failed else BAD_INPUT


def _say(sentence: str, status: int) -> int:
    click.echo(f"tankrig: {sentence}", err=True)
    return status


def _kept_traceback() -> str:
    """Write the traceback of the exception being handled to a file, and say where."""
    try:
        with tempfile.NamedTemporaryFile("w", prefix="tankrig-", suffix=".txt", encoding="utf-8", delete=False) as file:
            file.write(f"{' '.join(sys.argv)}\n\n{traceback.format_exc()}")
    except OSError:
        return "run again with TANKRIG_DEBUG=1 to see where"
    return f"what happened is in {file.name}; please send it to the developers"
