"""The gap monitor in a graph: it names what a simulated joint has, as a bag's diagnosis would, and says how it is."""

from __future__ import annotations

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.action import ActionClient
from rclpy.serialization import deserialize_message
from ros_messages import CommandWriter
from sensor_msgs.msg import JointState
from via_controllers.nodes.single import NODES
from via_core.bags.writer import BagWriter
from via_core.devices import load_device
from via_core.errors import ParameterError
from via_core.status import Status
from via_gap.design.proposal import with_proposal
from via_gap.diagnosis import diagnose
from via_gap.logs.log import read_log
from via_gap.nodes.monitor import MonitorNode
from via_interfaces.action import DiagnoseGap
from via_interfaces.msg import GapStatus, VsaCommand
from via_ros import qos
from via_ros.conversions import Command, JointStateWriter, nanoseconds
from via_sim.effects import Effect
from via_sim.effects.files import save_effects
from via_sim.nodes.simulator import SimulatorNode

DEVICE = load_device("cubic_demo")
FRICTION = Effect("coulomb_friction", "link", {"torque": 0.02})
START = 1_700_000_000_000_000_000  # [ns]
PERIOD = 1_000_000  # [ns]
RATE = 250.0  # [Hz] of simulated joints: a step in lockstep costs some milliseconds on a busy machine
JOINTS, COMMANDS = "sensor_msgs/msg/JointState", "via_interfaces/msg/VsaCommand"


class MonitorBench:
    """The monitor with ears on all it says, a client of its action, and somebody who can play the robot."""

    def __init__(self, graph, **parameters):
        self.graph, self.peer = graph, graph.node("peer")
        self.node = graph.add(MonitorNode, device=DEVICE.name, **parameters)
        self.gaps, self.reports, self.feedback = [], [], []
        self.peer.create_subscription(GapStatus, f"/{DEVICE.name}/gap", self.gaps.append, qos.SAMPLES)
        self.peer.create_subscription(DiagnosticArray, "/diagnostics", self._hear, qos.SAMPLES)
        self.client = ActionClient(self.peer, DiagnoseGap, "/gap_monitor/diagnose")
        self.samples = self.peer.create_publisher(JointState, "/joint_states", qos.SAMPLES)
        self.commands = self.peer.create_publisher(VsaCommand, DEVICE.command_topic, qos.SAMPLES)
        graph.until(lambda: self.client.server_is_ready() and self.gaps and self.samples.get_subscription_count() == 1)

    def _hear(self, message):
        if message.status[0].name.startswith("gap_monitor"):
            self.reports.append({each.key: each.value for each in message.status[0].values})

    def send(self, **goal):
        """Send a goal; its handle once the server has answered."""
        asked = self.client.send_goal_async(
            DiagnoseGap.Goal(**goal), feedback_callback=lambda message: self.feedback.append(message.feedback)
        )
        self.graph.until(asked.done)
        return asked.result()

    def result(self, handle):
        """(status, result) of a goal."""
        asked = handle.get_result_async()
        self.graph.until(asked.done)
        return asked.result().status, asked.result().result

    def play(self, count, start=START):
        """Samples and commands of a made-up motion at 1 kHz."""
        writer, commander = JointStateWriter(DEVICE), CommandWriter(DEVICE)
        already = self.node.monitor.samples
        for k in range(count):
            t, stamp = 1e-3 * k, start + PERIOD * k
            writer.position[:] = 0.3 * np.sin(5.0 * t), 0.5 + 0.1 * np.sin(9.0 * t), -0.5 + 0.2 * np.cos(7.0 * t)
            writer.effort[1:] = 0.4 * np.sin(4.0 * t), 0.3 * np.cos(6.0 * t)
            torques = Command(VsaCommand.MOTOR_TORQUE, 0.0, 0.0, 0.0, np.array(writer.effort[1:]))
            self.commands.publish(commander.numbered(stamp, torques))
            self.samples.publish(writer.stamped(stamp))
            if k % 200 == 199:
                self.graph.until(lambda k=k: self.node.monitor.samples >= already + k - 100)
        self.graph.until(lambda: self.node.monitor.samples == already + count)


