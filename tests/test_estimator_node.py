"""The estimator node in a graph: every sample answered in order, bit by bit what a replay in process gives."""

from __future__ import annotations

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from via_core.bags import BagWriter, read_bag
from via_core.devices import load_device
from via_core.errors import ParameterError
from via_core.status import Status
from via_estimators.methods import estimator_for
from via_estimators.nodes.estimator import EstimatorNode
from via_estimators.rows import estimate_bag
from via_interfaces.msg import DampingEstimate, MotorEstimate, StiffnessEstimate, VsaCommand
from via_interfaces.srv import ResetEstimator
from via_ros import qos
from via_ros.conversions import Command, CommandWriter, JointStateWriter, nanoseconds

START = 1_700_000_000_123_456_789  # [ns]
PERIOD = 1_000_000  # [ns]
JOINTS, COMMANDS = "sensor_msgs/msg/JointState", "via_interfaces/msg/VsaCommand"


def antagonistic_messages(count, device):
    """Serialised samples of smooth motion with a torque in every one; the content does not matter here, the bits do."""
    writer = JointStateWriter(device)
    rng = np.random.default_rng(3)
    for k in range(count):
        t = 1e-3 * k
        writer.position[:] = 0.3 * np.sin(5.0 * t), 0.5 + 0.1 * np.sin(9.0 * t), -0.5 + 0.2 * np.cos(7.0 * t)
        writer.effort[1:] = 0.4 * np.sin(4.0 * t) + 0.01 * rng.normal(size=2)
        yield serialize_message(writer.stamped(START + PERIOD * k))


class Bench:
    """The node under test with a publisher of samples and ears on everything it says."""

    def __init__(self, graph, **parameters):
        self.graph = graph
        self.device = load_device(parameters["device"])
        self.node = graph.add(EstimatorNode, **parameters)
        peer = graph.node("peer")
        self.samples = peer.create_publisher(JointState, "/joint_states", qos.SAMPLES)
        self.commands = peer.create_publisher(VsaCommand, self.device.command_topic, qos.SAMPLES)
        self.heard = {StiffnessEstimate: [], DampingEstimate: [], MotorEstimate: [], DiagnosticArray: []}
        for kind, topic in (
            (StiffnessEstimate, "stiffness"),
            (DampingEstimate, "damping"),
            (MotorEstimate, "motor"),
        ):
            peer.create_subscription(kind, f"/{self.device.name}/{topic}", self.heard[kind].append, qos.SAMPLES)
        peer.create_subscription(DiagnosticArray, "/diagnostics", self.heard[DiagnosticArray].append, qos.CONTROL)
        self.reset = peer.create_client(ResetEstimator, "/estimator/reset")
        answers = [f"/{self.device.name}/{topic}" for topic in ("stiffness", "damping", "motor")]
        graph.until(
            lambda: (
                self.samples.get_subscription_count() == 1
                and sum(peer.count_publishers(topic) for topic in answers) == 2
                and self.reset.service_is_ready()
            )
        )

    def send(self, messages, batch=200):
        """Publish, never further ahead than the queues are long."""
        estimates = self.heard[StiffnessEstimate]
        already = len(estimates)
        for count, message in enumerate(messages, start=1):
            self.samples.publish(message)
            if count % batch == 0:
                self.graph.until(lambda count=count: len(estimates) >= already + count)
        self.graph.until(lambda: len(estimates) >= already + count)


def test_live_estimates_are_those_of_the_bag_bit_by_bit(graph, tmp_path):
    bench = Bench(graph, device="cubic_demo")
    messages = list(antagonistic_messages(1500, bench.device))
    with BagWriter(tmp_path / "bag") as out:
        out.add_topic("/joint_states", JOINTS)
        for k, message in enumerate(messages):
            out.write("/joint_states", message, log_time=START + PERIOD * k)
    bench.send(messages)
    graph.until(lambda: len(bench.heard[MotorEstimate]) == 1500)
    replay = estimate_bag(read_bag(tmp_path / "bag"), bench.device, estimator_for(bench.device))
    live = bench.heard[StiffnessEstimate]
    assert [message.sequence for message in live] == list(range(1500))
    np.testing.assert_array_equal([nanoseconds(message.header.stamp) for message in live], replay.samples.stamp)
    np.testing.assert_array_equal([message.status for message in live], replay.estimates.status)
    estimates = replay.estimates
    assert (estimates.status == Status.WARMING_UP).sum() < 1000
    for at, values in enumerate(
        [
            [message.value for message in live],
            *np.transpose([message.transmission_value for message in live]),
            *np.transpose([message.inertia for message in bench.heard[MotorEstimate]]),
            *np.transpose([message.damping for message in bench.heard[MotorEstimate]]),
        ]
    ):
        np.testing.assert_array_equal(values, estimates.value[:, at])
    for at, values in enumerate(
        [
            [message.standard_deviation for message in live],
            *np.transpose([message.transmission_standard_deviation for message in live]),
            *np.transpose([message.inertia_standard_deviation for message in bench.heard[MotorEstimate]]),
            *np.transpose([message.damping_standard_deviation for message in bench.heard[MotorEstimate]]),
        ]
    ):
        np.testing.assert_array_equal(values, estimates.standard_deviation[:, at])


