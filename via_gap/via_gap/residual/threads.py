"""Calls of compiled kernels on several threads; kernels release the interpreter's lock."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import cache

THREADS = 2


@cache
def _pool() -> ThreadPoolExecutor:
    """One pool for the whole process, because starting threads takes about as long as their work."""
    return ThreadPoolExecutor(THREADS)


os.register_at_fork(after_in_child=_pool.cache_clear)  # threads do not survive a fork


def together(calls: Iterable[Callable[[], None]]) -> None:
    """Make all calls, THREADS at a time; raises what one of them raises."""
    waiting = list(calls)
    if len(waiting) == 1:
        waiting[0]()
        return
    for job in [_pool().submit(call) for call in waiting]:
        job.result()
