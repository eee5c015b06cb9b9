"""Runs one way of the loop in one process or in four, and measures it from outside."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from select import select
from typing import IO, Any

import numpy as np
from via_core.errors import ViaError
from via_ros.domains import reserved_domain

from via_validation.bench.node import cpu
from via_validation.bench.realtime.loop import MESSAGES, ROLES

LOOK = 0.1  # [s]
QUIET = 5.0  # [s] without a further message after which those that are missing count as lost
Show = Callable[[str, float], None]  # what is done, and the share done, NaN if unknown


@dataclass(frozen=True)
class Loop:
    """One run.

    seconds     from the last look before the loop began, at most LOOK earlier, to its end
    samples     published by the simulator
    late        share of the ticks that were due: begun more than a period late, or left out
    answered    samples whose command arrived
    lost        samples that did not arrive, summed over both estimators
    p50 to largest  round trip from the publication of a sample to the arrival of its command [ms]
    processor   processor time of all processes over the time of the run, of one core
    granted     SCHED_FIFO, affinity, memory locking: 'granted' or why not
    """

    seconds: float
    samples: int
    late: float
    answered: int
    lost: int
    p50: float
    p99: float
    largest: float
    processor: float
    granted: Mapping[str, str]

    @property
    def cost(self) -> float:
        """Processor time per published message [us]."""
        return 1e6 * self.processor * self.seconds / (MESSAGES * self.samples)


class Worker:
    """A process with some roles of the loop."""

    def __init__(self, way: str, seconds: float, cores: Sequence[int], roles: Sequence[str], domain: int) -> None:
        words = [sys.executable, "-m", "via_validation.bench.realtime.worker", way, str(seconds)]
        environment = {**os.environ, "ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        self._process = subprocess.Popen(
            [*words, ",".join(map(str, cores)), *roles],
            env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            bufsize=0,  # a line that a buffer holds is not seen by select
        )  # fmt: skip
        self.roles = roles
        self.granted: dict[str, str] = json.loads(self._line())

    @property
    def _output(self) -> IO[bytes]:
        assert self._process.stdout is not None
        return self._process.stdout

    def _line(self) -> str:
        line = self._output.readline()
        if not line:
            raise ViaError(f"the process of {', '.join(self.roles)} ended with code {self._process.wait()}")
        return line.decode().strip()

    def until(self, line: str, meanwhile: Callable[[], None]) -> None:
        """Wait until it prints this line; `meanwhile` is called all the while."""
        while not select([self._output], [], [], LOOK)[0]:
            meanwhile()
        found = self._line()
        assert found == line, f"'{found}' instead of '{line}'"

    def check(self) -> None:
        """Raise ViaError if it has ended."""
        if self._process.poll() is not None:
            self._line()

    @property
    def processor_time(self) -> float:
        """Of all its threads [s]."""
        return cpu(self._process.pid)

    def counts(self) -> dict[str, dict[str, float]]:
        """Counts of its nodes by role."""
        assert self._process.stdin is not None
        self._process.stdin.write(b"\n")
        counts: dict[str, dict[str, float]] = json.loads(self._line())
        return counts

    def end(self) -> None:
        """End it."""
        self._process.terminate()
        self._process.communicate()


def run(way: str, processes: int, seconds: float, show: Show) -> Loop:
    """Run the loop for `seconds` in one process or in four. Raises ViaError if a process ends."""
    available = sorted(os.sched_getaffinity(0))
    cores = available[-1:] if processes == 1 else available
    groups = [ROLES] if processes == 1 else [(role,) for role in ROLES]
    with ExitStack() as stack:
        domain = stack.enter_context(reserved_domain())
        workers = []
        for roles in groups:
            workers.append(Worker(way, seconds, cores, roles, domain))
            stack.callback(workers[-1].end)
        simulator = workers[0]

        def alive() -> None:
            for each in workers:
                each.check()

        def spent() -> np.ndarray:
            return np.array([time.monotonic(), sum(each.processor_time for each in workers)])

        before = spent()

        def waiting() -> None:
            nonlocal before
            alive()
            before = spent()  # this process may get to read 'begun' long after: the last look precedes the loop

        simulator.until("begun", waiting)

        def progress() -> None:
            alive()
            show("running", (time.monotonic() - before[0]) / seconds)

        simulator.until("finished", progress)
        passed, used = (spent() - before).tolist()
        counts = _final(workers)
    loop = counts["simulator"]
    samples = int(loop["samples"])
    lost = sum(samples - int(counts[role]["samples"]) for role in ROLES if role.startswith("estimator"))
    return Loop(
        passed, samples, loop["late"], int(loop["answered"]), lost, loop["p50"], loop["p99"], loop["largest"],
        used / passed, simulator.granted,
    )  # fmt: skip


def _final(workers: Sequence[Worker]) -> dict[str, dict[str, Any]]:
    """Counts by role when every message has arrived, or none for QUIET."""
    counts: dict[str, dict[str, Any]] = {}
    changed = time.monotonic()
    while time.monotonic() - changed < QUIET:
        found = {role: each for worker in workers for role, each in worker.counts().items()}
        if found != counts:
            counts, changed = found, time.monotonic()
        samples = counts["simulator"]["samples"]
        if samples == counts["simulator"]["answered"] and all(each["samples"] == samples for each in counts.values()):
            break
        time.sleep(LOOK)
    return counts
