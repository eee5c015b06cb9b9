"""Processes that Ctrl-C does not reach: the terminal sends it to all, it is for the parent, which ends the others."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker


@contextmanager
def undisturbed() -> Iterator[None]:
    """Whatever process or thread begins in here has SIGINT blocked from its birth, and so have those it begins."""
    resource_tracker.ensure_running()  # whoever starts it later unblocks the signal again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
