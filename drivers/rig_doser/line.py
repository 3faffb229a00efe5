"""The serial line to the rig's own doser: one request and its reply at a time, and stop bytes at any time."""

import threading

import serial

from drivers.clock import Clock
from drivers.serial_line import LOST, REPLY_S, LineLostError, NoReplyError, PortOpener, lost, open_port

from . import wire

BAUD = 115200
BANNER_S = 3.0


class RigDoserLine:
    """An open serial port with a doser on it.

    Parameters
    ----------
    port
        Its path.
    name
        Of the doser, for messages.
    clock
        That its waits go by.
    opener
        Opens the port.

    Raises
    ------
    DeviceError
        If the port cannot be opened.
    """

    def __init__(self, port: str, name: str, clock: Clock, opener: PortOpener = open_port) -> None:
        self._name, self._clock = name, clock
        self._asking = threading.Lock()
        self._life = threading.RLock()  # a signal handler may stop while a stop is under way
        self._sequence = 0
        self._received = b""
        self._lost = False
        self._port = opener(port, BAUD, name, clock)

    def wait_for_banner(self) -> wire.Banner | None:
        """The board's banner, or None if it does not come in time (a board that DTR does not reset)."""
        with self._asking:
            deadline = self._clock.monotonic() + BANNER_S
            while (line := self._line(deadline)) is not None:
                if found := wire.banner(line):
                    return found
        return None

    def ask(self, command: str, *arguments: tuple[int, int]) -> wire.Reply:
        """Send one request and wait for its reply; a late reply to an earlier one is not taken for it.

        Raises
        ------
        NoReplyError
            If no whole reply comes in time.
        LineLostError
            If the port is gone.
        """
        with self._asking:
            self._sequence = self._sequence + 1 & 0xFF
            try:
                self._port.reset_input_buffer()
                self._port.write(wire.request(self._sequence, command, *arguments))
            except serial.SerialTimeoutException as error:
                raise NoReplyError(f"{self._name}: takes no more bytes; check the cable and reset it") from error
            except LOST as error:
                raise self._line_lost() from error
            self._received = b""
            deadline = self._clock.monotonic() + REPLY_S
            while (line := self._line(deadline)) is not None:
                answer = wire.reply(line)
                if answer and answer[0] == self._sequence:
                    return answer[1]
        wait_ms = 1e3 * REPLY_S
        raise NoReplyError(f"{self._name}: no reply within {wait_ms:.0f} ms; check the cable and the board's power")

    def stop(self) -> None:
        """Put stop bytes on the wire now, whatever another thread reads or writes; never raises."""
        with self._life:
            if not self._lost:
                try:
                    self._port.write(wire.STOP)
                except serial.SerialTimeoutException:
                    return
                except LOST:
                    self._lost = True

    def close(self) -> None:
        """Let go of the port."""
        with self._life:
            self._lost = True
        with self._asking:
            self._port.close()

    def _line(self, deadline: float) -> bytes | None:
        """The next line, without its end; None once `deadline` (monotonic, s) has passed."""
        late = False
        while b"\n" not in self._received:
            if late:
                return None
            late = self._clock.monotonic() >= deadline
            try:
                if late and not self._port.in_waiting:  # what came while the computer was busy still counts
                    return None
                self._received += self._port.read(max(1, self._port.in_waiting))
            except LOST as error:
                raise self._line_lost() from error
        line, _, self._received = self._received.partition(b"\n")
        return line

    def _line_lost(self) -> LineLostError:
        self._lost = True
        return lost(self._name)
