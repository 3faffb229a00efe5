"""The other end of the window's process: starts it, asks, and is answered in time or says what is wrong."""

import json
import mmap
import os
import socket
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tankrig.errors import DeviceError

_START_S = 30.0
_END_S = 2.0


@dataclass(frozen=True)
class Screen:
    """A screen that is connected.

    Parameters
    ----------
    output
        Of the graphics card.
    serial, model, manufacturer
        As the screen says; empty where it does not.
    shape
        (rows, columns) that programs see.
    mode_shape
        (rows, columns) of the video mode, where that is known.
    refresh_hz
        Of the mode.
    pixel_ratio
        Of the screen's pixels to those that programs see.
    primary
        Whether it is the desktop's main screen.
    """

    output: str
    serial: str
    model: str
    manufacturer: str
    shape: tuple[int, int]
    mode_shape: tuple[int, int] | None
    refresh_hz: float
    pixel_ratio: float
    primary: bool

    def __str__(self) -> str:
        said = " ".join(word for word in (self.manufacturer, self.model, self.serial) if word)
        rows, columns = self.shape
        return f"{self.output} ({said or 'nameless'}, {columns}×{rows} at {self.refresh_hz:.2f} Hz)"


def list_screens() -> tuple[Screen, ...]:
    """All screens of this desktop.

    Raises
    ------
    DeviceError
        When there is no desktop, or it does not answer.
    """
    try:
        done = subprocess.run(_command(), capture_output=True, text=True, timeout=_START_S, check=False)
    except subprocess.TimeoutExpired as error:
        raise DeviceError("screens: the desktop does not answer; log out and in again") from error
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["no reason given"])[0]
        raise DeviceError(
            f"screens: there is no desktop to ask ({last}); run this in a graphical session, or set DISPLAY"
        )
    return tuple(_screen(facts) for facts in json.loads(done.stdout))


class WindowLink:
    """A window on the screen at `output`, in its own process.

    Parameters
    ----------
    name
        Of the projector, for messages.
    output
        Where.
    shape
        (rows, columns) of the picture.
    colours
        256 numbers 0xAARRGGBB: what goes out for each level.
    timeout_s
        How long to wait for an answer.
    """

    def __init__(
        self, name: str, output: str, shape: tuple[int, int], colours: Sequence[int], timeout_s: float
    ) -> None:
        self._name, self._timeout_s = name, timeout_s
        self._unread = b""
        self._number = 0
        self._gone: str | None = None
        rows, columns = shape
        memory = os.memfd_create("tankrig projector")
        os.ftruncate(memory, rows * columns)
        self._memory = mmap.mmap(memory, rows * columns)
        self._pixels: NDArray[np.uint8] = np.frombuffer(self._memory, np.uint8).reshape(shape)
        self._socket, theirs = socket.socketpair()
        with theirs:
            self._process = subprocess.Popen(
                [*_command(), str(theirs.fileno()), str(memory)],
                pass_fds=(theirs.fileno(), memory),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
            )
        os.close(memory)
        try:
            self._send(do="open", output=output, shape=list(shape), colours=list(colours))
            self.awake: bool = self._answer("opened", True, _START_S)["awake"]
        except BaseException:
            self.close()
            raise

    def show(self, pixels: NDArray[np.uint8]) -> int:
        """Show a picture; when its frame was swapped, monotonic ns."""
        self._pixels[:] = pixels
        swapped_ns: int = self._ask("show")["swapped_ns"]
        return swapped_ns

    def check(self) -> None:
        """Raise a DeviceError unless the window is still where it was opened."""
        self._ask("check")

    def close(self) -> None:
        """End the process; may be called any number of times."""
        self._gone = self._gone or "is closed; open it again"
        self._socket.close()
        try:
            self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait(_END_S)

    def _ask(self, what: str) -> dict[str, Any]:
        self._number += 1
        self._send(do=what, number=self._number)
        return self._answer("number", self._number, self._timeout_s)

    def _send(self, **facts: Any) -> None:
        if self._gone:
            raise DeviceError(f"{self._name}: {self._gone}")
        with suppress(BrokenPipeError, ConnectionResetError):  # what it said last is still to be read
            self._socket.sendall(json.dumps(facts).encode() + b"\n")

    def _answer(self, key: str, value: object, timeout_s: float) -> dict[str, Any]:
        """The line in which `key` is `value`; older ones are passed over."""
        deadline_s = time.monotonic() + timeout_s
        while True:
            facts = self._line(deadline_s, timeout_s)
            if "gone" in facts:
                self._lose(f"{facts['gone']}; connect the projector as before and open it again")
            if facts.get(key) == value:
                return facts

    def _line(self, deadline_s: float, timeout_s: float) -> dict[str, Any]:
        while b"\n" not in self._unread:
            self._socket.settimeout(max(1e-3, deadline_s - time.monotonic()))
            try:
                received = self._socket.recv(65536)
            except TimeoutError:
                raise DeviceError(
                    f"{self._name}: the output did not swap within {timeout_s:g} s; check that the projector is on"
                ) from None
            except OSError:
                received = b""
            if not received:
                self._lose("its window's process has ended; open it again")
            self._unread += received
        line, _, self._unread = self._unread.partition(b"\n")
        facts: dict[str, Any] = json.loads(line)
        return facts

    def _lose(self, reason: str) -> None:
        self._gone = self._gone or reason
        raise DeviceError(f"{self._name}: {self._gone}")


def _command() -> list[str]:
    return [sys.executable, "-m", "drivers.hdmi.window"]


def _screen(facts: dict[str, Any]) -> Screen:
    mode = facts.pop("mode_shape")
    return Screen(**{**facts, "shape": tuple(facts["shape"])}, mode_shape=tuple(mode) if mode else None)
