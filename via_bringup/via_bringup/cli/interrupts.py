"""Ctrl-C ends a command within a second: in compiled code too, and with its worker processes."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from typing import NoReturn

from via_bringup.cli.console import errors

PATIENCE = 0.6  # [s] in which Python ends by KeyboardInterrupt; a kernel that compiles takes longer
INTERRUPTED = 130  # exit code


def end_on_interrupt() -> None:
    """Raise KeyboardInterrupt at SIGINT; end the process after PATIENCE if it is then still busy.

    Python runs signal handlers between bytecodes only, so a thread watches the signals through the wake-up pipe.
    """
    end, begin = os.pipe()
    os.set_blocking(begin, False)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.set_wakeup_fd(begin, warn_on_full_buffer=False)

    def watch() -> None:
        while os.read(end, 1) != bytes([signal.SIGINT]):
            pass
        time.sleep(PATIENCE)
        leave()

    threading.Thread(target=watch, name="interrupt", daemon=True).start()


def leave() -> NoReturn:
    """End the process at once, with its worker processes."""
    import multiprocessing  # a tenth of the time that `via --help` takes

    for child in multiprocessing.active_children():
        child.kill()
    sys.stdout.flush()
    errors.show_cursor(True)  # a progress display hides it
    errors.print("interrupted")
    os._exit(INTERRUPTED)
