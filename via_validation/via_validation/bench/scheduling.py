"""Real-time scheduling (SCHED_FIFO) for control loops.

At normal priorities another process can occupy a processor for several milliseconds, however short the loop is.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

PRIORITY = 20  # of 1..99: above normal processes, below kernel threads


@contextmanager
def real_time(priority: int = PRIORITY) -> Iterator[bool]:
    """Context with real-time scheduling of this thread and of threads that it starts; yields whether it is granted.

    It is granted to root, with CAP_SYS_NICE, or within `ulimit -r`. Afterwards the previous scheduling is restored.
    """
    try:
        before = os.sched_getscheduler(0), os.sched_getparam(0)
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except (AttributeError, OSError):  # not supported, or not permitted
        yield False
        return
    try:
        yield True
    finally:
        os.sched_setscheduler(0, *before)
