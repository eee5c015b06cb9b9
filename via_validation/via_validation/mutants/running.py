"""Run the tests against mutated copies of the repository.

Every worker has a copy of the tracked files and a cache of compiled kernels. A test file is first run on the copy as it
is, which must pass and fills the cache; then on the mutated copy, with a copy of the cache. numba checks only the file
that defines a kernel, so the copy lacks the kernels of all files that import the mutated module.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue

from via_core.errors import ViaError

from via_validation.mutants.imports import Imports, covering, dependents, imports_of
from via_validation.mutants.operators import Mutation

PLUGINS = ("launch_testing", "launch_pytest", "launch_testing_ros_pytest_entrypoint", "xdist", "cacheprovider")
HANGS = 10.0  # times as long as without the mutation, and AT_LEAST [s], after which a test file hangs
AT_LEAST = 300.0
FAILED, NO_TESTS = 1, 5  # exit codes of pytest


@dataclass(frozen=True)
class Outcome:
    """What became of a mutation."""

    mutation: Mutation
    killed_by: str  # the test that failed; '' if none did
    files: int  # test files run
    seconds: float  # of them without the mutation


@dataclass(frozen=True)
class Limits:
    """Effort per mutation: test files run until one fails or the next would exceed `seconds` without the mutation."""

    seconds: float
    per_file: float  # [s] test files that take longer without a mutation are left out


class Worker:
    """One copy of the repository, in which one mutation at a time is tried."""

    def __init__(self, root: Path, folder: Path, limits: Limits) -> None:
        self.tree, self.cache, self.limits = folder / "tree", folder / "cache", limits
        self.tree.mkdir(parents=True)
        self.cache.mkdir()
        tracked = subprocess.run(
            ["git", "-C", str(root), "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
            check=True, capture_output=True,
        )  # fmt: skip
        for name in filter(None, tracked.stdout.decode().split("\0")):
            target = self.tree / name
            target.parent.mkdir(parents=True, exist_ok=True)
            if (root / name).is_file():
                shutil.copy2(root / name, target)
        self.imports: Imports = imports_of(self.tree)
        self.plain: dict[str, float] = {}  # test file -> [s] without a mutation; NaN where it fails

    def tried(self, mutation: Mutation) -> Outcome:
        """Run the tests that depend on the module of a mutation, nearest first, until one fails."""
        spent, run = 0.0, 0
        for test in covering(self.imports, mutation.path):
            if test not in self.plain:
                self.plain[test] = self._unmutated(test)
            seconds = self.plain[test]
            if not seconds <= self.limits.per_file or spent + seconds > self.limits.seconds:
                continue
            spent, run = spent + seconds, run + 1
            if failed := self._mutated(mutation, test, max(AT_LEAST, HANGS * seconds)):
                return Outcome(mutation, failed, run, spent)
        return Outcome(mutation, "", run, spent)

    def _unmutated(self, test: str) -> float:
        begin = time.perf_counter()
        code, _ = self._pytest(test, self.cache, 10.0 * AT_LEAST)
        return time.perf_counter() - begin if code == 0 else float("nan")

    def _mutated(self, mutation: Mutation, test: str, limit: float) -> str:
        """The name of the failing test, '' if all pass."""
        path, scratch = self.tree / mutation.path, self.cache.with_name("mutated")
        source = path.read_text(encoding="utf-8")
        shutil.copytree(self.cache, scratch, copy_function=os.link)  # numba replaces files, it does not write into them
        stale = {Path(each).stem for each in dependents(self.imports, mutation.path)}
        for kernel in scratch.rglob("*.nb[ic]"):
            if kernel.name.partition(".")[0] in stale:
                kernel.unlink()
        try:
            path.write_text(mutation.applied(source), encoding="utf-8")
            code, output = self._pytest(test, scratch, limit)
        finally:
            path.write_text(source, encoding="utf-8")
            shutil.rmtree(scratch)
        if code in (0, NO_TESTS):
            return ""
        failing = [line for line in output.splitlines() if line.startswith(("FAILED", "ERROR"))]
        return failing[0].split(" ", 1)[1].split(" - ")[0] if failing else f"{test} (exit code {code})"

    def _pytest(self, test: str, cache: Path, limit: float) -> tuple[int, str]:
        """Exit code and output of a test file; FAILED after `limit` [s]."""
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache), "PYTHONDONTWRITEBYTECODE": "1"}
        plugins = [word for name in PLUGINS for word in ("-p", f"no:{name}")]
        command = [sys.executable, "-m", "pytest", "-x", "-q", "--no-header", *plugins, test]
        with subprocess.Popen(
            command, cwd=self.tree, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT, start_new_session=True,
        ) as running:  # fmt: skip
            try:
                output, _ = running.communicate(timeout=limit)
            except subprocess.TimeoutExpired:
                os.killpg(running.pid, signal.SIGKILL)  # with the processes that the test started
                return FAILED, f"FAILED {test} - takes too long"
        return running.returncode, output.decode(errors="replace")


def tried(
    mutations: Sequence[Mutation],
    root: Path,
    folder: Path,
    processes: int,
    limits: Limits,
    report: Callable[[Outcome], None],
) -> list[Outcome]:
    """The outcome of every mutation, in their order; `report` is called after each. `folder` must be empty or new."""
    if folder.exists() and any(folder.iterdir()):
        raise ViaError(f"{folder} is not empty: choose another folder with --out")
    idle: SimpleQueue[Worker] = SimpleQueue()
    for k in range(processes):
        idle.put(Worker(root, folder / str(k), limits))

    def one(mutation: Mutation) -> Outcome:
        worker = idle.get()
        try:
            outcome = worker.tried(mutation)
        finally:
            idle.put(worker)
        report(outcome)
        return outcome

    with ThreadPoolExecutor(processes) as pool:
        return list(pool.map(one, mutations))
