"""What graph tests share: a DDS domain nobody else is in, a context of one's own, and waiting with deadlines."""

from __future__ import annotations

import gc
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

# Before any message class is imported: they look once. Wrong types and shapes then raise instead of passing.
os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
# Killed processes leave no shared-memory files behind this way, and it is not slower for small messages.
os.environ["FASTDDS_BUILTIN_TRANSPORTS"] = "UDPv4"

import pytest

try:
    import rclpy
    import via_interfaces.msg  # noqa: F401
except ImportError as error:
    pytest.exit(f"tests/ need the sourced workspace (make test, or source ros2_ws/env.sh): {error}", returncode=4)

from rclpy.parameter import Parameter
from via_ros import middleware
from via_ros.domains import reserved_domain
from via_ros.spin import close_all, make_executor, remove, spin_until

middleware.prepare()

DEADLINE = 600.0  # [s] after which something hangs: how fast it goes is not what is tested


@pytest.fixture(scope="session")
def domain(tmp_path_factory: pytest.TempPathFactory) -> Iterator[int]:
    """The DDS domain of this test worker, also for the processes it starts."""
    with reserved_domain() as own:
        os.environ["ROS_DOMAIN_ID"] = str(own)
        os.environ["ROS_LOG_DIR"] = str(tmp_path_factory.mktemp("ros_log"))
        gc.freeze()  # modules: only what tests leave behind is looked through after each of them
        yield own


class Graph:
    """Nodes of one test in one process, with one executor and one context."""

    def __init__(self, context: Any) -> None:
        self.context = context
        self.executor = make_executor(context=context)
        self.nodes: list[Any] = []

    def node(self, name: str) -> Any:
        """A plain node to publish and listen with."""
        return self._added(rclpy.create_node(name, context=self.context))

    def add(self, kind: Callable[..., Any], **parameters: Any) -> Any:
        """A node of class `kind`, which passes `context` and `parameter_overrides` on to rclpy's Node."""
        overrides = [Parameter(name, value=value) for name, value in parameters.items()]
        return self._added(kind(context=self.context, parameter_overrides=overrides))

    def _added(self, node: Any) -> Any:
        self.executor.add_node(node)
        self.nodes.append(node)
        return node

    def until(self, condition: Callable[[], bool], timeout: float = DEADLINE) -> None:
        """Run callbacks until condition(); the test fails after `timeout` [s]."""
        assert spin_until(self.executor, condition, timeout), f"nothing came of it within {timeout} s"

    def remove(self, node: Any) -> None:
        """Take a node out and close it."""
        self.nodes.remove(node)
        remove(self.executor, node)
        close_all([node])


@pytest.fixture
def graph(domain: int) -> Iterator[Graph]:
    context = rclpy.Context()
    rclpy.init(args=[], context=context, domain_id=domain)
    graph = Graph(context)
    yield graph
    for node in list(graph.nodes):
        graph.remove(node)
    graph.executor.shutdown()
    context.try_shutdown()
    # rclpy's lifecycle nodes lie in cycles of references. Until they are collected, they stay in the graph of later
    # tests, where services and their clients are counted.
    gc.collect()


@pytest.fixture(scope="session")
def root() -> Path:
    return Path(__file__).resolve().parent.parent
