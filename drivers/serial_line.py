"""Serial lines as the pump drivers use them: opened with a sentence for what can go wrong, read with a deadline,
stopped without waiting for a reader."""

import errno
import termios
import threading
from collections.abc import Callable, Iterable
from typing import Protocol, TypeVar, cast

import serial

from tankrig.errors import DeviceError

from .clock import Clock

REPLY_S = 0.3
QUIET_S = 0.6
READ_S = 0.02
PATIENCE_S = 1.0
LOST = (serial.SerialException, OSError, termios.error, TypeError)
Answer = TypeVar("Answer")


class NoReplyError(DeviceError):
    """The line is there, the device says nothing."""


class LineLostError(DeviceError):
    """The line is gone."""


class NotSentError(DeviceError):
    """Nothing was sent, because a stop came first."""


class Port(Protocol):
    """What a line needs of a serial port; as pyserial has it."""

    @property
    def in_waiting(self) -> int:
        """Bytes that have come."""

    def read(self, size: int) -> bytes:
        """Up to so many bytes; fewer, or none, when no more come in time."""

    def write(self, data: bytes) -> int | None:
        """Put `data` on the wire."""

    def reset_input_buffer(self) -> None:
        """Forget what has come."""

    def close(self) -> None:
        """Let go of it."""


PortOpener = Callable[[str, int, str, Clock], Port]
"""Opens a port: its path, its baud rate, the device's name for messages, and the clock that its timeouts keep."""


def open_port(port: str, baud: int, name: str, clock: Clock) -> Port:
    """Open a serial port (8N1) for this program alone.

    Raises
    ------
    DeviceError
        If it cannot be opened; the message says why and what to do.
    """
    try:
        timeouts = {"timeout": READ_S * clock.scale, "write_timeout": REPLY_S * clock.scale}
        return cast(Port, serial.Serial(port, baud, **timeouts, exclusive=True))
    except (OSError, termios.error) as error:
        raise DeviceError(f"{name}: cannot open {port}: {_why(error)}") from error


def lost(name: str) -> LineLostError:
    """What to raise when a port fails."""
    return LineLostError(f"{name}: the serial line is gone; plug it in and open it again")


class SerialLine:
    """A serial line to a device that answers each request once, in order, without saying which one it answers.

    A reply that did not come in time may still come. So after a missing reply, or a stop, the line is left until it has
    been quiet before anything else is asked; what comes meanwhile is still shown to `heard`.

    Parameters
    ----------
    port, baud, name
        Of the device; `name` for messages.
    frames
        Takes whole, undamaged frames out of what was received.
    heard
        Told of every frame.
    clock
        That its waits go by.
    opener
        Opens the port.

    Attributes
    ----------
    missed
        Replies that did not come.
    owed
        Replies that may still come, at most, to what was asked before; what comes next may be one of them.

    Raises
    ------
    DeviceError
        If the port cannot be opened.
    """

    def __init__(
        self,
        port: str,
        baud: int,
        name: str,
        frames: Callable[[bytearray], Iterable[bytes]],
        heard: Callable[[bytes], None],
        clock: Clock,
        opener: PortOpener = open_port,
    ) -> None:
        self.name, self.missed, self.owed = name, 0, 0
        self._frames, self._heard, self._clock = frames, heard, clock
        self._asking = threading.Lock()
        self._writing = threading.RLock()  # a signal handler may stop while this thread writes
        self._received = bytearray()
        self._unsettled = self._lost = False
        self._silent_since: float | None = None
        self._port = opener(port, baud, name, clock)

    def exchange(
        self, request: bytes, accept: Callable[[bytes], Answer | None], unless: Callable[[], bool] = lambda: False
    ) -> Answer:
        """Send `request` and wait for the first frame that `accept` makes an answer of.

        Raises
        ------
        NotSentError
            If `unless` holds when it would be sent; no stop can come between that check and the sending.
        NoReplyError
            If no answer comes in time.
        LineLostError
            If the port is gone.
        """
        with self._asking:
            try:
                self._clear()
                with self._writing:
                    if unless():
                        raise NotSentError(f"{self.name}: a stop is latched; clear it first")
                    self._port.write(request)
                deadline = self._clock.monotonic() + REPLY_S
                late = False
                while not late:
                    late = self._clock.monotonic() >= deadline
                    if late and not self._port.in_waiting:  # what came while the computer was busy still counts
                        break
                    for frame in self._hear():
                        if (answer := accept(frame)) is not None:
                            self._silent_since = None
                            return answer
            except serial.SerialTimeoutException as error:
                raise self._silent(f"{self.name}: takes no more bytes; check the cable and reset it") from error
            except LOST as error:
                raise self._gone() from error
        wait_ms = 1e3 * REPLY_S
        raise self._silent(f"{self.name}: no reply within {wait_ms:.0f} ms; check cable and power")

    @property
    def patient(self) -> bool:
        """Whether to ask once more: the device has not been silent for long enough yet to be told as silent."""
        return self._silent_since is None or self._clock.monotonic() - self._silent_since < PATIENCE_S

    def paid(self, replies: int) -> None:
        """It has been proved that so many of those owed do not come any more."""
        with self._writing:
            self.owed -= replies

    def send(self, data: bytes, replies: int) -> None:
        """Put bytes on the wire now, whatever another thread waits for, that bring so many replies; never raises."""
        with self._writing:
            self._unsettled = True
            self.owed += replies
            if not self._lost:
                try:
                    self._port.write(data)
                except serial.SerialTimeoutException:
                    return
                except LOST:
                    self._lost = True

    def unsettle(self) -> None:
        """More may come that answers nothing: wait for silence before the next request."""
        self._unsettled = True

    def close(self) -> None:
        """Let go of the port."""
        with self._writing:
            self._lost = True
        with self._asking:
            self._port.close()

    def _clear(self) -> None:
        """Nothing that came before counts as an answer; the line falls silent first if replies may be outstanding."""
        quiet_s = QUIET_S if self._unsettled else 0.0
        now = self._clock.monotonic()
        quiet_from, give_up = now, now + 4 * quiet_s
        self._unsettled = False
        for frame in self._frames(self._received):
            self._heard(frame)
        while True:
            waiting = self._port.in_waiting
            if waiting:
                quiet_from = self._clock.monotonic()
            elif self._clock.monotonic() - quiet_from >= quiet_s:
                break
            if waiting or quiet_s:
                for _ in self._hear():
                    pass
            if quiet_s and self._clock.monotonic() > give_up:
                raise self._silent(f"{self.name}: does not stop sending; is the baud rate right?")
        self._received.clear()

    def _hear(self) -> Iterable[bytes]:
        self._received += self._port.read(max(1, self._port.in_waiting))
        for frame in self._frames(self._received):
            self._heard(frame)
            yield frame

    def _silent(self, message: str) -> NoReplyError:
        self._unsettled = True
        self.missed += 1
        with self._writing:
            self.owed += 1
        if self._silent_since is None:
            self._silent_since = self._clock.monotonic() - REPLY_S
        return NoReplyError(message)

    def _gone(self) -> LineLostError:
        self._lost = True
        return lost(self.name)


def _why(error: Exception) -> str:
    number = getattr(error, "errno", None)
    if number in (errno.EAGAIN, errno.EBUSY):
        return "another program has it open; end that program first"
    if number == errno.ENOENT:
        return "there is no such port; is it plugged in? (`tankrig devices` lists the ports)"
    if number in (errno.EACCES, errno.EPERM):
        return "no permission; add yourself to the group that owns it (dialout) and log in anew"
    return f"{error}; is it a serial port?"
