"""Bad input to live nodes: they keep running, publish no NaN, and report skipped input in /diagnostics."""

from __future__ import annotations

import os
import resource
import subprocess
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from mcap.writer import Writer
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from via_controllers.nodes.single import NODES
from via_core.bags.definitions import definition_of
from via_core.bags.reader import read_bag
from via_core.bags.writer import BagWriter
from via_core.devices import load_device
from via_core.errors import BagError, ParameterError
from via_estimators.nodes.estimator import EstimatorNode
from via_estimators.nodes.pipeline import DevicePipeline
from via_interfaces.msg import DampingEstimate, StiffnessEstimate, VsaCommand
from via_ros import qos
from via_ros.conversions import RowReader, set_stamp
from via_ros.nodes.player import Player
from via_ros.nodes.recorder import Recorder
from via_sim.nodes.simulator import SimulatorNode

DEVICE = load_device("cubic_aa_vsa")
SERVO = load_device("maccepavd")
SAMPLES, STIFFNESS = "/joint_states", f"/{DEVICE.name}/stiffness"
NAMES = [DEVICE.link_joint, *DEVICE.motor_joints]
PERIOD = 1_000_000  # [ns]


class Peer:
    """Publishes to the node under test and receives its diagnostics."""

    def __init__(self, graph):
        self.graph, self.node, self.reports = graph, graph.node("peer"), []
        self.samples = self.node.create_publisher(JointState, SAMPLES, qos.SAMPLES)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self.reports.append, qos.CONTROL)

    def hear(self, kind, topic):
        heard = []
        self.node.create_subscription(kind, topic, heard.append, qos.SAMPLES)
        return heard

    def reported(self, key):
        """The last value of `key` in the diagnostics, None before the first."""
        values = [each.value for report in self.reports for each in report.status[0].values if each.key == key]
        return values[-1] if values else None


def sample(tick, positions=(0.1, 0.2, -0.2), efforts=(np.nan, 1.0, -1.0), names=NAMES):
    message = JointState(name=list(names), position=[float(x) for x in positions], effort=[float(x) for x in efforts])
    set_stamp(message.header.stamp, tick * PERIOD)
    return message


def nonsense():
    """Impossible samples with the stamps of the next ones."""
    yield sample(10, positions=(np.nan, 0.2, -0.2))
    yield sample(11, positions=(0.1, np.inf, -0.2))
    yield sample(12, positions=(0.1, 1e308, -1e308))
    yield sample(13, efforts=())
    yield sample(14, positions=(), efforts=())
    yield sample(15, positions=(0.1,))
    yield sample(16, names=[*NAMES, *NAMES], positions=(0.1,) * 6)
    yield sample(9)  # repeated
    yield sample(3)  # backward
    yield sample(17, names=())
    yield sample(18, names=("a_wheel", "another_wheel"), positions=(1.0, 2.0), efforts=())
    yield sample(19, efforts=(np.nan, 1e308, -1e308))
    early = sample(20)
    early.header.stamp.sec = -(2**31)
    yield early
    late = sample(21)
    late.header.stamp.sec, late.header.stamp.nanosec = 2**31 - 1, 2**32 - 1
    yield late


def test_the_estimator_survives_and_counts_invalid_input(graph):
    peer = Peer(graph)
    graph.add(EstimatorNode, device=DEVICE.name)
    heard = peer.hear(StiffnessEstimate, STIFFNESS)
    graph.until(lambda: peer.samples.get_subscription_count() == 1 and peer.node.count_publishers(STIFFNESS) == 1)
    stream = [*map(sample, range(10)), *nonsense(), *(sample(tick) for tick in range(22, 40))]
    for message in stream:
        peer.samples.publish(message)
    about = [message for message in stream if DEVICE.link_joint in message.name]
    graph.until(lambda: len(heard) == len(about))
    for message in heard:
        numbers = [message.value, message.standard_deviation, *message.transmission_value]
        assert np.all(np.isfinite([*numbers, *message.transmission_standard_deviation]))
    # The strange stamps are jumps of the clock: windows that restart, not bad samples.
    graph.until(lambda: peer.reported("samples") == "30")
    malformed = int(peer.reported("malformed messages"))
    for junk in (b"", b"\0\1\0\0", b"junk of no kind at all", serialize_message(sample(41))[:60]):
        peer.samples.publish(junk)
    graph.until(lambda: peer.reported("malformed messages") == str(malformed + 4))
    assert int(peer.reported("bad samples")) == len(about) - 30
    assert peer.reported("foreign messages") == "2"
    assert int(peer.reported("malformed messages")) > 0


