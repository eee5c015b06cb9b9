"""A loop that keeps time asks the kernel to be run before all that do not: SCHED_FIFO, as controllers of robots do.

At usual priorities a process beside it may hold a processor for several ticks of a kilohertz, whatever the loop costs.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

PRIORITY = 20  # of 99: before everything usual, after the kernel's own threads


@contextmanager
def real_time(priority: int = PRIORITY) -> Iterator[bool]:
    """Within it this thread, and every one that it starts, runs first; says whether the kernel granted it.

    It grants that to root, with CAP_SYS_NICE, or within `ulimit -r`. Afterwards this thread is scheduled as before.
    """
    try:
        before = os.sched_getscheduler(0), os.sched_getparam(0)
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except (AttributeError, OSError):  # a system without such schedulers, or a user without the right
        yield False
        return
    try:
        yield True
    finally:
        os.sched_setscheduler(0, *before)
