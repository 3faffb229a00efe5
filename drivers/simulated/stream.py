"""A camera's stream: exposures one after the other, and the queue that they wait in until a program takes them."""

from collections import deque


class Stream:
    """Works out which exposure a program gets next, as a video driver with a few buffers would have it.

    Exposures follow each other without a break. Those that have arrived wait; while all buffers are full, new ones are
    lost. So who comes back after a while first gets the oldest, then what is exposed from now on.

    Parameters
    ----------
    start_ns, number
        Of the first exposure.
    period_ns
        From exposure to exposure.
    delay_ns
        From the start of an exposure to its arrival.
    queue
        Number of buffers.

    Examples
    --------
    >>> stream = Stream(start_ns=0, number=0, period_ns=10, delay_ns=12, queue=2)
    >>> [stream.take(now_ns=100) for _ in range(4)]
    [0, 1, 9, 10]
    >>> stream.start_ns(9), stream.arrival_ns(9)
    (90, 102)
    """

    def __init__(self, start_ns: int, number: int, period_ns: int, delay_ns: int, queue: int) -> None:
        self._origin_ns = start_ns - number * period_ns
        self._period_ns, self._delay_ns, self._queue = period_ns, delay_ns, queue
        self._waiting: deque[int] = deque()
        self._next = number

    def start_ns(self, number: int) -> int:
        """When an exposure began."""
        return self._origin_ns + number * self._period_ns

    def arrival_ns(self, number: int) -> int:
        """When an exposure has arrived."""
        return self.start_ns(number) + self._delay_ns

    def take(self, now_ns: int) -> int:
        """Number of the next exposure for the program; it may still have to arrive."""
        if not self._waiting:
            arrived = (now_ns - self._origin_ns - self._delay_ns) // self._period_ns
            if arrived >= self._next + self._queue:
                self._waiting.extend(range(self._next, self._next + self._queue))
                self._next = arrived + 1
        if self._waiting:
            return self._waiting.popleft()
        self._next += 1
        return self._next - 1

    def give_back(self, number: int) -> None:
        """It was not waited for long enough to arrive; the next `take` gets it again."""
        self._waiting.appendleft(number)

    def hold(self, time_ns: int) -> None:
        """Let exposures that are still to come be later by `time_ns`: the time that went into computing a picture."""
        self._origin_ns += time_ns
