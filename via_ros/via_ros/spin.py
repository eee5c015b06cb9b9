"""Runs nodes on the events executor, with clean shutdown by SIGINT, SIGTERM or the node.

`executor.spin()` of rclpy 7.1's EventsExecutor runs no callbacks; spinning until a future is done does. Its callbacks
take one argument. MultiThreadedExecutor loses messages at 1 kHz and is not offered.
"""

from __future__ import annotations

import gc
import os
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable
from typing import Any

import rclpy
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from rclpy.utilities import remove_ros_args
from via_core.errors import ParameterError, ViaError
from via_core.text_files import shown

from via_ros import middleware

FOREVER = 1e6  # [s]
PATIENCE = 0.1  # [s] longest interval between two evaluations of a condition
STEADY = Clock(clock_type=ClockType.STEADY_TIME)  # for housekeeping timers: simulated time can stop
EXECUTORS = {"events": EventsExecutor, "single": SingleThreadedExecutor}
EXECUTOR = ParameterDescriptor(
    description="executor of the node; events: fast, single: of rclpy",
    read_only=True,
    additional_constraints=f"one of: {', '.join(EXECUTORS)}",
)
LAST_DOMAIN = 232  # higher ones have no valid ports: DDS would terminate the process without a Python error
# Errors of ROS for invalid arguments, names, parameters and environment.
REFUSALS = (rclpy_implementation.RCLError, NameValidationException, ParameterException)


def make_executor(kind: str = "events", context: Any = None) -> Any:
    """An executor of the named kind: 'events' (fast) or 'single' (rclpy's own, the fallback)."""
    if kind not in EXECUTORS:
        raise ParameterError(f"no executor '{kind}'; there are: {', '.join(EXECUTORS)}")
    return EXECUTORS[kind](context=context)


def spin(executor: Any, finished: Future | None = None) -> None:
    """Run callbacks until `finished` is done; without it until a signal or shutdown of the context raises.

    What exists now is left out of garbage collection meanwhile: to walk through it takes many periods of a fast loop.
    """
    gc.collect()
    gc.freeze()
    try:
        future = Future() if finished is None else finished
        while not future.done():
            executor.spin_until_future_complete(future, timeout_sec=FOREVER)
    finally:  # rclpy's lifecycle nodes lie in cycles of references: frozen ones would never leave the graph
        gc.unfreeze()


def spin_until(executor: Any, condition: Callable[[], bool], timeout: float) -> bool:
    """Run callbacks until condition() is true; False when `timeout` [s] of wall time passes first."""
    deadline = time.monotonic() + timeout
    while not condition():
        left = deadline - time.monotonic()
        if left <= 0.0:
            return False
        executor.spin_once(timeout_sec=min(left, PATIENCE))
    return True


def remove(executor: Any, node: Any) -> None:
    """Take a node out of its executor; when this returns, none of its callbacks will run any more.

    The events executor processes the removal as an event in its own queue. Callbacks of the node may be queued before
    that event, or behind it until it is reached; the second task is behind those.
    """
    executor.remove_node(node)
    for _ in range(2):
        reached = executor.create_task(lambda: None)
        while not reached.done():  # in short pieces: Python handles no signal while the executor waits
            executor.spin_until_future_complete(reached, timeout_sec=PATIENCE)


def close_all(nodes: Iterable[Any], failed: bool = False) -> None:
    """Destroy nodes, after a call of their method `close(failed)` (finish a bag, join a thread) where they have one."""
    for node in nodes:
        try:
            if hasattr(node, "close"):
                node.close(failed)
        finally:
            node.destroy_node()


def run(make_node: Callable[[], Any], args: list[str] | None = None) -> int:
    """Run the node returned by `make_node` in the main thread of its own process; returns the exit code.

    0 after SIGINT or SIGTERM; the result of the node's future `finished`, if it has one; 2, with one line on stderr,
    for errors in parameters, devices or bags. The node parameter `executor` selects 'events' or 'single'.
    """
    ended, begun = Future(), threading.Event()
    _end_on_signals(ended, begun)
    middleware.prepare()
    nodes: list[Any] = []
    code = 0
    try:
        executor = _set_up(make_node, args, nodes, ended)
        begun.set()
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
    """An executor with the node, which is appended to `nodes`. Raises ViaError for arguments that ROS refuses."""
    if "HOME" not in os.environ:  # ROS needs a folder for its logs to start
        os.environ.setdefault("ROS_LOG_DIR", os.path.join(tempfile.gettempdir(), "ros_log"))
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
        check_domain(rclpy.get_default_context())
        unknown = remove_ros_args(sys.argv if args is None else ["", *args])[1:]
        if unknown:
            raise ParameterError(
                f"unknown arguments: {' '.join(unknown)}; parameters are set by --ros-args -p name:=value"
            )
        node = make_node()
        nodes.append(node)
        if hasattr(node, "finished"):
            node.finished.add_done_callback(lambda done: ended.set_result(done.result()))
        executor = make_executor(node.declare_parameter("executor", "events", EXECUTOR).value)
        executor.add_node(node)
        _warn_of_unknown_parameters(node)
        _name_defaults(node)
    except REFUSALS as error:
        raise ParameterError(" ".join(str(error).split())) from None
    return executor


def check_domain(context: Any) -> None:
    """Raise ParameterError if the context's domain has no valid ports."""
    domain = context.get_domain_id()
    if not 0 <= domain <= LAST_DOMAIN:
        raise ParameterError(f"ROS_DOMAIN_ID must lie in [0, {LAST_DOMAIN}], got {domain}")


def _warn_of_unknown_parameters(node: Any) -> None:
    """Log the given parameters that this node does not have; a file for several nodes may contain such."""
    known = set(node.list_parameters([], 0).names)
    # rclpy has no public access to the given parameters.
    unknown = [name for name in node._parameter_overrides if name not in known and not name.startswith("qos_")]
    if unknown:
        node.get_logger().warning(f"no parameter {', '.join(unknown)}; there are: {', '.join(sorted(known))}")


def _name_defaults(node: Any) -> None:
    """Log which device or arm a node took although none was given."""
    for name in ("device", "arm"):
        if node.has_parameter(name) and not {name, f"{name}s"} & node._parameter_overrides.keys():
            taken = node.get_parameter(name).value
            text = f"no {name} was given, so '{taken}' is used; choose one with -p {name}:=NAME"
            node.get_logger().info(text)


def _complain(nodes: list[Any], error: Exception) -> None:
    print(shown(f"{nodes[0].get_name() if nodes else 'error'}: {error}"), file=sys.stderr)


def _end_on_signals(ended: Future, begun: threading.Event) -> None:
    """Finish `ended` at the first SIGINT or SIGTERM and ignore later ones, so that bags get closed.

    Before `begun` the process ends at once: a node that compiles its kernels has nothing to close.

    The handlers of rclpy shut the context down during callbacks, in which publishing then raises. These handlers write
    one byte into a pipe, also while the main thread waits in the executor, and a thread reads it.
    """
    end, begin = os.pipe()
    os.set_blocking(begin, False)
    signal.set_wakeup_fd(begin, warn_on_full_buffer=False)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: None)

    def watch() -> None:
        os.read(end, 1)
        if not begun.is_set():
            print("interrupted while the node started", file=sys.stderr, flush=True)
            os._exit(0)
        ended.set_result(0)

    threading.Thread(target=watch, name="signals", daemon=True).start()
