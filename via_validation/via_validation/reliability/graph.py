"""The graph into which faults are injected: nodes in this process and executables in their own, in one ROS domain."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from via_bringup.cli.run import find_executable
from via_core.errors import ViaError
from via_ros import qos
from via_ros.composition import Composition

PATIENCE = 120.0  # [s] for what must happen at some time: a machine under load is slow


class Graph:
    """A context manager: a domain with no other nodes, and an empty folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._nodes = Composition()
        self._processes: list[Process] = []
        self._clients: dict[str, Any] = {}
        self.reports: list[DiagnosticStatus] = []  # all diagnostics since `observe_diagnostics`

    def __enter__(self) -> Self:
        self._nodes.__enter__()
        self.peer = self.node("peer")  # plays the robot, a listener, a client
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for process in self._processes:
            process.end()
        self._nodes.__exit__(kind, error, trace)

    # ---- nodes of this process

    def node(self, name: str) -> Any:
        """A plain node."""
        return self._nodes.add(lambda **options: rclpy.create_node(name, **options))

    def add(self, make: Callable[..., Any], **parameters: Any) -> Any:
        """A node of the suite with these parameters."""
        return self._nodes.add(make, **parameters)

    def remove(self, node: Any) -> None:
        """Close and destroy a node."""
        self._nodes.remove(node)

    def until(self, condition: Callable[[], bool], what: str, timeout: float = PATIENCE) -> None:
        """Run callbacks until condition(); raises ViaError with `what` after `timeout` [s]."""
        self._nodes.run_until(condition, timeout, what)

    def pause(self, seconds: float) -> None:
        """Run callbacks for a while."""
        with suppress(ViaError):
            self.until(lambda: False, "nothing", seconds)

    def hear(self, kind: Any, topic: str, raw: bool = False) -> list[Any]:
        """A list that receives all messages of a topic."""
        heard: list[Any] = []
        self.peer.create_subscription(kind, topic, heard.append, qos.SAMPLES, raw=raw)
        return heard

    def publisher(self, kind: Any, topic: str, node: Any = None) -> Any:
        """A publisher of the peer or of another plain node."""
        return (node or self.peer).create_publisher(kind, topic, qos.SAMPLES)

    def connected(self, *publishers: Any, listeners: int = 1) -> None:
        """Wait until each publisher has that many subscribers."""
        self.until(
            lambda: all(each.get_subscription_count() >= listeners for each in publishers), "the connection of topics"
        )

    def call(self, kind: Any, service: str, request: Any) -> Any:
        """The answer of a service."""
        client = self._clients.setdefault(service, self.peer.create_client(kind, service))
        self.until(client.service_is_ready, f"service {service}")
        answer = client.call_async(request)
        self.until(answer.done, f"an answer of {service}")
        return answer.result()

    # ---- diagnostics

    def observe_diagnostics(self) -> None:
        """Begin to collect diagnostics."""
        self.peer.create_subscription(
            DiagnosticArray, "/diagnostics", lambda each: self.reports.extend(each.status), qos.SAMPLES
        )

    def reported(self, text: str) -> None:
        """Wait for the text in a message or value of a later diagnostic status."""
        self.reports.clear()
        self.until(lambda: any(text in each for each in map(_words, self.reports)), f"'{text}' in diagnostics")

    # ---- processes

    def start(
        self, package: str, executable: str, *parameters: str, name: str = "", options: Mapping[str, Any] | None = None
    ) -> Process:
        """An executable of the suite as a process of its own, with parameters `key:=value`."""
        words = ["--ros-args"] if parameters or name else []
        words += [word for each in parameters for word in ("-p", each)]
        words += ["-r", f"__node:={name}"] if name else []
        label = f"{name or executable}_{len(self._processes)}"
        self._processes.append(
            Process(
                label,
                [str(find_executable(package, executable)), *words],
                self.folder,
                self.domain,
                dict(options or {}),
            )
        )
        return self._processes[-1]

    def script(self, label: str, text: str, **options: Any) -> Process:
        """A Python script as a process of its own."""
        self._processes.append(Process(label, [sys.executable, "-c", text], self.folder, self.domain, options))
        return self._processes[-1]

    @property
    def domain(self) -> int:
        """Number of the ROS domain."""
        return int(self._nodes.context.get_domain_id())

    def all_run(self, *excepted: Process) -> None:
        """Raise ViaError if a process has ended that is not excepted."""
        for each in self._processes:
            if each not in excepted and each.code is not None:
                raise ViaError(f"{each.label} ended with code {each.code}: {each.errors()[-300:]}")


class Process:
    """A node in a process of its own; its standard error is kept."""

    def __init__(self, label: str, words: list[str], folder: Path, domain: int, options: dict[str, Any]) -> None:
        self.label = label
        self._errors = folder / f"{label}.err"
        environment = {**os.environ, "ROS_DOMAIN_ID": str(domain), "ROS_LOG_DIR": str(folder / "ros_log")}
        with self._errors.open("wb") as errors:
            self._process = subprocess.Popen(
                words, cwd=folder, env=environment, stdin=subprocess.DEVNULL, stdout=errors, stderr=errors, **options
            )

    @property
    def pid(self) -> int:
        """Its process number."""
        return self._process.pid

    @property
    def code(self) -> int | None:
        """The exit code; None while it runs."""
        return self._process.poll()

    def errors(self) -> str:
        """Its output so far."""
        return self._errors.read_text("utf-8", "replace")

    def signal(self, number: int) -> int:
        """Send a signal; returns the time [ns] of the system clock after it."""
        self._process.send_signal(number)
        return time.time_ns()

    def kill(self) -> int:
        """End it by SIGKILL; returns the time [ns] of the system clock after it."""
        killed = self.signal(signal.SIGKILL)
        self._process.wait()
        return killed

    def end(self) -> None:
        """End it if it runs."""
        if self._process.poll() is None:
            self._process.kill()
        self._process.wait()


def _words(status: DiagnosticStatus) -> str:
    return " ".join([status.name, status.message, *(f"{each.key}={each.value}" for each in status.values)])
