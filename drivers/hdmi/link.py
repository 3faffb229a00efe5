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
    link = WindowLink("screens", _START_S)
    try:
        return link.screens()
    finally:
        link.close()


class WindowLink:
    """The process of a window that is to be opened.

    Parameters
    ----------
    name
        Of the projector, for messages.
    timeout_s
        How long to wait for an answer.
    """

    def __init__(self, name: str, timeout_s: float) -> None:
        self._name, self._timeout_s = name, timeout_s
        self._unread = b""
        self._number = 0
        self._gone: str | None = None
        self._memory = os.memfd_create("tankrig projector")
        self._socket, theirs = socket.socketpair()
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "drivers.hdmi.window", str(theirs.fileno()), str(self._memory)],
                pass_fds=(theirs.fileno(), self._memory),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                env={**os.environ, "QT_QPA_UPDATE_IDLE_TIME": "0"},  # else Qt waits 5 ms before it draws
                # Qt has much to say that is no error; what matters comes over the socket.
                stderr=None if os.environ.get("TANKRIG_DEBUG") == "1" else subprocess.DEVNULL,
            )

    def screens(self) -> tuple[Screen, ...]:
        """All that there are.

        Raises
        ------
        DeviceError
            When there is no desktop.
        """
        try:
            told = self._ask("list", _START_S)["screens"]
        except DeviceError as error:
            raise DeviceError(
                f"{self._name}: there is no desktop to ask for its screens; "
                f"run this in a graphical session, or set DISPLAY"
            ) from error
        return tuple(_screen(facts) for facts in told)

    def open(
        self, output: str, shape: tuple[int, int], colours: Sequence[int], accept_compositor: bool = False
    ) -> bool:
        """Open the window; returns whether the screen will be kept from blanking.

        Parameters
        ----------
        output
            Where.
        shape
            (rows, columns) of the picture.
        colours
            256 numbers 0xAARRGGBB: what goes out for each level.
        accept_compositor
            Whether another program may make the screen's picture of this window's.
        """
        rows, columns = shape
        os.ftruncate(self._memory, rows * columns)
        pixels = mmap.mmap(self._memory, rows * columns)
        self._pixels: NDArray[np.uint8] = np.frombuffer(pixels, np.uint8).reshape(shape)
        facts: dict[str, Any] = {"output": output, "shape": list(shape), "colours": list(colours)}
        facts["accept_compositor"] = accept_compositor
        awake: bool = self._ask("open", _START_S, **facts)["awake"]
        return awake

    def show(self, pixels: NDArray[np.uint8]) -> int:
        """Show a picture; when its frame was swapped, monotonic ns."""
        self._pixels[:] = pixels
        swapped_ns: int = self._ask("show", self._timeout_s)["swapped_ns"]
        return swapped_ns

    def check(self) -> None:
        """Raise a DeviceError unless the window is still where it was opened, and nothing has covered or changed its
        picture since it was shown, as far as an X server can prove that.
        """
        if doubt := self._ask("check", self._timeout_s)["doubt"]:
            raise DeviceError(f"{self._name}: {doubt}")

    def close(self) -> None:
        """End the process; may be called any number of times."""
        if self._memory >= 0:
            os.close(self._memory)
            self._memory = -1
        self._gone = self._gone or "is closed; open it again"
        self._socket.close()
        try:
            self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait(_END_S)

    def _ask(self, what: str, timeout_s: float, **facts: Any) -> dict[str, Any]:
        self._number += 1
        self._send(do=what, number=self._number, **facts)
        return self._answer(self._number, timeout_s)

    def _send(self, **facts: Any) -> None:
        if self._gone:
            raise DeviceError(f"{self._name}: {self._gone}")
        with suppress(BrokenPipeError, ConnectionResetError):  # what it said last is still to be read
            self._socket.sendall(json.dumps(facts).encode() + b"\n")

    def _answer(self, number: int, timeout_s: float) -> dict[str, Any]:
        """The line that answers question `number`; late answers to others are passed over."""
        deadline_s = time.monotonic() + timeout_s
        while True:
            facts = self._line(deadline_s, timeout_s)
            if "gone" in facts:
                self._lose(f"{facts['gone']}; connect the projector as before and open it again")
            if facts.get("number") == number:
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


def _screen(facts: dict[str, Any]) -> Screen:
    mode = facts.pop("mode_shape")
    return Screen(**{**facts, "shape": tuple(facts["shape"])}, mode_shape=tuple(mode) if mode else None)
