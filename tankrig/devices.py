"""What the experiment asks of a projector, a camera and a doser; real and simulated drivers answer alike.

Times are nanoseconds of the monotonic clock (`time.monotonic_ns`). Every call that waits has a timeout and raises a
`DeviceError` that names the device; `close` may be called any number of times.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from tankrig.pattern import Pattern


@dataclass(frozen=True)
class Flip:
    """A pattern has gone on the output.

    Parameters
    ----------
    settled_ns
        When the frame was swapped onto the output.
    bound_ns
        From when on all light in the tank is this pattern's: swap, 99th percentile of the latency, one period.
        A frame belongs to the pattern only if its exposure began after this.
    pattern_hash
        `Pattern.hash` of what is shown.
    """

    settled_ns: int
    bound_ns: int
    pattern_hash: str


@runtime_checkable
class Projector(Protocol):
    """Shows patterns through the wall x = 0."""

    @property
    def name(self) -> str:
        """For messages."""

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns) a pattern must have."""

    def show(self, pattern: Pattern) -> Flip:
        """Put `pattern` on the output and return when it is there."""

    def close(self) -> None:
        """Go dark and let go of the output."""


@runtime_checkable
class Confirming(Protocol):
    """A projector that can tell whether its output is still what it was; asked after each exposure."""

    def confirm(self) -> None:
        """Raise a DeviceError unless what was shown last is still on the output."""


@dataclass(frozen=True)
class BurstTiming:
    """When the patterns of a burst come.

    Parameters
    ----------
    lit_ms
        For how long each is lit, which ends before the camera's exposure does; dark otherwise.
    period_ms
        From one to the next; None where somebody else's trigger calls for each.
    """

    lit_ms: float
    period_ms: float | None


@runtime_checkable
class BurstProjector(Protocol):
    """A projector that shows patterns one after the other by itself, and triggers the camera with each."""

    def load_burst(self, patterns: Sequence[Pattern], exposure_ms: float) -> BurstTiming:
        """Go dark and get ready to show `patterns` for a camera that exposes `exposure_ms` from each trigger on."""

    def play_burst(self) -> None:
        """Show the patterns that were loaded, once; returns when the first is about to come."""


@dataclass(frozen=True)
class CameraSettings:
    """What can be set on a camera; `configure` returns them as read back."""

    exposure_ms: float
    gain: float = 1.0


Pixels = NDArray[np.uint8] | NDArray[np.uint16]
"""(rows, columns) counts."""


@dataclass(frozen=True, eq=False)
class Frame:
    """One exposure.

    Parameters
    ----------
    pixels
        (rows, columns) uint8 or uint16 counts at the camera's native bit depth; row 0 is y = −Ly/2, column 0 is x = 0.
        Never a view of a buffer that the driver reuses.
    exposure_start_ns
        Monotonic time at which the exposure began.
    device_ns
        The device's own clock at the same moment.
    host_ns
        Monotonic time at which the frame had arrived.
    sequence
        Counts the camera's frames; a jump is a gap.
    """

    pixels: Pixels
    exposure_start_ns: int
    device_ns: int
    host_ns: int
    sequence: int


@runtime_checkable
class CameraDevice(Protocol):
    """A camera that can be configured and takes frames; looks down on the tank. One owner at a time.

    What a scene knows of a camera is `tankrig.Camera`.
    """

    @property
    def name(self) -> str:
        """For messages."""

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns) of a frame."""

    @property
    def saturation(self) -> int:
        """The count at which pixels saturate."""

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Apply `settings` and return them as read back from the device."""

    def capture(self, after_ns: int, timeout_s: float) -> Frame:
        """First frame whose exposure began after `after_ns`."""

    def close(self) -> None:
        """Stop streaming and let go of the device; wakes a capture that waits."""


@runtime_checkable
class TriggeredCamera(Protocol):
    """A camera that can expose on an electrical trigger, rather than freely."""

    def arm(self) -> None:
        """Expose once for each trigger from now on, and no more by itself; drop what waits from before."""

    def triggered(self, timeout_s: float) -> Frame | None:
        """The next exposure, in order; None when no trigger came, or its frame did not arrive, within `timeout_s`."""

    def disarm(self) -> None:
        """Expose freely again; may be called any number of times."""


class Delivered(NamedTuple):
    """Ink delivered since the device's zero: best value and hard bounds, µl."""

    volume_ul: float
    low_ul: float
    high_ul: float


@runtime_checkable
class Doser(Protocol):
    """Delivers ink into the tank.

    States that need a person are latched: after `stop` nothing moves until `clear_stop`; when what was delivered is
    not known, nothing moves until `resolve`.
    """

    @property
    def name(self) -> str:
        """For messages."""

    @property
    def identity(self) -> str:
        """Which doser this is, the same wherever it is plugged in: kind and serial number."""

    @property
    def increment_ul(self) -> float:
        """Smallest volume it can deliver, µl."""

    @property
    def stopped(self) -> bool:
        """Whether a stop is latched."""

    @property
    def unknown(self) -> bool:
        """Whether the delivered volume is unknown and latched."""

    def dose_to(self, total_ul: float) -> Delivered:
        """Deliver until the total since the device's zero is `total_ul` (absolute: never 'add again'), never beyond."""

    def delivered(self) -> Delivered:
        """What has been delivered, with hard bounds."""

    def stop(self) -> None:
        """Stop at once, from any thread, without waiting for a reader; latched until `clear_stop`."""

    def clear_stop(self) -> None:
        """Let the doser move again; does not move it."""

    def resolve(self, volume_ul: float) -> None:
        """A person says what was delivered in all; ends the unknown state."""

    def close(self) -> None:
        """Stop and let go of the port."""


def __getattr__(name: str) -> Any:
    """`Camera`, as `CameraDevice` was called when a scene's camera had the same name; works for one release more."""
    if name != "Camera":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    warnings.warn(
        f"{__name__}.Camera goes with the next release; use {__name__}.CameraDevice", DeprecationWarning, stacklevel=2
    )
    return CameraDevice
