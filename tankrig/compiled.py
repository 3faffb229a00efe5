"""The one way tankrig compiles a numerical kernel."""

from collections.abc import Callable
from typing import Any, TypeVar

F = TypeVar("F", bound=Callable[..., Any])


def kernel(function: F) -> F:
    """Compile `function` to machine code on its first call, keep the code on disk, and release the GIL while it runs.

    A kernel that held the GIL would freeze the window for as long as it ran (measured: 750 ms), and one that was not
    cached would cost every new process seconds. `fastmath` vectorises
    sums but keeps NaN and infinity meaningful.

    Parameters
    ----------
    function
        Numerical code that numba understands: arrays and numbers in, arrays and numbers out.
    """
    import numba

    compiled: F = numba.njit(nogil=True, cache=True, fastmath={"reassoc", "contract", "arcp", "nsz"})(function)
    return compiled
