"""The pump on its cable, with power of its own: pulling the cable leaves it running."""

from collections.abc import Iterator
from typing import Any

from drivers.emulation.board import EmulatedBoard
from drivers.emulation.cable import Cable
from drivers.emulation.truth import TruthFile

from .core import Core, Habits, Syringe
from .frames import Reader, basic, safe

BOOT_S = 0.3


class NewEraBoard(EmulatedBoard):
    """A pump, its cable and its motor.

    Parameters
    ----------
    state
        Its memory and the truth.
    cable
        To whoever opens its port.
    syringe
        That is really in it.
    nearest, counter_survives
        What nobody has verified: see `Core`.
    habits
        How it is set up, and what the manual leaves open.
    boot_s, others
        As for every board.
    """

    def __init__(
        self,
        state: TruthFile,
        cable: Cable,
        *,
        syringe: Syringe | None = None,
        nearest: bool = True,
        counter_survives: bool = False,
        habits: Habits | None = None,
        boot_s: float = BOOT_S,
        **others: Any,
    ) -> None:
        self._syringe = syringe or Syringe()
        self._nearest, self._counter_survives = nearest, counter_survives
        self._habits = habits or Habits()
        self._reader = Reader()
        super().__init__(state, cable, boot_s=boot_s, **others)

    def _power_up(self) -> tuple[Core, bytes]:
        kept = self._state.kept()
        self._reader = Reader(self._habits.answers_damaged)
        core = Core(
            kept,
            lambda: self._state.keep(kept),
            self._pulse,
            self._run,
            syringe=self._syringe,
            nearest=self._nearest,
            counter_survives=self._counter_survives,
            habits=self._habits,
        )
        return core, b"".join(self._unasked(core))

    def _answers(self, core: Core, received: bytes, now: float) -> Iterator[bytes]:
        yield from self._unasked(core)
        command = self._reader.feed(received, now, core.safe_mode)
        while command is not None:
            for _ in range(1 + self._injector.twice()):
                framed = safe if core.safe_mode else basic
                answer = "00SOTHER1.0" if self._injector.faults.stranger else core.obey(command, now)
                if answer is not None:
                    yield framed(answer)
                yield from self._unasked(core)
            command = self._reader.feed(b"", now, core.safe_mode)

    def _unasked(self, core: Core) -> Iterator[bytes]:
        while core.unasked:
            yield safe(core.unasked.pop(0))

    def _pulse(self) -> bool:
        followed = super()._pulse()
        if followed:
            self._state.step()
        return followed

    def _run(self, steps: int) -> int:
        made = super()._run(steps)
        if made:
            self._state.step(made)
        return made
