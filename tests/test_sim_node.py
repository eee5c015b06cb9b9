"""The simulator node in a ROS graph: lockstep, effects by service, invalid commands, end of the run."""

from __future__ import annotations

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.serialization import serialize_message
from ros_messages import CommandWriter
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from via_core.bags.writer import BagWriter
from via_core.devices import load_device
from via_core.errors import ParameterError
from via_core.signals import Signals
from via_core.wire import JOINT_STATE, VSA_COMMAND
from via_gap.diagnosis import diagnose
from via_gap.logs.log import read_log
from via_interfaces.msg import Effect as EffectMessage
from via_interfaces.msg import StiffnessEstimate, VsaCommand
from via_interfaces.srv import ClearEffects, SetEffects
from via_ros import qos
from via_ros.conversions import Command, nanoseconds
from via_sim.effects import Effect
from via_sim.effects.files import save_effects
from via_sim.joint.parameters import P
from via_sim.nodes.simulation import EPOCH
from via_sim.nodes.simulator import SimulatorNode
from via_sim.plants import JointPlant
from via_sim.sensors import Sensors
from via_sim.simulate import InitialConditions, simulate

PERIOD = 1_000_000  # [ns]


class SimulatorBench:
    """The node under test with a publisher of commands and subscribers of all its topics."""

    def __init__(self, graph, **parameters):
        self.graph = graph
        self.device = load_device(parameters["device"])
        self.peer = graph.node("peer")
        self.samples, self.clocks, self.reports, self.truths = [], [], [], []
        self.answers = None  # (tick) -> motor torques, or None for silence
        self.writer = CommandWriter(self.device)
        self.commands = self.peer.create_publisher(VsaCommand, self.device.command_topic, qos.CONTROL)
        self.peer.create_subscription(JointState, "/joint_states", self._hear, qos.SAMPLES)
        self.peer.create_subscription(Clock, "/clock", self._tell_time, qos.SAMPLES)
        self.peer.create_subscription(DiagnosticArray, "/diagnostics", self.reports.append, qos.CONTROL)
        truth = f"/{self.device.name}/truth/stiffness"
        self.peer.create_subscription(StiffnessEstimate, truth, self.truths.append, qos.SAMPLES)
        self.node = graph.add(SimulatorNode, **parameters)
        self.set = self.peer.create_client(SetEffects, "/simulator/set_effects")
        self.clear = self.peer.create_client(ClearEffects, "/simulator/clear_effects")
        graph.until(lambda: self.set.service_is_ready() and self.clear.service_is_ready())

    def _hear(self, message):
        stamp = nanoseconds(message.header.stamp)
        self.samples.append((stamp, list(message.position), list(message.effort)))
        if self.answers is not None:
            torques = self.answers(len(self.samples) - 1)
            if torques is not None:
                self.send(stamp, torques)

    def _tell_time(self, message):
        self.clocks.append(nanoseconds(message.clock))

    def send(self, stamp, torques):
        command = Command(VsaCommand.MOTOR_TORQUE, 0.0, 0.0, 0.0, np.asarray(torques, dtype=float))
        self.commands.publish(self.writer.numbered(stamp, command))

    def reported(self, key):
        """Values of a key in all diagnostics so far."""
        return [e.value for report in self.reports for e in report.status[0].values if e.key == key]

    def call(self, client, request):
        answer = client.call_async(request)
        self.graph.until(answer.done)
        return answer.result()

    @property
    def angles(self):
        return np.array([position for _, position, _ in self.samples])


def excitation(tick):
    t = 1e-3 * tick
    return 5.0 * np.sin(9.0 * t), -4.0 * np.sin(7.0 * t)


