"""How many threads a computation takes."""

import os

VARIABLE = "TANKRIG_THREADS"
USUAL = 2


def threads_asked() -> int:
    """What the environment asks for, or two.

    Examples
    --------
    >>> os.environ[VARIABLE] = "3"
    >>> threads_asked()
    3
    >>> del os.environ[VARIABLE]
    """
    asked = os.environ.get(VARIABLE, "")
    return max(1, int(asked)) if asked.isdecimal() else USUAL


THREADS = threads_asked()
"""Of this process, which begins with it: kernels are compiled for it, and a process's children inherit the variable."""
