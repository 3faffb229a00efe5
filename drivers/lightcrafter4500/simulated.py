"""A LightCrafter on the simulated rig: the real driver, through pyusb, on the stand-in, whose light is in the tank."""

import threading
import time

from drivers.simulated.light import FrameBuffer, frame_buffer
from drivers.simulated.projector import SimulatedProjector
from drivers.simulated.settings import SimulatedProjectorSettings
from tankrig.devices import Projector

from .emulator.backend import Faults, LightcrafterOnBus
from .emulator.controller import Controller, Habits
from .flash import Flash, Place
from .projector import Lightcrafter
from .settings import LightcrafterSettings, SimulatedLightcrafterSettings

_STOP, _FROM_FLASH, _IMAGES = b"\0", b"\3", b"\1"


class SimulatedLightcrafter(Lightcrafter):
    """The driver of a real one, with computed light.

    Parameters
    ----------
    settings
        From the rig file.

    Attributes
    ----------
    faults
        What goes wrong on its USB, from now on.

    Raises
    ------
    DeviceError
        As of a real one.
    """

    def __init__(self, settings: SimulatedLightcrafterSettings) -> None:
        self._buffer = frame_buffer(settings.folder)
        flash = Flash(settings.flash, settings.shape) if settings.flash else None
        habits = Habits(in_standby=settings.in_standby)
        self._lit = _LitController(habits, flash, self._buffer)
        self._buffer.catch_up = self._lit.catch_up
        board = LightcrafterOnBus(self._lit)
        self.faults: Faults = board.faults

        def window(asked: LightcrafterSettings) -> Projector:
            period_ms, latency_ms = 1000.0 / asked.refresh_hz, asked.latency_ms
            return SimulatedProjector(
                SimulatedProjectorSettings(
                    folder=settings.folder,
                    shape=asked.shape,
                    period_ms=period_ms,
                    latency_ms=(0.6 * latency_ms, latency_ms),
                    seed=settings.seed,
                )
            )

        super().__init__(settings, board, window)

    def close(self) -> None:
        """Stop its patterns; the tank is dark."""
        super().close()
        self._buffer.catch_up = lambda: None
        self._buffer.go_dark()


class _LitController(Controller):
    """The stand-in's controller, which lights the tank with what it shows from flash; the window does with the video.

    The program and the camera ask it from threads of their own.
    """

    def __init__(self, habits: Habits, flash: Flash | None, buffer: FrameBuffer) -> None:
        super().__init__(habits)
        self._held_in_flash, self._buffer = flash, buffer
        self._asking = threading.RLock()
        self._told_source, self._told_mailbox, self._told_images = b"", b"", b"\0"
        self._lit_image = 0
        self._newest_s = 0.0

    def write(self, command: int, data: bytes, now_s: float) -> bool:
        """Obey a command; whether it can be acknowledged."""
        with self._asking:
            acknowledged = super().write(command, data, self._time(now_s))
            match command:
                case 0x1A22:
                    self._told_source = data
                case 0x1A33:
                    self._told_mailbox = data
                case 0x1A34 if self._told_mailbox == _IMAGES:
                    self._told_images = data
                case 0x1A24 if data == _STOP:
                    self._buffer.go_dark()
            self._light()
            return acknowledged

    def read(self, command: int, now_s: float) -> bytes:
        """What a command reads back."""
        with self._asking:
            answer = super().read(command, self._time(now_s))
            self._light()
            return answer

    def advance(self, now_s: float) -> None:
        """Let patterns go on until `now_s`."""
        with self._asking:
            super().advance(self._time(now_s))

    def catch_up(self) -> None:
        """Let patterns go on until now, and light the tank with them."""
        with self._asking:
            self.advance(time.monotonic())
            self._light()

    def _time(self, now_s: float) -> float:
        """Time does not go back, whichever thread has looked at the clock first."""
        self._newest_s = max(self._newest_s, now_s)
        return self._newest_s

    def _light(self) -> None:
        for shown in self.shown:
            if self._told_source != _FROM_FLASH or self._held_in_flash is None:
                continue
            if shown.line == 0:
                self._lit_image = 0
            self._lit_image += shown.entry.swap
            place = Place(self._told_images[self._lit_image], shown.entry.number, shown.entry.bits)
            self._buffer.flash(self._held_in_flash.at(place), round(1e9 * shown.from_s), round(1e9 * shown.until_s))
        self.shown.clear()
