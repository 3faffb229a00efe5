"""Stand-ins for pumps in this process, for tests that look at the truth and switch faults."""

import atexit
import math
import os
import threading
import time
from abc import ABC, abstractmethod
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any

from drivers.cavro.doser import CavroDoser
from drivers.cavro.emulator.board import CavroBoard
from drivers.cavro.emulator.core import FINER
from drivers.cavro.emulator.core import Habits as CavroHabits
from drivers.cavro.settings import CavroSettings
from drivers.dosing.doser import PumpDoser
from drivers.emulation.board import EmulatedBoard
from drivers.emulation.cable import PseudoTerminal
from drivers.emulation.truth import TruthFile
from drivers.new_era.doser import NewEraDoser
from drivers.new_era.emulator.board import NewEraBoard
from drivers.new_era.emulator.core import FASTEST_MM_PER_MIN
from drivers.new_era.emulator.core import Habits as NewEraHabits
from drivers.new_era.settings import NewEraSettings
from drivers.rig_doser.doser import RigDoser
from drivers.rig_doser.emulator.board import RigDoserBoard
from drivers.rig_doser.emulator.memory import Commissioning, StateFile
from drivers.rig_doser.settings import RigDoserSettings
from drivers.serial_line import PortOpener, open_port
from tankrig.devices import Doser
from tankrig.errors import DeviceError

from .virtual_time import ProgramClock, VirtualCable, World

STEPS_PER_UL = 10.0


class ListeningTerminal(PseudoTerminal):
    """Keeps what has come, and when."""

    def __init__(self, link: Path) -> None:
        super().__init__(link)
        self.heard: list[tuple[float, bytes]] = []

    def receive(self) -> tuple[bool, bytes]:
        opened, data = super().receive()
        if data:
            self.heard.append((time.perf_counter(), data))
        return opened, data


class AnyBench(ABC):
    """A stand-in with its motor and its truth: on a pseudo-terminal in a thread, or in a `World` on its clock."""

    steps_per_ul: float

    def __init__(self, folder: Path, time_scale: float, seed: int = 0, world: World | None = None) -> None:
        self.folder, self.scale, self.world = folder, 1.0 if world else time_scale, world
        self._opened: list[Any] = []
        self._ports: dict[int, Any] = {}
        self.cable = VirtualCable(world) if world else None
        self.power_on(seed)

    def _life(self, seed: int) -> dict[str, Any]:
        """What a board is told of where it lives."""
        life: dict[str, Any] = {"boot_s": 0.02, "time_scale": self.scale, "seed": seed}
        if self.world:
            return life | {"cable": self.cable, "now": self.world.now, "in_bulk": True}
        self.terminal = ListeningTerminal(self.folder / "doser")
        return life | {"cable": self.terminal}

    def _surroundings(self) -> dict[str, Any]:
        """What a driver is told of where it lives."""
        if not self.world:
            return {"opener": self._keeping(open_port)}
        self.clock = ProgramClock(self.world)
        return {"clock": self.clock, "opener": self._keeping(self.cable.open)}

    def _keeping(self, opener: PortOpener) -> PortOpener:
        def opened(port: str, baud: int, name: str, clock: Any) -> Any:
            self._newest_port = opener(port, baud, name, clock)
            return self._newest_port

        return opened

    @abstractmethod
    def _plug_in(self, seed: int) -> tuple[TruthFile, EmulatedBoard]: ...

    @abstractmethod
    def _open(self, **settings: Any) -> Doser: ...

    def port_of(self, doser: Any) -> Any:
        """The driver's serial port, to pull it out or to write noise to."""
        return self._ports[id(doser)]

    def power_on(self, seed: int = 0) -> None:
        self._state, self.board = self._plug_in(seed)
        if self.cable:
            self.cable.board = self.board
            return
        self._thread = threading.Thread(target=self.board.run)
        self._thread.start()

    def power_off(self) -> None:
        if self.cable:
            self.board.unplug()
            self.cable.board = None
        else:
            self.board.quit()
            self._thread.join()
        self._state.close()

    def open(self, **settings: Any) -> Any:
        doser = self._open(**settings)
        self._opened.append(doser)
        self._ports[id(doser)] = self._newest_port
        return doser

    def bury(self, doser: Any) -> None:
        """What the system does for a program that is gone: its files are closed."""
        atexit.unregister(doser.close)
        self.port_of(doser).close()

    def written(self, doser: Any) -> int:
        """Bytes that the driver has put on the wire."""
        return int(self.port_of(doser).written)

    @property
    def moving(self) -> bool:
        """Whether its motor runs."""
        self.board.catch_up()
        return self.board.core is not None and self.board.core.moving

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
        if self.cable:
            self.cable.live()
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
    """The rig's own doser, whose firmware speaks version `protocol`."""

    steps_per_ul = STEPS_PER_UL

    def __init__(
        self,
        folder: Path,
        time_scale: float = 0.5,
        rate: float = 4000.0,
        seed: int = 0,
        world: World | None = None,
        protocol: int = 1,
        **commissioning: Any,
    ) -> None:
        self.rate, self._protocol, self._commissioning = rate, protocol, Commissioning(**commissioning)
        super().__init__(folder, time_scale, seed, world)

    def _plug_in(self, seed: int) -> tuple[TruthFile, EmulatedBoard]:
        state = StateFile(self.folder / "state", self._commissioning)
        motor = {"rate": self.rate, "acceleration": 10 * self.rate, "protocol": self._protocol}
        return state, RigDoserBoard(state, **motor, **self._life(seed))

    def _open(self, **settings: Any) -> RigDoser:
        given = {"port": str(self.folder / "doser"), "steps_per_ul": STEPS_PER_UL, "time_scale": self.scale}
        return RigDoser(RigDoserSettings(**(given | settings)), **self._surroundings())