def expected(device, ticks, effects=()):
    """The same run without ROS."""
    t = np.arange(ticks) / 1000.0
    motor = np.array([excitation(tick) for tick in range(ticks)])
    held = Signals(t, {"motor": motor}, {"motor": "N m"}, frozenset({"motor"}))
    plant = JointPlant.from_device(device)
    run = simulate(
        plant.with_effects(effects), held, ticks / 1000.0, 1000.0, Sensors.of_device(device), InitialConditions(seed=4)
    )
    return np.column_stack([run.measured["q"], run.measured["theta"]]), run


def test_lockstep_gives_the_bits_of_the_batch_and_ends_after_its_duration(graph):
    bench = SimulatorBench(graph, device="cubic_aa_vsa", mode="lockstep", seed=4, duration=0.5, truth=True)
    bench.answers = excitation
    graph.until(lambda: bench.node.finished.done() and len(bench.samples) == 501 and len(bench.truths) == 501)
    angles, run = expected(bench.device, 500)
    np.testing.assert_array_equal(bench.angles, angles)
    assert np.ptp(angles[:, 1]) > 0.1
    assert [stamp for stamp, _, _ in bench.samples] == [EPOCH + PERIOD * tick for tick in range(501)]
    np.testing.assert_array_equal([e[1:] for _, _, e in bench.samples], run.measured["tau"])
    assert all(np.isnan(e[0]) for _, _, e in bench.samples)  # no torque sensor at the link: unknown, not zero
    np.testing.assert_array_equal([m.value for m in bench.truths], run.truth["stiffness"])
    assert [m.sequence for m in bench.truths] == list(range(501))
    assert {m.method for m in bench.truths} == {"truth"}
    graph.until(lambda: bench.node.round_trips.count == 501)  # the last sample is answered too
    graph.until(lambda: bench.reported("round trip, 99 % [ms]")[-1:] not in ([], ["nan"]))
    graph.until(lambda: len(bench.clocks) == 501)
    assert bench.clocks == [stamp for stamp, _, _ in bench.samples]


def test_lockstep_waits_for_the_command_of_its_last_sample(graph):
    bench = SimulatorBench(graph, device="cubic_demo", mode="lockstep")
    graph.until(lambda: len(bench.samples) == 1)
    bench.send(EPOCH + 5, (1.0, 1.0))  # stamp of no sample
    bench.send(EPOCH - PERIOD, (1.0, 1.0))
    graph.until(lambda: any(value == "2" for value in bench.reported("unmatched commands")))
    assert len({stamp for stamp, _, _ in bench.samples}) == 1
    bench.send(EPOCH, (1.0, 1.0))
    graph.until(lambda: bench.samples[-1][0] == EPOCH + PERIOD)


def test_effects_change_by_service_during_a_run(graph):
    bench = SimulatorBench(graph, device="cubic_aa_vsa", mode="lockstep", seed=4)
    bench.answers = lambda tick: excitation(tick) if tick < 100 else None
    graph.until(lambda: len(bench.samples) == 101)
    stuck = EffectMessage(
        name="coulomb_friction", site="motor", motor=1, parameter_names=["torque"], parameter_values=[500.0]
    )
    answer = bench.call(bench.set, SetEffects.Request(effects=[stuck]))
    assert answer.success and answer.message == "coulomb_friction at motor 1"
    bench.answers = lambda tick: excitation(tick) if tick < 200 else None
    bench.send(bench.samples[-1][0], excitation(100))
    graph.until(lambda: len(bench.samples) == 201)
    held = bench.angles[110:201, 1]
    assert np.all(held == held[0])  # the motor that stuck
    assert np.ptp(bench.angles[110:201, 2]) > 0.0  # the one that did not
    assert bench.call(bench.clear, ClearEffects.Request()).message == "nominal model"
    bench.answers = lambda tick: excitation(tick) if tick < 300 else None
    bench.send(bench.samples[-1][0], excitation(200))
    graph.until(lambda: len(bench.samples) == 301)
    assert np.ptp(bench.angles[210:, 1]) > 0.0


