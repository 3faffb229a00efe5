"""Stand-ins for pumps in this process, for tests that look at the truth and switch faults."""

import threading
from abc import ABC, abstractmethod
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any

from drivers.cavro.doser import CavroDoser
from drivers.cavro.emulator.board import CavroBoard
from drivers.cavro.settings import CavroSettings
from drivers.dosing.doser import PumpDoser
from drivers.emulation.board import Board as AnyBoard
from drivers.emulation.truth import TruthFile
from drivers.new_era import open_new_era
from drivers.new_era.emulator.board import NewEraBoard
from drivers.rig_doser.doser import RigDoser
from drivers.rig_doser.emulator.board import Board
from drivers.rig_doser.emulator.memory import Commissioning, StateFile
from drivers.rig_doser.settings import RigDoserSettings
from tankrig.devices import Doser
from tankrig.errors import DeviceError

STEPS_PER_UL = 10.0


class AnyBench(ABC):
    """A stand-in on its pseudo-terminal, with its motor and its truth."""

    steps_per_ul: float

    def __init__(self, folder: Path, time_scale: float, seed: int = 0) -> None:
        self.folder, self.scale = folder, time_scale
        self._opened: list[Any] = []
        self.power_on(seed)

    @abstractmethod
    def _plug_in(self, seed: int) -> tuple[TruthFile, AnyBoard]: ...

    @abstractmethod
    def _open(self, **settings: Any) -> Doser: ...

    @abstractmethod
    def port_of(self, doser: Any) -> Any:
        """The driver's serial port, to pull it out or to write noise to."""

    def power_on(self, seed: int = 0) -> None:
        self._state, self.board = self._plug_in(seed)
        self._thread = threading.Thread(target=self.board.run)
        self._thread.start()

    def power_off(self) -> None:
        self.board.quit()
        self._thread.join()
        self._state.close()

    def open(self, **settings: Any) -> Any:
        self._opened.append(self._open(**settings))
        return self._opened[-1]

    def kill(self, doser: Any) -> None:
        """As kill -9: its port is closed and nothing more is written."""
        self.port_of(doser).close()

    def put_right(self, doser: Any) -> None:  # noqa: B027, most need nothing
        """What a person has to do at the device before it can dose."""

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
        return self._state.truth.steps / self.steps_per_ul

    def __enter__(self) -> Any:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for doser in self._opened:
            doser.close()
        self.power_off()


class Bench(AnyBench):
    """The rig's own doser."""

    steps_per_ul = STEPS_PER_UL

    def __init__(
        self, folder: Path, time_scale: float = 0.5, rate: float = 4000.0, seed: int = 0, **commissioning: Any
    ) -> None:
        self.rate, self._commissioning = rate, Commissioning(**commissioning)
        super().__init__(folder, time_scale, seed)

    def _plug_in(self, seed: int) -> tuple[TruthFile, AnyBoard]:
        state = StateFile(self.folder / "state", self._commissioning)
        motor = {"rate": self.rate, "acceleration": 10 * self.rate}
        board = Board(state, self.folder / "doser", **motor, boot_s=0.02, time_scale=self.scale, seed=seed)
        return state, board

    def _open(self, **settings: Any) -> RigDoser:
        given = {"port": str(self.folder / "doser"), "steps_per_ul": STEPS_PER_UL, "time_scale": self.scale}
        return RigDoser(RigDoserSettings(**(given | settings)))

    def port_of(self, doser: RigDoser) -> Any:
        return doser._pump._line._port


class CountedBench(AnyBench):
    """A pump whose driver keeps a count file."""

    def kill(self, doser: PumpDoser) -> None:
        file = doser._pump._file
        file.write = lambda record: setattr(file, "record", record)
        super().kill(doser)

    def port_of(self, doser: PumpDoser) -> Any:
        return doser._pump._counter._line._port


class NewEraBench(CountedBench):
    """An NE-1000 with a 5 ml syringe."""

    steps_per_ul = 20.0

    def __init__(
        self, folder: Path, time_scale: float = 0.2, rate_ml_per_min: float = 30.0, seed: int = 0, **device: Any
    ) -> None:
        self.rate, self._device = rate_ml_per_min, device
        super().__init__(folder, time_scale, seed)

    def _plug_in(self, seed: int) -> tuple[TruthFile, AnyBoard]:
        state = TruthFile(self.folder / "state")
        unverified = {"nearest": bool(seed & 1), "counter_survives": bool(seed & 2)} | self._device
        board = NewEraBoard(state, self.folder / "doser", **unverified, boot_s=0.02, time_scale=self.scale, seed=seed)
        return state, board

    def _open(self, **settings: Any) -> PumpDoser:
        given = {"port": str(self.folder / "doser"), "count_file": self.folder / "count", "time_scale": self.scale}
        syringe = {"diameter_mm": 12.0, "rate_ml_per_min": self.rate}
        return open_new_era(given | syringe | settings)


class CavroBench(CountedBench):
    """An XCalibur, initialised and filled before the first program uses it."""

    def __init__(
        self,
        folder: Path,
        time_scale: float = 0.2,
        speed_ul_per_s: float = 500.0,
        syringe_ul: float = 1000.0,
        seed: int = 0,
    ) -> None:
        self.steps_per_ul = 24000.0 / syringe_ul
        self.speed, self.syringe_ul, self._ready = speed_ul_per_s, syringe_ul, True
        super().__init__(folder, time_scale, seed)

    def _plug_in(self, seed: int) -> tuple[TruthFile, AnyBoard]:
        state = TruthFile(self.folder / "state")
        link, ready, self._ready = self.folder / "doser", self._ready, False
        return state, CavroBoard(state, link, ready=ready, boot_s=0.02, time_scale=self.scale, seed=seed)

    def _open(self, **settings: Any) -> CavroDoser:
        given = {"port": str(self.folder / "doser"), "count_file": self.folder / "count", "time_scale": self.scale}
        syringe = {"syringe_ul": self.syringe_ul, "speed_ul_per_s": self.speed, "fine": False}
        return CavroDoser(CavroSettings(**(given | syringe | settings)))

    def put_right(self, doser: CavroDoser) -> None:
        with suppress(DeviceError):
            if self.board.command({})["board"] and not self.board._core._initialised:
                doser.initialise()
                doser._pump._renew()  # filled, so that the next dose begins at once
