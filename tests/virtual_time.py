"""A world in which only time and the bytes' way are made up: driver and stand-in run in one thread on one clock.

Time passes while a program waits: in `sleep`, in `wait`, and in a read from its port. What somebody else does
meanwhile (stops it, pulls the cable, kills it, looks at it from another thread) is an event at its time, and happens in
that wait, as a signal handler would. Nothing depends on the machine, so that every history can be repeated.
"""

import heapq
import itertools
import threading
from collections.abc import Callable

import serial

from drivers.emulation.board import EmulatedBoard
from tankrig.errors import DeviceError

BITS_PER_BYTE = 10


class KilledError(BaseException):
    """The program is gone; no line of it runs any more."""


class World:
    """The time that all share, and what will happen."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self._events: list[tuple[float, int, Callable[[], object]]] = []
        self._number = itertools.count()

    def now(self) -> float:
        return self.now_s

    def after(self, delay_s: float, act: Callable[[], object]) -> None:
        """`act` happens so much later; what it waits for in turn is time that passes for all."""
        heapq.heappush(self._events, (self.now_s + delay_s, next(self._number), act))

    def advance_to(self, until_s: float, but: Callable[[], object] = lambda: False) -> None:
        """Let everything happen that is due until then, or until `but` holds."""
        while not but() and self._events and self._events[0][0] <= until_s:
            at_s, _, act = heapq.heappop(self._events)
            self.now_s = max(self.now_s, at_s)
            act()
        if not but():
            self.now_s = max(self.now_s, until_s)

    def advance(self, duration_s: float) -> None:
        self.advance_to(self.now_s + duration_s)


class ProgramClock:
    """The clock of one program (`drivers.clock.Clock`), which stands still for ever once it has been killed."""

    scale = 1.0

    def __init__(self, world: World) -> None:
        self.world, self.killed = world, False
        self.dying: Callable[[], object] = lambda: None
        """Called as it is killed."""
        self.dies_after: int | None = None
        """So many reads, writes, waits and syncs with the disk."""

    def kill(self) -> None:
        """As kill -9."""
        if not self.killed:
            self.killed = True
            self.dying()
        raise KilledError

    def alive(self) -> None:
        if self.dies_after is not None:
            self.dies_after -= 1
        if self.killed or (self.dies_after is not None and self.dies_after < 0):
            self.kill()

    def monotonic(self) -> float:
        return self.world.now_s

    def sleep(self, duration_s: float) -> None:
        self.alive()
        self.world.advance(duration_s)

    def wait(self, event: threading.Event, timeout_s: float) -> bool:
        self.alive()
        self.world.advance_to(self.world.now_s + timeout_s, event.is_set)
        return event.is_set()


class VirtualCable:
    """Bytes between a stand-in and one program's port, which take their time (`drivers.emulation.cable.Cable`)."""

    def __init__(self, world: World) -> None:
        self.world = world
        self.plugged = False
        self.port: VirtualPort | None = None
        self.board: EmulatedBoard | None = None
        self._to_board = b""
        self._woken = False

    def plug(self) -> None:
        self.plugged = True

    def unplug(self) -> None:
        self.plugged, self.port = False, None

    def wait(self, duration_s: float) -> None:
        raise AssertionError(f"a stand-in on this cable lives by the world's events, and waits no {duration_s} s")

    def receive(self) -> tuple[bool, bytes]:
        data, self._to_board = self._to_board, b""
        return self.port is not None, data

    def send(self, data: bytes) -> None:
        """The reply, in two parts: a driver must not depend on reading it whole."""
        port, byte_s = self.port, BITS_PER_BYTE / self.port.baud
        half = len(data) // 2
        for part, arrives in ((data[:half], half), (data[half:], len(data))):
            self.world.after(byte_s * arrives, lambda part=part: port.received.extend(part))

    def open(self, path: str, baud: int, name: str, clock: ProgramClock) -> "VirtualPort":
        """As `drivers.serial_line.open_port`."""
        if not self.plugged:
            raise DeviceError(f"{name}: cannot open {path}: there is no such port; is it plugged in?")
        if self.port:
            raise DeviceError(f"{name}: cannot open {path}: another program has it open; end that program first")
        self.port = VirtualPort(self, baud, clock)
        self.live()
        return self.port

    def carry(self, data: bytes, baud: int) -> None:
        """Bytes on their way to the stand-in, lost if the cable is pulled before they arrive."""

        def arrive() -> None:
            if self.plugged:
                self._to_board += data
            self.live()

        self.world.after(len(data) * BITS_PER_BYTE / baud, arrive)

    def live(self) -> None:
        """Let the stand-in do what is due, and come back when it has more to say."""
        if self.board is None:
            return
        self.board.catch_up()
        says_next_s = self.board.says_next_s
        if says_next_s is not None and not self._woken:
            self._woken = True
            self.world.after(max(0.0, says_next_s - self.world.now_s) + 1e-9, self._wake)

    def _wake(self) -> None:
        self._woken = False
        self.live()


class VirtualPort:
    """A program's end of the cable, as pyserial has it (`drivers.serial_line.Port`)."""

    READ_S = 0.1
    """Longer than a driver's, for fewer steps; a read ends anyway as soon as something comes."""

    def __init__(self, cable: VirtualCable, baud: int, clock: ProgramClock) -> None:
        self._cable, self.baud, self._clock = cable, baud, clock
        self.received, self.written = bytearray(), 0

    @property
    def in_waiting(self) -> int:
        self._require(OSError("device reports error"))
        return len(self.received)

    def read(self, size: int) -> bytes:
        world = self._clock.world
        self._require(serial.SerialException("device disconnected"))
        if not self.received:
            world.advance_to(world.now_s + self.READ_S, lambda: bool(self.received))
            if not self.received:
                self._cable.live()
            self._require(serial.SerialException("device disconnected"))
        data = bytes(self.received[:size])
        del self.received[:size]
        return data

    def write(self, data: bytes) -> int:
        self._require(serial.SerialException("write failed"))
        self.written += len(data)
        self._cable.carry(data, self.baud)
        return len(data)

    def reset_input_buffer(self) -> None:
        self._require(serial.SerialException("device disconnected"))
        self.received.clear()

    def close(self) -> None:
        if self._cable.port is self:
            self._cable.port = None
            self._cable.live()

    def _require(self, error: OSError) -> None:
        self._clock.alive()
        if self._cable.port is not self:
            raise error
