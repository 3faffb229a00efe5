"""The command line: `tankrig COMMAND …`, one file per command, each loaded when it is asked for."""

import difflib
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

from tankrig.errors import DecisionError, MissingExtraError, SettingsError, TankrigError, UndecidedError
from tankrig.extras import missing

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
    "separate",
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
_OF_A_PATH = {errno.ENAMETOOLONG, errno.ENOENT, errno.ENOTDIR, errno.EISDIR, errno.ELOOP, errno.EACCES, errno.EROFS}
"""Errors of a path that a person has given, where nothing has told them in better words."""


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

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """As click does, but a name that is mistyped is asked for among `COMMANDS`, none of which is loaded yet."""
        name = args[0]
        if not ctx.resilient_parsing and not name.startswith("-") and self.get_command(ctx, name) is None:
            near = difflib.get_close_matches(name, self.list_commands(ctx), n=1)
            ctx.fail(f"No such command {name!r}" + (f"; did you mean {near[0]!r}?" if near else ""))
        return super().resolve_command(ctx, args)


@click.group(
    cls=Commands,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
    epilog="Example: tankrig predict scene.toml --out predicted",
)
@click.version_option(package_name="tankrig", message="tankrig %(version)s")
def tankrig() -> None:
    """Predict and measure how light scatters in a tank, and run the rig that does it.

    Exit status: 0 done, 1 failure, 2 bad input, 3 a person has to decide. An image that misses its tolerance, a liquid
    that is not determined and a comparison that is not passed are results: they are said, and the status is 0.
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
        words = sys.argv[1:] if arguments is None else arguments
        asked = next((f"tankrig {word}" for word in words if word in COMMANDS), "tankrig")  # click forgets it at times
        where = error.ctx.command_path if error.ctx else asked
        # click puts each choice on a line of its own, and a question into a sentence of its own.
        said = error.format_message().replace("\n\t", " ").replace(". Did you mean", "; did you mean").rstrip(".")
        return _say(f"{said} (see {where} --help)" if said.endswith("?") else f"{said}; see {where} --help", BAD_INPUT)
    except click.ClickException as error:
        return _say(error.format_message(), BAD_INPUT)
    except click.Abort:
        return _say("stopped on request", FAILURE)
    except TankrigError as error:
        return _say(str(error), exit_status(error))
    except ModuleNotFoundError as error:
        if said := missing(error, "this"):
            return _say(said, FAILURE)
        return _unexpected(error)
    except MemoryError as error:
        return _say(f"needs more memory than there is ({error}); ask for less, or for fewer pixels", FAILURE)
    except Exception as error:
        if isinstance(error, OSError) and error.errno in _OF_A_PATH and error.filename:
            return _say(f"{error.filename}: cannot be used ({error.strerror}); give another path", BAD_INPUT)
        if isinstance(error, OSError) and error.errno in DISK_FAILED:
            return _say(f"{error.filename or 'a file'}: cannot be written ({error.strerror}); see to the disk", FAILURE)
        return _unexpected(error)
    return result if isinstance(result, int) else DONE


def _unexpected(error: Exception) -> int:
    """Say that something went wrong that is not tankrig's own error; called while it is handled."""
    if os.environ.get("TANKRIG_DEBUG") == "1":
        raise error
    return _say(f"failed unexpectedly ({type(error).__name__}: {error}); {_kept_traceback()}", FAILURE)


def exit_status(error: TankrigError) -> int:
    """The exit status of a command that ends with this error."""
    if isinstance(error, UndecidedError | DecisionError):
        return DECISION
    if isinstance(error, SettingsError):
        return BAD_INPUT
    # A device or a scheduler that did not do what it was asked is a failure, whatever was typed.
    return FAILURE if isinstance(error, RuntimeError | MissingExtraError) or _disk_failed(error) else BAD_INPUT


def _disk_failed(error: BaseException | None) -> bool:
    """Whether a disk is behind an error, however often that was put into other words."""
    seen: list[BaseException] = []
    while error is not None and error not in seen:  # an error may be raised from itself
        if isinstance(error, OSError) and error.errno in DISK_FAILED:
            return True
        seen.append(error)
        error = error.__cause__
    return False


def _say(sentence: str, status: int) -> int:
    click.echo(f"tankrig: {_on_one_line(sentence)}", err=True)
    return status


def _on_one_line(sentence: str) -> str:
    r"""A sentence with the letters escaped that would tear it apart: a file's name or a key may hold any.

    >>> print(_on_one_line('key "a' + chr(10) + 'b" is unknown'))
    key "a\nb" is unknown
    """
    lines = sentence.strip()
    return "".join(letter if letter.isprintable() else letter.encode("unicode_escape").decode() for letter in lines)


def _kept_traceback() -> str:
    """Write the traceback of the exception being handled to a file, and say where."""
    try:
        with tempfile.NamedTemporaryFile("w", prefix="tankrig-", suffix=".txt", encoding="utf-8", delete=False) as file:
            file.write(f"{' '.join(sys.argv)}\n\n{traceback.format_exc()}")
    except OSError:
        return "run again with TANKRIG_DEBUG=1 to see where"
    return f"what happened is in {file.name}; please send it to the developers"
