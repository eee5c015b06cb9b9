"""Reads damaged files in a child process, and reports everything but a result or an error of the project."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path
from resource import RUSAGE_SELF, getrusage
from tempfile import TemporaryDirectory
from types import FrameType
from typing import Any

import numpy as np
from via_core.errors import ViaError

from via_validation.fuzz.inputs import damaged, kinds

BATCH = 2000  # files per child process call
PATIENCE = 60  # [s] for one file
WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT


@dataclass
class Result:
    """Counts of one kind of file, and one line for each fault; the sum of batches has their largest growth."""

    files: int = 0
    read: int = 0
    refused: int = 0
    faults: list[str] = field(default_factory=list)
    growth: float = 0.0  # [MB] of the largest memory, in the second half of the batch

    def __add__(self, other: Result) -> Result:
        counts = self.files + other.files, self.read + other.read, self.refused + other.refused
        return Result(*counts, self.faults + other.faults, max(self.growth, other.growth))


def batches(kind: str, inputs: int, seed: int) -> Iterator[Result]:
    """Results of so many damaged files, batch by batch; a crash is a fault of its batch."""
    for begin in range(0, inputs, BATCH):
        numbers = range(begin, min(begin + BATCH, inputs))
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
            try:
                yield pool.submit(_read, kind, numbers, seed).result()
            except BrokenProcessPool:
                crash = f"{kind} {numbers.start} to {numbers.stop - 1}: the process crashed"
                yield Result(len(numbers), faults=[crash])


def _read(kind: str, numbers: range, seed: int) -> Result:
    result, (ending, originals, read, beside) = Result(len(numbers)), kinds()[kind]
    before = 0
    signal.signal(signal.SIGALRM, _too_long)
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"file{ending}"
        for name, content in beside.items():
            (Path(folder) / name).write_bytes(content)
        for original in originals:
            path.write_bytes(original)
            read(path)  # imports and compiles
        forbidden: list[str] = []
        sys.addaudithook(lambda event, given: _audit(event, given, folder, forbidden))
        for number in numbers:
            if number == numbers[len(numbers) // 2]:
                before = _memory()
            rng = np.random.default_rng((seed, number))
            path.write_bytes(damaged(rng, originals[rng.integers(len(originals))]))
            signal.alarm(PATIENCE)
            try:
                read(path)
                result.read += 1
            except ViaError as error:
                result.refused += 1
                if "\n" in str(error) or len(str(error)) > 2000:
                    result.faults.append(f"{kind} {number}: the error is longer than one line")
            except BaseException as error:
                result.faults.append(f"{kind} {number}: {type(error).__name__}: {' '.join(str(error).split())[:100]}")
            finally:
                signal.alarm(0)
            result.faults += [f"{kind} {number}: {each}" for each in forbidden]
            forbidden.clear()
        result.growth = (_memory() - before) / 1e3
    return result


def _memory() -> int:
    """[kB] largest memory of this process so far."""
    return getrusage(RUSAGE_SELF).ru_maxrss


def _too_long(_: int, __: FrameType | None) -> None:
    raise TimeoutError(f"more than {PATIENCE} s")


def _audit(event: str, given: tuple[Any, ...], folder: str, forbidden: list[str]) -> None:
    """Take note of programs, connections and files written outside of `folder` and of the cache of compiled code."""
    if event in ("os.system", "os.exec", "os.posix_spawn", "subprocess.Popen", "socket.connect"):
        forbidden.append(f"{event} {given!r}"[:100])
    if event == "open" and isinstance(given[2], int) and given[2] & WRITING and isinstance(given[0], str):
        cache = os.environ.get("NUMBA_CACHE_DIR", folder)
        if not given[0].startswith((folder, cache)) and "__pycache__" not in given[0]:
            forbidden.append(f"wrote {given[0]}"[:100])
