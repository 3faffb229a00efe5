"""How many threads a computation takes."""

import os
import threading
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

VARIABLE, USUAL = "TANKRIG_THREADS", 2


def threads_asked() -> int:
    """What the environment asks for, or two, with which all times in the documentation were taken."""
    asked = os.environ.get(VARIABLE, "")
    return max(1, int(asked)) if asked.isdecimal() else USUAL


THREADS = threads_asked()
"""Of this process; workers inherit the variable."""


class _OneBlasThread:
    """How many ask for it, and how it was before."""

    def __init__(self) -> None:
        self.lock, self.asked = threading.Lock(), 0
        self.libraries: ThreadpoolController | None = None
        self.before: AbstractContextManager[object] | None = None


_one = _OneBlasThread()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Keep products of matrices in the thread that asks for them, until all who asked for that have left.

    Many small products keep the threads of a BLAS library spinning between them: smoothing took eight times its CPU
    time on a busy machine. What may take more threads asks for `THREADS` itself.
    """
    with _one.lock:
        if _one.asked == 0:
            from threadpoolctl import ThreadpoolController

            _one.libraries = _one.libraries or ThreadpoolController()
            _one.before = _one.libraries.limit(limits=1, user_api="blas")
            _one.before.__enter__()
        _one.asked += 1
    try:
        yield
    finally:
        with _one.lock:
            _one.asked -= 1
            if _one.asked == 0 and _one.before is not None:
                _one.before.__exit__(None, None, None)