class CountedBench(AnyBench):
    """A pump whose driver keeps a count file."""

    def bury(self, doser: PumpDoser) -> None:
        super().bury(doser)
        count = (self.folder / "count").resolve()
        for file in Path("/proc/self/fd").iterdir():
            with suppress(OSError):  # one of them was that of the listing
                if file.readlink() == count:
                    os.close(int(file.name))
        self._opened.remove(doser)  # whose file's number may be that of another soon


class NewEraBench(CountedBench):
    """An NE-1000 with a 5 ml syringe, set up as `habits` says.

    Where it checks rates its own is the fastest that the motor makes with this syringe, 5.7 ml/min, else 30.
    """

    steps_per_ul = 20.0
    DIAMETER_MM = 12.0
    FASTEST_ML_PER_MIN = math.floor(10 * FASTEST_MM_PER_MIN * math.pi / 4 * DIAMETER_MM**2 / 1000) / 10

    def __init__(
        self,
        folder: Path,
        time_scale: float = 0.2,
        rate_ml_per_min: float | None = None,
        seed: int = 0,
        world: World | None = None,
        habits: NewEraHabits | None = None,
        **device: Any,
    ) -> None:
        self._habits, self._device = habits or NewEraHabits(), device
        self.rate = rate_ml_per_min or (self.FASTEST_ML_PER_MIN if self._habits.checks_rates else 30.0)
        super().__init__(folder, time_scale, seed, world)

    def _plug_in(self, seed: int) -> tuple[TruthFile, EmulatedBoard]:
        state = TruthFile(self.folder / "state")
        unverified = {"nearest": bool(seed & 1), "counter_survives": bool(seed & 2)} | self._device
        return state, NewEraBoard(state, habits=self._habits, **unverified, **self._life(seed))

    def _open(self, **settings: Any) -> PumpDoser:
        given = {"port": str(self.folder / "doser"), "count_file": self.folder / "count", "time_scale": self.scale}
        syringe = {"diameter_mm": self.DIAMETER_MM, "rate_ml_per_min": self.rate}
        return NewEraDoser(NewEraSettings(**(given | syringe | settings)), **self._surroundings())


class CavroBench(CountedBench):
    """An XCalibur, or what `habits` says, initialised and filled before the first program uses it.

    Its fastest is a stroke a second, whichever model.
    """

    def __init__(
        self,
        folder: Path,
        time_scale: float = 0.2,
        speed_ul_per_s: float = 500.0,
        syringe_ul: float = 1000.0,
        seed: int = 0,
        world: World | None = None,
        habits: CavroHabits | None = None,
    ) -> None:
        self._habits = habits or CavroHabits()
        self.steps_per_ul = self._habits.model.increments * FINER / syringe_ul
        self.speed, self.syringe_ul, self._ready = speed_ul_per_s, syringe_ul, True
        super().__init__(folder, time_scale, seed, world)

    def _plug_in(self, seed: int) -> tuple[TruthFile, EmulatedBoard]:
        state = TruthFile(self.folder / "state")
        ready, self._ready = self._ready, False
        return state, CavroBoard(state, ready=ready, habits=self._habits, **self._life(seed))

    def _open(self, **settings: Any) -> CavroDoser:
        given = {"port": str(self.folder / "doser"), "count_file": self.folder / "count", "time_scale": self.scale}
        pump = {"model": self._habits.model.name, "fine": False}
        syringe = {"syringe_ul": self.syringe_ul, "speed_ul_per_s": self.speed}
        return CavroDoser(CavroSettings(**(given | pump | syringe | settings)), **self._surroundings())

    def put_right(self, doser: CavroDoser) -> None:
        with suppress(DeviceError):
            if self.board.command({})["board"] and not self.board.core.initialised:
                doser.initialise()
                volume_ul = doser.last_known.volume_ul + 1.0
                doser.pump.prepare(round(volume_ul * doser.pump.ticks_per_ul))  # filled: the next dose begins at once
