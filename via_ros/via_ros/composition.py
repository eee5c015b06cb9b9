"""Several nodes in one process, with one events executor and their own ROS domain.

One process keeps a 1 kHz loop on time. The separate domain and LOCALHOST discovery keep the nodes from commanding a
robot on the same network.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any, Self, TypeVar

import rclpy
from rclpy.context import Context
from rclpy.parameter import Parameter
from via_core.errors import ViaError

from via_ros import middleware, spin
from via_ros.domains import reserved_domain

Node = TypeVar("Node")


class Composition:
    """A context manager that runs nodes. On exit all are closed and destroyed in reverse order."""

    def __init__(self) -> None:
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        self.context = Context()
        self._nodes: list[Any] = []
        self._reservation = ExitStack()

    def __enter__(self) -> Self:
        middleware.prepare()
        rclpy.init(context=self.context, domain_id=self._reservation.enter_context(reserved_domain()))
        self._executor = spin.make_executor(context=self.context)
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        for node in self._nodes:
            self._executor.remove_node(node)
        spin.close_all(reversed(self._nodes), failed=kind is not None)
        self._executor.shutdown()
        rclpy.try_shutdown(context=self.context)
        self._reservation.close()

    def add(self, make: Callable[..., Node], **parameters: Any) -> Node:
        """Create a node with these parameters and add it to the executor."""
        overrides = [Parameter(name, value=value) for name, value in parameters.items()]
        node = make(context=self.context, parameter_overrides=overrides)
        self._nodes.append(node)
        self._executor.add_node(node)
        return node

    def remove(self, node: Any) -> None:
        """Close and destroy one node."""
        self._nodes.remove(node)
        spin.remove(self._executor, node)
        spin.close_all([node])

    def run_until(self, condition: Callable[[], bool], timeout: float, what: str) -> None:
        """Run callbacks until condition() is true. Raises ViaError with `what` after `timeout` [s] of wall time."""
        if not spin.spin_until(self._executor, condition, timeout):
            raise ViaError(f"{what} did not happen within {timeout:.0f} s")
