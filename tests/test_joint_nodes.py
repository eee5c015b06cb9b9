"""Joints over DDS in lockstep: the node of every joint controller, the estimator in the loop, lifecycle, bad input."""

from __future__ import annotations

import time

import numpy as np
import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from sensor_msgs.msg import JointState
from via_bringup.demo.reference import throwing_controller
from via_controllers.contract import JointSample
from via_controllers.joint_axes import JointAxes
from via_controllers.joint_methods import ExcitationParameters, MaxVelocityParameters
from via_controllers.nodes.single import NODES
from via_core.devices import load_device
from via_core.errors import ViaError
from via_estimators.nodes.estimator import EstimatorNode
from via_interfaces.msg import ControlState, JointReference, StiffnessEstimate, VsaCommand
from via_ros import qos
from via_ros.conversions import JointStateWriter, nanoseconds
from via_sim.nodes.simulator import SimulatorNode
from via_validation.control.cycles import Cycles, relative_sd

TICK = 1e-3  # [s]


class JointBench:
    """A simulated joint in lockstep, its controller (node and parameters), and records of their messages.

    real  the simulated device, if it differs from the controller's model
    """

    def __init__(self, graph, device, kind, parameters=None, real=None, **simulator):
        self.graph, self.peer, self.device = graph, graph.node("peer"), load_device(device)
        name = self.device.name
        self.samples, self.states, self.commands, self.truth = [], [], [], []
        self.peer.create_subscription(JointState, "/joint_states", self._sample, qos.SAMPLES)
        self.peer.create_subscription(ControlState, f"/{name}/control", self._state, qos.SAMPLES)
        self.peer.create_subscription(VsaCommand, self.device.command_topic, self._command, qos.SAMPLES)
        self.peer.create_subscription(StiffnessEstimate, f"/{name}/truth/stiffness", self._truth, qos.SAMPLES)
        self.references = self.peer.create_publisher(JointReference, f"/{name}/reference", qos.CONTROL)
        self.controller = graph.add(kind, device=device, **(parameters or {}))
        self.simulator = graph.add(SimulatorNode, device=real or device, mode="lockstep", truth=True, **simulator)

    def _sample(self, message):
        self.samples.append(np.array([message.position, message.velocity, message.effort]))

    def _state(self, message):
        self.states.append((message.activity, message.limited, np.array(message.value)))
        self.names = list(message.name)

    def _command(self, message):
        self.commands.append((nanoseconds(message.header.stamp), message.damping, np.array(message.motor)))

    def _truth(self, message):
        self.truth.append(message.value)

    def finish(self):
        """Wait for the end of a run and for all its messages."""
        done = self.simulator.finished.done
        self.graph.until(lambda: done() and min(len(self.states), len(self.truth)) >= self.simulator.ticks)

    def quantity(self, name):
        """(N,) values of a quantity of the controller."""
        return np.array([value[self.names.index(name)] for _, _, value in self.states])

    def transition(self, number):
        client = self.peer.create_client(ChangeState, f"/{self.controller.get_name()}/change_state")
        self.graph.until(client.service_is_ready)
        answer = client.call_async(ChangeState.Request(transition=Transition(id=number)))
        self.graph.until(answer.done)
        assert answer.result().success

    @property
    def answers(self):
        """First torques to each stamp [ns]; zero ones with a stamp that has an answer come after 20 ms of silence."""
        return {stamp: torque for stamp, _, torque in reversed(self.commands)}

    @property
    def joint(self):
        """(N, 3, 1 + m) positions, velocities and efforts."""
        return np.array(self.samples)


def written(folder, described):
    """Path of a device file."""
    path = folder / f"{described['name']}.yaml"
    path.write_text(yaml.safe_dump(described), encoding="utf-8")
    return str(path)


