"""A rig doser's emulator in this process, for tests that look at the truth and switch faults."""

import threading
from pathlib import Path
from types import TracebackType
from typing import Any

from drivers.rig_doser.doser import RigDoser
from drivers.rig_doser.emulator.board import Board
from drivers.rig_doser.emulator.memory import Commissioning, StateFile
from drivers.rig_doser.settings import RigDoserSettings

STEPS_PER_UL = 10.0


class Bench:
    """A board on its pseudo-terminal, with its motor and its truth."""

    def __init__(self, folder: Path, time_scale: float = 0.5, rate: float = 4000.0, **commissioning: Any) -> None:
        self.folder, self.scale, self.rate = folder, time_scale, rate
        self._commissioning = Commissioning(**commissioning)
        self._opened: list[RigDoser] = []
        self.power_on()

    def power_on(self, seed: int = 0) -> None:
        self._state = StateFile(self.folder / "state", self._commissioning)
        motor = {"rate": self.rate, "acceleration": 10 * self.rate}
        link = self.folder / "doser"
        self.board = Board(self._state, link, **motor, boot_s=0.02, time_scale=self.scale, seed=seed)
        self._thread = threading.Thread(target=self.board.run)
        self._thread.start()

    def power_off(self) -> None:
        self.board.quit()
        self._thread.join()
        self._state.close()

    def open(self, **settings: Any) -> RigDoser:
        given = {"port": str(self.folder / "doser"), "steps_per_ul": STEPS_PER_UL, "time_scale": self.scale}
        doser = RigDoser(RigDoserSettings(**(given | settings)))
        self._opened.append(doser)
        return doser

    def faults(self, **faults: Any) -> None:
        self.board.command({"faults": faults})

    def no_faults(self) -> None:
        self.faults(
            lose=0.0, corrupt=0.0, duplicate=0.0, delay_ms=0.0, jitter_ms=0.0, mute=False, deaf=False, junk=False
        )
        self.faults(stranger=False, stall_after=None, reset_after=None, unplug_after=None)

    def do(self, action: str) -> dict[str, Any]:
        return self.board.command({"do": action})

    @property
    def true_ul(self) -> float:
        return self._state.truth.steps / STEPS_PER_UL

    def __enter__(self) -> "Bench":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for doser in self._opened:
            doser.close()
        self.power_off()
