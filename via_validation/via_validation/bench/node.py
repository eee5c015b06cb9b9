"""Benchmark of the estimator node: 16 joints of two transmissions each at 1 kHz over DDS; no estimate may be lost.

Three processes: this one publishes joint states, stamped with the monotonic clock; the estimator node; and a listener
that takes every estimate of every topic, checks the sequence numbers and measures the time from stamp to arrival.
CPU shares are relative to one core and include all threads of a process.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from via_core.devices import Device, load_device
from via_core.errors import ViaError
from via_core.wire import SECOND

from via_validation.tables.rows import Row

RATE = 1000.0  # [Hz]
CONNECT = 60.0  # [s] time limit for all topics to be connected
CPU_LIMIT = 80.0  # [%] of a core, with some margin
TICKS = os.sysconf("SC_CLK_TCK")  # per second of CPU time


def listen(devices: list[Device]) -> None:
    """Take every estimate until SIGTERM; then print counts, errors and latencies as JSON."""
    import rclpy
    from rclpy.executors import ExternalShutdownException
    from via_interfaces.msg import MotorEstimate, StiffnessEstimate
    from via_ros import middleware, qos
    from via_ros.interfaces import opening_of
    from via_ros.spin import make_executor, spin_until

    middleware.prepare()
    rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
    ended: list[bool] = []
    signal.signal(signal.SIGTERM, lambda *_: ended.append(True))
    node = rclpy.create_node("listener")
    late: list[
        int
    ] = []  # [ns] from stamp to arrival of the last device's stiffness, the last estimate but one of a tick
    counts: dict[str, int] = {}
    wrong: list[str] = []

    def check(topic: str, data: bytes) -> int:
        opening = opening_of(data)
        assert opening is not None
        stamp, sequence = opening
        if sequence != counts.get(topic, 0):
            wrong.append(f"{topic}: {sequence} after {counts.get(topic, 0) - 1}")
        counts[topic] = sequence + 1
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

    def take(data: bytes) -> None:
        now = time.monotonic_ns()
        late.append(now - check(last, data))
        if len(late) % 50 == 0:
            drain()

    # Only this subscription wakes the process; messages of the others stay in the middleware until drained.
    awake = rclpy.create_node("awake")
    awake.create_subscription(StiffnessEstimate, last, take, qos.SAMPLES, raw=True)
    executor = make_executor()
    executor.add_node(awake)
    try:
        spin_until(executor, lambda: bool(ended), 1e6)
        drain()
    except ExternalShutdownException:
        pass
    taken = np.array(late) / 1e3
    print(json.dumps({"counts": counts, "wrong": wrong, "latency": np.percentile(taken, [50, 99, 99.9, 100]).tolist()}))


def cpu(pid: int) -> float:
    """CPU time of a process [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


def publish(
    devices: list[Device],
    seconds: float,
    separate: bool,
    node: subprocess.Popen[bytes],
    listener: subprocess.Popen[str],
) -> dict[str, float]:
    """Publish smooth motion for `seconds`; returns steps, elapsed time, CPU shares and late ticks."""
    import rclpy
    from rclpy.serialization import serialize_message
    from sensor_msgs.msg import JointState
    from via_ros import middleware, qos

    middleware.prepare()
    rclpy.init()
    peer = rclpy.create_node("robot")
    groups = [[device] for device in devices] if separate else [devices]
    publishers = [peer.create_publisher(JointState, "/joint_states", qos.SAMPLES) for _ in groups]
    topics = [f"/{device.name}/{name}" for device in devices for name in ("stiffness", "motor")]
    deadline = time.monotonic() + CONNECT
    while any(each.get_subscription_count() < 1 for each in publishers) or any(
        peer.count_publishers(topic) < 1 or peer.count_subscribers(topic) < 1 for topic in topics
    ):
        if time.monotonic() > deadline or node.poll() is not None or listener.poll() is not None:
            raise ViaError(f"the node or its listener ended, or was not connected within {CONNECT:g} s")
        time.sleep(0.05)
    time.sleep(6.0)  # this process has discovered both others; they need to discover each other as well
    writers: list[tuple[Any, bytearray, np.ndarray, np.ndarray]] = []
    for group, publisher in zip(groups, publishers, strict=True):
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
        writers.append((publisher, data, positions, efforts))
    phase = np.arange(3 * len(devices)) * 0.7
    pace = 5.0 + 0.1 * np.arange(3 * len(devices))
    steps, missed = round(seconds * RATE), 0
    used, start = cpu(node.pid), time.monotonic()
    mine = time.process_time()
    for step in range(steps):
        left = start + step / RATE - time.monotonic()
        if left > 0.0:
            time.sleep(left)
        missed += left < -1.0 / RATE
        angles = 0.3 * np.sin(pace * (step / RATE) + phase)
        torques = 0.5 * np.cos(pace * (step / RATE) + phase)
        at = 0
        for publisher, data, positions, efforts in writers:
            positions[:] = angles[at : at + len(positions)]
            efforts[:] = torques[at : at + len(positions)]
            at += len(positions)
            stamp = time.monotonic_ns()
            data[4:12] = np.array([stamp // SECOND, stamp % SECOND], dtype=np.uint32).tobytes()
            publisher.publish(bytes(data))
    elapsed = time.monotonic() - start
    share, own = (cpu(node.pid) - used) / elapsed, (time.process_time() - mine) / elapsed
    time.sleep(2.0)
    return {"steps": steps, "elapsed": elapsed, "node": share, "robot": own, "late ticks": missed}


def node_rows(seconds: float, joints: int, device: str, separate: bool) -> list[Row]:
    """Rows of a run of `seconds`, with one JointState per joint if `separate`. Raises ViaError if a process fails."""
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    from via_ros.domains import reserved_domain

    names = [f"j{k}={device}" for k in range(1, joints + 1)]
    devices = [load_device(name) for name in names]
    listing = json.dumps(names)
    with reserved_domain() as domain:
        os.environ["ROS_DOMAIN_ID"] = str(domain)
        estimator = [sys.executable, "-m", "via_estimators.nodes.estimator", "--ros-args", "-p", f"devices:={listing}"]
        node = subprocess.Popen(estimator)
        listener = subprocess.Popen([sys.executable, "-m", __name__, listing], stdout=subprocess.PIPE, text=True)
        try:
            sent = publish(devices, seconds, separate, node, listener)
            listener.send_signal(signal.SIGTERM)
            received = json.loads(listener.communicate(timeout=30.0)[0])
        finally:
            for process in (node, listener):
                process.terminate()
                process.wait()
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
