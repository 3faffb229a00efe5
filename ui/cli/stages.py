"""What a command that takes long is doing: a line that changes on a terminal, plain lines elsewhere, on stderr."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Protocol

FIRST_S = 2.0
"""Silence before the first line: quick commands end within it."""
AGAIN_S = 30.0
"""After which a stage that lasts is told once more."""
POLL_S = 0.25
"""Between two looks at what is being done."""


class Tell(Protocol):
    """Takes the stage in a few words, and what changes while it lasts, such as the time that is left."""

    def __call__(self, what: str, more: str = "") -> None:
        """Show what is being done from now on."""


@contextmanager
def stages_shown(first: str = "reading", apart_s: float = 0.0) -> Iterator[Tell]:
    """Show the stage that a command is in, with the time that it has taken.

    Where stderr is no terminal, as in a scheduler's log, a stage is a line of its own, written when it begins, and
    every half minute while it lasts: a file without a line for minutes looks like a program that hangs.

    Parameters
    ----------
    first
        In a few words, what is done until the function that is given is called with others.
    apart_s
        Between two lines at least, where stages are many and short.
    """
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    if not console.is_terminal:
        with _lines(console.print, first, apart_s) as told:
            yield told
        return
    columns = SpinnerColumn(), TextColumn("{task.description}", markup=False), TimeElapsedColumn()
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task(first)

        def told(what: str, more: str = "") -> None:
            progress.update(task, description=_both(what, more))

        yield told


def _both(what: str, more: str) -> str:
    return f"{what}; {more}" if more else what


@contextmanager
def _lines(print_line: Callable[..., None], first: str, apart_s: float) -> Iterator[Tell]:
    began, stage, ended = time.monotonic(), [(first, "")], threading.Event()

    def write() -> None:
        written, at = "", began
        while not ended.wait(POLL_S):
            now, (what, more) = time.monotonic(), stage[0]
            due = now - at >= (AGAIN_S if what == written else apart_s)
            if now - began >= FIRST_S and due:
                print_line(f"{now - began:.0f} s: {_both(what, more)}", highlight=False, markup=False, soft_wrap=True)
                written, at = what, now

    writer = threading.Thread(target=write, name="stages", daemon=True)
    writer.start()

    def told(what: str, more: str = "") -> None:
        stage[0] = what, more

    try:
        yield told
    finally:
        ended.set()
        writer.join()