@pytest.mark.parametrize(
    ("effect", "message"),
    [
        (EffectMessage(name="rust", site="motor"), "must be one of coulomb_friction"),
        (
            EffectMessage(
                name="backlash", site="transmission", motor=1, parameter_names=["gap"], parameter_values=[3.0]
            ),
            "backlash.gap: must be 0 to 0.5 rad, got 3.0",
        ),
        (
            EffectMessage(name="backlash", site="transmission", motor=1, parameter_names=["gap"]),
            "1 parameter names for 0",
        ),
        (
            EffectMessage(
                name="coulomb_friction", site="link", joint="other", parameter_names=["torque"], parameter_values=[1.0]
            ),
            "joint is 'other'",
        ),
    ],
)
def test_invalid_effects_are_refused_and_change_nothing(graph, effect, message):
    bench = SimulatorBench(graph, device="cubic_demo", mode="lockstep")
    answer = bench.call(bench.set, SetEffects.Request(effects=[effect]))
    assert not answer.success and message in answer.message and "\n" not in answer.message
    assert bench.node._effects.active == "nominal model"


def test_realtime_with_effects_file_until_the_watchdog_acts(graph, tmp_path):
    heavier = Effect("device_numbers", "device", {"link inertia": 1.5})
    save_effects(tmp_path / "effects.yaml", [Effect("torque_gain", "motor", {"gain": 0.0}, 2), heavier])
    effects = str(tmp_path / "effects.yaml")
    bench = SimulatorBench(graph, device="cubic_aa_vsa", mode="realtime", rate=200.0, effects=effects)
    assert bench.node._simulator.plant.parameters[P.inertia] == 1.5 * bench.node.device.link.inertia
    bench.answers = lambda _: (5.0, 5.0)
    graph.until(lambda: len(bench.samples) > 60 and bench.samples[-1][2][1] == 5.0)
    stamps = np.array([stamp for stamp, _, _ in bench.samples])
    assert np.all(np.diff(stamps) > 0)
    assert np.count_nonzero(np.diff(stamps) == 5_000_000) > 0.9 * (len(stamps) - 1)
    moved = np.ptp(bench.angles, axis=0)
    assert moved[1] > 0.05 and moved[2] < 0.2 * moved[1]  # the second motor has lost its torque
    bench.answers = None
    graph.until(lambda: bench.samples[-1][2][1] == 0.0)  # after the watchdog time
    graph.until(lambda: any("passive" in report.status[0].message for report in bench.reports))
    assert bench.clocks == []


def test_command_acts_for_20_ms_after_its_sample_even_if_repeated(graph):
    """By stamps: a late message of a dead controller does not extend the validity of its command."""
    bench = SimulatorBench(graph, device="cubic_aa_vsa", mode="realtime", rate=200.0)
    asked = []

    def repeat(_):
        asked[:] = asked or [bench.samples[-1][0]]
        bench.send(asked[0], (5.0, 5.0))

    bench.answers = repeat
    graph.until(lambda: bench.samples and bench.samples[-1][0] > asked[0] + 100 * PERIOD)
    driven = [stamp - asked[0] for stamp, _, effort in bench.samples if effort[1] != 0.0]
    assert driven and max(driven) <= 20 * PERIOD


def test_invalid_commands_are_ignored_and_counted(graph):
    bench = SimulatorBench(graph, device="cubic_aa_vsa", mode="lockstep")
    graph.until(lambda: len(bench.samples) >= 1)
    for torques in ((np.nan, 0.0), (0.0, np.inf), (1.0,), (1.0, 2.0, 3.0)):
        bench.send(EPOCH, torques)
    message = bench.writer.numbered(EPOCH, Command(VsaCommand.EQUILIBRIUM_PRESET, 0.1, 0.2, 0.0, np.empty(0)))
    bench.commands.publish(message)  # this device has no position servos
    message = bench.writer.numbered(EPOCH, Command(17, 0.1, 0.2, 0.0, np.empty(0)))
    bench.commands.publish(message)
    bench.commands.publish(serialize_message(message)[:40])
    graph.until(lambda: any(value == "7" for value in bench.reported("refused commands")))
    assert {stamp for stamp, _, _ in bench.samples} == {EPOCH}
    bench.send(EPOCH, (1e308, -1e308))  # finite, but the state overflows
    graph.until(lambda: any(value == "1" for value in bench.reported("numerical failures")))
    assert bench.samples[-1][0] == EPOCH + PERIOD
    assert np.all(np.isfinite(bench.samples[-1][1]))


