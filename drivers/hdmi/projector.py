"""A projector at a video output: patterns pixel by pixel on the right screen, at known times."""

import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from tankrig import bounded_reading
from tankrig.devices import Flip
from tankrig.errors import DeviceError
from tankrig.pattern import Pattern

from .link import Screen, WindowLink
from .settings import HdmiProjectorSettings

SwapClock = Callable[[int], int]
"""From when a frame was swapped, ns, to when it is on the output; waits for that. Screens without a vertical
synchronisation of their own (virtual ones) need one."""

_SWAPS_MEASURED = 32
_SWAPS_BEFORE = 8
_SETTLING_S = 1.0
_UNSTEADY = 0.1
_OTHER_RATE = 0.02


class HdmiProjector:
    """Implements `tankrig.devices.Projector`.

    Parameters
    ----------
    settings
        From the rig file.
    swap_clock
        Where the screen has no vertical synchronisation.

    Raises
    ------
    DeviceError
        When the screen is not there or is not unique, is the desktop's main one, scales, is in another mode than
        `settings` say, does not swap steadily, or cannot be shown to get the picture as it is.
    """

    def __init__(self, settings: HdmiProjectorSettings, swap_clock: SwapClock = lambda swapped_ns: swapped_ns) -> None:
        self._settings = settings
        self._swap_clock = swap_clock
        self._lock = threading.Lock()
        colours = _colours(settings.response)
        self._link = WindowLink(self.name, settings.timeout_s)
        try:
            screen = self._chosen(self._link.screens())
            self.kept_awake = self._link.open(screen.output, settings.shape, colours, settings.accept_compositor)
            """Whether the desktop or the X server has promised not to blank the screen."""
            self.swap_ms = self._swap_intervals_ms()
            self._require_proved()
            self._require_steady()
        except BaseException:
            self._link.close()
            raise

    @property
    def name(self) -> str:
        """For messages."""
        return f"projector {self._settings.screen}"

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        return self._settings.shape

    def show(self, pattern: Pattern) -> Flip:
        """Swap `pattern` onto the output, and return when it is there.

        Raises
        ------
        DeviceError
            If the pattern has another shape, the screen is gone or does not swap in time, or this is closed.
        """
        if pattern.shape != self.shape:
            raise DeviceError(
                f'{self.name}: pattern "{pattern.name}" has shape {list(pattern.shape)} and the output '
                f"{list(self.shape)}; draw it in the output's shape"
            )
        with self._lock:
            settled_ns = self._swap_clock(self._link.show(pattern.pixels))
        later_ns = round(self._settings.latency_ms * 1e6 + 1e9 / self._settings.refresh_hz)
        return Flip(settled_ns, settled_ns + later_ns, pattern.hash)

    def confirm(self) -> None:
        """Make sure that what was shown last is still on the output, and has been since.

        Raises
        ------
        DeviceError
            If the screen is gone, something has covered or changed the picture, or this is closed.
        """
        with self._lock:
            self._link.check()

    def close(self) -> None:
        """Take the window off the screen."""
        self._link.close()

    def _chosen(self, screens: tuple[Screen, ...]) -> Screen:
        """The one that the settings describe, if it is fit."""
        settings = self._settings
        wanted = settings.screen.model_dump(exclude_none=True)
        found = [screen for screen in screens if all(getattr(screen, key) == value for key, value in wanted.items())]
        if not wanted or len(found) != 1:
            known = "; ".join(map(str, screens))
            how = "is not connected" if wanted and not found else "could be several screens"
            raise DeviceError(
                f"{self.name}: {how}; name one of {known} by serial, model, manufacturer or output in projector.screen"
            )
        screen = found[0]
        if screen.primary and not settings.accept_primary:
            which = "the desktop's only screen" if len(screens) == 1 else "the desktop's main screen"
            raise DeviceError(
                f"{self.name}: is {which}, where windows and messages appear; make another screen the main one, or "
                f"accept it: accept_primary = true in [projector]"
            )
        if screen.pixel_ratio != 1.0:
            raise DeviceError(
                f"{self.name}: the desktop scales it by {screen.pixel_ratio:g}; set its scale to 100 % "
                f"(and QT_SCALE_FACTOR to nothing)"
            )
        for shape in (screen.shape, screen.mode_shape or screen.shape):
            if shape != settings.shape:
                raise DeviceError(
                    f"{self.name}: is in a mode of {list(shape)} pixels (rows, columns), and the rig file says "
                    f"{list(settings.shape)}; set that mode, unscaled, in the desktop's display settings"
                )
        if abs(screen.refresh_hz - settings.refresh_hz) > _OTHER_RATE * settings.refresh_hz:
            raise DeviceError(
                f"{self.name}: refreshes at {screen.refresh_hz:.2f} Hz, and the rig file says {settings.refresh_hz:g}; "
                f"set that rate in the desktop's display settings"
            )
        return screen

    def _swap_intervals_ms(self) -> tuple[float, ...]:
        dark = np.zeros(self.shape, np.uint8)
        swaps_ns = [self._swap_clock(self._link.show(dark)) for _ in range(_SWAPS_BEFORE + _SWAPS_MEASURED + 1)]
        return tuple((np.diff(swaps_ns[_SWAPS_BEFORE:]) / 1e6).tolist())

    def _require_proved(self) -> None:
        """Wait a little for a window manager to have put the window where it belongs; then refuse what is in doubt."""
        deadline_s = time.monotonic() + _SETTLING_S
        while True:
            try:
                self._link.check()
            except DeviceError:
                if time.monotonic() > deadline_s:
                    raise
                time.sleep(_SETTLING_S / 10)
                self._link.show(np.zeros(self.shape, np.uint8))
            else:
                return

    def _require_steady(self) -> None:
        period_ms = 1000.0 / self._settings.refresh_hz
        least, most = min(self.swap_ms), max(self.swap_ms)
        if least < (1.0 - _UNSTEADY) * period_ms or most > (1.0 + _UNSTEADY) * period_ms:
            raise DeviceError(
                f"{self.name}: swaps come {least:.1f} to {most:.1f} ms apart where its refresh rate says "
                f"{period_ms:.1f} ms; turn off what delays or hurries them (compositor, variable refresh rate)"
            )


def _colours(response: Path | None) -> Sequence[int]:
    """0xFFRRGGBB for each level."""
    if response is None:
        table = np.repeat(np.arange(256)[:, None], 3, axis=1)
    else:
        try:
            table = np.loadtxt(bounded_reading.text(response).splitlines(), dtype=int, delimiter=None, ndmin=2)
        except (OSError, ValueError) as error:
            raise DeviceError(f"{response}: cannot be read as a response curve ({error}); measure it anew") from error
        if table.shape != (256, 3) or table.min() < 0 or table.max() > 255:
            raise DeviceError(f"{response}: is no response curve; it takes 256 rows of three numbers from 0 to 255")
    colours: list[int] = (0xFF000000 + table @ [0x10000, 0x100, 1]).tolist()
    return colours
