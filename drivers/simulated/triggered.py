"""Which triggers a camera answers with an exposure."""

from collections.abc import Iterable


class TriggeredStream:
    """Exposures that follow triggers; one that comes before the camera is ready again is missed.

    Parameters
    ----------
    armed_ns
        From when on triggers count.
    period_ns
        From the start of an exposure until the camera is ready for the next.

    Examples
    --------
    >>> stream = TriggeredStream(armed_ns=100, period_ns=10)
    >>> [stream.take([90, 101, 105, 112]), stream.take([90, 101, 105, 112]), stream.take([90, 101, 105, 112])]
    [101, 112, None]
    """

    def __init__(self, armed_ns: int, period_ns: int) -> None:
        self._ready_ns, self._period_ns = armed_ns, period_ns

    def take(self, triggers_ns: Iterable[int]) -> int | None:
        """When the next exposure began, given all triggers so far; None where there was none."""
        for at_ns in triggers_ns:
            if at_ns >= self._ready_ns:
                self._ready_ns = at_ns + self._period_ns
                return at_ns
        return None