def test_free_mode_runs_alone_and_stops_after_its_duration(graph):
    bench = SimulatorBench(graph, device="maccepavd", mode="free", rate=500.0, duration=0.4)
    graph.until(lambda: bench.node.finished.done() and len(bench.samples) == 201)
    stamps = [stamp for stamp, _, _ in bench.samples]
    assert stamps == [EPOCH + 2 * PERIOD * tick for tick in range(201)]


def test_time_begins_with_all_listeners_and_parameters_are_readable(graph):
    bench = SimulatorBench(graph, device="cubic_demo", mode="free", duration=0.05, listeners=2)
    graph.until(lambda: any("waiting" in report.status[0].message for report in bench.reports))
    assert bench.samples == []
    second = []
    bench.peer.create_subscription(JointState, "/joint_states", second.append, qos.SAMPLES)
    graph.until(lambda: len(bench.samples) == 51 and len(second) == 51)
    assert bench.node.get_parameter("rate").value == 1000.0


def test_servo_device_follows_equilibrium_and_preset(graph):
    bench = SimulatorBench(graph, device="maccepavd", mode="lockstep", duration=1.0)
    command = Command(VsaCommand.EQUILIBRIUM_PRESET, 0.4, 0.9, 0.5, np.empty(0))

    def answer(_tick):
        bench.commands.publish(bench.writer.numbered(bench.samples[-1][0], command))

    bench.answers = answer
    graph.until(lambda: bench.node.finished.done() and len(bench.samples) == 1001)
    assert bench.angles[-1, 1:] == pytest.approx([0.4, 0.9], abs=0.01)
    assert bench.angles[-1, 0] == pytest.approx(0.4, abs=0.05)


def test_rigid_joint_is_simulated_recorded_and_diagnosed_over_ros(graph, tmp_path):
    """In messages and bags its drive is motor 1, with torque only."""
    save_effects(tmp_path / "dry.yaml", [Effect("coulomb_friction", "link", {"torque": 0.1})])
    rate, ticks = 300.0, 2400
    bench = SimulatorBench(
        graph,
        device="dfki_elbow",
        mode="lockstep",
        rate=rate,
        duration=ticks / rate,
        effects=str(tmp_path / "dry.yaml"),
    )
    time = np.arange(ticks) / rate
    sent = 0.5 * np.sin(2.1 * time) + 0.4 * np.sin(6.7 * time + 1.0) + 0.2 * np.sin(13.0 * time)
    heard, asked = [], []
    bench.peer.create_subscription(JointState, "/joint_states", heard.append, qos.SAMPLES)
    bench.peer.create_subscription(VsaCommand, bench.device.command_topic, asked.append, qos.SAMPLES)
    bench.answers = lambda tick: [sent[tick]] if tick < ticks else None
    graph.until(lambda: bench.node.finished.done() and len(heard) == ticks + 1 and len(asked) == ticks)
    assert list(heard[0].name) == ["elbow", "dfki_elbow_motor_1_joint"]
    assert np.isnan([heard[0].effort[1], heard[0].position[1]]).all()  # nothing was sent before the first sample
    assert [message.effort[1] for message in heard[1:]] == pytest.approx(sent)  # over the tick that ends at the stamp
    for name, streams in (("bag", (heard,)), ("commanded", (heard, asked))):
        with BagWriter(tmp_path / name) as bag:
            for topic, kind, messages in zip(
                ("/joint_states", bench.device.command_topic), (JOINT_STATE, VSA_COMMAND), streams
            ):
                bag.add_topic(topic, kind)
                for message in messages:
                    bag.write(topic, serialize_message(message), nanoseconds(message.header.stamp))
    assert read_log(tmp_path / "commanded", bench.device).commands["external_torque"] == pytest.approx(sent)
    log = read_log(tmp_path / "bag", bench.device)
    assert (log.level, log.commands) == ("full", None)
    assert log.measured["tau"][1:, 0] == pytest.approx(sent)
    report = diagnose([log], bench.device)
    assert report.verdict == "effect"
    cause = report.causes[0]
    assert (cause.effect, cause.site) == ("coulomb_friction", "link")
    assert cause.parameters["torque"].value == pytest.approx(0.1, rel=0.05)