def command(tick, equilibrium=0.1, preset=0.5, damping=0.5):
    message = VsaCommand(equilibrium=equilibrium, preset=preset, damping=damping)
    set_stamp(message.header.stamp, tick * PERIOD)
    return message


def test_a_command_from_the_far_future_does_not_block_the_next(graph):
    peer = Peer(graph)
    node = graph.add(EstimatorNode, device=SERVO.name)
    commands = peer.node.create_publisher(VsaCommand, SERVO.command_topic, qos.SAMPLES)
    heard = peer.hear(DampingEstimate, f"/{SERVO.name}/damping")
    graph.until(lambda: commands.get_subscription_count() == 1 and peer.samples.get_subscription_count() == 1)
    far = command(0, damping=1.0)
    far.header.stamp.sec = 2**31 - 1
    for message in (far, command(1, damping=np.nan), command(1, equilibrium=1e308), command(0, damping=0.25)):
        commands.publish(message)
    graph.until(lambda: len(node.pipelines[0].pending) == 3)
    names = [SERVO.link_joint, *SERVO.motor_joints]
    peer.samples.publish(sample(0, names=names, positions=[0.0] * len(names), efforts=()))
    graph.until(lambda: len(heard) == 1)
    assert [each.header.stamp.sec for each in node.pipelines[0].pending] == [0, 2**31 - 1]
    graph.until(lambda: peer.reported("refused commands") == "1")


def test_commands_of_a_bag_that_is_played_again_are_not_late():
    columns = ("q", "equilibrium")
    channel = SimpleNamespace(device=SERVO, live=SimpleNamespace(estimator=SimpleNamespace(inputs=columns)))
    reader = RowReader([(SERVO, columns)])
    pipeline = DevicePipeline([channel], [0], reader)
    for tick in (1, 9, 1, 2):
        pipeline.hold(command(tick, equilibrium=0.1 * tick))
        pipeline.reach(tick * PERIOD)
        assert reader.rows[0][0, 2] == 0.1 * tick
    assert pipeline._late == 1  # the first one after the jump, before a sample has shown it


def test_commands_without_a_later_sample_are_discarded(graph, monkeypatch):
    monkeypatch.setattr("via_estimators.nodes.pipeline.MOST_PENDING", 3)
    peer = Peer(graph)
    node = graph.add(EstimatorNode, device=SERVO.name)
    commands = peer.node.create_publisher(VsaCommand, SERVO.command_topic, qos.SAMPLES)
    graph.until(lambda: commands.get_subscription_count() == 1)
    for tick in (5, 4, 3, 2, 1):
        commands.publish(command(tick))
    graph.until(lambda: peer.reported("refused commands") == "2")
    assert [each.header.stamp.nanosec for each in node.pipelines[0].pending] == [PERIOD, 2 * PERIOD, 3 * PERIOD]


