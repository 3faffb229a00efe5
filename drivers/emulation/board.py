"""A device on its cable: a pseudo-terminal, the faults of the line, and the life of the device behind it."""

import contextlib
import os
import select
import threading
import time
import tty
from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any, Protocol

from .faults import Gremlin
from .truth import TruthFile


class PowerLostError(Exception):
    """The device's life ends in the middle of a step."""


class Core(Protocol):
    """What runs in the device from one power-up to the next."""

    @property
    def moving(self) -> bool:
        """Whether its motor runs."""

    def advance(self, now_s: float) -> None:
        """Let motor and timers run until `now_s`."""

    def believed(self) -> dict[str, Any]:
        """What it thinks of itself, for the control channel."""


class Board(ABC):
    """A device, its cable and its motor.

    Parameters
    ----------
    state
        Its memory and the truth.
    link
        Where the device's path is published, as a symbolic link that stays the same over re-plugging.
    boot_s
        From power to life.
    time_scale
        All of the device's times are multiplied by this (tests).
    seed
        Of the faults.
    """

    powered_by_cable = False
    most_hits: int | None = None

    def __init__(self, state: TruthFile, link: Path, *, boot_s: float, time_scale: float = 1.0, seed: int = 0) -> None:
        self._state, self._link, self._scale, self._boot_s = state, link, time_scale, boot_s
        self._gremlin = Gremlin(seed, self.most_hits)
        self._turn = threading.Lock()
        self._master: int | None = None
        self._core: Core | None = None
        self._booted_s = 0.0
        self._unplug_now = False
        self._replies: list[tuple[float, bytes]] = []
        self._client = False
        self._client_left_s = self._now()
        self.quitting = False
        self._reset()
        self._plug()

    # -- what the device adds ----------------------------------------------------------------------------------------

    @abstractmethod
    def _power_up(self) -> tuple[Core, bytes]:
        """A new life, and what the device says unasked as it begins."""

    @abstractmethod
    def _answers(self, core: Any, received: bytes, now: float) -> Iterable[bytes]:
        """Obey what came in; what the device says to it."""

    def _opened(self) -> None:  # noqa: B027, most devices do not notice
        """Somebody has opened the port."""

    def _forget(self) -> None:
        """The non-volatile memory is destroyed."""
        self._state.keep({})

    # -- life --------------------------------------------------------------------------------------------------------

    def _now(self) -> float:
        return time.monotonic() / self._scale

    @property
    def idle_s(self) -> float:
        """For how long no one has had the device open."""
        return 0.0 if self._client else (self._now() - self._client_left_s) * self._scale

    def run(self) -> None:
        """Live until `quit`."""
        while not self.quitting:
            self.live()
        self.unplug()

    def quit(self) -> None:
        """Let `run` end soon."""
        self.quitting = True

    def unplug(self) -> None:
        """Pull the cable; a device that has its power from there dies."""
        with self._turn:
            self._unplug()

    def live(self) -> None:
        """Wait a moment for the line, then let everything that is due happen."""
        master, busy = self._master, self._core is None or self._core.moving or bool(self._replies)
        wait_s = max(0.0005, 0.004 * self._scale) if busy else 0.02
        if master is None or not self._client:
            time.sleep(min(wait_s, 0.002))
        else:
            poll = select.poll()
            poll.register(master, select.POLLIN)
            poll.poll(1000 * wait_s)
        with self._turn:
            try:
                self._live()
            except PowerLostError:
                self._reset()
            if self._unplug_now:
                self._unplug()

    def command(self, request: dict[str, object]) -> dict[str, object]:
        """The control channel: `{"faults": {...}}`, `{"do": "reset" | "unplug" | "plug" | "forget" | "quit"}`, or `{}`.

        Returns the truth, what the board believes, and the faults in force.
        """
        with self._turn:
            if faults := request.get("faults"):
                self._gremlin.set(dict(faults))  # type: ignore[call-overload]
            action = request.get("do")
            if action == "plug" and self._master is None:
                if self.powered_by_cable:
                    self._reset()
                self._plug()
            elif action == "unplug":
                self._unplug()
            elif action in ("reset", "forget"):
                if action == "forget":
                    self._forget()
                self._reset()
            self.quitting |= action == "quit"
            truth = self._state.truth
            believed = self._core.believed() if self._core else None
            faults_now = asdict(self._gremlin.faults)
            return {"true_steps": truth.steps, "moved_ns": truth.moved_ns, "board": believed, "faults": faults_now}

    def _plug(self) -> None:
        self._master, slave = os.openpty()
        tty.setraw(slave)
        os.set_blocking(self._master, False)
        waiting = self._link.with_name(f"{self._link.name}.{os.getpid()}")
        waiting.symlink_to(os.ttyname(slave))
        waiting.replace(self._link)
        os.close(slave)

    def _unplug(self) -> None:
        if self._master is not None:
            self._link.unlink(missing_ok=True)
            os.close(self._master)
        self._master, self._unplug_now = None, False
        if self.powered_by_cable:
            self._core = None
        self._replies.clear()
        self._drop_client()

    def _reset(self) -> None:
        self._core = None
        self._replies.clear()
        self._booted_s = self._now() + self._boot_s

    def _drop_client(self) -> None:
        if self._client:
            self._client_left_s = self._now()
        self._client = False

    def _live(self) -> None:
        now = self._now()
        if self._master is None:
            if self._core:
                self._core.advance(now)
            return
        received = self._receive(self._master)
        if self._core is None and now >= self._booted_s:
            self._core, greeting = self._power_up()
            self._say(self._gremlin.junk() if self._gremlin.faults.junk else greeting)
        elif self._core:
            self._core.advance(now)
            for answer in self._answers(self._core, received, now):
                self._say(answer)
        now = self._now()
        due = [data for at, data in self._replies if at <= now]
        self._replies = [(at, data) for at, data in self._replies if at > now]
        self._send(self._master, b"".join(due))

    # -- the line ----------------------------------------------------------------------------------------------------

    def _receive(self, master: int) -> bytes:
        poll = select.poll()
        poll.register(master, select.POLLIN)
        events = dict(poll.poll(0)).get(master, 0)
        if not events & select.POLLHUP and not self._client:
            self._client = True
            self._opened()
        received = b""
        with contextlib.suppress(OSError):
            while chunk := os.read(master, 4096):
                received += chunk
        if events & select.POLLHUP:
            self._drop_client()
        return b"" if self._gremlin.faults.deaf else self._gremlin.on_line(received)

    def _send(self, master: int, data: bytes) -> None:
        if self._client and data and not self._gremlin.faults.mute:
            with contextlib.suppress(OSError):
                os.write(master, self._gremlin.on_line(data))

    def _say(self, data: bytes) -> None:
        """Queue what the device says; nothing overtakes what was said before."""
        due = self._now() + self._gremlin.delay_s()
        self._replies.append((max([due, *(at for at, _ in self._replies)]), data))

    def _pulse(self) -> bool:
        """One step of the motor; whether the plunger has followed."""
        fate = self._gremlin.on_step()
        self._unplug_now |= fate == "unplug"
        if fate == "reset" or (fate == "unplug" and self.powered_by_cable):
            raise PowerLostError
        return fate != "stall"
