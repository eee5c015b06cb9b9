"""Faults on the live graph: a bad message, a frozen sensor or a second commander neither ends nor silences a node."""

from __future__ import annotations

import subprocess
import sys
import time

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from sensor_msgs.msg import JointState
from via_controllers.nodes.single import NODES
from via_core.devices import load_device
from via_estimators.nodes.estimator import EstimatorNode
from via_interfaces.msg import StiffnessEstimate, VsaCommand
from via_interfaces.srv import Hold, Push
from via_ros import qos
from via_ros.conversions import Command, JointStateWriter
from via_ros.gate import QUIET, RenewedSubscription
from via_ros.serialised import CommandBytes
from via_sim.nodes.arm_simulator import ArmSimulatorNode
from via_sim.nodes.simulation import YOUNG
from via_sim.nodes.simulator import SimulatorNode

DEVICE = load_device("qbmove_a")
MILLISECOND = 1_000_000  # [ns]


class Peer:
    """A node that plays the robot or another node, and hears commands and diagnostics."""

    def __init__(self, graph, name="peer"):
        self.graph, self.node = graph, graph.node(name)
        self.commands, self.reports = [], []
        self.samples = self.node.create_publisher(JointState, "/joint_states", qos.SAMPLES)
        self.node.create_subscription(VsaCommand, DEVICE.command_topic, self.commands.append, qos.SAMPLES)
        self.node.create_subscription(
            DiagnosticArray, "/diagnostics", lambda each: self.reports.extend(each.status), qos.SAMPLES
        )
        self.writer = JointStateWriter(DEVICE)
        self.writer.position[:] = 0.1

    def call(self, kind, name, request):
        client = self.node.create_client(kind, name)
        self.graph.until(client.service_is_ready)
        answer = client.call_async(request)
        self.graph.until(answer.done)
        return answer.result()

    def torque(self, stamp, angles=None):
        """Torques that answer a sample."""
        if angles is not None:
            self.writer.position[:] = angles
        count = len(self.commands)
        self.samples.publish(self.writer.stamped(stamp))
        self.graph.until(lambda: len(self.commands) > count)
        return np.array(self.commands[count].motor)

    def reported(self, text):
        """Wait until diagnostics of the next report contain the text."""
        self.reports.clear()
        self.graph.until(lambda: any(text in each.message for each in self.reports))


def pause(graph, seconds):
    """Run callbacks for a while."""
    end = time.monotonic() + seconds
    graph.until(lambda: time.monotonic() > end)


def test_an_estimate_with_an_unknown_status_is_refused_and_reported(graph):
    peer = Peer(graph)
    graph.add(NODES["equilibrium_preset"], device=DEVICE.name, feedback=True)
    estimates = peer.node.create_publisher(StiffnessEstimate, f"/{DEVICE.name}/stiffness", qos.SAMPLES)
    graph.until(lambda: estimates.get_subscription_count() == 1 and peer.samples.get_subscription_count() == 1)
    estimates.publish(StiffnessEstimate(status=99))
    peer.reported("refused messages: 99 is not a valid Status")
    assert len(peer.torque(1)) == 2


def test_a_hold_of_any_length_is_answered(graph):
    peer = Peer(graph)
    graph.add(ArmSimulatorNode, mode="free")
    for duration in (1.7e308, np.inf, np.nan, -1.0):
        answer = peer.call(Hold, "/arm_simulator/hold", Hold.Request(duration=duration))
        assert not answer.success and "duration must lie in [0, 1e+09] s" in answer.message
    assert peer.call(Hold, "/arm_simulator/hold", Hold.Request(duration=1e9)).success


def test_a_push_of_too_many_numbers_is_refused_in_one_line(graph):
    peer = Peer(graph)
    graph.add(ArmSimulatorNode, mode="free")
    answer = peer.call(Push, "/arm_simulator/push", Push.Request(impulse=[0.0] * 100_000))
    assert not answer.success
    assert answer.message == "impulse must hold 4 finite numbers or none, got 100000 numbers"


