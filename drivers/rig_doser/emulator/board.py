"""The board on its cable: opening the port resets the firmware, as DTR resets an Arduino."""

from collections.abc import Iterator
from typing import Any

from drivers.emulation.board import EmulatedBoard
from drivers.emulation.cable import Cable

from .firmware import Firmware
from .frames import Request, RequestReader, framed
from .memory import StateFile

BOOT_S = 0.5


class RigDoserBoard(EmulatedBoard):
    """A doser's board, its cable and its motor.

    Parameters
    ----------
    state
        FRAM and truth.
    cable
        To whoever opens its port.
    rate, acceleration
        Of the motor, steps/s and steps/s².
    protocol
        Version of the protocol that its firmware speaks.
    boot_s
        From reset to banner.
    others
        As for every board.
    """

    powered_by_cable = True

    def __init__(
        self,
        state: StateFile,
        cable: Cable,
        *,
        rate: float = 2000.0,
        acceleration: float = 8000.0,
        protocol: int = 1,
        boot_s: float = BOOT_S,
        **others: Any,
    ) -> None:
        self._fram = state
        self._motor, self._protocol = (rate, acceleration), protocol
        super().__init__(state, cable, boot_s=boot_s, **others)

    @property
    def firmware(self) -> Firmware | None:
        """What runs on the board, if it is awake."""
        return self.core if isinstance(self.core, Firmware) else None

    def _power_up(self) -> tuple[Firmware, bytes]:
        firmware = Firmware(self._fram, *self._motor, self._pulse, self._protocol, self._run)
        return firmware, framed("!GRBL 1.1") if self._injector.faults.stranger else firmware.banner()

    def _answers(self, core: Firmware, received: bytes, now: float) -> Iterator[bytes]:
        for item in self._reader.feed(received, now):
            if not isinstance(item, Request):
                core.stop(now)
            elif not self._injector.faults.stranger:
                for _ in range(1 + self._injector.twice()):
                    yield core.answer(item, now)

    def _opened(self) -> None:
        self._reset()

    def _reset(self) -> None:
        self._reader = RequestReader(self._protocol)
        super()._reset()

    def _forget(self) -> None:
        self._fram.forget()

    def _pulse(self) -> bool:
        made = super()._pulse()
        if made:
            self._state.step()
        return made

    def _run(self, steps: int) -> int:
        made = super()._run(steps)
        if made:
            self._state.step(made)
        return made
