"""How a calibration talks with the person at the bench: on a terminal, or line by line with a window that shows it.

With TANKRIG_GUIDED=1 in the environment each line of output is a JSON object with one key: `ask` (a request, to answer
with an empty line), `number` (answer with a number), `say`, `watch` (of the moment only), `look` (see `Look`), `kept`
(the result). Answers are read from the input.
"""

import base64
import io
import json
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from typing import IO, TYPE_CHECKING, Any, cast

import click

if TYPE_CHECKING:
    from rich.console import Console

    from tankrig.calibration.lit_camera import Look
    from tankrig.devices import Pixels

GUIDED = "TANKRIG_GUIDED"
_APART_S = 0.1
_WIDTH = 160


def guided() -> bool:
    """Whether a window leads the person."""
    return os.environ.get(GUIDED) == "1"


def somebody() -> bool:
    """Whether there is a person who can be asked."""
    return guided() or sys.stdin.isatty()


def emit(key: str, value: Any) -> None:
    """A line for the window."""
    sys.stdout.write(json.dumps({key: value}, ensure_ascii=False) + "\n")
    sys.stdout.flush()


def ask(request: str) -> None:
    """Ask for something to be done, and wait until it is."""
    if guided():
        emit("ask", request)
        _answer()
    else:
        click.prompt(f"{request} Then Enter", "", show_default=False, err=True)


def confirm(question: str) -> None:
    """Go on only if a person says that it is so."""
    if guided():
        ask(question)
    else:
        click.confirm(question, abort=True)


def number(what: str) -> float:
    """Ask for a number."""
    if not guided():
        value: float = click.prompt(what, type=float)
        return value
    while True:
        emit("number", what.strip())
        try:
            return float(_answer())
        except ValueError:
            emit("say", "that is no number; give one")


def _answer() -> str:
    answer = sys.stdin.readline()
    if not answer:  # the window is gone
        raise click.Abort
    return answer


class Feedback:
    """How far a calibration is, and how bright the last frame was: a line on a terminal, or for the window."""

    def __init__(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        self.bar = Progress(
            TextColumn("{task.description:42s}"),
            BarColumn(),
            TextColumn("{task.fields[light]}"),
            TimeElapsedColumn(),
            console=Console(stderr=True),
            transient=True,
            disable=guided(),
        )
        self._task = self.bar.add_task("", total=1.0, light="")
        self._told_s = 0.0

    def look(self, look: "Look") -> None:
        """Show how it is getting on."""
        if guided():
            if time.monotonic() - self._told_s > _APART_S:
                self._told_s = time.monotonic()
                emit("look", {**asdict(look), "pixels": thumbnail(look.pixels)})
            return
        light = f"brightest {look.filled:4.0%}" if look.pixels is not None else ""
        if look.saturated > 1e-3:
            light += f", [red]{look.saturated:.1%} saturated[/red]"
        self.bar.update(self._task, description=look.doing, completed=look.done, light=light)

    @contextmanager
    def pause(self) -> Iterator[None]:
        """Leave the terminal to a question."""
        self.bar.stop()
        try:
            yield
        finally:
            self.bar.start()


@contextmanager
def feedback() -> Iterator[Feedback]:
    """Live feedback while a calibration goes on."""
    shown = Feedback()
    with shown.bar:
        yield shown


def picture(doing: str, pixels: "Pixels", saturation: int) -> None:
    """Show a window what the camera sees; a terminal has no place for it."""
    if guided():
        filled, saturated = float(pixels.max()) / saturation, float((pixels >= saturation).mean())
        look = {"doing": doing, "done": None, "filled": filled, "saturated": saturated, "pixels": thumbnail(pixels)}
        emit("look", look)


def thumbnail(pixels: "Pixels | None") -> dict[str, Any] | None:
    """A small 8-bit copy of a frame, as text."""
    if pixels is None:
        return None
    by = max(1, pixels.shape[1] // _WIDTH)
    sparse = pixels[::by, ::by]
    brightest = max(sorted(sparse.ravel().tolist())[-1 - sparse.size // 200], 1)  # but for hot pixels
    small = (sparse * (255.0 / brightest)).clip(0, 255).astype("uint8")
    return {"shape": list(small.shape), "base64": base64.b64encode(small.tobytes()).decode()}


def console() -> "Console":
    """For what is said on the way."""
    from rich.console import Console

    return Console(file=cast(IO[str], _Said()), width=1000) if guided() else Console(stderr=True)


@contextmanager
def watching(to: "Console") -> Iterator[Callable[[str], None]]:
    """A line that is replaced by the next; call what this gives with each."""
    from rich.live import Live

    if guided():
        yield lambda line: emit("watch", line)
        return
    with Live("", console=to, transient=True, auto_refresh=False) as live:
        yield lambda line: live.update(line, refresh=True)


class _Said(io.TextIOBase):
    """A stream whose lines are said."""

    def write(self, text: str) -> int:
        """Say the lines of `text`."""
        for line in filter(None, text.splitlines()):
            emit("say", line)
        return len(text)