ROBOT = """
import rclpy, sys, time
from sensor_msgs.msg import JointState
from via_core.devices import load_device
from via_ros import middleware, qos
from via_ros.conversions import JointStateWriter
middleware.prepare()
rclpy.init()
node = rclpy.create_node("robot")
samples = node.create_publisher(JointState, "/joint_states", qos.SAMPLES)
writer = JointStateWriter(load_device("qbmove_a"))
writer.position[:] = .1
while samples.get_subscription_count() < 2:
    time.sleep(.05)
for tick in range(10**9):
    samples.publish(writer.stamped(time.time_ns()))
    if tick == 50:
        samples.publish(b"")
    time.sleep(.005)
"""


def test_an_empty_message_silences_nobody(graph):
    """Of another process: within one the middleware delivers it. A writer's history of 1000 lasts 5 s here."""
    peer, estimates = Peer(graph), []
    graph.add(NODES["excitation"], device=DEVICE.name)
    estimator = graph.add(EstimatorNode, device=DEVICE.name, method="modulated_torque")
    peer.node.create_subscription(StiffnessEstimate, f"/{DEVICE.name}/stiffness", estimates.append, qos.SAMPLES)
    with subprocess.Popen([sys.executable, "-c", ROBOT], stdin=subprocess.DEVNULL) as robot:
        try:
            graph.until(lambda: len(estimates) >= 45 and len(peer.commands) >= 45)
            began = time.monotonic()
            graph.until(lambda: len(estimates) >= 150 and len(peer.commands) >= 150)
            assert time.monotonic() - began < 4.0
        finally:
            robot.kill()
    assert estimator._samples.subscription.renewals == 1


def test_a_message_with_a_million_names_is_not_decoded(graph, capfd):
    peer, heard = Peer(graph), []
    estimator = graph.add(EstimatorNode, device=DEVICE.name, method="modulated_torque")
    peer.node.create_subscription(StiffnessEstimate, f"/{DEVICE.name}/stiffness", heard.append, qos.SAMPLES)
    graph.until(lambda: peer.samples.get_subscription_count() == 1 and estimator.count_subscribers("/diagnostics"))
    peer.samples.publish(JointState(name=[f"joint_{k}" for k in range(1_000_000)]))
    peer.samples.publish(JointState(name=[f"j{k}" for k in range(2000)]))
    peer.samples.publish(JointState(name=[f"\x1b[2J{k}" for k in range(200)]))
    peer.samples.publish(peer.writer.stamped(1))
    graph.until(lambda: len(heard) == 1)
    assert estimator._samples.broken == 2 and estimator._reader.foreign == 1
    errors = capfd.readouterr().err
    assert "\x1b[2J" not in errors and "␛[2J19" in errors and "20" not in errors.partition(" in ")[2].split(",")


def test_transitions_while_samples_arrive_do_not_end_a_controller(graph):
    peer = Peer(graph)
    graph.add(NODES["excitation"], device=DEVICE.name)
    simulator = graph.add(SimulatorNode, device=DEVICE.name, mode="free")
    graph.until(lambda: simulator.ticks > 10)
    client = peer.node.create_client(ChangeState, "/excitation/change_state")
    graph.until(client.service_is_ready)
    configure, activate = Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE
    cycle = [Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP, 99, configure, configure]
    cycle += [activate, activate]
    answers = []
    for number in 20 * cycle:
        answer = client.call_async(ChangeState.Request(transition=Transition(id=number)))
        graph.until(answer.done)
        answers.append(answer.result().success)
    assert answers == 20 * [True, True, False, True, False, True, False]
    answered = len(peer.commands)
    graph.until(lambda: len(peer.commands) > answered + 10)


def test_a_check_that_was_due_when_its_subscription_was_destroyed_does_nothing(graph):
    peer, heard = Peer(graph), []
    renewed = RenewedSubscription(graph.node("listener"), JointState, "/joint_states", heard.append, qos.CONTROL)
    graph.until(lambda: peer.samples.get_subscription_count() == 1)
    peer.samples.publish(peer.writer.stamped(1))
    graph.until(lambda: len(heard) == 1)
    renewed.destroy()
    for _ in range(QUIET + 1):
        renewed._look()


def test_frozen_positions_end_the_torque_until_they_move_again(graph):
    """The references move on while the encoders repeat one number."""
    peer = Peer(graph)
    node = graph.add(NODES["excitation"], device=DEVICE.name)
    graph.until(lambda: peer.samples.get_subscription_count() == 1 and node.count_subscribers("/diagnostics"))
    frozen = np.array([peer.torque(tick * MILLISECOND, 0.1) for tick in range(1, 800)])
    driven = np.flatnonzero(np.abs(frozen).max(axis=1))
    assert np.abs(frozen).max() > 1.0 and driven[-1] < 200
    peer.reported("a motor does not follow its torque")
    moving = [peer.torque((800 + tick) * MILLISECOND, 0.1 + 1e-4 * tick) for tick in range(600)]
    assert np.abs(moving).max() > 0.1


