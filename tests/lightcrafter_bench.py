"""A LightCrafter's stand-in on a clock of its own, with the driver on it, for tests that switch faults."""

from collections.abc import Callable, Mapping
from typing import Any

from drivers.lightcrafter4500.emulator.backend import Faults, LightcrafterOnBus
from drivers.lightcrafter4500.emulator.controller import Controller, Habits
from drivers.lightcrafter4500.projector import Lightcrafter
from drivers.lightcrafter4500.settings import LightcrafterSettings
from tankrig.devices import Flip
from tankrig.pattern import Pattern

SHAPE = (1140, 912)


class StandingClock:
    """Time that passes only while somebody waits."""

    scale = 1.0

    def __init__(self) -> None:
        self.now_s = 1000.0

    def monotonic(self) -> float:
        return self.now_s

    def sleep(self, duration_s: float) -> None:
        self.now_s += max(0.0, duration_s)

    def wait(self, _event: object, timeout_s: float) -> bool:
        self.sleep(timeout_s)
        return False


class ScheduledBoard(LightcrafterOnBus):
    """The stand-in, whose faults come at given commands.

    `schedule` maps the number of a command, from 0, to what is done just before it arrives.
    """

    def __init__(self, controller: Controller, schedule: Mapping[int, Callable[["ScheduledBoard"], object]], **kw: Any):
        super().__init__(controller, **kw)
        self.schedule, self.arrived = dict(schedule), 0
        self.now_s: Callable[[], float] = kw["clock"]

    def intr_write(self, *arguments: Any) -> int:
        fault = self.schedule.get(self.arrived)
        self.arrived += 1
        if fault:
            fault(self)
        return super().intr_write(*arguments)


class HdmiInput:
    """Stands for the window at the HDMI input, which has tests of its own."""

    def __init__(self, settings: LightcrafterSettings, clock: StandingClock) -> None:
        self.name, self.shape = f"projector {settings.screen}", settings.shape
        self._clock, self.shows, self.closed = clock, "", False

    def show(self, pattern: Pattern) -> Flip:
        self._clock.sleep(1 / 60)
        self.shows = pattern.hash
        now_ns = round(1e9 * self._clock.now_s)
        return Flip(now_ns, now_ns + 1, pattern.hash)

    def close(self) -> None:
        self.closed = True


class LightcrafterBench:
    """Driver and stand-in on one clock."""

    def __init__(self, schedule: Mapping[int, Callable[[ScheduledBoard], object]] | None = None, **habits: Any) -> None:
        self.clock = StandingClock()
        self.controller = Controller(Habits(**habits))
        self.board = ScheduledBoard(self.controller, schedule or {}, clock=self.clock.monotonic, sleep=self.clock.sleep)
        self.windows: list[HdmiInput] = []

    @property
    def faults(self) -> Faults:
        return self.board.faults

    @property
    def displaying(self) -> bool:
        self.controller.advance(self.clock.now_s)
        return self.controller.displaying

    def sent(self, command: int, read: bool = False) -> list[bytes]:
        """Data of each time that a command was sent."""
        return [data for was_read, number, data in self.board.commands if number == command and was_read == read]

    def open(self, **changes: Any) -> Lightcrafter:
        table = {"screen": {"model": "DLP"}, "refresh_hz": 60.0, "latency_ms": 30.0, **changes}

        def window(settings: LightcrafterSettings) -> HdmiInput:
            self.windows.append(HdmiInput(settings, self.clock))
            return self.windows[-1]

        return Lightcrafter(LightcrafterSettings(**table), self.board, window, self.clock)