def stiffer(folder, name, factor):
    """The device with stiffer springs than in the shipped file, under the same name."""
    described = load_device(name).model_dump(mode="json", exclude_none=True)
    for spring in described["springs"]:
        spring["k"] *= factor
    return written(folder, described)


def serial(folder):
    """A serial joint of torque motors: the second one pretensions the spring of the first."""
    described = load_device("maccepavd").model_dump(mode="json", exclude={"damper", "observed", "wire"})
    described.update(name="serial_demo", drive="torque", sensors={"rate": 1.0 / TICK, "link_quantum": 1e-4})
    described["motors"] = [{"inertia": 0.01, "viscous_friction": 0.1, "torque_limit": 20.0, "speed_limit": 8.0}] * 2
    return written(folder, described)


def test_stiffness_feedback_removes_the_error(graph, tmp_path):
    """Estimator -> controller -> simulator, springs 15 % stiffer than in both models, the equilibrium in motion."""
    name, wanted = "qbmove_a", 6.0
    graph.add(EstimatorNode, device=name)
    parameters = {"stiffness": wanted, "feedback": True, "correction_time": 0.4}
    real = stiffer(tmp_path, name, 1.15)
    bench = JointBench(graph, name, NODES["equilibrium_preset"], parameters, real, duration=4.0, listeners=4)

    def move(message):
        """Fifty references a second, each stamped as the sample that it follows."""
        if (tick := len(bench.samples)) % 20:
            return
        time = tick * TICK
        angle = 0.15 * np.sin(2.0 * np.pi * time) + 0.05 * np.sin(5.4 * np.pi * time)
        reference = JointReference(equilibrium=angle, stiffness=wanted)
        reference.header.stamp = message.header.stamp
        bench.references.publish(reference)

    bench.peer.create_subscription(JointState, "/joint_states", move, qos.SAMPLES)
    graph.until(lambda: bench.references.get_subscription_count() == 1)
    bench.finish()
    error, factor = np.abs(np.array(bench.truth) / wanted - 1.0), bench.quantity("factor")
    assert error[500:600].max() > 0.13  # the motors have arrived, nothing is corrected yet
    assert error[3000:].mean() < 0.03
    assert factor[0] == 1.0 and factor[-1] == pytest.approx(1.15, abs=0.03)
    assert {activity for activity, _, _ in bench.states} == {ControlState.ACTIVE}
    assert not any(limited for _, limited, _ in bench.states) and bench.quantity("reached").all()


def test_a_serial_joint_oscillates_by_switching(graph, tmp_path):
    """It starts at zero, away from its equilibrium, with a slack spring."""
    parameters = {"equilibrium": 0.2, "preset": 3.0, "amplitude": 0.05, "threshold": 0.01}
    bench = JointBench(graph, serial(tmp_path), NODES["bang_bang_joint"], parameters, duration=4.0)
    bench.finish()
    late = bench.joint[2000:, 0, 0]
    cycles = Cycles(TICK * np.arange(len(late)), late, 0.2)
    assert len(cycles.periods) >= 4
    assert relative_sd(cycles.periods) < 1e-2 and relative_sd(cycles.swings) < 2e-2
    assert cycles.swings.mean() > 4.0 * parameters["amplitude"]
    device = bench.device
    stiffness = float(device.stiffness(0.2, device.motor_angles(0.2, 3.0)))
    assert 0.95 < 2.0 * np.pi * np.sqrt(device.link.inertia / stiffness) / cycles.periods.mean() < 1.25
    # The preset motor moves at most at half its speed limit; later nothing is near a limit.
    assert ControlState.SPEED_LIMIT in {limited for _, limited, _ in bench.states[:1000]}
    assert np.abs(np.diff(bench.joint[::10, 0, 1:], axis=0)).max() / (10.0 * TICK) < 8.0
    assert not any(limited for _, limited, _ in bench.states[2000:])