def test_invalid_parameters_are_refused_with_the_reason(graph, tmp_path):
    with pytest.raises(ParameterError, match="must be one of realtime, lockstep, free, got 'warp'"):
        graph.add(SimulatorNode, mode="warp")
    with pytest.raises(ParameterError, match="cannot be read"):
        graph.add(SimulatorNode, effects=str(tmp_path / "none.yaml"))
    with pytest.raises(ParameterError, match=r"none\.py: no such file"):
        graph.add(SimulatorNode, own_effects=str(tmp_path / "none.py"))


def test_position_drive_is_commanded_switched_off_and_recorded(graph, tmp_path):
    """A goal of NaN switches the drive off; effort is NaN without torque sensors; torque commands are refused."""
    ticks = 200
    bench = SimulatorBench(graph, device="xl330", mode="lockstep", rate=200.0, duration=ticks / 200.0)
    goals = np.where(np.arange(ticks) < 150, 0.5 * np.sin(0.05 * np.arange(ticks)), np.nan)
    heard, asked, refused = [], [], []
    bench.peer.create_subscription(JointState, "/joint_states", heard.append, qos.SAMPLES)
    bench.peer.create_subscription(VsaCommand, bench.device.command_topic, asked.append, qos.SAMPLES)

    def answers(tick):
        if tick == 10 and not refused:
            refused.append(tick)
            bench.send(bench.samples[-1][0], [0.1])
        if tick < ticks:
            command = Command(VsaCommand.EQUILIBRIUM_PRESET, goals[tick], np.nan, 0.0, np.empty(0))
            bench.commands.publish(bench.writer.numbered(bench.samples[-1][0], command))

    bench.answers = answers
    graph.until(lambda: bench.node.finished.done() and len(heard) == ticks + 1 and len(asked) == ticks + 1)
    assert np.isnan([message.effort[1] for message in heard]).all()
    held = Signals(np.arange(ticks) / 200.0, {"equilibrium": goals}, {"equilibrium": "rad"}, frozenset({"equilibrium"}))
    plant = JointPlant.from_device(bench.device)
    run = simulate(plant, held, ticks / 200.0, 200.0, sensors=Sensors.of_device(bench.device))
    np.testing.assert_array_equal(bench.angles[:, 0], run.measured["q"])
    with BagWriter(tmp_path / "bag") as bag:
        for topic, kind, messages in zip(
            ("/joint_states", bench.device.command_topic),
            (JOINT_STATE, VSA_COMMAND),
            (heard, [message for message in asked if message.mode == VsaCommand.EQUILIBRIUM_PRESET]),
        ):
            bag.add_topic(topic, kind)
            for message in messages:
                bag.write(topic, serialize_message(message), nanoseconds(message.header.stamp))
    log = read_log(tmp_path / "bag", bench.device)
    assert (log.level, log.drivable, "tau" in log.measured) == ("encoder and command", True, False)
    np.testing.assert_array_equal(log.commands["equilibrium"], goals)
    again = simulate(plant, log.commands, ticks / 200.0, 200.0, sensors=Sensors.of_device(bench.device)).measured
    np.testing.assert_array_equal(again["q"], log.measured["q"])
