"""The one way nodes run here: on the events executor, ended cleanly by SIGINT, by SIGTERM or by themselves.

Why not `executor.spin()`: rclpy 7.1's EventsExecutor turns idle circles in it and runs nothing; waiting for a future
that never comes is the same without the fault. Its callbacks take one argument. MultiThreadedExecutor loses messages
at 1 kHz and is not offered.
"""

from __future__ import annotations

import os
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable
from typing import Any

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from rclpy.utilities import remove_ros_args
from via_core.errors import ParameterError, ViaError

from via_ros import middleware

FOREVER = 1e6  # [s]
PATIENCE = 0.1  # [s] longest sleep between two looks at a condition
STEADY = Clock(clock_type=ClockType.STEADY_TIME)  # for housekeeping timers: simulated time may stand still
EXECUTORS = {"events": EventsExecutor, "single": SingleThreadedExecutor}
LAST_DOMAIN = 232  # the ports of higher ones do not exist; DDS then ends the process without a word to Python
# What ROS says about arguments, names, parameters and the environment that it was given.
REFUSALS = (rclpy_implementation.RCLError, NameValidationException, ParameterException)


def make_executor(kind: str = "events", context: Any = None) -> Any:
    """An executor of the named kind: 'events' (fast) or 'single' (rclpy's own, the fallback)."""
    if kind not in EXECUTORS:
        raise ParameterError(f"no executor '{kind}'; there are: {', '.join(EXECUTORS)}")
    return EXECUTORS[kind](context=context)


def spin(executor: Any, finished: Future | None = None) -> None:
    """Run callbacks until `finished` is done; without one until a signal or a shutdown of the context raises."""
    future = Future() if finished is None else finished
    while not future.done():
        executor.spin_until_future_complete(future, timeout_sec=FOREVER)


def spin_until(executor: Any, condition: Callable[[], bool], timeout: float) -> bool:
    """Run callbacks until condition() holds: True; or until `timeout` [s] of wall time has passed: False."""
    deadline = time.monotonic() + timeout
    while not condition():
        left = deadline - time.monotonic()
        if left <= 0.0:
            return False
        executor.spin_once(timeout_sec=min(left, PATIENCE))
    return True


def close_all(nodes: Iterable[Any], failed: bool = False) -> None:
    """Close and destroy nodes. One with a method `close(failed)` (a bag to finish, a thread to join) is asked first."""
    for node in nodes:
        try:
            if hasattr(node, "close"):
                node.close(failed)
        finally:
            node.destroy_node()


def run(make_node: Callable[[], Any], args: list[str] | None = None) -> int:
    """Run the node that `make_node` makes, in the main thread of its own process; the exit code.

    0 after SIGINT, SIGTERM or the node's own end with nothing to say; the number that the node put into its future
    `finished`, if it has one; 2 with one line on stderr where parameters, devices or bags are at fault.
    The parameter `executor` of the node chooses 'events' or 'single'.
    """
    ended = Future()
    _end_on_signals(ended)
    middleware.prepare()
    nodes: list[Any] = []
    code = 0
    try:
        executor = _set_up(make_node, args, nodes, ended)
        spin(executor, ended)
        code = ended.result() or 0
    except ExternalShutdownException:
        pass
    except (ViaError, OSError) as error:
        _complain(nodes, error)
        code = 2
    finally:
        try:
            close_all(nodes, failed=code != 0 or sys.exc_info()[0] is not None)
        except (ViaError, OSError) as error:
            _complain(nodes, error)
            code = 2
        rclpy.try_shutdown()
    return code


def _set_up(make_node: Callable[[], Any], args: list[str] | None, nodes: list[Any], ended: Future) -> Any:
    """An executor with the node, which is put into `nodes`; raises ViaError where ROS refuses what it was given."""
    if "HOME" not in os.environ:  # where ROS writes its logs, or does not start
        os.environ.setdefault("ROS_LOG_DIR", os.path.join(tempfile.gettempdir(), "ros_log"))
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
        domain = rclpy.get_default_context().get_domain_id()
        if not 0 <= domain <= LAST_DOMAIN:
            raise ParameterError(f"ROS_DOMAIN_ID must lie in [0, {LAST_DOMAIN}], got {domain}")
        strangers = remove_ros_args(sys.argv if args is None else ["", *args])[1:]
        if strangers:
            raise ParameterError(
                f"unknown arguments: {' '.join(strangers)}; parameters are set by --ros-args -p name:=value"
            )
        node = make_node()
        nodes.append(node)
        if hasattr(node, "finished"):
            node.finished.add_done_callback(lambda done: ended.set_result(done.result()))
        executor = make_executor(node.declare_parameter("executor", "events").value)
        executor.add_node(node)
        _warn_of_strangers(node)
    except REFUSALS as error:
        raise ParameterError(" ".join(str(error).split())) from None
    return executor


def _warn_of_strangers(node: Any) -> None:
    """Say which parameters were given that this node does not have; a file for several nodes may do so on purpose."""
    known = set(node.list_parameters([], 0).names)
    # rclpy tells what was given nowhere else.
    strangers = [name for name in node._parameter_overrides if name not in known and not name.startswith("qos_")]
    if strangers:
        node.get_logger().warning(f"no parameter {', '.join(strangers)}; there are: {', '.join(sorted(known))}")


def _complain(nodes: list[Any], error: Exception) -> None:
    print(f"{nodes[0].get_name() if nodes else 'error'}: {error}", file=sys.stderr)


def _end_on_signals(ended: Future) -> None:
    """The first SIGINT or SIGTERM finishes `ended`; later ones are taken and ignored, so that bags get closed.

    rclpy's own handlers shut the context down under a callback that is about to publish, which then raises. These
    write one byte into a pipe, even while the main thread waits inside the executor, and a thread reads it.
    """
    end, begin = os.pipe()
    os.set_blocking(begin, False)
    signal.set_wakeup_fd(begin, warn_on_full_buffer=False)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: None)

    def watch() -> None:
        os.read(end, 1)
        ended.set_result(0)

    threading.Thread(target=watch, name="signals", daemon=True).start()
