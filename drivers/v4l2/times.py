"""How many frames a camera has made, and when the exposure of each began: mathematics, without a device."""

from collections import deque
from itertools import pairwise

_REMEMBERED = 8
_WRAPS_AT = 2**32


class FrameCount:
    """Counts a camera's frames by the kernel's own count, which also counts frames that were lost on the way.

    Times have no say: a frame that comes late, or a camera that has become slower, is no loss.

    Examples
    --------
    >>> count = FrameCount()
    >>> [count.next(device) for device in (7, 8, 11)]  # two frames lost
    [1, 2, 5]
    >>> count.interrupted()
    >>> count.next(0)  # the kernel counts each stream from 0 on
    7
    """

    def __init__(self) -> None:
        self._frames = 0
        self._device: int | None = None

    def interrupted(self) -> None:
        """The kernel's count begins anew with the next frame; how many were lost nobody knows, so one is."""
        if self._device is not None:
            self._frames += 1
        self._device = None

    def next(self, device_sequence: int) -> int:
        """Number of the frame that the kernel counts as `device_sequence` (32 bits, then it begins at 0 again).

        A count that stands still or goes back says nothing: the frame is taken for the next one.
        """
        ahead = 1 if self._device is None else (device_sequence - self._device) % _WRAPS_AT
        self._device = device_sequence
        self._frames += ahead if 0 < ahead < _WRAPS_AT // 2 else 1
        return self._frames


class FrameTimes:
    """When frames began, from time stamps of which each may be late but none is early.

    A frame cannot have begun later than its own stamp says. Nor can it have begun later than an earlier frame's stamp
    and the frames since then say, at the pace of the camera: so a late stamp is bounded by those before it. The pace is
    the second shortest interval of the last eight frames, because one late stamp makes one interval too short; in
    a camera that has become slower frames seem to begin too early for that long, and never too late.

    So none is given too late while three of the last eight stamps are true. Nothing older counts, so that no error
    accumulates.

    Parameters
    ----------
    period_ns
        Shortest time from one frame to the next, as the camera is set; 0 where it is not known.

    Examples
    --------
    >>> times = FrameTimes(period_ns=10)
    >>> [times.began_ns(frame, stamp) for frame, stamp in ((1, 100), (2, 110), (3, 127), (4, 130), (6, 150))]
    [100, 110, 120, 130, 150]
    """

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self._stamps: deque[tuple[int, int]] = deque(maxlen=_REMEMBERED)
        self._began_ns = 0

    def began_ns(self, frame: int, stamped_ns: int) -> int | None:
        """The latest time at which this frame can have begun.

        Parameters
        ----------
        frame
            Its number, as `FrameCount` has it.
        stamped_ns
            Its time stamp.

        Returns
        -------
        int or None
            ns; None for a stamp that is not after the beginning of the frame before, which can't be true.
        """
        self._stamps.append((frame, stamped_ns))
        if stamped_ns <= self._began_ns:
            return None
        pace_ns = self._pace_ns()
        latest_ns = min(stamp + (frame - number) * pace_ns for number, stamp in self._stamps)
        self._began_ns = max(latest_ns, self._began_ns + 1)
        return self._began_ns

    def _pace_ns(self) -> int:
        intervals = sorted(
            (late - early) // (after - before) for (before, early), (after, late) in pairwise(self._stamps)
        )
        shortest_ns = intervals[1] if len(intervals) > 2 else min(intervals, default=0)
        return max(self._period_ns, shortest_ns)