def test_stamps_that_stand_still_end_the_torque(graph):
    peer = Peer(graph)
    node = graph.add(NODES["equilibrium_preset"], device=DEVICE.name)
    graph.until(lambda: peer.samples.get_subscription_count() == 1 and node.count_subscribers("/diagnostics"))
    assert peer.torque(0).any()
    pause(graph, 0.05)
    for tick in range(20):
        assert not peer.torque(0, 0.1 + 1e-3 * tick).any()
    peer.reports.clear()
    graph.until(lambda: any("stamps stand still" in each.message for each in peer.reports))
    assert peer.torque(MILLISECOND, 0.1).any()


def commander(graph, name):
    node = graph.node(name)
    return node.create_publisher(VsaCommand, DEVICE.command_topic, qos.SAMPLES), CommandBytes(DEVICE.name)


def test_two_commanders_are_refused_and_named(graph):
    peer, torques = Peer(graph), []
    peer.node.create_subscription(
        JointState, "/joint_states", lambda each: torques.append(max(abs(each.effort[1]), abs(each.effort[2]))), 1000
    )
    (first, ours), (second, foreign) = commander(graph, "first"), commander(graph, "second")
    simulator = graph.add(SimulatorNode, device=DEVICE.name, mode="realtime", rate=250.0)
    graph.until(lambda: first.get_subscription_count() == 2 and second.get_subscription_count() == 2)
    graph.until(lambda: simulator.ticks > 5)

    def send(publisher, writer):
        command = Command(VsaCommand.MOTOR_TORQUE, 0.0, 0.0, 0.0, np.array([0.5, -0.5]))
        publisher.publish(writer.numbered(simulator._stamp(), command))
        pause(graph, 0.004)

    for _ in range(50):
        send(first, ours)
    assert max(torques[-10:]) == 0.5 and simulator._mixed == 0
    for _ in range(100):
        send(first, ours)
        send(second, foreign)
    assert simulator._mixed > 150 and max(torques[-10:]) == 0.0
    peer.reported("2 commanders: /first, /second")
    pause(graph, 1.1)
    for _ in range(50):  # the second one is silent
        send(first, ours)
    assert max(torques[-10:]) == 0.5


def test_a_second_simulator_of_a_joint_does_not_begin_and_both_are_named(graph):
    peer = Peer(graph)
    peer.node.create_subscription(JointState, "/joint_states", lambda _: None, qos.SAMPLES)
    first = graph.add(SimulatorNode, device=DEVICE.name, mode="realtime", rate=250.0)
    graph.until(lambda: first.ticks > 20)
    second = graph.add(SimulatorNode, device=DEVICE.name, mode="realtime", rate=250.0)
    peer.reported("3 drivers: /peer, /simulator, /simulator")  # the peer may publish samples, too
    graph.until(lambda: first.ticks > 300)
    assert second.ticks == 0
    graph.remove(first)
    graph.until(lambda: second.ticks > 20)


def test_a_simulator_that_began_before_it_knew_of_another_one_gives_way(graph):
    peer = Peer(graph)
    peer.node.create_subscription(JointState, "/joint_states", lambda _: None, qos.SAMPLES)
    first = graph.add(SimulatorNode, device=DEVICE.name, mode="realtime", rate=250.0)
    graph.until(lambda: first.ticks > 0 and time.monotonic() - first._since > YOUNG)
    second = graph.add(SimulatorNode, device=DEVICE.name, mode="realtime", rate=250.0)
    alone, second._drivers.is_alone = second._drivers.is_alone, lambda: True  # the graph does not show the first one
    graph.until(lambda: second.ticks > 0)
    second._drivers.is_alone = alone
    graph.until(lambda: not second._running)
    ticks, later = second.ticks, first.ticks + 300
    graph.until(lambda: first.ticks > later)
    assert second.ticks == ticks
    graph.remove(first)
    graph.until(lambda: second.ticks > ticks + 20)