def test_a_throw_is_as_fast_as_the_closed_form(graph):
    bench = JointBench(graph, "visco_elastic_demo", NODES["max_velocity"], {"turns": 2, "damping": 0.25}, duration=1.2)
    controller, ideal = throwing_controller(bench.device, 0.25, 2)
    bench.finish()
    position, end, around = bench.joint[:, 0], round(controller.horizon / TICK), 3
    reached = (position[end + around, 0] - position[end - around, 0]) / (2.0 * around * TICK)
    assert reached == pytest.approx(MaxVelocityParameters().speed_share * ideal, rel=1e-2)
    assert np.abs(np.diff(position[::5, 1])).max() / (5.0 * TICK) <= controller.velocity
    assert {damping for _, damping, _ in bench.commands} == {0.25}
    assert bench.quantity("left")[0] == pytest.approx(controller.horizon) and bench.quantity("left")[-1] < 0.0


def test_a_joint_passes_all_its_states(graph):
    """No commands, holding, tracking, refusing an unreachable reference, holding, no commands, and again."""
    bench = JointBench(graph, "qbmove_a", NODES["equilibrium_preset"], {"autostart": False, "stiffness": 3.0})
    bench.transition(Transition.TRANSITION_CONFIGURE)
    graph.until(lambda: bench.states and bench.states[-1][0] == ControlState.HOLDING)
    graph.until(lambda: bench.references.get_subscription_count() == 1)
    bench.references.publish(JointReference(equilibrium=0.2, stiffness=4.0))  # kept until activation
    bench.references.publish(JointReference(equilibrium=0.2, stiffness=1e9))
    bench.references.publish(JointReference(equilibrium=np.nan, stiffness=4.0))
    bench.transition(Transition.TRANSITION_ACTIVATE)
    graph.until(lambda: bench.quantity("equilibrium")[-1] == 0.2)
    assert np.isnan(bench.states[0][2]).all()
    graph.until(lambda: bench.samples[-1][0, 0] == pytest.approx(0.2, abs=0.02))
    assert bench.quantity("stiffness")[-1] == 4.0
    graph.until(lambda: bench.truth[-1] == pytest.approx(4.0, rel=0.05))
    bench.transition(Transition.TRANSITION_DEACTIVATE)
    graph.until(lambda: bench.states[-1][0] == ControlState.HOLDING)
    held = len(bench.samples)
    graph.until(lambda: len(bench.samples) > held + 200)
    assert bench.joint[held:, 0, 0] == pytest.approx(0.2, abs=0.02)
    assert bench.truth[-1] == pytest.approx(4.0, rel=0.05)
    assert bench.commands[-1][2].any()
    bench.transition(Transition.TRANSITION_CLEANUP)
    graph.until(lambda: not bench.commands[-1][2].any())  # the last command, before any watchdog
    stopped = bench.simulator.ticks
    bench.transition(Transition.TRANSITION_CONFIGURE)
    graph.until(lambda: bench.simulator.ticks > stopped)  # the sample without an answer is repeated
    assert bench.states[-1][0] == ControlState.HOLDING
    assert max(np.abs(torque).max() for _, _, torque in bench.commands) <= 6.0


