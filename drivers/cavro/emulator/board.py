"""The pump on its cable, with power of its own: pulling the cable leaves it running."""

import random
from collections.abc import Iterator
from pathlib import Path

from drivers.emulation.board import Board
from drivers.emulation.truth import TruthFile

from .core import Core, Habits
from .frames import Reader, answered

BOOT_S = 0.3


class CavroBoard(Board):
    """A pump, its cable and its motor.

    Parameters
    ----------
    state
        The truth, in fine increments of ink that have left the output.
    link
        Where the device's path is published.
    address
        Set with its switch.
    most_lost
        Most fine increments that a plunger stopped in motion may lose.
    ready
        Whether it has been initialised and filled already, in its first life.
    habits
        Which model, and what the manuals leave open.
    time_scale, seed, boot_s
        As for every board.
    """

    most_hits = 1  # two can pass a checksum by exclusive or

    def __init__(
        self,
        state: TruthFile,
        link: Path,
        *,
        address: int = 1,
        most_lost: int = 64,
        ready: bool = False,
        habits: Habits | None = None,
        boot_s: float = BOOT_S,
        time_scale: float = 1.0,
        seed: int = 0,
    ) -> None:
        self._address, self._most_lost, self._random = address, most_lost, random.Random(seed)
        self._reader, self._ready, self._habits = Reader(), ready, habits
        super().__init__(state, link, boot_s=boot_s, time_scale=time_scale, seed=seed)

    def _power_up(self) -> tuple[Core, bytes]:
        self._reader, ready, self._ready = Reader(), self._ready, False
        lost = self._random.randrange
        core = Core(self._pulse, self._state.step, lambda: lost(self._most_lost + 1), ready, self._habits)
        return core, b""

    def _answers(self, core: Core, received: bytes, now: float) -> Iterator[bytes]:
        for command in self._reader.feed(received):
            for _ in range(1 + self._gremlin.twice()):
                if self._gremlin.faults.stranger:
                    yield b"ERROR\r\n"
                elif command.address == self._address:
                    yield answered(*core.obey(command, now))