def simulate(graph, bench, folder, duration, effects=()):
    """A simulated joint with its controller, `duration` [s] in lockstep, recorded into a bag; the path of the bag."""
    save_effects(folder / "effects.yaml", effects)
    heard = []
    for kind, topic in ((JointState, "/joint_states"), (VsaCommand, DEVICE.command_topic)):
        bench.peer.create_subscription(
            kind, topic, lambda data, topic=topic: heard.append((topic, data)), qos.SAMPLES, raw=True
        )
    graph.add(NODES["excitation"], device=DEVICE.name)
    simulator = graph.add(
        SimulatorNode, device=DEVICE.name, mode="lockstep", rate=RATE, duration=duration, listeners=3,
        effects=str(folder / "effects.yaml"),
    )  # fmt: skip
    count = round(duration * RATE) + 1

    def all_heard():
        """By the monitor and by the bag: every sample, those said again included, and every command."""
        samples = sum(topic == "/joint_states" for topic, _ in heard)
        received = len(bench.node.monitor.rolling._commands.stamp)
        last = next((data for topic, data in reversed(heard) if topic != "/joint_states"), None)
        # The controller's last word, when samples end, is none but zeros.
        return (
            simulator.finished.done()
            and bench.node.monitor.samples == samples >= count
            and received == len(heard) - samples
            and not any(deserialize_message(last, VsaCommand).motor)
        )

    graph.until(all_heard)
    with BagWriter(folder / "live") as out:
        out.add_topic("/joint_states", JOINTS)
        out.add_topic(DEVICE.command_topic, COMMANDS)
        for topic, data in heard:
            kind = JointState if topic == "/joint_states" else VsaCommand
            out.write(topic, data, log_time=nanoseconds(deserialize_message(data, kind).header.stamp))
    return folder / "live"


def test_friction_of_a_simulated_joint_is_named_and_the_report_is_that_of_a_bag(graph, tmp_path):
    bench = MonitorBench(graph, window=30.0, every=0.0)
    bag = simulate(graph, bench, tmp_path, 6.0, (FRICTION,))
    live = [each for each in bench.gaps if each.status == Status.OK]
    assert live[-1].sites[0].site == "link" and live[-1].residual_ratio > 2.0 and live[-1].hypotheses == []
    # First here, where what is not yet compiled is compiled at full speed.
    expected = with_proposal(diagnose([read_log(bag, DEVICE)], DEVICE), DEVICE).to_json()
    status, result = bench.result(bench.send())
    assert (status, result.success, result.verdict) == (GoalStatus.STATUS_SUCCEEDED, True, "effect"), result.message
    cause = result.hypotheses[0]
    assert (cause.effect.name, cause.effect.site, cause.identifiable) == ("coulomb_friction", "link", True)
    assert cause.effect.parameter_values[0] == pytest.approx(0.02, rel=0.1) and cause.probability > 0.9
    assert result.sites[0].site == "link" and result.gap_after < 0.2 * result.gap_before and result.explained > 0.9
    shares = [each.share for each in bench.feedback]
    assert shares == sorted(shares) and len(shares) > 5 and bench.feedback[-1].doing
    assert result.report == expected
    # The same from the file, and from then on in every message.
    status, again = bench.result(bench.send(path=str(bag)))
    assert again.report == result.report
    before = len(bench.gaps)
    graph.until(lambda: len(bench.gaps) > before + 1)
    last = bench.gaps[-1]
    assert (last.verdict, last.hypotheses[0].effect.name) == ("effect", "coulomb_friction")
    assert nanoseconds(last.diagnosed) == nanoseconds(last.header.stamp)
    assert last.status == Status.BAD_SAMPLE and "no samples for" in last.message  # the simulation is over
    numbers = [each.sequence for each in bench.gaps]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))


