"""A device on its cable: the faults of the line, and the life of the device behind it."""

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import asdict
from typing import Any, Protocol

from .cable import Cable
from .faults import FaultInjector
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


class EmulatedBoard(ABC):
    """A device, its cable and its motor.

    Parameters
    ----------
    state
        Its memory and the truth.
    cable
        To whoever opens its port.
    boot_s
        From power to life.
    time_scale
        All of the device's times are multiplied by this (tests).
    seed
        Of the faults.
    now
        Tells the time, s.
    in_bulk
        Whether steps that nothing befalls are made at once: faster, but a process that is killed in between may then
        remember more than one step that was not made.
    """

    powered_by_cable = False
    most_hits: int | None = None

    def __init__(
        self,
        state: TruthFile,
        cable: Cable,
        *,
        boot_s: float,
        time_scale: float = 1.0,
        seed: int = 0,
        now: Callable[[], float] = time.monotonic,
        in_bulk: bool = False,
    ) -> None:
        self._state, self._cable, self._scale, self._boot_s = state, cable, time_scale, boot_s
        self._clock, self._in_bulk = now, in_bulk
        self._injector = FaultInjector(seed, self.most_hits)
        self._lock = threading.Lock()
        self.core: Core | None = None
        self._booted_s = 0.0
        self._unplug_now = False
        self._replies: list[tuple[float, bytes]] = []
        self._client = False
        self._client_left_s = self._now()
        self.quitting = False
        self._reset()
        self._cable.plug()

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
        return self._clock() / self._scale

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
        with self._lock:
            self._unplug()

    def live(self) -> None:
        """Wait a moment for the line, then let everything that is due happen."""
        busy = self.core is None or self.core.moving or bool(self._replies)
        self._cable.wait(max(0.0005, 0.004 * self._scale) if busy else 0.02)
        self.catch_up()

    def catch_up(self) -> None:
        """Let everything happen that is due."""
        with self._lock:
            try:
                self._live()
            except PowerLostError:
                self._reset()
            if self._unplug_now:
                self._unplug()

    @property
    def says_next_s(self) -> float | None:
        """When it will next say something that it has said already; None if nothing is on its way."""
        return self._replies[0][0] * self._scale if self._replies else None

    def command(self, request: dict[str, object]) -> dict[str, object]:
        """The control channel: `{"faults": {...}}`, `{"do": "reset" | "unplug" | "plug" | "forget" | "quit"}`, or `{}`.

        Returns the truth, what the board believes, and the faults in force.
        """
        with self._lock:
            if faults := request.get("faults"):
                self._injector.set(dict(faults))  # type: ignore[call-overload]
            action = request.get("do")
            if action == "plug" and not self._cable.plugged:
                if self.powered_by_cable:
                    self._reset()
                self._cable.plug()
            elif action == "unplug":
                self._unplug()
            elif action in ("reset", "forget"):
                if action == "forget":
                    self._forget()
                self._reset()
            self.quitting |= action == "quit"
            truth = self._state.truth
            believed = self.core.believed() if self.core else None
            faults_now = asdict(self._injector.faults)
            return {"true_steps": truth.steps, "moved_ns": truth.moved_ns, "board": believed, "faults": faults_now}

    def _unplug(self) -> None:
        self._cable.unplug()
        self._unplug_now = False
        if self.powered_by_cable:
            self.core = None
        self._replies.clear()
        self._drop_client()

    def _reset(self) -> None:
        self.core = None
        self._replies.clear()
        self._booted_s = self._now() + self._boot_s

    def _drop_client(self) -> None:
        if self._client:
            self._client_left_s = self._now()
        self._client = False

    def _live(self) -> None:
        now = self._now()
        if not self._cable.plugged:
            if self.core:
                self.core.advance(now)
            return
        received = self._receive()
        if self.core is None and now >= self._booted_s:
            self.core, greeting = self._power_up()
            self._say(self._injector.junk() if self._injector.faults.junk else greeting)
        elif self.core:
            self.core.advance(now)
            for answer in self._answers(self.core, received, now):
                self._say(answer)
        now = self._now()
        while self._replies and self._replies[0][0] <= now:
            self._send(self._replies.pop(0)[1])

    # -- the line ----------------------------------------------------------------------------------------------------

    def _receive(self) -> bytes:
        opened, received = self._cable.receive()
        if opened and not self._client:
            self._client = True
            self._opened()
        if not opened:
            self._drop_client()
        return b"" if self._injector.faults.deaf else self._injector.on_line(received)

    def _send(self, data: bytes) -> None:
        if self._client and not self._injector.faults.mute:
            self._cable.send(self._injector.on_line(data))

    def _say(self, data: bytes) -> None:
        """Queue what the device says; nothing overtakes what was said before."""
        due = self._now() + self._injector.delay_s()
        self._replies.append((max(due, self._replies[-1][0]) if self._replies else due, data))

    def _run(self, steps: int) -> int:
        """As many steps of the motor at once as nothing befalls, the plunger following; the next is a `_pulse`."""
        return self._injector.undisturbed(steps) if self._in_bulk else 0

    def _pulse(self) -> bool:
        """One step of the motor; whether the plunger has followed."""
        fate = self._injector.on_step()
        self._unplug_now |= fate == "unplug"
        if fate == "reset" or (fate == "unplug" and self.powered_by_cable):
            raise PowerLostError
        return fate != "stall"
