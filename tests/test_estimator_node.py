"""The estimator node in a graph: one answer per sample, in order, with the bits of an in-process replay."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message, serialize_message
from ros_messages import CommandWriter
from sensor_msgs.msg import JointState
from via_core.bags.reader import read_bag
from via_core.bags.writer import BagWriter
from via_core.devices import load_device
from via_core.errors import ParameterError, ViaError
from via_core.status import Status
from via_estimators.methods import estimator_for, methods_for
from via_estimators.nodes.estimator import BANK, ESTIMATOR, EstimatorNode, single
from via_estimators.rows import estimate_bag
from via_interfaces.msg import DampingEstimate, MotorEstimate, StiffnessEstimate, VsaCommand
from via_interfaces.srv import ResetEstimator
from via_ros import qos
from via_ros.conversions import Command, JointStateWriter, nanoseconds

START = 1_700_000_000_123_456_789  # [ns]
PERIOD = 1_000_000  # [ns]
JOINTS, COMMANDS = "sensor_msgs/msg/JointState", "via_interfaces/msg/VsaCommand"


def antagonistic_messages(count, device, sign=1.0):
    """Serialised samples of smooth motion under the torques that the device needs, or with `sign` -1 the reverse."""
    writer = JointStateWriter(device)
    rng = np.random.default_rng(3)
    for k in range(count):
        t = 1e-3 * k
        writer.position[:] = 0.3 * np.sin(5.0 * t), 0.5 + 0.1 * np.sin(9.0 * t), -0.5 + 0.2 * np.cos(7.0 * t)
        rate = np.array([0.9 * np.cos(9.0 * t), -1.4 * np.sin(7.0 * t)])
        bend = np.array([-8.1 * np.sin(9.0 * t), -9.8 * np.cos(7.0 * t)])
        spring = device.torque_each(writer.position[0], writer.position[1:])
        motor = device.motors[0]
        writer.effort[1:] = sign * (motor.inertia * bend + motor.viscous_friction * rate - spring)
        writer.effort[1:] += 0.01 * rng.normal(size=2)
        yield serialize_message(writer.stamped(START + PERIOD * k))


class Harness:
    """The node under test with a publisher of samples and subscriptions to all it publishes."""

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
    bench = Harness(graph, device="cubic_demo")
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


def test_commands_apply_by_stamp_in_any_order_of_arrival(graph, tmp_path):
    bench = Harness(graph, device="maccepavd")
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
    graph.until(lambda: len(bench.node.pipelines[0].pending) == 60)
    bench.send([message for _, message in samples])
    graph.until(lambda: len(bench.heard[DampingEstimate]) == 300)
    replay = estimate_bag(read_bag(tmp_path / "bag"), bench.device, estimator_for(bench.device))
    assert np.ptp(replay.samples.rows[:, 3]) > 0.5
    np.testing.assert_array_equal(
        [m.value for m in bench.heard[DampingEstimate]], replay.estimates.column("damping")[0]
    )
    np.testing.assert_array_equal([m.value for m in bench.heard[StiffnessEstimate]], replay.estimates.value[:, 0])
    # A late command: it applies from now on and is reported.
    late = CommandWriter(bench.device).numbered(START, Command(0, 0.0, 0.5, 0.5, np.empty(0)))
    bench.commands.publish(late)
    graph.until(lambda: any(diagnostic(report, "late commands") == "1" for report in bench.heard[DiagnosticArray]))
    # After a reset another log may follow: no command of the last one holds in it.
    graph.until(bench.reset.call_async(ResetEstimator.Request()).done)
    bench.send([message for _, message in samples[:50]])
    uncommanded = replay.samples.rows[:50].copy()
    uncommanded[:, 3:] = np.nan
    expected = estimator_for(bench.device).run_rows(uncommanded)[1].value[:, 0]
    np.testing.assert_array_equal([m.value for m in bench.heard[StiffnessEstimate][300:]], expected)


def diagnostic(report, key):
    """The value of a key in a diagnostics message."""
    return next((entry.value for entry in report.status[0].values if entry.key == key), None)


def test_bad_samples_are_reported_counted_and_never_give_a_nan(graph):
    bench = Harness(graph, device="cubic_demo")
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
    graph.until(lambda: any(diagnostic(report, "bad samples") == "5" for report in bench.heard[DiagnosticArray]))
    report = bench.heard[DiagnosticArray][-1].status[0]
    assert report.level == report.WARN and "bad samples" in report.message and report.hardware_id == "cubic_demo"


def test_unknown_joints_are_reported_and_ignored(graph):
    bench = Harness(graph, device="cubic_demo")
    unknown = JointState(name=["elbow"], position=[0.0])
    for _ in range(3):
        bench.samples.publish(unknown)
    graph.until(lambda: any(diagnostic(report, "foreign messages") == "3" for report in bench.heard[DiagnosticArray]))
    assert "no cubic_demo_shaft_joint in elbow" in bench.heard[DiagnosticArray][-1].status[0].message
    assert bench.heard[StiffnessEstimate] == []
    bench.send(list(antagonistic_messages(10, bench.device)))
    assert len(bench.heard[StiffnessEstimate]) == 10


def test_reset_forgets_samples_and_continues_the_numbering(graph):
    bench = Harness(graph, device="cubic_demo")
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
    parameters = node.pipelines[0].channels[0].live.estimator.parameters
    assert parameters.memory == 0.5
    assert parameters.inertia == load_device("maccepavd").link.inertia
    with pytest.raises(ParameterError, match="window"):
        EstimatorNode(context=graph.context, parameter_overrides=[parameter("window", 1)])
    with pytest.raises(ParameterError, match="a position servo"):
        EstimatorNode(context=graph.context, parameter_overrides=[parameter("method", "link_impedance")])


def parameter(name, value):
    return Parameter(name, value=value)


TWINS = ("left=cubic_demo", "right=cubic_demo")


class Pair:
    """Two joints of one kind in one node, with subscriptions to their stiffness."""

    def __init__(self, graph, **parameters):
        self.graph = graph
        self.devices = [load_device(name) for name in TWINS]
        self.node = graph.add(EstimatorNode, devices=list(TWINS), **parameters)
        self.peer = graph.node("peer")
        self.samples = self.peer.create_publisher(JointState, "/joint_states", qos.SAMPLES)
        self.left, self.right, self.reports = [], [], []
        topics = ["/left/stiffness", "/right/stiffness"]
        for topic, heard in zip(topics, (self.left, self.right), strict=True):
            self.peer.create_subscription(StiffnessEstimate, topic, heard.append, qos.SAMPLES)
        self.peer.create_subscription(DiagnosticArray, "/diagnostics", self.reports.append, qos.CONTROL)
        graph.until(
            lambda: (
                self.samples.get_subscription_count() == 1
                and all(self.peer.count_publishers(topic) == 1 for topic in topics)
            )
        )

    def send(self, messages, left, right):
        """Publish and wait until so many estimates of either have come."""
        for message in messages:
            self.samples.publish(message)
        self.graph.until(lambda: len(self.left) >= left and len(self.right) >= right)
        assert (len(self.left), len(self.right)) == (left, right)

    def call(self, name):
        client = self.peer.create_client(ResetEstimator, name)
        self.graph.until(client.service_is_ready)
        answer = client.call_async(ResetEstimator.Request())
        self.graph.until(answer.done)
        return answer.result()


def together(messages):
    """One JointState with the content of several."""
    whole = JointState(header=messages[0].header)
    for member in ("name", "position", "velocity", "effort"):
        setattr(whole, member, [each for message in messages for each in getattr(message, member)])
    return whole


def of_twins(count, start=0):
    """(left, right) messages of smooth motion, not the same for both."""
    writers = [JointStateWriter(load_device(name)) for name in TWINS]
    for k in range(start, start + count):
        pair = []
        for at, writer in enumerate(writers):
            writer.position[:] = 0.3 * np.sin(5e-3 * k + at), 0.5 + 0.1 * np.sin(9e-3 * k), 0.2 * np.cos(7e-3 * k) - 0.5
            writer.effort[1:] = 0.4 * np.sin(4e-3 * k)
            pair.append(deserialize_message(serialize_message(writer.stamped(START + PERIOD * k)), JointState))
        yield pair


def test_one_message_for_all_joints_or_one_for_each_is_the_same(graph):
    twins = Pair(graph)
    pairs = list(of_twins(500))
    twins.send([together(pair) for pair in pairs], 500, 500)
    assert twins.call("/estimator/reset").message == "500 samples of left, 500 samples of right forgotten"
    twins.send([message for pair in pairs for message in pair], 1000, 1000)
    for heard in (twins.left, twins.right):
        assert [message.value for message in heard[500:]] == [message.value for message in heard[:500]]
        assert heard[499].status != Status.WARMING_UP
    assert [message.value for message in twins.left] != [message.value for message in twins.right]


def test_a_message_with_some_joints_is_a_sample_of_those_with_their_link(graph):
    twins = Pair(graph)
    pairs = list(of_twins(30))
    twins.send([pair[0] for pair in pairs[:10]], 10, 0)
    headless = together(pairs[10])  # both links, but the motors of the left one only
    for member in ("name", "position", "velocity", "effort"):
        setattr(headless, member, list(getattr(headless, member))[:4])
    twins.send([headless], 11, 1)
    assert (twins.left[-1].status, twins.right[-1].status) == (Status.WARMING_UP, Status.BAD_SAMPLE)
    motors = pairs[11][0]
    for member in ("name", "position", "velocity", "effort"):
        setattr(motors, member, list(getattr(motors, member))[1:])
    reverse = together(pairs[12][::-1])
    twins.send([motors, reverse], 12, 2)
    assert twins.right[-1].status == Status.WARMING_UP
    pairs[13][0].position[0] = np.nan
    twins.send([together(pairs[13])], 13, 3)
    assert (twins.left[-1].status, twins.right[-1].status) == (Status.BAD_SAMPLE, Status.WARMING_UP)


def test_reset_of_one_device_does_not_affect_the_other(graph):
    twins = Pair(graph)
    twins.send([together(pair) for pair in of_twins(500)], 500, 500)
    answer = twins.call("/estimator/left/reset")
    assert answer.success and answer.message == "500 samples of left forgotten"
    twins.send([together(pair) for pair in of_twins(1, start=500)], 501, 501)
    assert twins.left[-1].status == Status.WARMING_UP and twins.right[-1].status != Status.WARMING_UP
    assert (twins.left[-1].sequence, twins.right[-1].sequence) == (500, 500)


def test_diagnostics_and_status_tell_a_fault(graph):
    """Reversed torques: IMPLAUSIBLE in every message, the suspected fault in the diagnostics."""
    harness = Harness(graph, device="cubic_demo")
    harness.send(antagonistic_messages(1200, harness.device, sign=-1.0))
    assert harness.heard[StiffnessEstimate][-1].status == StiffnessEstimate.IMPLAUSIBLE

    def reported():
        heard = [status for report in harness.heard[DiagnosticArray] for status in report.status]
        return next((each for each in heard if "wrong sign of tau_1, tau_2" in each.message), None)

    graph.until(reported)
    status = reported()
    assert status.level == DiagnosticStatus.WARN
    values = {entry.key: entry.value for entry in status.values}
    assert values["status"] == "IMPLAUSIBLE" and values["suspected fault"] in status.message


def test_diagnostics_report_rate_excitation_condition_and_cost_of_each(graph):
    twins = Pair(graph)
    twins.send([together(pair) for pair in of_twins(500)], 500, 500)

    def last(device):
        return next((each.status[0] for each in reversed(twins.reports) if each.status[0].hardware_id == device), None)

    def running(device):
        status = last(device)
        return status and float({entry.key: entry.value for entry in status.values}["rate [Hz]"]) > 0.0

    for device in ("left", "right"):
        graph.until(lambda device=device: running(device))
        status = last(device)
        assert status.name == f"estimator: {device} modulated_torque"
        values = {entry.key: entry.value for entry in status.values}
        assert float(values["time per sample [us]"]) > 0.0
        assert float(values["motion in the window [rad]"]) > 0.0 and float(values["condition number"]) >= 1.0
        assert {"gaps", "bad samples", "samples", "share of a core, whole process [%]"} <= values.keys()


def test_a_bank_publishes_every_method_and_prefixes_its_parameters(graph):
    file = Path(__file__).resolve().parent.parent / "via_bringup" / "config" / "arm.yaml"
    names = [f"j{k}=qbmove_a" for k in range(1, 5)]
    bank = graph.add(
        partial(EstimatorNode, BANK, cli_args=["--ros-args", "--params-file", str(file)]),
        devices=names,
        **{"j1.modulated_torque.window": 150},
    )
    topics = {name for name, _ in bank.get_publisher_names_and_types_by_node("estimator_bank", "/")}
    suited = methods_for(load_device("qbmove_a"))
    assert len(suited) > 1
    for pipeline in bank.pipelines:
        assert [channel.method for channel in pipeline.channels] == list(suited)
        assert all(f"/{pipeline.device.name}/{method}/stiffness" in topics for method in suited)
    first, last = (bank.pipelines[at].channels[suited.index("modulated_torque")].live.estimator for at in (0, 3))
    own = estimator_for(load_device("qbmove_a"), "modulated_torque").parameters.window
    assert (first.parameters.window, last.parameters.window) == (150, own) and own != 150
    assert last.parameters.memory == 5.0 != first.parameters.memory
    assert bank.describe_parameter("j4.signal_based.window").description


def test_each_device_gets_the_listed_methods_that_suit_it(graph):
    methods = ["signal_based", "modulated_torque", "link_impedance"]
    bank = graph.add(partial(EstimatorNode, BANK), devices=["cubic_demo", "maccepavd"], methods=methods)
    chosen = [[channel.method for channel in pipeline.channels] for pipeline in bank.pipelines]
    assert chosen == [["signal_based", "modulated_torque"], ["link_impedance"]]


def test_a_single_method_node_has_its_name_and_plain_topics(graph):
    node = graph.add(partial(EstimatorNode, single("signal_based")), device="cubic_demo", window=150)
    assert node.get_name() == "signal_based"
    assert node.pipelines[0].channels[0].live.estimator.parameters.window == 150
    assert graph.node("peer").count_publishers("/cubic_demo/stiffness") == 1
    assert not node.has_parameter("method")


@pytest.mark.parametrize(
    ("kind", "parameters", "complaint"),
    [
        (ESTIMATOR, {"devices": ["cubic_demo", "cubic_demo"]}, "device 'cubic_demo' is given twice"),
        (ESTIMATOR, {"device": "qbmove_b", "devices": ["qbmove_a"]}, "one device or several, not both"),
        (ESTIMATOR, {"devices": ["cubic_demo", "nobody"]}, "no device 'nobody'"),
        (ESTIMATOR, {"devices": ["cubic_demo", "maccepavd"], "method": "link_impedance"}, "none of .* 'cubic_demo'"),
        (BANK, {"methods": ["magic"]}, "no method 'magic'; there are: auto, modulated_torque"),
        (BANK, {"methods": ["link_impedance"]}, "'cubic_demo' is not driven by a position servo"),
        (BANK, {"devices": ["cubic_demo", "maccepavd"], "methods": ["modulated_torque"]}, "none of .* 'maccepavd'"),
        (BANK, {"devices": ["edinburgh_vsa"]}, "no estimator suits 'edinburgh_vsa'"),
        (BANK, {"cubic_demo.modulated_torque.window": 1}, r"parameter cubic_demo\.modulated_torque\.window"),
    ],
)
def test_invalid_parameters_raise(graph, kind, parameters, complaint):
    overrides = [parameter(name, value) for name, value in parameters.items()]
    with pytest.raises(ViaError, match=complaint):
        EstimatorNode(kind, context=graph.context, parameter_overrides=overrides)


def test_devices_that_share_a_joint_raise(graph, tmp_path):
    content = yaml.safe_load(load_device("cubic_demo").model_dump_json())
    path = tmp_path / "joint.yaml"
    path.write_text(yaml.safe_dump({**content, "wire": {"link": "elbow"}}))
    overrides = [parameter("devices", [f"left={path}", f"right={path}"])]
    with pytest.raises(ParameterError, match="devices 'left' and 'right' both have the joint 'elbow'"):
        EstimatorNode(context=graph.context, parameter_overrides=overrides)
