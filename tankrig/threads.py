"""How many threads a computation takes."""

import os

VARIABLE, USUAL = "TANKRIG_THREADS", 2


def threads_asked() -> int:
    """What the environment asks for, or two, with which all times in the documentation were taken."""
    asked = os.environ.get(VARIABLE, "")
    return max(1, int(asked)) if asked.isdecimal() else USUAL


THREADS = threads_asked()
"""Of this process; workers inherit the variable."""
