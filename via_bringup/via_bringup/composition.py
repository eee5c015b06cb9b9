"""Several nodes in one process, on one events executor, in a ROS domain of their own.

One process is what keeps a 1 kHz loop in time here; the own domain and LOCALHOST discovery keep a demo from commanding
a robot that happens to listen on the same network.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from types import TracebackType
from typing import Any, Self, TypeVar

import rclpy
from rclpy.context import Context
from rclpy.parameter import Parameter
from via_core.errors import ViaError
from via_ros import middleware, spin
from via_ros.domains import Domain

Node = TypeVar("Node")


class Composition:
    """A context manager: nodes added to it are closed and destroyed, last first, when it ends."""

    def __init__(self) -> None:
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        self.context = Context()
        self._nodes: list[Any] = []

    def __enter__(self) -> Self:
        middleware.prepare()
        self._domain = Domain()
        rclpy.init(context=self.context, domain_id=self._domain.number)
        self._executor = spin.make_executor(context=self.context)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for node in self._nodes:
            self._executor.remove_node(node)
        spin.close_all(reversed(self._nodes), failed=kind is not None)
        self._executor.shutdown()
        rclpy.try_shutdown(context=self.context)
        self._domain.release()

    def add(self, make: Callable[..., Node], **parameters: Any) -> Node:
        """A node made with these parameters, on the executor."""
        overrides = [Parameter(name, value=value) for name, value in parameters.items()]
        node = make(context=self.context, parameter_overrides=overrides)
        self._nodes.append(node)
        self._executor.add_node(node)
        return node

    def remove(self, node: Any) -> None:
        """Close and destroy one node before the end."""
        self._nodes.remove(node)
        self._executor.remove_node(node)
        spin.close_all([node])

    def run_until(self, condition: Callable[[], bool], timeout: float, what: str) -> None:
        """Run callbacks until condition() holds; raises ViaError naming `what` after `timeout` [s] of wall time."""
        if not spin.spin_until(self._executor, condition, timeout):
            raise ViaError(f"{what} did not happen within {timeout:.0f} s")