def test_an_excited_joint_passes_all_its_states_with_the_torques_of_its_controller(graph):
    """Bit by bit: supervision does not change torques within the limits."""
    device = "cubic_demo"
    bench = JointBench(graph, device, NODES["excitation"], {"autostart": False})
    bench.transition(Transition.TRANSITION_CONFIGURE)
    graph.until(lambda: len(bench.states) > 50)
    assert {activity for activity, _, _ in bench.states} == {ControlState.HOLDING}
    bench.transition(Transition.TRANSITION_ACTIVATE)
    graph.until(lambda: bench.states[-1][0] == ControlState.ACTIVE)
    graph.until(lambda: np.ptp(bench.joint[:, 0, 0]) > 0.2)
    bench.transition(Transition.TRANSITION_DEACTIVATE)
    graph.until(lambda: bench.states[-1][0] == ControlState.HOLDING)
    swung = len(bench.states)
    graph.until(lambda: len(bench.states) > swung + 1500)
    assert np.ptp(bench.joint[swung + 1300 :, 0], axis=0).max() < 0.02
    activities = np.array([activity for activity, _, _ in bench.states])
    active = np.flatnonzero(activities == ControlState.ACTIVE)
    assert np.array_equal(active, np.arange(active[0], active[-1] + 1)) and len(active) > 100
    controller = ExcitationParameters().build().supervisor.controller.controller
    answers = bench.answers
    state = controller.init()
    first = min(answers)
    for tick in active:
        angles = bench.joint[tick, 0]
        state, out = controller.step(state, JointSample(tick * 10**6 / 10**9, angles[0], angles[1:]))
        assert np.array_equal(answers[first + tick * 10**6], out.torque)
    assert not any(limited for _, limited, _ in bench.states)
    assert bench.quantity("preset")[active[-1]] == pytest.approx(controller.observe(state)[1])
    bench.transition(Transition.TRANSITION_CLEANUP)


def test_an_excited_joint_without_limits_in_its_file_has_the_limit_parameter(graph):
    device, states = load_device("cubic_aa_vsa"), []
    assert JointAxes(device).torque_limit.tolist() == [np.inf, np.inf]
    graph.node("peer").create_subscription(ControlState, f"/{device.name}/control", states.append, qos.SAMPLES)
    graph.add(NODES["excitation"], device=device.name, torque_limit=0.5)
    graph.add(SimulatorNode, device=device.name, mode="lockstep", duration=0.3, listeners=1)
    graph.until(lambda: len(states) >= 300)
    assert list(states[0].torque_limit) == [0.5, 0.5]
    assert {state.limited for state in states} >= {ControlState.TORQUE_LIMIT}
    kept = ExcitationParameters(device="qbmove_a", torque_limit=0.5).build().axes.torque_limit
    assert kept.tolist() == [6.0, 6.0]  # from its file


def test_motors_without_limits_are_named_when_their_controller_starts(graph, capfd):
    graph.add(NODES["commanded_torque"], device="cubic_aa_vsa")
    graph.add(NODES["commanded_torque"], device="qbmove_a")
    said = capfd.readouterr().err
    assert "cubic_aa_vsa: its file states no torque_limit (motor 1, 2), speed_limit (motor 1, 2): not limited" in said
    assert "qbmove_a: its file states no" not in said


def test_slow_samples_are_reported_in_one_line_with_the_remedy(graph, capfd):
    device, reports = load_device("cubic_demo"), []
    controller, peer = graph.add(NODES["excitation"], device=device.name), graph.node("peer")
    samples = peer.create_publisher(JointState, "/joint_states", qos.SAMPLES)
    peer.create_subscription(DiagnosticArray, "/diagnostics", lambda each: reports.extend(each.status), qos.SAMPLES)
    graph.until(lambda: samples.get_subscription_count() and controller.count_subscribers("/diagnostics"))
    writer = JointStateWriter(device)
    writer.position[:] = 0.1

    def say(period, count):
        """Samples so far apart [ms]; what was reported when all of them were in."""
        before = controller.answered
        for _ in range(count):
            say.stamp += period * 10**6
            samples.publish(writer.stamped(say.stamp))
        graph.until(lambda: controller.answered == before + count)
        seen = len(reports)
        graph.until(lambda: len(reports) > seen)
        return reports[seen].message

    say.stamp = 10**9
    remedy = "samples more than 20 ms apart restart the controller: publish /joint_states at 100 Hz or more"
    assert remedy in say(25, 5)
    say(1, 1)  # the one after the last of these
    assert remedy not in say(19, 5)
    assert capfd.readouterr().err.count(remedy) == 1


