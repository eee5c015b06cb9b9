"""One diagnosis at a time in a process of its own, so that the caller is not blocked and can end it at once.

worker = Worker()
worker.begin(Job(device, log))
worker.poll()       # Progress, then Finished or Failed; None: no news
worker.cancel()     # ends the process; the next job gets a new one
worker.close()

A thread receives the messages of the process. The process has a lower priority and ends with its parent.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing import get_context, resource_tracker
from multiprocessing.connection import Connection
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

from via_core.devices import Device
from via_core.errors import ViaError
from via_sim.effects.own import load_all, loaded

from via_gap.design.proposal import with_proposal
from via_gap.diagnosis import diagnose
from via_gap.logs.log import JointLog, read_log
from via_gap.selection.search import Progress as OnProgress

NICE = 10  # niceness of the process
PATIENCE = 1.0  # [s] wait for a terminated process


@dataclass(frozen=True, eq=False)
class Job:
    """What to diagnose: a log, or the path of one."""

    device: Device
    source: JointLog | Path
    joint_topic: str = "/joint_states"
    own_effects: tuple[str, ...] = field(default_factory=loaded)  # modules and files to load in the process


@dataclass(frozen=True)
class Progress:
    doing: str
    share: float  # 0..1


@dataclass(frozen=True)
class Finished:
    report: str  # JSON of a GapReport


@dataclass(frozen=True)
class Failed:
    reason: str  # one line


Event = Progress | Finished | Failed


class Worker:
    """Runs one Job at a time; `begin` starts the process if there is none."""

    def __init__(self, own_effects: Iterable[str] = ()) -> None:
        """Load modules and files that add effects, here and in the process. Raises ParameterError as `load_own`."""
        load_all(own_effects)
        self._context = get_context("spawn")
        self._process: Any = None
        self._connection: Connection | None = None
        self._events: SimpleQueue[Event] = SimpleQueue()
        self.busy = False

    @property
    def pid(self) -> int | None:
        """Id of the process; None: there is none."""
        return None if self._process is None else int(self._process.pid)

    def begin(self, job: Job) -> None:
        """Start a job; none may be under way."""
        assert not self.busy
        self.busy = True
        self._events = SimpleQueue()
        if self._process is None or not self._process.is_alive():
            self._start()
        threading.Thread(
            target=_converse, args=(self._connection, job, self._events), name="diagnosis", daemon=True
        ).start()

    def poll(self, patience: float = 0.0) -> Event | None:
        """The next event; None where there is none within `patience` [s]."""
        try:
            event = self._events.get(patience > 0.0, patience)
        except Empty:
            return None
        if not isinstance(event, Progress):
            self.busy = False
        return event

    def cancel(self) -> None:
        """End the job and its process."""
        process, self._process, self.busy = self._process, None, False
        self._events = SimpleQueue()
        if process is None:
            return
        process.terminate()
        process.join(PATIENCE)
        if process.is_alive():
            process.kill()
            process.join()

    close = cancel

    def _start(self) -> None:
        here, there = self._context.Pipe()
        process = self._context.Process(target=_work, args=(there,), name="via_gap diagnosis", daemon=True)
        with undisturbed():
            process.start()
        there.close()
        self._process, self._connection = process, here


@contextmanager
def undisturbed() -> Iterator[None]:
    """Processes and threads started inside ignore Ctrl-C, and so do their children: only the parent handles it."""
    resource_tracker.ensure_running()  # started later, it would unblock the signal again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _converse(connection: Connection, job: Job, events: SimpleQueue[Event]) -> None:
    """Send the job and pass on its events."""
    try:
        connection.send(job)
        event: Event = connection.recv()
        while isinstance(event, Progress):
            events.put(event)
            event = connection.recv()
        events.put(event)
    except (EOFError, OSError):
        events.put(Failed("the process of the diagnosis ended before it was finished"))


def _work(connection: Connection) -> None:
    """The process: one job after another, until the parent is gone."""
    os.nice(NICE)
    try:
        while True:
            connection.send(diagnosed(connection.recv(), lambda doing, share: connection.send(Progress(doing, share))))
    except (EOFError, OSError):
        return


def diagnosed(job: Job, progress: OnProgress | None = None) -> Finished | Failed:
    """The report on a job, with a proposed motion; a faulty log is an outcome, not an error."""
    try:
        load_all(job.own_effects)
        log = job.source if isinstance(job.source, JointLog) else read_log(job.source, job.device, job.joint_topic)
        return Finished(with_proposal(diagnose([log], job.device, progress=progress), job.device).to_json())
    except BrokenPipeError:
        raise
    except (ViaError, OSError) as error:
        return Failed(" ".join(str(error).split()))
