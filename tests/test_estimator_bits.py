"""Live over DDS, replayed from its bag and run in process: every method gives the same bits, many in one node."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pytest
import rclpy
from rclpy.serialization import deserialize_message, serialize_message
from ros_messages import CommandWriter
from sensor_msgs.msg import JointState
from via_core.bags.reader import read_bag
from via_core.bags.writer import BagWriter
from via_core.devices import device_names, load_device
from via_core.status import Status
from via_estimators.methods import METHODS, estimator_for, methods_for, pairs_of
from via_estimators.nodes.estimator import BANK, EstimatorNode
from via_estimators.rows import estimate_bag
from via_interfaces.msg import DampingEstimate, MotorEstimate, StiffnessEstimate, VsaCommand
from via_ros import qos
from via_ros.composition import Composition
from via_ros.conversions import Command, JointStateWriter, nanoseconds
from via_ros.nodes.player import Player

START = 1_700_000_000_123_456_789  # [ns]
PERIOD = 1_000_000  # [ns]
COUNT, BAD, GAP = 2600, 100, 2300  # samples; a bad one of the twin; the first after a gap
WINDOW, PATIENCE = 200, 600.0  # samples on their way at a time, [s]
SHIPPED = [load_device(name) for name in device_names()]
FIRST = {method: next(each for each in SHIPPED if method in methods_for(each)) for method in METHODS}
# Each of these once, and the first one twice: a node of several devices.
NAMES = ["twin=" + FIRST["modulated_torque"].name, *dict.fromkeys(device.name for device in FIRST.values())]
DEVICES = [load_device(name) for name in NAMES]
PAIRS = pairs_of(DEVICES, ["all"])
KINDS = {"stiffness": StiffnessEstimate, "damping": DampingEstimate, "motor": MotorEstimate}
# Topic, members of value and standard deviation, and the outputs they hold.
MEMBERS = (
    ("stiffness", "value", "standard_deviation", "stiffness"),
    ("stiffness", "transmission_value", "transmission_standard_deviation", "stiffness_"),
    ("damping", "value", "standard_deviation", "damping"),
    ("motor", "inertia", "inertia_standard_deviation", "motor_inertia_"),
    ("motor", "damping", "damping_standard_deviation", "motor_damping_"),
)


def samples():
    """(stamp, JointStates of that stamp): smooth motion, a dropout and a NaN; alternately one message or one each."""
    rng = np.random.default_rng(7)
    writers = [JointStateWriter(device) for device in DEVICES]
    for k in range(COUNT):
        t, stamp = 1e-3 * k, START + PERIOD * k + (100 * PERIOD if k >= GAP else 0)
        for at, writer in enumerate(writers):
            pace = np.array([5.0, 9.0, 7.0])[: len(writer.position)] + 0.1 * at
            rest = np.array([0.0, 0.4, -0.4])[: len(writer.position)]
            size = np.array([0.6, 0.25, 0.25])[: len(writer.position)]
            writer.position[:] = rest + size * np.sin(pace * t + at)
            writer.velocity[:] = size * pace * np.cos(pace * t + at)
            writer.effort[:] = effort(DEVICES[at], writer, -size * pace**2 * np.sin(pace * t + at))
            writer.effort[:] += 0.01 * rng.normal(size=len(writer.effort))
        writers[0].position[0] += np.nan if k == BAD else 0.0
        messages = [writer.stamped(stamp) for writer in writers]
        if k % 2:
            yield stamp, [serialize_message(message) for message in messages]
            continue
        whole = JointState(header=messages[0].header)
        for member in ("name", "position", "velocity", "effort"):
            setattr(whole, member, [each for message in messages for each in getattr(message, member)])
        yield stamp, [serialize_message(whole)]


def effort(device, writer, acceleration):
    """Torques (1 + m,) that the device needs for its motion: others would be implausible."""
    if device.damper is not None and not device.n_motors:
        return np.array([2.0 * writer.velocity[0]])
    found = np.zeros(len(writer.effort))
    for i, motor in enumerate(device.motors, start=1):
        if device.drive == "torque":
            spring = device.springs[i - 1].torque(writer.position[0] - writer.position[i])
            found[i] = motor.inertia * acceleration[i] + motor.viscous_friction * writer.velocity[i] - spring
    return found


def commands():
    """(stamp, topic, VsaCommand) for every device, twenty a second."""
    for device in DEVICES:
        writer = CommandWriter(device)
        for k in range(0, COUNT, 50):
            command = Command(VsaCommand.EQUILIBRIUM_PRESET, 0.2 * np.sin(0.01 * k), 0.5, 0.5, np.empty(0))
            stamp = START + PERIOD * k - 1
            yield stamp, device.command_topic, serialize_message(writer.numbered(stamp, command))


class Ears:
    """Subscriptions to all topics of a bank."""

    def __init__(self, graph):
        self.peer = graph.add(lambda **options: rclpy.create_node("peer", **options))
        self.heard = {}
        for pair in PAIRS:
            for name, kind in KINDS.items():
                topic = f"/{pair.device.name}/{pair.method}/{name}"
                self.heard[topic] = []
                self.peer.create_subscription(kind, topic, self.heard[topic].append, qos.SAMPLES, raw=True)

    def topics(self, node):
        """Those of them that the node publishes on."""
        offered = {name for name, _ in node.get_publisher_names_and_types_by_node(node.get_name(), "/")}
        return sorted(offered & self.heard.keys())

    def complete(self, topics, count):
        return all(len(self.heard[topic]) >= count for topic in topics)


@pytest.fixture(scope="module")
def answers(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict, dict, Path]:
    """Messages of a bank live, of another one in replay, and the bag."""
    bag = tmp_path_factory.mktemp("bits") / "bag"
    stream = list(samples())
    with BagWriter(bag) as out:
        out.add_topic("/joint_states", "sensor_msgs/msg/JointState")
        for stamp, messages in stream:
            for message in messages:
                out.write("/joint_states", message, stamp)
        for device in DEVICES:
            out.add_topic(device.command_topic, "via_interfaces/msg/VsaCommand")
        for stamp, topic, message in commands():
            out.write(topic, message, stamp)
    bank = partial(EstimatorNode, BANK)
    with Composition() as graph:
        ears = Ears(graph)
        node = graph.add(bank, devices=NAMES)
        states = ears.peer.create_publisher(JointState, "/joint_states", qos.SAMPLES)
        orders = {
            each.device.command_topic: ears.peer.create_publisher(VsaCommand, each.device.command_topic, qos.SAMPLES)
            for each in node.pipelines
            if each.commanded
        }
        topics = ears.topics(node)
        graph.run_until(
            lambda: (
                all(each.get_subscription_count() == 1 for each in (states, *orders.values()))
                and all(ears.peer.count_publishers(topic) == 1 for topic in topics)
            ),
            PATIENCE,
            "meeting",
        )
        for _, topic, message in commands():
            if topic in orders:
                orders[topic].publish(message)
        graph.run_until(
            lambda: all(len(each.pending) == COUNT // 50 for each in node.pipelines if each.commanded),
            PATIENCE,
            "orders",
        )
        for count, (_, messages) in enumerate(stream, start=1):
            for message in messages:
                states.publish(message)
            if count % WINDOW == 0:
                graph.run_until(lambda count=count: ears.complete(topics, count), PATIENCE, f"answers to {count}")
        live = ears.heard
    with Composition() as graph:
        ears = Ears(graph)
        node = graph.add(bank, devices=NAMES)
        player = graph.add(Player, bag=str(bag), rate=0.0, window=WINDOW, answers=ears.topics(node), subscribers=0)
        graph.run_until(lambda: player.finished.done() and ears.complete(topics, COUNT), 2 * PATIENCE, "the replay")
        return live, ears.heard, bag


def decoded(answers, kind):
    return [deserialize_message(data, kind) for data in answers]


def bits(messages, member):
    """(N, k) whole numbers of the doubles of a member."""
    return np.array([np.atleast_1d(getattr(message, member)) for message in messages]).view(np.uint64)


@pytest.mark.parametrize("pair", PAIRS, ids=lambda pair: f"{pair.method}-{pair.device.name}")
def test_live_replayed_and_in_process_estimates_are_equal(answers, pair):
    live, replayed, bag = answers
    done = estimate_bag(read_bag(bag), pair.device, estimator_for(*pair))
    estimates = done.estimates
    assert len(estimates) == COUNT
    assert Status.OK in estimates.status, "the samples are not informative for this method"
    published = set()
    for topic, member, sd, output in MEMBERS:
        outputs = [each for each in estimates.outputs if each == output or each.rstrip("0123456789") == output]
        if not outputs:
            continue
        for heard in (live, replayed):
            messages = decoded(heard[f"/{pair.device.name}/{pair.method}/{topic}"], KINDS[topic])
            assert [message.sequence for message in messages] == list(range(COUNT))
            assert [nanoseconds(message.header.stamp) for message in messages] == done.samples.stamp.tolist()
            assert [message.status for message in messages] == estimates.status.tolist()
            assert {(message.method, message.header.frame_id) for message in messages} == {
                (pair.method, pair.device.name)
            }
            expected = [estimates.column(name) for name in outputs]
            np.testing.assert_array_equal(
                bits(messages, member), np.column_stack([value for value, _ in expected]).view(np.uint64)
            )
            np.testing.assert_array_equal(
                bits(messages, sd), np.column_stack([sd for _, sd in expected]).view(np.uint64)
            )
        published.add(topic)
    assert published
    silent = KINDS.keys() - published
    assert not any(live[f"/{pair.device.name}/{pair.method}/{topic}"] for topic in silent)


def test_every_method_is_covered():
    assert {pair.method for pair in PAIRS} == set(METHODS)
    assert len({pair.device.name for pair in PAIRS}) == len(DEVICES)


def test_a_bad_sample_affects_only_its_device(answers):
    live, _, _ = answers
    for name, status in (("twin", Status.BAD_SAMPLE), (FIRST["modulated_torque"].name, Status.WARMING_UP)):
        messages = decoded(live[f"/{name}/modulated_torque/stiffness"], StiffnessEstimate)
        assert messages[BAD].status == status
