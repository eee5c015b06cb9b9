"""Real-time scheduling (SCHED_FIFO), affinity and memory locking for control loops.

At normal priorities another process can occupy a processor for several milliseconds, however short the loop is. A page
that was moved out of memory takes milliseconds to come back.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager

PRIORITY = 20  # of 1..99: above normal processes, below kernel threads

LOCKED = 1 | 2 | 4  # MCL_CURRENT, MCL_FUTURE, MCL_ONFAULT: what is in memory stays there
GRANTED = "granted"


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


def prepare(cores: Collection[int]) -> dict[str, str]:
    """Request all three for this process and what it starts, on these cores; 'granted' or the reason for each."""
    return {
        "SCHED_FIFO": _granted(lambda: os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))),
        "affinity": _granted(lambda: os.sched_setaffinity(0, cores)),
        "memory locking": _granted(_lock_memory),
    }


def _granted(request: Callable[[], None]) -> str:
    try:
        request()
    except AttributeError:
        return "this system has none"
    except OSError as error:
        return f"not granted: {error.strerror}"
    return GRANTED


def _lock_memory() -> None:
    if ctypes.CDLL(None, use_errno=True).mlockall(LOCKED):
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
