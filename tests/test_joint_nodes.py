"""Joints over DDS in lockstep: every law of a joint on its node, the estimator in the loop, lifecycle, bad input."""

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
from via_controllers.nodes.bang_bang_joint import BangBangJointNode
from via_controllers.nodes.equilibrium_preset import EquilibriumPresetNode
from via_controllers.nodes.excitation import ExcitationNode, ExcitationParameters, driven
from via_controllers.nodes.excitation import law_of as excitation_of
from via_controllers.nodes.max_velocity import MaxVelocityNode, MaxVelocityParameters
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
    """A simulated joint in lockstep, its controller (class and parameters), and ears on what they say.

    real  the device that is simulated, if not the one that the controller knows
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
        told = np.array([message.position, message.velocity, message.effort])
        self.samples.append(told)

    def _state(self, message):
        self.states.append((message.activity, message.limited, np.array(message.value)))
        self.names = list(message.name)

    def _command(self, message):
        self.commands.append((nanoseconds(message.header.stamp), message.damping, np.array(message.motor)))

    def _truth(self, message):
        self.truth.append(message.value)

    def finish(self):
        """Wait for the end of a run, and for what was told of all of it."""
        done = self.simulator.finished.done
        self.graph.until(lambda: done() and min(len(self.states), len(self.truth)) >= self.simulator.ticks)

    def quantity(self, name):
        """(N,) what the law told."""
        return np.array([value[self.names.index(name)] for _, _, value in self.states])

    def transition(self, number):
        client = self.peer.create_client(ChangeState, f"/{self.controller.get_name()}/change_state")
        self.graph.until(client.service_is_ready)
        answer = client.call_async(ChangeState.Request(transition=Transition(id=number)))
        self.graph.until(answer.done)
        assert answer.result().success

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
    """The device with springs that are stiffer than the shipped file says, under the same name."""
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


def test_stiffness_feedback_takes_the_error_out(graph, tmp_path):
    """Estimator -> law -> simulator, springs 15 % stiffer than both think, the equilibrium in motion."""
    name, wanted = "qbmove_a", 6.0
    graph.add(EstimatorNode, device=name)
    parameters = {"stiffness": wanted, "feedback": True, "correction_time": 0.4}
    real = stiffer(tmp_path, name, 1.15)
    bench = JointBench(graph, name, EquilibriumPresetNode, parameters, real, duration=4.0, listeners=4)

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


def test_a_serial_joint_swings_by_switching(graph, tmp_path):
    """It begins at zero, away from its equilibrium, and with a slack spring."""
    parameters = {"equilibrium": 0.2, "preset": 3.0, "amplitude": 0.05, "threshold": 0.01}
    bench = JointBench(graph, serial(tmp_path), BangBangJointNode, parameters, duration=4.0)
    bench.finish()
    late = bench.joint[2000:, 0, 0]
    cycles = Cycles(TICK * np.arange(len(late)), late, 0.2)
    assert len(cycles.periods) >= 4
    assert relative_sd(cycles.periods) < 1e-2 and relative_sd(cycles.swings) < 2e-2
    assert cycles.swings.mean() > 4.0 * parameters["amplitude"]
    device = bench.device
    stiffness = float(device.stiffness(0.2, device.motor_angles(0.2, 3.0)))
    assert 0.95 < 2.0 * np.pi * np.sqrt(device.link.inertia / stiffness) / cycles.periods.mean() < 1.25
    # The preset motor is led there no faster than half its limit allows, later nothing is near one.
    assert ControlState.SPEED_LIMIT in {limited for _, limited, _ in bench.states[:1000]}
    assert np.abs(np.diff(bench.joint[::10, 0, 1:], axis=0)).max() / (10.0 * TICK) < 8.0
    assert not any(limited for _, limited, _ in bench.states[2000:])


def test_a_throw_is_as_fast_as_the_closed_form_says(graph):
    bench = JointBench(graph, "visco_elastic_demo", MaxVelocityNode, {"turns": 2, "damping": 0.25}, duration=1.2)
    law, ideal = throwing_controller(bench.device, 0.25, 2)
    bench.finish()
    position, end, around = bench.joint[:, 0], round(law.horizon / TICK), 3
    reached = (position[end + around, 0] - position[end - around, 0]) / (2.0 * around * TICK)
    assert reached == pytest.approx(MaxVelocityParameters().speed_share * ideal, rel=1e-2)
    assert np.abs(np.diff(position[::5, 1])).max() / (5.0 * TICK) <= law.velocity  # not the least beyond its limit
    assert {damping for _, damping, _ in bench.commands} == {0.25}
    assert bench.quantity("left")[0] == pytest.approx(law.horizon) and bench.quantity("left")[-1] < 0.0


def test_a_joint_lives_through_its_states(graph):
    """Silent, holding still, standing as told, refusing what cannot be, holding still, silent, and once more."""
    bench = JointBench(graph, "qbmove_a", EquilibriumPresetNode, {"autostart": False, "stiffness": 3.0})
    bench.transition(Transition.TRANSITION_CONFIGURE)
    graph.until(lambda: bench.states and bench.states[-1][0] == ControlState.HOLDING)
    graph.until(lambda: bench.references.get_subscription_count() == 1)
    bench.references.publish(JointReference(equilibrium=0.2, stiffness=4.0))  # kept for when it is asked to
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
    bench.transition(Transition.TRANSITION_CLEANUP)
    stopped = bench.simulator.ticks
    bench.transition(Transition.TRANSITION_CONFIGURE)
    graph.until(lambda: bench.simulator.ticks > stopped)  # the sample that nobody answered is said again
    assert bench.states[-1][0] == ControlState.HOLDING
    assert max(np.abs(torque).max() for _, _, torque in bench.commands) <= 6.0


def test_an_excited_joint_lives_through_its_states_and_moves_as_its_law_alone_says(graph):
    """Bit by bit: supervision changes no torque that keeps the limits."""
    device = "cubic_demo"
    bench = JointBench(graph, device, ExcitationNode, {"autostart": False})
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
    law = excitation_of(ExcitationParameters(), JointAxes(bench.device))
    state, answers = law.init(), {stamp: torque for stamp, _, torque in reversed(bench.commands)}  # the first to each
    first = min(answers)
    for tick in active:
        angles = bench.joint[tick, 0]
        state, out = law.step(state, JointSample(tick * 10**6 / 10**9, angles[0], angles[1:]))
        assert np.array_equal(answers[first + tick * 10**6], out.torque)
    assert not any(limited for _, limited, _ in bench.states)
    assert bench.quantity("preset")[active[-1]] == pytest.approx(law.told(state)[1])
    bench.transition(Transition.TRANSITION_CLEANUP)


def test_an_excited_joint_without_limits_in_its_file_has_those_of_the_parameter(graph):
    device, states = load_device("cubic_aa_vsa"), []
    assert JointAxes(device).torque_limit.tolist() == [np.inf, np.inf]
    graph.node("peer").create_subscription(ControlState, f"/{device.name}/control", states.append, qos.SAMPLES)
    graph.add(ExcitationNode, device=device.name, torque_limit=0.5)
    graph.add(SimulatorNode, device=device.name, mode="lockstep", duration=0.3, listeners=1)
    graph.until(lambda: len(states) >= 300)
    assert list(states[0].torque_limit) == [0.5, 0.5]
    assert {state.limited for state in states} >= {ControlState.TORQUE_LIMIT}
    kept = JointAxes(driven(ExcitationParameters(device="qbmove_a", torque_limit=0.5))).torque_limit
    assert kept.tolist() == [6.0, 6.0]  # its file knows


def test_samples_too_slow_for_a_law_are_told_in_one_line_with_the_remedy(graph, capfd):
    device, reports = load_device("cubic_demo"), []
    controller, peer = graph.add(ExcitationNode, device=device.name), graph.node("peer")
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
    remedy = "samples more than 20 ms apart, the law starts anew at each: publish /joint_states at 100 Hz or more"
    assert remedy in say(25, 5)
    say(1, 1)  # the one after the last of these
    assert remedy not in say(19, 5)
    assert capfd.readouterr().err.count(remedy) == 1


def test_samples_that_stop_or_cannot_be_used_are_answered_with_nothing(graph):
    device = load_device("qbmove_a")
    controller, peer, commands, states = graph.add(EquilibriumPresetNode, stiffness=6.0), graph.node("peer"), [], []
    samples = peer.create_publisher(JointState, "/joint_states", qos.SAMPLES)
    peer.create_subscription(VsaCommand, device.command_topic, commands.append, qos.SAMPLES)
    peer.create_subscription(ControlState, f"/{device.name}/control", states.append, qos.SAMPLES)
    graph.until(lambda: samples.get_subscription_count() and controller.count_subscribers(device.command_topic))
    graph.until(lambda: controller.count_subscribers(f"/{device.name}/control") == 1)
    writer, begin = JointStateWriter(device), time.time_ns()
    for tick, position in enumerate((0.1, np.nan, 1e9, 0.1)):
        writer.position[:] = position
        samples.publish(writer.stamped(begin + tick * 10**6))
    # Nobody tells for 20 ms where the joint is: a zero, stamped with its making.
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
        (EquilibriumPresetNode, {"device": "none"}, "no device 'none'"),
        (EquilibriumPresetNode, {"device": "maccepavd"}, "no two motors that take torques"),
        (EquilibriumPresetNode, {"device": "visco_elastic_demo"}, "no two motors"),
        (EquilibriumPresetNode, {"stiffness": 1e6}, "has no stiffness 1e"),
        (BangBangJointNode, {"device": "maccepavd"}, "take no torques"),
        (BangBangJointNode, {"device": "compact_vpda"}, "has no springs"),
        (BangBangJointNode, {"bandwidth": 0.0}, "bandwidth must lie in"),
        (MaxVelocityNode, {"device": "cubic_demo"}, "one spring and one motor"),
        (ExcitationNode, {"device": "maccepavd"}, "needs an antagonistic device with torque drive"),
        (ExcitationNode, {"preset_frequencies": [0.0]}, "frequencies must be > 0 Hz"),
        (MaxVelocityNode, {"speed_share": 2.0}, "speed_share must lie in"),
    ],
)
def test_wrong_parameters_are_refused_with_the_reason(graph, node, parameters, complaint):
    with pytest.raises(ViaError, match=complaint):
        graph.add(node, **parameters)
