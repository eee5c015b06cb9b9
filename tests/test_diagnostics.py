"""Diagnostics as the standard tools read them: constant names, and levels that show the present."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from via_controllers.nodes.single import NODES
from via_estimators.nodes.estimator import EstimatorNode
from via_ros import qos, reports
from via_ros.reports import StatusReport
from via_sim.nodes.simulator import SimulatorNode

NODE = SimpleNamespace(get_fully_qualified_name=lambda: "/left/estimator")


@pytest.fixture
def clock(monkeypatch):
    clock = SimpleNamespace(now=5.0)
    monkeypatch.setattr(reports.time, "monotonic", lambda: clock.now)
    return clock


def test_a_status_warns_of_an_event_for_a_while_and_of_a_condition_as_long_as_it_lasts(clock):
    report = StatusReport(NODE, "elbow", "modulated_torque")

    def seen(gaps, silent=False):
        status = report.status(
            {"no samples": silent}, {"gaps": gaps, "late": 0}, {"gaps": gaps, "share": 0.1 + 0.2}, "OK"
        )
        assert (status.name, status.hardware_id) == ("left/estimator: elbow modulated_torque", "elbow")
        assert [(each.key, each.value) for each in status.values] == [("gaps", str(gaps)), ("share", "0.3")]
        return status.level, status.message

    assert seen(0) == (DiagnosticStatus.OK, "OK")
    assert seen(1) == (DiagnosticStatus.WARN, "gaps")
    clock.now += 0.9 * reports.RECENT
    assert seen(1) == (DiagnosticStatus.WARN, "gaps")
    clock.now += 0.2 * reports.RECENT
    assert seen(1) == (DiagnosticStatus.OK, "OK")
    assert seen(1, silent=True) == (DiagnosticStatus.WARN, "no samples")
    assert seen(1) == (DiagnosticStatus.OK, "OK")
    assert seen(2, silent=True) == (DiagnosticStatus.WARN, "no samples, gaps")


def test_a_refusal_with_another_reason_is_another_event(clock):
    report = StatusReport(NODE, "elbow")
    for count in range(1, 2000):
        status = report.status({}, {f"refused: {count} rad": count}, {}, "running")
        assert (status.level, status.message) == (DiagnosticStatus.WARN, f"refused: {count} rad")
    assert len(report._counts) == len(report._latest) == 1


def test_a_status_keeps_its_name_in_every_state_of_its_node(graph):
    """A tool would show each name as a status of its own, of which all but one are stale."""
    heard = []
    peer = graph.node("peer")
    peer.create_subscription(DiagnosticArray, "/diagnostics", lambda each: heard.extend(each.status), qos.SAMPLES)
    controller = graph.add(NODES["excitation"], device="qbmove_a")
    simulator = graph.add(SimulatorNode, device="qbmove_a", mode="lockstep")

    def state(wanted):
        def reported(status):
            return any((each.key, each.value) == ("state", wanted) for each in status.values)

        heard.clear()
        graph.until(lambda: any(map(reported, heard)) and any(each.name.startswith("simulator") for each in heard))
        return {each.name for each in heard}

    graph.until(lambda: simulator.ticks > 10)
    names = state("active")
    assert names == {"excitation: qbmove_a", "simulator: qbmove_a"}
    controller.trigger_deactivate()
    assert state("holding still") == names


def test_nodes_in_two_namespaces_have_two_statuses(graph):
    heard = []
    peer = graph.node("peer")
    peer.create_subscription(DiagnosticArray, "/diagnostics", lambda each: heard.extend(each.status), qos.SAMPLES)
    for space in ("left", "right"):
        overrides = [Parameter("device", value="qbmove_a")]
        graph._added(EstimatorNode(context=graph.context, namespace=space, parameter_overrides=overrides))
    peer.create_publisher(JointState, "/joint_states", qos.SAMPLES)
    graph.until(lambda: len({each.name for each in heard}) == 2)
    assert {each.name for each in heard} == {
        f"{each}/estimator: qbmove_a modulated_torque" for each in ("left", "right")
    }