def test_samples_that_a_simulator_catches_up_are_all_answered(graph):
    """100 ms at 1 kHz, published while the controller is busy."""
    device, commands = load_device("qbmove_a"), []
    controller, peer = graph.add(NODES["excitation"], device=device.name), graph.node("peer")
    samples = peer.create_publisher(JointState, "/joint_states", qos.SAMPLES)
    peer.create_subscription(VsaCommand, device.command_topic, commands.append, qos.SAMPLES)
    graph.until(lambda: samples.get_subscription_count() and controller.count_subscribers(device.command_topic))
    writer, stamps = JointStateWriter(device), [10**9 + tick * 10**6 for tick in range(100)]
    writer.position[:] = 0.1
    for stamp in stamps:
        samples.publish(writer.stamped(stamp))
    graph.until(lambda: any(nanoseconds(each.header.stamp) == stamps[-1] for each in commands))
    assert controller.answered == len(stamps)


def test_zero_torque_is_sent_for_unusable_samples_and_when_samples_stop(graph):
    device = load_device("qbmove_a")
    controller, peer = graph.add(NODES["equilibrium_preset"], stiffness=6.0), graph.node("peer")
    commands, states = [], []
    samples = peer.create_publisher(JointState, "/joint_states", qos.SAMPLES)
    peer.create_subscription(VsaCommand, device.command_topic, commands.append, qos.SAMPLES)
    peer.create_subscription(ControlState, f"/{device.name}/control", states.append, qos.SAMPLES)
    graph.until(lambda: samples.get_subscription_count() and controller.count_subscribers(device.command_topic))
    graph.until(lambda: controller.count_subscribers(f"/{device.name}/control") == 1)
    writer, begin = JointStateWriter(device), time.time_ns()
    for tick, position in enumerate((0.1, np.nan, 1e9, 0.1)):
        writer.position[:] = position
        samples.publish(writer.stamped(begin + tick * 10**6))
    # After 20 ms without a sample: zero torque, stamped with the time now.
    graph.until(lambda: len(states) == 4 and len(commands) >= 5 and not any(commands[-1].motor))
    passive, active = ControlState.PASSIVE, ControlState.ACTIVE
    assert [state.activity for state in states] == [active, passive, passive, active]
    stamps = [nanoseconds(command.header.stamp) for command in commands]
    answers = [command for command, stamp in zip(commands, stamps, strict=True) if stamp <= begin + 3 * 10**6]
    assert [any(command.motor) for command in answers] == [True, False, False, True]
    assert begin + 10**7 < stamps[-1] <= time.time_ns()


@pytest.mark.parametrize(
    ("node", "parameters", "complaint"),
    [
        (NODES["equilibrium_preset"], {"device": "none"}, "no device 'none'"),
        (NODES["equilibrium_preset"], {"device": "maccepavd"}, "no two motors that take torques"),
        (NODES["equilibrium_preset"], {"device": "visco_elastic_demo"}, "no two motors"),
        (NODES["equilibrium_preset"], {"stiffness": 1e6}, "has no stiffness 1e"),
        (NODES["bang_bang_joint"], {"device": "maccepavd"}, "take no torques"),
        (NODES["bang_bang_joint"], {"device": "compact_vpda"}, "has no springs"),
        (NODES["bang_bang_joint"], {"bandwidth": 0.0}, "bandwidth must lie in"),
        (NODES["max_velocity"], {"device": "cubic_demo"}, "one spring and one motor"),
        (NODES["excitation"], {"device": "maccepavd"}, "needs an antagonistic device with torque drive"),
        (NODES["excitation"], {"preset_frequencies": [0.0]}, "frequencies must be > 0 Hz"),
        (NODES["max_velocity"], {"speed_share": 2.0}, "speed_share must lie in"),
    ],
)
def test_wrong_parameters_are_refused_with_the_reason(graph, node, parameters, complaint):
    with pytest.raises(ViaError, match=complaint):
        graph.add(node, **parameters)
