"""Calls of compiled kernels on several threads; kernels release the interpreter's lock."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from math import ceil

THREADS = 2
BLOCKS = 8  # that one call computes at most: its own cost is small beside them


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


def per_call(runs: int, block: int) -> int:
    """Runs of each call, if `runs` are computed in blocks that cost the same however many of `block` lanes are used.

    Blocks are full, and no thread has more than one block more than another.
    """
    blocks = ceil(runs / block)
    return block * ceil(blocks / (THREADS * ceil(blocks / (THREADS * BLOCKS))))
