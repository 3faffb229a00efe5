"""The pump on its cable, with power of its own: pulling the cable leaves it running."""

import random
from collections.abc import Iterator
from typing import Any

from drivers.emulation.board import EmulatedBoard
from drivers.emulation.cable import Cable
from drivers.emulation.truth import TruthFile

from .core import Core, Habits
from .frames import Reader, answered

BOOT_S = 0.3


class CavroBoard(EmulatedBoard):
    """A pump, its cable and its motor.

    Parameters
    ----------
    state
        The truth, in fine increments of ink that have left the output.
    cable
        To whoever opens its port.
    address
        Set with its switch.
    most_lost
        Most fine increments that a plunger stopped in motion may lose.
    ready
        Whether it has been initialised and filled already, in its first life.
    habits
        Which model, and what the manuals leave open.
    boot_s, seed, others
        As for every board.
    """

    most_hits = 1  # two can pass a checksum by exclusive or

    def __init__(
        self,
        state: TruthFile,
        cable: Cable,
        *,
        address: int = 1,
        most_lost: int = 64,
        ready: bool = False,
        habits: Habits | None = None,
        boot_s: float = BOOT_S,
        seed: int = 0,
        **others: Any,
    ) -> None:
        self._address, self._most_lost, self._random = address, most_lost, random.Random(seed)
        self._reader, self._ready, self._habits = Reader(), ready, habits
        super().__init__(state, cable, boot_s=boot_s, seed=seed, **others)

    def _power_up(self) -> tuple[Core, bytes]:
        self._reader, ready, self._ready = Reader(), self._ready, False
        return Core(self._pulse, self._state.step, self._lost, ready, self._habits, self._run), b""

    def _lost(self) -> int:
        return self._random.randrange(self._most_lost + 1)

    def _answers(self, core: Core, received: bytes, now: float) -> Iterator[bytes]:
        for command in self._reader.feed(received):
            for _ in range(1 + self._injector.twice()):
                if self._injector.faults.stranger:
                    yield b"ERROR\r\n"
                elif command.address == self._address:
                    yield answered(*core.obey(command, now))