def test_excitation_answers_invalid_samples_with_zero_torque_and_recovers(graph):
    peer = Peer(graph)
    graph.add(NODES["excitation"], device=DEVICE.name)
    heard = peer.hear(VsaCommand, DEVICE.command_topic)
    graph.until(lambda: peer.samples.get_subscription_count() == 1 and peer.node.count_publishers(DEVICE.command_topic))
    good = [sample(tick) for tick in range(22, 30)]
    answers = {}
    for message in [sample(0), *list(nonsense())[:6], *good]:
        count = len(heard)
        peer.samples.publish(message)
        graph.until(lambda: heard[count:] and heard[-1].header.stamp == message.header.stamp)  # noqa: B023
        answers[message.header.stamp.nanosec // PERIOD] = list(heard[count].motor)
    assert np.all(np.isfinite(list(answers.values())))
    assert {tick for tick, torque in answers.items() if not any(torque)} == {10, 11, 12, 14, 15}
    assert all(all(answers[tick]) for tick in range(22, 30))  # a number beyond all numbers is not remembered
    graph.until(lambda: peer.reported("unusable samples") == "5")


def test_simulator_refuses_a_duration_below_one_tick(graph):
    with pytest.raises(ParameterError, match=r"at least a tick of 0\.001 s"):
        graph.add(SimulatorNode, device=DEVICE.name, mode="free", duration=1e-9)


@pytest.mark.parametrize("name", [SERVO.name, DEVICE.name])
def test_simulator_stays_finite_under_huge_commands(graph, name):
    device = load_device(name)
    peer = Peer(graph)
    heard = peer.hear(JointState, SAMPLES)
    commands = peer.node.create_publisher(VsaCommand, device.command_topic, qos.SAMPLES)
    graph.add(SimulatorNode, device=name, mode="lockstep", listeners=1)
    graph.until(lambda: len(heard) == 1)
    for size in (1e308, -1e308, 1e200, 1e16, -1e9):
        message = VsaCommand(mode=VsaCommand.MOTOR_POSITION if device.drive == "servo" else VsaCommand.MOTOR_TORQUE)
        message.motor = [size, -size]
        message.damping = abs(size)
        message.header.stamp = heard[-1].header.stamp
        count = len(heard)
        commands.publish(message)
        graph.until(lambda: len(heard) > count)  # noqa: B023
        assert np.all(np.isfinite(heard[-1].position))


def test_recorder_skips_and_counts_invalid_messages(graph, tmp_path):
    peer = Peer(graph)
    recorder = graph.add(
        Recorder, bag=str(tmp_path / "bag"), topics=[f"{STIFFNESS}:via_interfaces/msg/StiffnessEstimate"]
    )
    publisher = peer.node.create_publisher(StiffnessEstimate, STIFFNESS, qos.SAMPLES)
    graph.until(lambda: publisher.get_subscription_count() == 1)
    whole = serialize_message(StiffnessEstimate(sequence=7))
    for data in (whole, b"\0\1\0\0", whole[:14], whole[:18], whole[:12] + b"\xff" * 4 + whole[16:], whole):
        publisher.publish(data)
    graph.until(lambda: recorder.counts[STIFFNESS].messages == 2)
    graph.until(lambda: peer.reported("malformed") == "4")
    graph.remove(recorder)
    bag = read_bag(tmp_path / "bag")
    assert bag.complete
    assert list(bag[STIFFNESS]["sequence"]) == [7, 7]


def played(graph, bag, **parameters):
    return graph.add(Player, bag=str(bag), subscribers=0, rate=0.0, **parameters)


@pytest.fixture
def bag(tmp_path):
    with BagWriter(tmp_path / "bag") as out:
        out.add_topic(SAMPLES, "sensor_msgs/msg/JointState")
        for tick in range(10):
            out.write(SAMPLES, serialize_message(sample(tick)), log_time=tick)
    return tmp_path / "bag"


def foreign(path, topic=SAMPLES, offered="", time=1):
    """A bag of one message by another writer."""
    definition = definition_of("std_msgs/msg/String")
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", definition.text.encode())
        channel = writer.register_channel(topic, "cdr", schema, {"offered_qos_profiles": offered})
        writer.add_message(channel, time, serialize_message(String(data="a")), time)
        writer.finish()
    return path


@pytest.mark.parametrize("depth", ["99999999999999999999", "4294967295", ".inf", "2020-13-45"])
def test_player_accepts_any_qos_depth(graph, tmp_path, depth):
    player = played(graph, foreign(tmp_path / "a.mcap", offered=f"- depth: {depth}"))
    graph.until(player.finished.done)
    assert (player.finished.result(), player.played) == (0, 1)


@pytest.mark.parametrize("time", [2**62, 2**31 * 10**9])
def test_player_refuses_stamps_outside_the_range_of_the_clock(graph, tmp_path, time):
    with pytest.raises(BagError, match=str(time)):
        played(graph, foreign(tmp_path / "a.mcap", time=time))


def test_player_plays_stamps_before_zero_without_a_clock(graph, tmp_path):
    player = played(graph, foreign(tmp_path / "a.mcap", time=2**64 - 5))
    graph.until(player.finished.done)
    assert (player.finished.result(), player.played) == (0, 1)


def test_player_refuses_a_rate_too_small_to_play(graph, bag):
    with pytest.raises(ParameterError, match="rate must be 0 or at least"):
        graph.add(Player, bag=str(bag), rate=1e-308)


def executable(name):
    prefixes = [Path(prefix) for prefix in os.environ["AMENT_PREFIX_PATH"].split(os.pathsep)]
    return next(path for prefix in prefixes if (path := prefix / "lib" / "via_ros" / name).is_file())


def ended(name, *parameters, folder, environment=(), **options):
    """Output of a node of via_ros that ends by itself."""
    words = [word for each in parameters for word in ("-p", each)]
    return subprocess.run(
        [executable(name), "--ros-args", *words],
        cwd=folder, env={**os.environ, **dict(environment)}, capture_output=True, text=True, timeout=600, check=False,
        **options,
    )  # fmt: skip


def complaints(errors):
    """Lines of a node's standard error without those that say what it does."""
    return [line for line in errors.strip().splitlines() if not line.startswith(("[INFO]", "[WARN]"))]


@pytest.mark.parametrize(
    ("name", "parameters", "environment", "complaint"),
    [
        ("recorder", ("bag:=new", "topics:=['/bad topic']"), {}, "topic name must not contain"),
        ("recorder", ("bag:=new", "topics:=['/a:std_msgs/msg/_string']"), {}, "std_msgs/msg/_string is not installed"),
        ("recorder", ("bag:=new", "executor:=5"), {}, "executor"),
        ("recorder", ("bag:=new",), {"ROS_DOMAIN_ID": "nonsense"}, "ROS_DOMAIN_ID is not an integral number"),
        ("recorder", ("bag:=new",), {"ROS_DOMAIN_ID": "99999"}, "ROS_DOMAIN_ID must lie in [0, 232], got 99999"),
        ("recorder", ("bag:=new",), {"ROS_LOG_DIR": "/dev/null/x"}, "log directory"),
        ("player", ("bag:=bad_topic.mcap",), {}, "Invalid topic name"),
    ],
)
def test_errors_of_ros_give_one_line_and_an_exit_code(domain, tmp_path, name, parameters, environment, complaint):
    foreign(tmp_path / "bad_topic.mcap", topic="/bad topic//x")
    done = ended(name, *parameters, folder=tmp_path, environment=environment)
    assert done.returncode == 2, done.stderr
    assert complaint in done.stderr
    assert len(complaints(done.stderr)) == 1, done.stderr
    assert not list(tmp_path.rglob("*_0.mcap")) and not list(tmp_path.rglob("metadata.yaml"))


def test_a_recorder_on_a_full_disk_fails_and_leaves_no_finished_bag(graph, tmp_path):
    publisher = graph.node("robot").create_publisher(String, "/text", qos.SAMPLES)
    process = subprocess.Popen(
        [executable("recorder"), "--ros-args", "-p", "bag:=new", "-p", "topics:=['/text:std_msgs/msg/String']"],
        cwd=tmp_path, stderr=subprocess.PIPE, text=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000)),
    )  # fmt: skip
    rng = np.random.default_rng(0)

    def over():
        if publisher.get_subscription_count():
            publisher.publish(String(data=rng.bytes(20_000).hex()))
        return process.poll() is not None

    try:
        graph.until(over)
    finally:
        process.kill()
    errors = process.communicate()[1]
    assert process.returncode == 2
    lines = complaints(errors)
    assert len(lines) == 1, errors
    assert "cannot write the bag new: File too large" in lines[0]
    assert [file.name for file in (tmp_path / "new").iterdir()] == ["new_0.mcap.active"]


def test_without_a_home_the_logs_go_to_a_writable_folder(domain, tmp_path):
    environment = {key: value for key, value in os.environ.items() if key not in ("HOME", "ROS_LOG_DIR")}
    done = subprocess.run(
        [executable("player"), "--ros-args", "-p", "bag:=nowhere"],
        cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=600, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stderr.strip()) == (2, "error: no bag at nowhere")
