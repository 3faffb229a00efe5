"""The board on its cable: a pseudo-terminal that resets the firmware when it is opened, as DTR resets an Arduino."""

import contextlib
import os
import select
import threading
import time
import tty
from dataclasses import asdict
from pathlib import Path

from .faults import Gremlin
from .firmware import Firmware
from .frames import Request, RequestReader, framed
from .memory import StateFile

BOOT_S = 0.5


class _PowerLostError(Exception):
    """The board's life ends in the middle of a step."""


class Board:
    """A doser's board, its cable and its motor.

    Parameters
    ----------
    state
        FRAM and truth.
    link
        Where the device's path is published, as a symbolic link that stays the same over re-plugging.
    rate, acceleration
        Of the motor, steps/s and steps/s².
    boot_s
        From reset to banner.
    time_scale
        All of the board's times are multiplied by this (tests).
    seed
        Of the faults.
    """

    def __init__(
        self,
        state: StateFile,
        link: Path,
        *,
        rate: float = 2000.0,
        acceleration: float = 8000.0,
        boot_s: float = BOOT_S,
        time_scale: float = 1.0,
        seed: int = 0,
    ) -> None:
        self._state, self._link, self._scale = state, link, time_scale
        self._motor, self._boot_s = (rate, acceleration), boot_s
        self._gremlin = Gremlin(seed)
        self._turn = threading.Lock()
        self._master: int | None = None
        self._reader = RequestReader()
        self._firmware: Firmware | None = None
        self._booted_s = 0.0
        self._unplug_now = False
        self._replies: list[tuple[float, bytes]] = []
        self._client = False
        self._client_left_s = self._now()
        self.quitting = False
        self._plug()

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
        """Pull the cable."""
        with self._turn:
            self._unplug()

    def live(self) -> None:
        """Wait a moment for the line, then let everything that is due happen."""
        master, busy = self._master, self._firmware is None or self._firmware.moving or bool(self._replies)
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
            except _PowerLostError:
                self._power_lost()

    def command(self, request: dict[str, object]) -> dict[str, object]:
        """The control channel: `{"faults": {...}}`, `{"do": "reset" | "unplug" | "plug" | "forget" | "quit"}`, or `{}`.

        Returns the truth, what the board believes, and the faults in force.
        """
        with self._turn:
            if faults := request.get("faults"):
                self._gremlin.set(dict(faults))  # type: ignore[call-overload]
            action = request.get("do")
            if action == "plug" and self._master is None:
                self._plug()
            elif action == "unplug":
                self._unplug()
            elif action in ("reset", "forget"):
                if action == "forget":
                    self._state.forget()
                self._reset()
            self.quitting |= action == "quit"
            truth = self._state.truth
            believed = asdict(self._firmware.record) if self._firmware else None
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
        self._reset()

    def _unplug(self) -> None:
        if self._master is not None:
            self._link.unlink(missing_ok=True)
            os.close(self._master)
        self._master, self._firmware = None, None
        self._drop_client()

    def _reset(self) -> None:
        self._firmware = None
        self._reader = RequestReader()
        self._replies.clear()
        self._booted_s = self._now() + self._boot_s

    def _power_lost(self) -> None:
        if self._unplug_now:
            self._unplug()
        else:
            self._reset()

    def _drop_client(self) -> None:
        if self._client:
            self._client_left_s = self._now()
        self._client = False

    def _live(self) -> None:
        if self._master is None:
            return
        now = self._now()
        received = self._receive(self._master)
        if self._firmware is None and now >= self._booted_s:
            self._boot()
        elif self._firmware:
            self._firmware.advance(now)
            self._obey(self._firmware, received, now)
        now = self._now()
        due = [data for at, data in self._replies if at <= now]
        self._replies = [(at, data) for at, data in self._replies if at > now]
        self._send(self._master, b"".join(due))

    def _receive(self, master: int) -> bytes:
        poll = select.poll()
        poll.register(master, select.POLLIN)
        events = dict(poll.poll(0)).get(master, 0)
        if not events & select.POLLHUP and not self._client:
            self._client = True
            self._reset()
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

    def _boot(self) -> None:
        faults = self._gremlin.faults
        self._firmware = Firmware(self._state, *self._motor, pulse=self._pulse)
        banner = framed("!GRBL 1.1") if faults.stranger else self._firmware.banner()
        self._say(self._gremlin.junk() if faults.junk else banner)

    def _say(self, data: bytes) -> None:
        due = self._now() + self._gremlin.delay_s()
        self._replies.append((max([due, *(at for at, _ in self._replies)]), data))

    def _obey(self, firmware: Firmware, received: bytes, now: float) -> None:
        for item in self._reader.feed(received, now):
            if not isinstance(item, Request):
                firmware.stop(now)
            elif not self._gremlin.faults.stranger:
                for _ in range(1 + self._gremlin.twice()):
                    self._say(firmware.answer(item, now))

    def _pulse(self) -> bool:
        fate = self._gremlin.on_step()
        if fate in ("reset", "unplug"):
            self._unplug_now = fate == "unplug"
            raise _PowerLostError
        if fate != "stall":
            self._state.step()
        return fate != "stall"
