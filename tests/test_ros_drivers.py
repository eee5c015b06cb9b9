"""Drivers as laboratories have them: other qualities of service, other joints, values that are missing."""

from __future__ import annotations

import time
from types import SimpleNamespace

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import JointState
from via_controllers.nodes.single import NODES
from via_core.devices import load_device
from via_core.errors import ParameterError
from via_estimators.nodes.estimator import EstimatorNode
from via_gap.nodes.monitor import MonitorNode
from via_ros import gate, qos
from via_ros.conversions import JointStateWriter
from via_ros.gate import LOSSY, Gate, RenewedSubscription

DEVICE = load_device("qbmove_a")
NODE_KINDS = {"estimator": EstimatorNode, "excitation": NODES["excitation"]}
LISTENERS = NODE_KINDS | {"gap_monitor": MonitorNode}


@pytest.mark.parametrize("reliable_first", [False, True])
def test_a_best_effort_driver_is_heard_and_reported(graph, reliable_first):
    peer, heard = graph.node("peer"), []
    offered = [qos.SAMPLES, qos_profile_sensor_data] if reliable_first else [qos_profile_sensor_data]
    drivers = [peer.create_publisher(JointState, "/joint_states", profile) for profile in offered]
    renewed = RenewedSubscription(graph.node("listener"), JointState, "joint_states", heard.append, qos.LOOP)
    graph.until(lambda: renewed.is_lossy and renewed.get_publisher_count() == len(drivers))
    for driver in drivers:
        driver.publish(JointState(name=["elbow"]))
    graph.until(lambda: len(heard) == len(drivers))
    assert renewed.renewals == 1


def test_a_reliable_driver_is_heard_reliably(graph):
    peer, heard = graph.node("peer"), []
    driver = peer.create_publisher(JointState, "/joint_states", qos.SAMPLES)
    renewed = RenewedSubscription(graph.node("listener"), JointState, "joint_states", heard.append, qos.LOOP)
    graph.until(lambda: driver.get_subscription_count() == 1)
    driver.publish(JointState(name=["elbow"]))
    graph.until(lambda: heard)
    assert not renewed.is_lossy and renewed.renewals == 0


class Driver:
    """A driver of DEVICE, and the statuses of the node that listens to it."""

    def __init__(self, graph, kind, profile=qos.SAMPLES):
        self.graph, self.statuses = graph, []
        peer = graph.node("peer")
        self.samples = peer.create_publisher(JointState, "/joint_states", profile)
        peer.create_subscription(
            DiagnosticArray, "/diagnostics", lambda each: self.statuses.extend(each.status), qos.SAMPLES
        )
        graph.add(LISTENERS[kind], device=DEVICE.name)
        graph.until(lambda: self.samples.get_subscription_count() == 1)
        self.writer = JointStateWriter(DEVICE)
        self.writer.position[:] = 0.1

    def reported(self, text, names=None):
        """Publish samples, with these joint names if given, until a status contains the text."""

        def sent():
            message = self.writer.stamped(time.time_ns())
            message.name = names or message.name
            self.samples.publish(message)
            return any(text in each.message for each in self.statuses)

        self.graph.until(sent)


@pytest.mark.parametrize("kind", NODE_KINDS)
def test_joints_of_other_names_are_named_in_the_diagnostics(graph, kind):
    Driver(graph, kind).reported(f"no {DEVICE.link_joint} in elbow, flexor", ["elbow", "flexor", "extensor"])


@pytest.mark.parametrize(("kind", "lacks"), [("estimator", ("position", "effort")), ("excitation", ("position",))])
def test_missing_motors_are_named_in_the_diagnostics(graph, kind, lacks):
    first, second = DEVICE.motor_joints
    driver = Driver(graph, kind)
    driver.writer.effort[:] = 0.0
    driver.reported(
        f"no value of {', '.join(f'{each} of {first}' for each in lacks)}", [DEVICE.link_joint, "m", second]
    )


@pytest.mark.parametrize("kind", LISTENERS)
def test_a_best_effort_driver_is_named_in_the_diagnostics(graph, kind):
    Driver(graph, kind, qos_profile_sensor_data).reported(LOSSY)


def test_refusals_at_the_rate_of_the_messages_do_not_fill_the_log(monkeypatch):
    lines = []

    def refuse(message):
        raise ParameterError(f"{message} rad is out of reach")

    now = [0.0]
    monkeypatch.setattr(gate.time, "monotonic", lambda: now[0])
    checked = Gate(SimpleNamespace(warning=lines.append))
    take = checked.message(refuse)
    for tick in range(2500):
        now[0] = 1e-3 * tick
        take(tick)
    assert (checked.refused, checked.reason) == (2500, "2499 rad is out of reach")
    assert lines == [f"refused: {tick} rad is out of reach" for tick in (0, 1000, 2000)]
