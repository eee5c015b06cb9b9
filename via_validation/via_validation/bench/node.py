"""Benchmark of the estimator node: 16 joints of two transmissions each at 1 kHz over DDS; no estimate may be lost.

Three processes: this one publishes joint states, stamped with the monotonic clock; the estimator node; and a listener
that takes every estimate of every topic, checks the sequence numbers and measures the time from stamp to arrival.
Samples before and after the run show that all are connected, and that the last estimate of the run has arrived: nothing
depends on the speed of the machine. CPU shares are relative to one core and include all threads of a process.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from select import select
from typing import IO, Any

import numpy as np
from via_core.devices import Device, load_device
from via_core.errors import ViaError
from via_core.wire import SECOND

from via_validation.tables.rows import Row

RATE = 1000.0  # [Hz]
IDLE = 0.02  # [s] between two samples before and after the run
CPU_LIMIT = 60.0  # [%] of a core
TICKS = os.sysconf("SC_CLK_TCK")  # per second of CPU time
FOREVER = 1 << 62  # [ns]
Show = Callable[[str, float], None]  # what is done, and the share done, NaN if unknown


def listen(devices: list[Device]) -> None:
    """Take every estimate and check its number; print 'ready' as soon as each topic had one.

    Then two lines of stdin, each of which is answered, name the stamps [ns] between which estimates count. When each
    topic had a later one: print counts, errors and latencies as JSON.
    """
    import rclpy
    from via_interfaces.msg import MotorEstimate, StiffnessEstimate
    from via_ros import middleware, qos
    from via_ros.interfaces import opening_of
    from via_ros.spin import FOREVER as PATIENCE
    from via_ros.spin import make_executor, spin_until

    middleware.prepare()
    rclpy.init()
    node = rclpy.create_node("listener")
    # [ns] from stamp to arrival of the last device's stiffness, the last estimate but one of a tick
    late: list[int] = []
    bounds = [FOREVER, FOREVER]  # [ns]
    newest: dict[str, tuple[int, int]] = {}  # stamp and number
    counts: dict[str, int] = {}
    wrong: list[str] = []

    def check(topic: str, data: bytes) -> int | None:
        """The stamp of an estimate of the run."""
        opening = opening_of(data)
        assert opening is not None
        stamp, sequence = opening
        if topic in newest and sequence != newest[topic][1] + 1:
            wrong.append(f"{topic}: {sequence} after {newest[topic][1]}")
        newest[topic] = opening
        if not bounds[0] <= stamp < bounds[1]:
            return None
        counts[topic] = counts.get(topic, 0) + 1
        return stamp

    others: list[tuple[str, Any, Any]] = []
    for device in devices:
        for kind, name in ((StiffnessEstimate, "stiffness"), (MotorEstimate, "motor")):
            topic = f"/{device.name}/{name}"
            if device is devices[-1] and name == "stiffness":
                continue
            others.append((topic, kind, node.create_subscription(kind, topic, lambda _: None, qos.SAMPLES)))

    def drain() -> None:
        for topic, kind, subscription in others:
            while (taken := subscription.handle.take_message(kind, True)) is not None:
                check(topic, taken[0])

    last = f"/{devices[-1].name}/stiffness"
    heard = 0

    def take(data: bytes) -> None:
        nonlocal heard
        now = time.monotonic_ns()
        stamp = check(last, data)
        if stamp is not None:
            late.append(now - stamp)
        heard += 1
        if heard % 50 == 0:
            drain()

    def all_after(stamp: int) -> bool:
        drain()
        return len(newest) == 2 * len(devices) and all(newest[topic][0] >= stamp for topic in newest)

    def bound() -> None:
        for k in range(2):
            bounds[k] = int(sys.stdin.readline())
            print("yes", flush=True)

    # Only this subscription wakes the process; messages of the others stay in the middleware until drained.
    awake = rclpy.create_node("awake")
    awake.create_subscription(StiffnessEstimate, last, take, qos.SAMPLES, raw=True)
    executor = make_executor()
    executor.add_node(awake)
    spin_until(executor, lambda: all_after(0), PATIENCE)
    print("ready", flush=True)
    threading.Thread(target=bound, daemon=True).start()
    spin_until(executor, lambda: all_after(bounds[1]), PATIENCE)
    latency = np.percentile(np.array(late) / 1e3, [50, 99, 99.9, 100]).tolist()
    print(json.dumps({"counts": counts, "wrong": wrong, "latency": latency}), flush=True)


def cpu(pid: int) -> float:
    """CPU time of a process [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


class Robot:
    """Publishes smooth motion; with one JointState per joint if `separate`."""

    def __init__(self, devices: list[Device], separate: bool, domain: int) -> None:
        import rclpy
        from rclpy.context import Context
        from via_ros import middleware

        middleware.prepare()
        self._context = Context()
        rclpy.init(context=self._context, domain_id=domain)
        self._node = rclpy.create_node("robot", context=self._context)
        self._writers = [self._writer(group) for group in ([[each] for each in devices] if separate else [devices])]
        self._phase = np.arange(3 * len(devices)) * 0.7
        self._pace = 5.0 + 0.1 * np.arange(3 * len(devices))

    def _writer(self, group: list[Device]) -> tuple[Any, bytearray, np.ndarray, np.ndarray]:
        """Publisher, serialised message, and views of its positions and efforts."""
        from rclpy.serialization import serialize_message
        from sensor_msgs.msg import JointState
        from via_ros import qos

        message = JointState(name=[name for each in group for name in (each.link_joint, *each.motor_joints)])
        count = len(message.name)
        for field in ("position", "velocity", "effort"):
            setattr(message, field, [1.0] * count)
        data = bytearray(serialize_message(message))
        first = bytes(data).index(np.float64(1.0).tobytes())
        # Three arrays of n doubles, each preceded by its length (aligned to 8 bytes).
        positions = np.frombuffer(data, np.float64, count, first)
        efforts = np.frombuffer(data, np.float64, count, first + 2 * (8 * count + 8))
        assert np.all(positions == 1.0) and np.all(efforts == 1.0)
        return self._node.create_publisher(JointState, "/joint_states", qos.SAMPLES), data, positions, efforts

    def close(self) -> None:
        """Leave the graph."""
        self._node.destroy_node()
        self._context.try_shutdown()

    def publish(self, time_: float) -> None:
        """The sample at a time [s] of the motion."""
        angles = 0.3 * np.sin(self._pace * time_ + self._phase)
        torques = 0.5 * np.cos(self._pace * time_ + self._phase)
        at = 0
        for publisher, data, positions, efforts in self._writers:
            positions[:] = angles[at : at + len(positions)]
            efforts[:] = torques[at : at + len(positions)]
            at += len(positions)
            stamp = time.monotonic_ns()
            data[4:12] = np.array([stamp // SECOND, stamp % SECOND], dtype=np.uint32).tobytes()
            publisher.publish(bytes(data))


@dataclass(frozen=True)
class Peers:
    """The processes beside the robot."""

    node: subprocess.Popen[bytes]
    listener: subprocess.Popen[str]

    @property
    def _answers(self) -> IO[str]:
        assert self.listener.stdout is not None
        return self.listener.stdout

    def line(self, meanwhile: Callable[[], None]) -> str:
        """The next line of the listener; until then `meanwhile` is called. Raises ViaError if a process ends."""
        while not select([self._answers], [], [], IDLE)[0]:
            if self.node.poll() is not None:
                raise ViaError(f"the node ended with code {self.node.returncode}")
            meanwhile()
        return self._answers.readline() or self._ended()

    def bound(self) -> None:
        """Give the listener the time now as a bound of the run."""
        assert self.listener.stdin is not None
        print(time.monotonic_ns(), file=self.listener.stdin, flush=True)
        self.line(lambda: None)

    def _ended(self) -> str:
        raise ViaError(f"the listener ended with code {self.listener.wait()}")


def publish(robot: Robot, seconds: float, peers: Peers, show: Show) -> tuple[dict[str, float], dict[str, Any]]:
    """Publish for `seconds`; returns what was sent (steps, CPU shares, late ticks) and what was received."""
    show("waiting for an estimate on every topic", float("nan"))
    peers.line(lambda: robot.publish(0.0))
    peers.bound()
    steps, missed = round(seconds * RATE), 0
    used, mine, start = cpu(peers.node.pid), time.process_time(), time.monotonic()
    for step in range(steps):
        left = start + step / RATE - time.monotonic()
        if left > 0.0:
            time.sleep(left)
        missed += left < -1.0 / RATE
        robot.publish(step / RATE)
        if step % RATE == 0:
            show("publishing samples", step / steps)
    elapsed = time.monotonic() - start
    share, own = (cpu(peers.node.pid) - used) / elapsed, (time.process_time() - mine) / elapsed
    peers.bound()
    show("waiting for the last estimates", float("nan"))
    received = json.loads(peers.line(lambda: robot.publish(seconds)))
    return {"steps": steps, "node": share, "robot": own, "late ticks": missed}, received


def node_rows(
    seconds: float, joints: int, device: str, separate: bool, show: Show = lambda step, share: None
) -> list[Row]:
    """Rows of a run of `seconds`, with one JointState per joint if `separate`. Raises ViaError if a process fails."""
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    from via_ros.domains import reserved_domain

    names = [f"j{k}={device}" for k in range(1, joints + 1)]
    devices = [load_device(name) for name in names]
    listing = json.dumps(names)
    with ExitStack() as stack:
        domain = stack.enter_context(reserved_domain())
        pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}

        def started(module: str, *words: str, **options: Any) -> Any:
            environment = {**os.environ, "ROS_DOMAIN_ID": str(domain)}
            process = subprocess.Popen([sys.executable, "-m", module, *words], env=environment, **options)
            stack.callback(process.wait)
            stack.callback(process.terminate)
            return process

        node = started("via_estimators.nodes.estimator", "--ros-args", "-p", f"devices:={listing}")
        listener = started(__name__, listing, **pipes)
        robot = Robot(devices, separate, domain)
        stack.callback(robot.close)
        sent, received = publish(robot, seconds, Peers(node, listener), show)
    return _rows(sent, received, f"{joints} x {device}, {RATE:g} Hz, {seconds:g} s, "
                 f"{'one JointState per joint' if separate else 'one JointState for all'}", 2 * joints)  # fmt: skip


def _rows(sent: Mapping[str, float], received: Mapping[str, Any], settings: str, topics: int) -> list[Row]:
    """Rows from what was sent and received."""
    expected = sent["steps"] * topics
    count = sum(received["counts"].values())

    def row(name: str, what: str, quantity: str, ours: float, limit: float | None = None) -> Row:
        return Row(f"node.{name}", what, quantity, None, float(ours), limit, settings)

    return [
        row("expected", "expected estimates", "count", expected),
        row("lost", "lost estimates", "count", expected - count, 0.0),
        row("out_of_order", "estimates out of order", "count", len(received["wrong"]), 0.0),
        row("cpu.node", "CPU share of the node", "share of a core [%]", 100.0 * sent["node"], CPU_LIMIT),
        row("cpu.publisher", "CPU share of the publisher", "share of a core [%]", 100.0 * sent["robot"]),
        row("late", "ticks of the publisher late by more than a period", "count", sent["late ticks"]),
        *(row(f"latency.{name}", f"sample to its last estimate, {name}", "time [us]", value)
          for name, value in zip(("p50", "p99", "p99.9", "worst"), received["latency"], strict=True)),
    ]  # fmt: skip


if __name__ == "__main__":
    listen([load_device(name) for name in json.loads(sys.argv[1])])
