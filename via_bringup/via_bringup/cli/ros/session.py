"""A hidden node for the duration of one command, and waiting with it."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from threading import Event
from typing import Any

import rclpy
from rcl_interfaces.srv import ListParameters
from rclpy.context import Context
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.task import Future
from via_core.errors import ParameterError, ViaError
from via_ros import middleware
from via_ros.spin import FOREVER, REFUSALS, check_domain, make_executor, spin_until

from via_bringup.cli.console import errors
from via_bringup.enclaves import COMMANDS, enclave_arguments

QUIET = 1.2  # [s] without a change after which discovery counts as complete
LONGEST = 5.0  # [s] of discovery
REPEATED = 0.3  # [s] after which a request that may have been lost is repeated
PATIENCE = 4.0  # [s] after which a line names what is awaited


@dataclass(frozen=True)
class Session:
    """A node whose name starts with an underscore, so that lists do not show it, and its executor."""

    node: Any
    executor: Any
    interrupted: Event  # set by Ctrl-C: an exception within a callback can leave rclpy's executor locked

    def wait(self, condition: Callable[[], bool], timeout: float = FOREVER) -> bool:
        """Run callbacks until condition(); False after `timeout` [s]. Raises KeyboardInterrupt after Ctrl-C."""
        done = spin_until(self.executor, lambda: self.interrupted.is_set() or condition(), timeout)
        self._end_if_interrupted()
        return done

    def pause(self, duration: float) -> None:
        """Wait for `duration` [s] without running callbacks. Raises KeyboardInterrupt after Ctrl-C."""
        until = time.monotonic() + duration
        while (left := until - time.monotonic()) > 0.0 and not self.interrupted.is_set():
            time.sleep(min(left, 0.05))
        self._end_if_interrupted()

    def _end_if_interrupted(self) -> None:
        if self.interrupted.is_set():
            self.interrupted.clear()
            raise KeyboardInterrupt

    def result(self, future: Future) -> Any:
        """Run callbacks until the future is done; its result."""
        self.wait(future.done)
        return future.result()

    def discover(self, found: Callable[[], bool] | None = None) -> bool:
        """Wait until found(), or until the graph has other nodes and has not changed for QUIET; at most LONGEST."""
        if found is not None:
            return self.wait(found, LONGEST)
        seen: list[Any] = []
        since = began = time.monotonic()
        while time.monotonic() - began < LONGEST and (time.monotonic() - since < QUIET or not self.nodes()):
            self.wait(lambda: False, 0.05)
            graph = [sorted(self.nodes()), sorted(self.node.get_topic_names_and_types())]
            if graph != seen:
                seen, since = graph, time.monotonic()
        return True

    def nodes(self) -> list[str]:
        """Full names of all nodes that are not hidden."""
        pairs = self.node.get_node_names_and_namespaces()
        return [f"{space.rstrip('/')}/{name}" for name, space in pairs if not name.startswith("_")]

    def topics(self) -> dict[str, list[str]]:
        """Types of every topic with a publisher or a subscription that is not hidden."""
        return {name: types for name, types in self.node.get_topic_names_and_types() if "/_" not in name}

    def until(self, condition: Callable[[], bool], what: str, known: Callable[[], list[str]] = list) -> None:
        """Wait without limit until condition(); after PATIENCE prints what is awaited (`what`) and what is `known`."""
        if self.wait(condition, PATIENCE):
            return
        there = ", ".join(sorted(known()))
        errors.print(f"waiting for {what}" + (f"; there are: {there}" if there else ""))
        self.wait(condition)

    def type_of(self, topic: str) -> str:
        """Type of a topic, which is awaited. Raises ViaError if it has several."""
        self.until(lambda: topic in self.topics(), f"topic {topic}", lambda: list(self.topics()))
        types = self.topics()[topic]
        if len(types) > 1:
            raise ViaError(f"{topic} has several types: {', '.join(types)}; add the one that is meant")
        return types[0]

    def node_named(self, name: str) -> str:
        """Full name of a node. Raises ViaError, which lists the nodes, unless discovery finds it."""
        full = absolute(name)
        if not self.discover(lambda: full in self.nodes()):
            raise ViaError(f"no node {full}; there are: {', '.join(sorted(self.nodes())) or 'none'}")
        return full

    def call(self, kind: Any, name: str, request: Any) -> Any:
        """Response of a service, which is awaited."""
        client = self.node.create_client(kind, name)
        self.until(client.service_is_ready, f"service {name}", self._services)
        self.introduced(name)
        return self.result(client.call_async(request))

    def introduced(self, service: str) -> None:
        """Wait until the node that offers `service` has found the clients that this node made before.

        Until then it loses their requests, and discovery in that direction can take seconds longer than in this one.
        Clients are announced in the order in which they were made. So once the node has answered another one, made
        here, it has found all. For a node that does not list its parameters, this waits LONGEST instead.
        """
        found: list[str] = []

        def beside() -> bool:
            found[:] = self._beside(service)
            return bool(found)

        if not self.discover(beside):
            return
        client = self.node.create_client(ListParameters, found[0])
        while not self.wait(client.call_async(ListParameters.Request()).done, REPEATED):
            pass

    def _beside(self, service: str) -> list[str]:
        """The services `list_parameters` of the nodes that offer `service`."""
        asked = []
        for name, space in self.node.get_node_names_and_namespaces():
            try:
                offered = dict(self.node.get_service_names_and_types_by_node(name, space))
            except rclpy_implementation.RCLError:  # the node has ended meanwhile
                continue
            own = f"{space.rstrip('/')}/{name}/list_parameters"
            asked += [own] if {service, own} <= offered.keys() else []
        return asked

    def _services(self) -> list[str]:
        own = ("describe_parameters", "get_parameter", "get_type_description", "list_parameters", "set_parameters")
        names = [name for name, _ in self.node.get_service_names_and_types()]
        return [name for name in names if "/_" not in name and not name.rsplit("/", 1)[1].startswith(own)]


@contextmanager
def session() -> Iterator[Session]:
    """A session on the ROS domain of the environment. Raises ParameterError for names and domains that ROS refuses."""
    middleware.prepare()
    context = Context()
    try:
        rclpy.init(args=["--ros-args", *enclave_arguments(COMMANDS)], context=context)
        check_domain(context)
        node = rclpy.create_node(
            f"_via_{os.getpid()}", context=context, enable_rosout=False, start_parameter_services=False
        )
        executor = make_executor(context=context)
        executor.add_node(node)
        interrupted = Event()
        signal.signal(signal.SIGINT, lambda *_: interrupted.set())
        yield Session(node, executor, interrupted)
    except REFUSALS as error:
        raise ParameterError(" ".join(str(error).split())) from None
    finally:
        context.try_shutdown()


def absolute(name: str) -> str:
    """The name with a leading slash."""
    return name if name.startswith("/") else f"/{name}"