def test_a_nominal_joint_has_no_gap_and_ticks_go_on_while_that_is_found_out(graph, tmp_path):
    bench = MonitorBench(graph, window=8.0, least=3.0, recent=1.0)
    simulate(graph, bench, tmp_path, 5.0)
    graph.until(lambda: bench.gaps[-1].verdict != "")
    assert bench.gaps[-1].verdict == "no_gap" and bench.gaps[-1].hypotheses == []
    assert bench.gaps[-1].method == "tuned model"
    assert sum(bool(each["diagnosing"]) for each in bench.reports) > 3
    assert [each.residual_ratio for each in bench.gaps if each.status == Status.OK][-1] < 1.5


def test_one_goal_at_a_time_which_can_be_cancelled(graph, tmp_path):
    bench = MonitorBench(graph, every=0.0)
    status, result = bench.result(bench.send())
    assert (status, result.success) == (GoalStatus.STATUS_ABORTED, False)
    assert "no samples of 'cubic_demo' yet" in result.message and np.isnan(result.gap_before)
    bench.play(3000)
    for goal, reason in (
        ({"seconds": 100.0}, "seconds must lie in [0, 20], got 100"),
        ({"seconds": -1.0}, "seconds must lie in [0, 20], got -1"),
        ({"seconds": float("nan")}, "got nan"),
        ({"path": str(tmp_path / "none.csv")}, "cannot be read"),
        ({"path": "x", "seconds": 1.0}, "seconds must be 0 with a path"),
    ):
        status, result = bench.result(bench.send(**goal))
        assert status == GoalStatus.STATUS_ABORTED and reason in result.message
    bench.feedback.clear()
    first = bench.send(seconds=2.5)
    assert first.accepted
    graph.until(lambda: len(bench.feedback) > 0)
    assert not bench.send().accepted
    graph.until(lambda: "one at a time" in bench.reports[-1]["refused goal"])
    process = bench.node.monitor.worker.pid
    first.cancel_goal_async()
    status, result = bench.result(first)
    assert (status, result.success, result.message) == (GoalStatus.STATUS_CANCELED, False, "cancelled")
    assert process is not None and bench.node.monitor.worker.pid is None
    again = bench.send(seconds=2.5)
    assert again.accepted
    bench.feedback.clear()
    graph.until(lambda: len(bench.feedback) > 0)
    graph.remove(bench.node)  # a node that is closed in the middle leaves no process
    assert bench.node.monitor.worker.pid is None


def test_it_says_when_it_does_not_know_and_a_clock_set_back_begins_anew(graph):
    bench = MonitorBench(graph, every=0.0)
    assert bench.gaps[-1].status == Status.WARMING_UP and "no samples yet" in bench.gaps[-1].message
    assert np.isnan(bench.gaps[-1].error) and nanoseconds(bench.gaps[-1].header.stamp) == 0
    bench.samples.publish(JointState(name=["other"], position=[0.0]))
    graph.until(lambda: "others only" in bench.gaps[-1].message)
    bench.play(1000)
    graph.until(lambda: any("warming up" in each.message for each in bench.gaps))
    bench.play(1500, START + 1000 * PERIOD)
    graph.until(lambda: any(each.status == Status.OK for each in bench.gaps))
    seen = next(each for each in bench.gaps if each.status == Status.OK)
    assert seen.error > 0.0 and seen.sites and seen.window == pytest.approx(2.0)
    graph.until(lambda: bench.gaps[-1].status == Status.BAD_SAMPLE and "no samples for" in bench.gaps[-1].message)
    bench.play(500, START - 100_000 * PERIOD)
    graph.until(lambda: "the clock ran back" in bench.gaps[-1].message)
    assert bench.gaps[-1].status == Status.WARMING_UP and np.isnan(bench.gaps[-1].residual_ratio)
    graph.until(lambda: bench.reports[-1]["clock ran back"] == "1")


def test_wrong_parameters_are_refused_with_the_reason(graph):
    with pytest.raises(ParameterError, match="recent must lie in"):
        graph.add(MonitorNode, recent=5.0, window=3.0)
    with pytest.raises(ParameterError, match="rate must lie in"):
        graph.add(MonitorNode, rate=1000.0)
