"""The simulated projector: a frame buffer that swaps at its refresh rate and lights the tank a little later."""

import threading
import time

import numpy as np

from tankrig.devices import Flip
from tankrig.errors import DeviceError
from tankrig.pattern import Pattern

from .light import frame_buffer
from .settings import ProjectorFaults, SimulatedProjectorSettings

_SWAPS_MEASURED = 32
_UNSTEADY = 0.1


class SimulatedProjector:
    """Implements `tankrig.devices.Projector`.

    Parameters
    ----------
    settings
        From the rig file.

    Attributes
    ----------
    faults
        In force now; may be replaced at any time.

    Raises
    ------
    DeviceError
        If its swap interval is unsteady.
    """

    def __init__(self, settings: SimulatedProjectorSettings) -> None:
        self._settings = settings
        self.faults: ProjectorFaults = settings.faults
        self._random = np.random.default_rng((settings.seed, 1))
        self._closed = threading.Event()
        self._lock = threading.Lock()
        self._flips = 0
        self._period_ns = self._ns(settings.period_ms)
        self._require_steady()
        self._buffer = frame_buffer(settings.folder)
        self._start_ns = time.monotonic_ns()

    @property
    def name(self) -> str:
        """For messages."""
        return f"simulated projector of {self._settings.folder}"

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        return self._settings.shape

    def show(self, pattern: Pattern) -> Flip:
        """Swap `pattern` onto the output at the next refresh, and return then.

        Raises
        ------
        DeviceError
            If the pattern has another shape, the output is gone or does not swap in time, or this is closed.
        """
        if pattern.shape != self.shape:
            raise DeviceError(
                f'{self.name}: pattern "{pattern.name}" has shape {list(pattern.shape)} and the output '
                f"{list(self.shape)}; draw it in the output's shape"
            )
        with self._lock:
            swap_ns = self._next_swap()
            least_ns, most_ns = (self._ns(latency_ms) for latency_ms in self._settings.latency_ms)
            self._buffer.show(pattern, swap_ns + int(self._random.uniform(least_ns, most_ns)))
            self._wait(swap_ns)
            self._flips += 1
            return Flip(swap_ns, swap_ns + most_ns + self._period_ns, pattern.hash)

    def close(self) -> None:
        """Go dark."""
        if not self._closed.is_set():
            self._closed.set()
            self._buffer.go_dark()

    def _next_swap(self) -> int:
        """When the next swap comes; waits in vain, and complains, if that is too late."""
        self._require_there()
        now_ns = time.monotonic_ns()
        deadline_ns = now_ns + int(self._settings.timeout_s * 1e9)
        late_ns = self._ns(self.faults.late_ms) if self._random.random() < self.faults.late else 0
        refreshes = (now_ns - self._start_ns + late_ns) // self._period_ns + 1
        swap_ns = self._start_ns + refreshes * self._period_ns
        if swap_ns > deadline_ns or _since(self.faults.stuck_from, self._flips):
            self._wait(deadline_ns)
            raise DeviceError(
                f"{self.name}: the output did not swap within {self._settings.timeout_s:g} s; check that it is on"
            )
        return swap_ns

    def _wait(self, until_ns: int) -> None:
        self._closed.wait(max(0, until_ns - time.monotonic_ns()) / 1e9)
        self._require_there()

    def _require_there(self) -> None:
        if self._closed.is_set():
            raise DeviceError(f"{self.name}: is closed; open it again")
        if _since(self.faults.unplugged_from, self._flips):
            self._buffer.go_dark()
            raise DeviceError(f"{self.name}: the output is gone; plug the projector in and open it again")

    def _require_steady(self) -> None:
        period_ms, jitter_ms = self._settings.period_ms, self.faults.unsteady_ms
        intervals_ms = period_ms + jitter_ms * self._random.standard_normal(_SWAPS_MEASURED)
        if np.abs(intervals_ms - period_ms).max() > _UNSTEADY * period_ms:
            raise DeviceError(
                f"{self.name}: swaps come {intervals_ms.min():.1f} to {intervals_ms.max():.1f} ms apart where its "
                f"refresh rate says {period_ms:.1f} ms; turn off what delays them (compositor, variable refresh rate)"
            )

    def _ns(self, time_ms: float) -> int:
        return round(time_ms * self._settings.time_scale * 1e6)


def _since(first: int | None, number: int) -> bool:
    return first is not None and number >= first