def test_commands_apply_by_stamp_whatever_order_they_arrive_in(graph, tmp_path):
    bench = Bench(graph, device="maccepavd")
    graph.until(lambda: bench.commands.get_subscription_count() == 1)
    writer, commander = JointStateWriter(bench.device), CommandWriter(bench.device)
    samples, commands = [], []
    for k in range(300):
        writer.position[:2] = 0.5 * np.sin(0.06 * k), 0.0
        samples.append((START + 4_600_000 * k, serialize_message(writer.stamped(START + 4_600_000 * k))))
    for k in range(60):
        time = START + 20_000_000 * k
        command = Command(VsaCommand.EQUILIBRIUM_PRESET, 0.01 * k, 0.5, 0.5, np.empty(0))
        commands.append((time, serialize_message(commander.numbered(time, command))))
    with BagWriter(tmp_path / "bag") as out:
        out.add_topic("/joint_states", JOINTS)
        out.add_topic(bench.device.command_topic, COMMANDS)
        for time, message in samples:
            out.write("/joint_states", message, log_time=time)
        for time, message in commands:
            out.write(bench.device.command_topic, message, log_time=time)
    # All commands come long before the samples they belong to; the node must wait with them.
    for _, message in commands:
        bench.commands.publish(message)
    graph.until(lambda: len(bench.node.stations[0].pending) == 60)
    bench.send([message for _, message in samples])
    graph.until(lambda: len(bench.heard[DampingEstimate]) == 300)
    replay = estimate_bag(read_bag(tmp_path / "bag"), bench.device, estimator_for(bench.device))
    assert np.ptp(replay.samples.rows[:, 3]) > 0.5
    np.testing.assert_array_equal(
        [m.value for m in bench.heard[DampingEstimate]], replay.estimates.column("damping")[0]
    )
    np.testing.assert_array_equal([m.value for m in bench.heard[StiffnessEstimate]], replay.estimates.value[:, 0])
    # A command of the past: it holds from now on, and is told.
    late = CommandWriter(bench.device).numbered(START, Command(0, 0.0, 0.5, 0.5, np.empty(0)))
    bench.commands.publish(late)
    graph.until(lambda: any(told(report, "late commands") == "1" for report in bench.heard[DiagnosticArray]))
    # After a reset another log may follow: no command of the last one holds in it.
    graph.until(bench.reset.call_async(ResetEstimator.Request()).done)
    bench.send([message for _, message in samples[:50]])
    uncommanded = replay.samples.rows[:50].copy()
    uncommanded[:, 3:] = np.nan
    expected = estimator_for(bench.device).run_rows(uncommanded)[1].value[:, 0]
    np.testing.assert_array_equal([m.value for m in bench.heard[StiffnessEstimate][300:]], expected)


def told(report, key):
    """The value of a key in a diagnostics message."""
    return next((entry.value for entry in report.status[0].values if entry.key == key), None)


def test_bad_samples_are_answered_counted_and_never_give_a_nan(graph):
    bench = Bench(graph, device="cubic_demo")
    messages = [deserialize_message(message, JointState) for message in antagonistic_messages(600, bench.device)]
    messages[450].position[0] = np.nan
    messages[460].effort[2] = np.inf
    messages[470].header.stamp = messages[469].header.stamp
    messages[480].header.stamp = messages[470].header.stamp
    messages[490].position = messages[490].position[:1]
    bench.send(messages)
    live = bench.heard[StiffnessEstimate]
    bad = [k for k, message in enumerate(live) if message.status == Status.BAD_SAMPLE]
    assert bad == [450, 460, 470, 480, 490]
    assert live[450].value == live[449].value
    assert live[450].header.stamp == messages[450].header.stamp
    assert all(np.isfinite([m.value, m.standard_deviation]).all() for m in live)
    graph.until(lambda: any(told(report, "bad samples") == "5" for report in bench.heard[DiagnosticArray]))
    report = bench.heard[DiagnosticArray][-1].status[0]
    assert report.level == report.WARN and "bad samples" in report.message and report.hardware_id == "cubic_demo"


def test_renamed_joints_are_told_and_survived(graph):
    bench = Bench(graph, device="cubic_demo")
    stranger = JointState(name=["elbow"], position=[0.0])
    for _ in range(3):
        bench.samples.publish(stranger)
    graph.until(lambda: any(told(report, "foreign messages") == "3" for report in bench.heard[DiagnosticArray]))
    assert "joints of other devices only" in bench.heard[DiagnosticArray][-1].status[0].message
    assert bench.heard[StiffnessEstimate] == []
    bench.send(list(antagonistic_messages(10, bench.device)))
    assert len(bench.heard[StiffnessEstimate]) == 10


def test_reset_forgets_the_samples_but_not_the_numbering(graph):
    bench = Bench(graph, device="cubic_demo")
    messages = list(antagonistic_messages(600, bench.device))
    bench.send(messages)
    assert bench.heard[StiffnessEstimate][-1].status == Status.OK
    answer = bench.reset.call_async(ResetEstimator.Request())
    graph.until(answer.done)
    assert answer.result().success and answer.result().message.startswith("600 samples")
    bench.send(messages)  # the same log again, its stamps going back
    live = bench.heard[StiffnessEstimate]
    assert [message.sequence for message in live] == list(range(1200))
    assert [message.value for message in live[600:]] == [message.value for message in live[:600]]
    assert [message.status for message in live[600:]] == [message.status for message in live[:600]]


def test_parameters_start_from_the_device_and_are_checked(graph):
    node = graph.add(EstimatorNode, device="maccepavd", memory=0.5)
    parameters = node.stations[0].lines[0].live.estimator.parameters
    assert parameters.memory == 0.5
    assert parameters.inertia == load_device("maccepavd").link.inertia
    with pytest.raises(ParameterError, match="window"):
        EstimatorNode(context=graph.context, parameter_overrides=[parameter("window", 1)])
    with pytest.raises(ParameterError, match="a position servo"):
        EstimatorNode(context=graph.context, parameter_overrides=[parameter("method", "link_impedance")])


def parameter(name, value):
    from rclpy.parameter import Parameter

    return Parameter(name, value=value)
