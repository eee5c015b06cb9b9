"""A process of the loop: python -m via_validation.bench.realtime.worker WAY SECONDS CORES ROLE...

It prints 'begun' and 'finished' if it has the simulator. Each line of its input is answered by the counts of its nodes
as JSON. It ends with its input.
"""

from __future__ import annotations

import json
import os
import sys
import threading
from collections.abc import Callable

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from via_ros import middleware, spin

from via_validation.bench.realtime import plain, suite
from via_validation.bench.realtime.loop import Part
from via_validation.bench.scheduling import prepare

WAYS = {"suite": suite, "plain": plain}
LOOK = 0.02  # [s]


def _part(way: str, role: str, seconds: float) -> Part:
    nodes = WAYS[way]
    name, _, number = role.partition(" ")
    makers: dict[str, Callable[[], Part]] = {
        "simulator": lambda: nodes.simulator(seconds),
        "estimator": lambda: nodes.estimator(int(number)),
        "controller": nodes.controller,
    }
    return makers[name]()


def _own_output() -> Callable[[str], None]:
    """Prints lines to stdout, which all others no longer do: rclpy prints warnings there."""
    stream = os.fdopen(os.dup(sys.stdout.fileno()), "w")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    return lambda text: print(text, file=stream, flush=True)


def _announce(part: Part, say: Callable[[str], None]) -> None:
    """Print when the loop begins and ends."""
    running = part.running
    assert running is not None

    def look() -> None:
        if running():
            timer.cancel()
            say("begun")

    timer = part.node.create_timer(LOOK, look, clock=Clock(clock_type=ClockType.STEADY_TIME))
    part.finished.add_done_callback(lambda _: say("finished"))


def main() -> None:
    say = _own_output()
    way, seconds, cores, *roles = sys.argv[1:]
    say(json.dumps(prepare({int(each) for each in cores.split(",")})))
    middleware.prepare()
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    parts = {role: _part(way, role, float(seconds)) for role in roles}
    executor = spin.make_executor() if way == "suite" else SingleThreadedExecutor()
    for part in parts.values():
        executor.add_node(part.node)
    if "simulator" in parts:
        _announce(parts["simulator"], say)
    ended = Future()

    def answer() -> None:
        for _ in sys.stdin:
            say(json.dumps({role: part.counts() for role, part in parts.items()}))
        ended.set_result(0)

    threading.Thread(target=answer, daemon=True).start()
    spin.spin(executor, ended)
    spin.close_all([part.node for part in parts.values()])
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
