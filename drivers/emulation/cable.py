"""The cable between a stand-in and whoever opens its port: a pseudo-terminal."""

import contextlib
import os
import select
import time
import tty
from pathlib import Path
from typing import Protocol


class Cable(Protocol):
    """What a stand-in needs of its cable."""

    @property
    def plugged(self) -> bool:
        """Whether it is plugged in."""

    def plug(self) -> None:
        """Plug it in."""

    def unplug(self) -> None:
        """Pull it out; whoever has the port open notices."""

    def wait(self, duration_s: float) -> None:
        """Let so much time pass, or less if something comes."""

    def receive(self) -> tuple[bool, bytes]:
        """Whether somebody has the port open, and what has come since the last time."""

    def send(self, data: bytes) -> None:
        """Send to whoever has the port open."""


class PseudoTerminal:
    """A pseudo-terminal.

    Parameters
    ----------
    link
        Where its path is published, as a symbolic link that stays the same over re-plugging.
    """

    def __init__(self, link: Path) -> None:
        self._link = link
        self._master: int | None = None

    @property
    def plugged(self) -> bool:
        """Whether it is plugged in."""
        return self._master is not None

    def plug(self) -> None:
        """Make a new one and publish it."""
        self._master, slave = os.openpty()
        tty.setraw(slave)
        os.set_blocking(self._master, False)
        waiting = self._link.with_name(f"{self._link.name}.{os.getpid()}")
        waiting.symlink_to(os.ttyname(slave))
        waiting.replace(self._link)
        os.close(slave)

    def unplug(self) -> None:
        """Take it back."""
        if self._master is not None:
            self._link.unlink(missing_ok=True)
            os.close(self._master)
        self._master = None

    def wait(self, duration_s: float) -> None:
        """Let so much time pass, or less if something comes."""
        if self._master is None or self._events() & select.POLLHUP:
            time.sleep(min(duration_s, 0.002))
        else:
            self._events(1000 * duration_s)

    def receive(self) -> tuple[bool, bytes]:
        """Whether somebody has the port open, and what has come since the last time."""
        if self._master is None:
            return False, b""
        hung_up = self._events() & select.POLLHUP
        received = b""
        with contextlib.suppress(OSError):
            while chunk := os.read(self._master, 4096):
                received += chunk
        return not hung_up, received

    def send(self, data: bytes) -> None:
        """Send to whoever has the port open; what does not fit is lost."""
        with contextlib.suppress(OSError):
            os.write(self._master or 0, data)

    def _events(self, wait_ms: float = 0.0) -> int:
        poll = select.poll()
        poll.register(self._master or 0, select.POLLIN)
        return dict(poll.poll(wait_ms)).get(self._master or 0, 0)
