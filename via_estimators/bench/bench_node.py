"""The estimator node at work: 16 joints of two transmissions each, 1 kHz, over DDS; nothing may be lost.

    python via_estimators/bench/bench_node.py --seconds 60
    python via_estimators/bench/bench_node.py --seconds 20 --separate         one JointState per joint, not one for all

Three processes: this one publishes joint states, stamped with the monotonic clock; the node; and a listener that takes
every estimate of every topic, checks the numbers one by one and measures how long after its stamp one came.
CPU shares are of one core and count all threads of the process.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from via_core.devices import Device, load_device
from via_core.wire import SECOND

RATE = 1000.0  # [Hz]
SETTLE = 60.0  # [s] within which every topic has its listener
TICKS = os.sysconf("SC_CLK_TCK")  # per second of CPU time


def listen(devices: list[Device]) -> None:
    """Take every estimate until SIGTERM; then say in JSON what came."""
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
    late: list[int] = []  # [ns] from stamp to here, of the last device's stiffness: the last but one to be published
    counts: dict[str, int] = {}
    wrong: list[str] = []

    def check(topic: str, data: bytes) -> int:
        opening = opening_of(data)
        assert opening is not None
        if opening.sequence != counts.get(topic, 0):
            wrong.append(f"{topic}: {opening.sequence} after {counts.get(topic, 0) - 1}")
        counts[topic] = opening.sequence + 1
        return opening.stamp

    others = []
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

    # Only this one wakes the process; the others wait in the middleware until they are drained.
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
    """[s] of CPU time that a process has used."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


def publish(
    devices: list[Device], seconds: float, separate: bool, node: subprocess.Popen, ear: subprocess.Popen
) -> dict:
    """Publish smooth motion until `seconds` are over; what it took."""
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
    deadline = time.monotonic() + SETTLE
    while any(each.get_subscription_count() < 1 for each in publishers) or any(
        peer.count_publishers(topic) < 1 or peer.count_subscribers(topic) < 1 for topic in topics
    ):
        if time.monotonic() > deadline or node.poll() is not None or ear.poll() is not None:
            sys.exit("the node and its listener did not come up")
        time.sleep(0.05)
    time.sleep(2.0)  # discovery is known here; the two others need to have heard of each other as well
    writers = []
    for group, publisher in zip(groups, publishers, strict=True):
        message = JointState(name=[name for each in group for name in (each.link_joint, *each.motor_joints)])
        count = len(message.name)
        for field in ("position", "velocity", "effort"):
            setattr(message, field, [1.0] * count)
        data = bytearray(serialize_message(message))
        first = bytes(data).index(np.float64(1.0).tobytes())
        # Three arrays of n doubles; before each but the first the length, aligned to 8.
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--joints", type=int, default=16)
    parser.add_argument("--device", default="qbmove_a", help="what every joint is")
    parser.add_argument("--separate", action="store_true", help="one JointState per joint instead of one for all")
    parser.add_argument("--listen", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    names = [f"j{k}={given.device}" for k in range(1, given.joints + 1)]
    devices = [load_device(name) for name in names]
    if given.listen:
        listen(devices)
        return
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    from via_ros.domains import Domain

    with Domain() as domain:
        os.environ["ROS_DOMAIN_ID"] = str(domain.number)
        node = subprocess.Popen(
            [
                sys.executable,
                "-m",
                "via_estimators.nodes.estimator",
                "--ros-args",
                "-p",
                f"devices:={json.dumps(names)}",
            ]
        )
        ear = subprocess.Popen([sys.executable, __file__, *sys.argv[1:], "--listen"], stdout=subprocess.PIPE, text=True)
        try:
            sent = publish(devices, given.seconds, given.separate, node, ear)
            ear.send_signal(signal.SIGTERM)
            heard = json.loads(ear.communicate(timeout=30.0)[0])
        finally:
            for process in (node, ear):
                process.terminate()
                process.wait()
    expected = sent["steps"] * 2 * len(devices)
    came = sum(heard["counts"].values())
    p50, p99, p999, worst = heard["latency"]
    print(
        f"Estimator node: {len(devices)} x {given.device}, {RATE:g} Hz, {given.seconds:g} s, "
        f"{'one JointState per joint' if given.separate else 'one JointState for all'}"
    )
    print(
        f"  estimates sent for {expected}, received {came}, lost {expected - came}, out of order {len(heard['wrong'])}"
    )
    print(f"  CPU share of the node {100 * sent['node']:.0f} % of a core, of the publisher {100 * sent['robot']:.0f} %")
    print(
        f"  sample to its last estimate: p50 {p50:.0f} us, p99 {p99:.0f} us, p99.9 {p999:.0f} us, worst {worst:.0f} us"
        f"   ({sent['late ticks']} ticks of the publisher late by more than a period)"
    )
    sys.exit(0 if came == expected and not heard["wrong"] else 1)


if __name__ == "__main__":
    main()
