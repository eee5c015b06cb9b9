"""Run long jobs in separate processes, two at a time. Messages of a job arrive in order; a job that dies ends alone.

def work(part: str, send: Send) -> None: ...            # at the top level of a module, since it is pickled by name
complete = side_by_side([(work, ("a",)), (work, ("b",))], receive, started, ended)
"""

from __future__ import annotations

import signal
from collections.abc import Callable, Sequence
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import Any, cast

AT_ONCE = 2
Send = Callable[[Any], None]
Job = tuple[Callable[..., None], tuple[Any, ...]]  # called with these arguments and a Send


def side_by_side(
    jobs: Sequence[Job],
    receive: Callable[[int, Any], None],
    started: Callable[[int], None],
    ended: Callable[[int], None],
) -> bool:
    """Run all jobs; False if an interrupt ended them before all were done.

    receive         called with the number of a job and a message from it
    started, ended  called with the number of a job when its process starts, and when it has ended for any reason
    """
    waiting = list(range(len(jobs)))
    running: dict[Connection, tuple[int, SpawnProcess]] = {}
    try:
        while waiting or running:
            while waiting and len(running) < AT_ONCE:
                number = waiting.pop(0)
                reader, process = _start(jobs[number])
                running[reader] = number, process
                started(number)
            for ready in wait(list(running)):
                reader = cast(Connection, ready)
                number, process = running[reader]
                try:
                    receive(number, reader.recv())
                except EOFError:
                    process.join()
                    del running[reader]
                    ended(number)
    except KeyboardInterrupt:
        for number, process in running.values():
            process.terminate()
            process.join()
            ended(number)
        return False
    return True


def _start(job: Job) -> tuple[Connection, SpawnProcess]:
    context = get_context("spawn")  # a fork would copy the threads of the progress display
    reader, writer = context.Pipe(duplex=False)
    process = context.Process(target=_work, args=(*job, writer), daemon=True)
    process.start()
    writer.close()
    return reader, process


def _work(work: Callable[..., None], arguments: tuple[Any, ...], writer: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends it
    work(*arguments, writer.send)
