"""Ctrl-C ends a command within a second: in compiled code too, and with its worker processes."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NoReturn

from via_bringup.cli.console import errors

PATIENCE = 0.6  # [s] in which Python ends by KeyboardInterrupt; a kernel that compiles takes longer
INTERRUPTED = 130  # exit code


@contextmanager
def ending_on_interrupt() -> Iterator[None]:
    """Inside, SIGINT raises KeyboardInterrupt; a process that is still busy PATIENCE later ends.

    Python runs signal handlers between bytecodes only, so a thread watches the signals through the wake-up pipe.
    """
    end, begin = os.pipe()
    os.set_blocking(begin, False)
    handler = signal.signal(signal.SIGINT, signal.default_int_handler)
    wakeup = signal.set_wakeup_fd(begin, warn_on_full_buffer=False)
    over = threading.Event()

    def watch() -> None:
        while (number := os.read(end, 1)) not in (bytes([signal.SIGINT]), b""):
            pass
        os.close(end)
        if number and not over.wait(PATIENCE):
            leave()

    threading.Thread(target=watch, name="interrupt", daemon=True).start()
    try:
        yield
    finally:
        over.set()
        signal.set_wakeup_fd(wakeup)
        signal.signal(signal.SIGINT, handler)
        os.close(begin)


def leave() -> NoReturn:
    """End the process at once, with its worker processes."""
    import multiprocessing  # a tenth of the time that `via --help` takes

    for child in multiprocessing.active_children():
        child.kill()
    sys.stdout.flush()
    errors.show_cursor(True)  # a progress display hides it
    errors.print("interrupted")
    os._exit(INTERRUPTED)
