"""Blocks of Markdown pages, and their commands run as a reader would run them.

A recording ends after SAMPLES joint states instead of half a minute. Blocks without a language are shell commands;
diagrams are blocks of language `text`. A block is a file if the paragraph before it says "Save this as `NAME`".
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from via_ros import qos
from via_ros.spin import make_executor, spin_until

ROOT = Path(__file__).resolve().parents[1]
SAMPLES = 8000  # joint states of a recording that a page lets run for half a minute
DEADLINE = 1800.0  # [s] for one command: only what hangs
INTERRUPTED = 130  # exit code of `via` after Ctrl-C


@dataclass(frozen=True)
class Block:
    """A fenced block of a page, its language ('' for shell), and the paragraph before it."""

    page: str
    line: int
    language: str
    lines: tuple[str, ...]
    before: str

    @property
    def text(self) -> str:
        """What is between the fences."""
        return "\n".join(self.lines) + "\n"

    @property
    def file(self) -> str:
        """The name under which the reader saves the block; empty if it is no file."""
        found = re.search(r"Save this as `(.+?)`", self.before)
        return found[1] if found else ""

    @property
    def commands(self) -> list[str]:
        """The commands without their comments."""
        return [command for line in self.lines if (command := re.sub(r"\s{2,}#.*$", "", line).strip())]


def blocks(page: Path) -> Iterator[Block]:
    """The fenced blocks of a Markdown page, except directives of the documentation site."""
    paragraph: list[str] = []
    language, start, inside, previous = "", 0, None, ""
    for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), start=1):
        if not line.startswith("```"):
            if inside is not None:
                inside.append(line)
            elif line.strip():
                paragraph = [*paragraph, line] if previous.strip() else [line]
        elif inside is None:
            language, start, inside = line[3:].strip(), number, []
        else:
            if not language.startswith("{"):
                yield Block(page.stem, start, language, tuple(inside), " ".join(paragraph))
            inside = None
        previous = line


@dataclass
class Shell:
    """Commands in one folder, with jobs in the background; `node` observes the ROS graph."""

    folder: Path
    node: Node
    executor: Any
    jobs: list[subprocess.Popen[bytes]] = field(default_factory=list)

    def run(self, command: str) -> None:
        """Run to the end; fails unless the command succeeds."""
        done = subprocess.run(
            ["bash", "-c", command], cwd=self.folder, capture_output=True, text=True, timeout=DEADLINE, check=False
        )
        assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}"

    def start(self, command: str) -> subprocess.Popen[bytes]:
        """Start a node and wait until ROS sees it."""
        known = len(self._nodes())
        log = (self.folder / f"job_{len(list(self.folder.glob('job_*')))}.txt").open("wb")
        job = subprocess.Popen(
            ["bash", "-c", f"exec {command}"], cwd=self.folder, stdout=log, stderr=subprocess.STDOUT,
            start_new_session=True,
        )  # fmt: skip
        self.jobs.append(job)

        def there() -> bool:
            assert job.poll() is None, f"{command} ended:\n{Path(log.name).read_text()}"
            return len(self._nodes()) > known

        assert spin_until(self.executor, there, DEADLINE), f"{command}: no node"
        return job

    def record(self, command: str) -> None:
        """Record until the diagnostics of the recorder count SAMPLES joint states."""
        counts = [0]

        def take(report: DiagnosticArray) -> None:
            for status in report.status:
                if status.name == "recorder: /joint_states":
                    counts.extend(int(each.value) for each in status.values if each.key == "messages")

        subscription = self.node.create_subscription(DiagnosticArray, "/diagnostics", take, qos.CONTROL)
        recorder = self.start(command)
        assert spin_until(self.executor, lambda: max(counts) >= SAMPLES, DEADLINE), f"{command}: {max(counts)} samples"
        self.stop(recorder)
        self.node.destroy_subscription(subscription)

    def follow_output(self, command: str) -> None:
        """Start a command that prints until it is stopped, and stop it after its first line."""
        job = subprocess.Popen(["bash", "-c", f"exec {command}"], cwd=self.folder, stdout=subprocess.PIPE)
        self.jobs.append(job)
        assert job.stdout is not None and job.stdout.readline(), f"{command} printed nothing"
        job.stdout.close()
        self.stop(job)

    def stop(self, job: subprocess.Popen[bytes], with_signal: signal.Signals = signal.SIGINT) -> None:
        """End a job as Ctrl-C or `kill` does; fails unless it ends cleanly."""
        before = len(self._nodes())
        job.send_signal(with_signal)
        assert job.wait(DEADLINE) in (0, INTERRUPTED), job.args
        self.jobs.remove(job)
        spin_until(self.executor, lambda: len(self._nodes()) < before, 60.0)  # the graph forgets it a moment later

    def _nodes(self) -> list[str]:
        return list(self.node.get_node_names())

    def close(self) -> None:
        """End what is still running."""
        for job in list(self.jobs):
            job.kill()
            job.wait()
        self.jobs.clear()


def is_node(command: str) -> bool:
    """Whether a command runs until it is stopped."""
    words = command.split()
    return words[:2] in (["via", "run"], ["via", "launch"]) or (words[:2] == ["via", "sim"] and "--record" not in words)


def prints_until_stopped(command: str) -> bool:
    """Whether a command prints messages until it is stopped."""
    return command.startswith(("via topic echo", "via topic hz", "via watch")) and "--once" not in command


def follow(shell: Shell, commands: list[str], skips: Callable[[str], object] = lambda _: False) -> None:
    """Run a block's commands, except those that `skips` is true of; what it leaves in the background ends with it."""
    jobs = []
    for command in commands:
        if skips(command):
            continue
        if command.startswith("source "):
            subprocess.run(["bash", "-c", f"{command} && command -v via"], cwd=ROOT, check=True, capture_output=True)
        elif command.startswith("kill "):
            for number in re.findall(r"%(\d+)", command):
                shell.stop(jobs[int(number) - 1], signal.SIGTERM)
        elif command.endswith("&"):
            jobs.append(shell.start(command.removesuffix("&").strip()))
        elif command.startswith("via bag record"):
            shell.record(command)
        elif prints_until_stopped(command):
            shell.follow_output(command)
        elif is_node(command):
            shell.stop(shell.start(command))
        else:
            shell.run(command)
    for job in list(shell.jobs):
        shell.stop(job)


def run_python(shell: Shell, program: str) -> None:
    """Run a program in the folder of the shell; fails unless it succeeds."""
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=shell.folder, env={**os.environ, "MPLBACKEND": "agg"},
        capture_output=True, text=True, timeout=DEADLINE, check=False,
    )  # fmt: skip
    assert done.returncode == 0, f"{program}\n{done.stdout}{done.stderr}"


@contextmanager
def shell_in(folder: Path, domain: int) -> Iterator[Shell]:
    """A shell in a folder that has `out` and the shipped samples, on a DDS domain."""
    (folder / "out").mkdir()
    (folder / "via_core").symlink_to(ROOT / "via_core")
    context = rclpy.Context()
    rclpy.init(args=[], context=context, domain_id=domain)
    node = rclpy.create_node("reader", context=context)
    executor = make_executor(context=context)
    executor.add_node(node)
    shell = Shell(folder, node, executor)
    try:
        yield shell
    finally:
        shell.close()
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown(context=context)
