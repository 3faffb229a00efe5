"""The light that a simulated projector sends into a tank, moment by moment, and its wire to the camera's trigger."""

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from weakref import WeakValueDictionary

from tankrig.pattern import Pattern

_REMEMBERED = 1024
"""Flips and triggers; far more than happen while frames wait in a camera's queue, or in a burst."""


class FrameBuffer:
    """What a projector shows and has shown.

    Examples
    --------
    >>> import numpy as np
    >>> full = Pattern("full", np.full((2, 2), 255, np.uint8))
    >>> buffer = FrameBuffer()
    >>> buffer.show(full, lit_ns=1000)
    >>> buffer.shown(0, 4000)[full]
    0.75
    """

    def __init__(self) -> None:
        self._flips: deque[tuple[int, Pattern | None]] = deque([(0, None)], maxlen=_REMEMBERED)
        self._triggers: deque[int] = deque(maxlen=_REMEMBERED)
        self._lock = threading.Lock()
        self.catch_up: Callable[[], object] = lambda: None
        """Called before anybody looks: a projector that works by itself tells here what it has shown meanwhile."""

    def flash(self, pattern: Pattern, lit_ns: int, dark_ns: int) -> None:
        """Light the tank with `pattern` from `lit_ns` to `dark_ns`, and trigger the camera at `lit_ns`."""
        with self._lock:
            self._flips.extend([(lit_ns, pattern), (dark_ns, None)])
            self._triggers.append(lit_ns)

    def triggers(self, after_ns: int) -> list[int]:
        """When the camera was triggered later than `after_ns`, in order."""
        self.catch_up()
        with self._lock:
            return [at_ns for at_ns in self._triggers if at_ns > after_ns]

    def show(self, pattern: Pattern | None, lit_ns: int) -> None:
        """Light the tank with `pattern`, or not at all, from `lit_ns` on, which rises from call to call."""
        with self._lock:
            self._flips.append((lit_ns, pattern))

    def go_dark(self) -> None:
        """No light from now on, whatever was to come."""
        now_ns = time.monotonic_ns()
        with self._lock:
            while self._flips and self._flips[-1][0] >= now_ns:
                self._flips.pop()
            self._flips.append((now_ns, None))

    def shown(self, start_ns: int, end_ns: int) -> Mapping[Pattern, float]:
        """Parts of the time from `start_ns` to `end_ns` in which each pattern was shown."""
        self.catch_up()
        with self._lock:
            flips = list(self._flips)
        parts: dict[Pattern, float] = {}
        ends = [lit_ns for lit_ns, _ in flips[1:]] + [end_ns]
        for (lit_ns, pattern), until_ns in zip(flips, ends, strict=True):
            overlap_ns = min(until_ns, end_ns) - max(lit_ns, start_ns)
            if pattern is not None and overlap_ns > 0:
                parts[pattern] = parts.get(pattern, 0.0) + overlap_ns / (end_ns - start_ns)
        return parts


def frame_buffer(folder: Path) -> FrameBuffer:
    """The one that lights the tank in `folder`: the same for all who ask in this process, while one of them has it."""
    with _opening:
        return _buffers.setdefault(folder.absolute(), FrameBuffer())


_opening = threading.Lock()
_buffers: WeakValueDictionary[Path, FrameBuffer] = WeakValueDictionary()
