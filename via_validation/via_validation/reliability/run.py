"""Runs faults one after another in a child process; a fault that ends or blocks it is missed, and a new one goes on."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory
from time import monotonic
from typing import NamedTuple

from via_validation.reliability import controllers, estimators, playing, processes, recordings, requests, simulators
from via_validation.reliability.fault import Fault, MissedError, Outcome
from via_validation.reliability.graph import Graph

LIMIT = 600.0  # [s] for one fault


class Name(NamedTuple):
    """A fault by its group and what is injected."""

    group: str
    injected: str


def groups() -> Mapping[str, Sequence[Fault]]:
    """Title of each group -> its faults."""
    return {
        "Samples of an estimator": estimators.faults(),
        "Samples of a controller": controllers.sample_faults(),
        "Estimates and references of a controller": controllers.input_faults(),
        "Commands and requests of a simulator": simulators.faults(),
        "Lifecycle, parameters and services": requests.faults(),
        "Recordings": recordings.faults(),
        "Reading and playing of bags": playing.faults(),
        "Processes": processes.faults(),
    }


def outcomes(names: Sequence[Name], limit: float = LIMIT) -> Iterator[Outcome]:
    """The outcome of each fault, in order."""
    known = {(group, each.injected): each for group, faults in groups().items() for each in faults}
    child: _Child | None = None
    try:
        for name in names:
            child = child or _Child()
            began = monotonic()
            outcome = child.outcome(name, limit)
            if outcome is None:
                child.end()
                seconds, fault = monotonic() - began, known[name]
                seen = "the process of the graph crashed" if seconds < limit else f"no end within {limit:g} s"
                outcome, child = Outcome(name.group, fault.injected, fault.must, seen, False, seconds), None
            yield outcome
    finally:
        if child is not None:
            child.end()


class _Child:
    """A process that runs faults."""

    def __init__(self) -> None:
        context = get_context("spawn")  # rclpy and its middleware do not survive a fork
        self._end, other = context.Pipe()
        self._process = context.Process(target=_work, args=(other,), daemon=False)
        self._process.start()
        other.close()

    def outcome(self, name: Name, limit: float) -> Outcome | None:
        """The outcome of a fault; None if the process has ended or the time is over."""
        self._end.send(name)
        try:
            if not self._end.poll(limit):
                return None
            found: Outcome = self._end.recv()
        except (EOFError, ConnectionError):
            return None
        return found

    def end(self) -> None:
        """End the process."""
        self._end.close()
        self._process.join(5.0)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()


def _work(end: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends it
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    faults = {(group, each.injected): each for group, each_of in groups().items() for each in each_of}
    while True:
        try:
            name = end.recv()
        except EOFError:
            return
        end.send(run_one(name.group, faults[name]))


def run_one(group: str, fault: Fault) -> Outcome:
    """The outcome of a fault in a new graph in this process; what its nodes print is not shown."""
    began = monotonic()
    with TemporaryDirectory() as folder:
        os.environ["ROS_LOG_DIR"] = str(Path(folder) / "ros_log")
        try:
            with _quiet(Path(folder) / "peer.err"), Graph(Path(folder)) as graph:
                seen, met = fault.check(graph), True
        except Exception as error:  # an error of a node ends the executor: that, too, is an outcome
            kind = "" if isinstance(error, MissedError) else f"{type(error).__name__}: "
            seen, met = f"{kind}{' '.join(str(error).split())}"[:400], False
    return Outcome(group, fault.injected, fault.must, seen, met, monotonic() - began)


@contextmanager
def _quiet(path: Path) -> Iterator[None]:
    """Write what this process prints, also that of C++ code, into a file."""
    kept = [(number, os.dup(number)) for number in (1, 2)]
    sys.stdout.flush()
    sys.stderr.flush()
    with path.open("wb") as file:
        try:
            for number, _ in kept:
                os.dup2(file.fileno(), number)
            yield
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            for number, copy in kept:
                os.dup2(copy, number)
                os.close(copy)
