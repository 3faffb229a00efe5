"""Processes that may have only the processor time that nobody else wants."""

import os


def take_leftover_time(niceness: int) -> None:
    """Make the process that calls this give way to all others, in recording and on the screen.

    On Linux it is scheduled as idle: it is put aside at once when anyone else has something to do, where a merely nice
    process is let finish its turn. On a machine whose processors are all busy it therefore stands nearly still.

    Parameters
    ----------
    niceness
        That the process keeps, for systems that know no idle scheduling, and for those who list processes.
    """
    os.nice(niceness)
    if hasattr(os, "SCHED_IDLE"):
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
