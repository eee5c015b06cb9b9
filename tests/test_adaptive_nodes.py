"""The limit cycle with estimators over DDS: a wrong model is corrected, and without them it is that of the file."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from arm_bench import ArmBench
from via_bringup.demo.reference import ARM, EQUILIBRIUM, LEVEL
from via_controllers.nodes.single import NODES
from via_core.status import Status
from via_estimators.nodes.estimator import EstimatorNode
from via_estimators.nodes.payload import PayloadNode
from via_interfaces.msg import ControlState, PayloadEstimate, StiffnessEstimate
from via_ros import qos
from via_ros.conversions import nanoseconds, set_stamp

REST = EQUILIBRIUM.tolist()
JOINTS = [f"reference_4dof:{joint}" for joint in ARM.joints]
WRONG = {"payload": 0.44, "spring_scale": [0.9] * 4, "link_friction": [0.3] * 4}  # of the simulated arm
SCALES = [f"spring_scale_{joint}" for joint in range(1, 5)]
FRICTION = [f"link_friction_{joint}" for joint in range(1, 5)]
OF_THE_FILE = np.repeat([0.0, 1.0], [5, 4])


def model(bench):
    """Payload [kg], friction of links (4,) [N m s/rad] and spring scales (4,) of the controller's model now."""
    return np.array([bench.now(name) for name in ("payload", *FRICTION, *SCALES)])


def within_limits(bench):
    return all((np.abs(torque) <= ARM.torque_limit).all() for _, torque in bench.commands)


def largest_step(bench, since, until=None):
    """Largest change of a motor's torque between the answers to two samples, over its limit.

    A controller that hears nothing for 20 ms, here while the test itself is busy, also lets go: with the last stamp.
    """
    answers = {}
    for stamp, torque in bench.commands:
        answers.setdefault(stamp, torque)
    torques = np.array(list(answers.values())[since:until])
    return float(np.abs(np.diff(torques, axis=0) / ARM.torque_limit).max())


def test_estimators_correct_the_model_and_its_fallback_is_smooth(graph):
    """Payload 20 % of the forearm, friction, springs 10 % soft: H within 2 %; without estimators, the file's model."""
    estimators = [graph.add(PayloadNode), graph.add(EstimatorNode, devices=JOINTS)]
    bench = ArmBench(
        graph, NODES["modal_limit_cycle"], {"adapt": True, "correction_time": 0.2, "fallback_time": 0.2}, posture=REST,
        mode="lockstep", duration=4.0, listeners=4, **WRONG,
    )  # fmt: skip
    graph.until(lambda: len(bench.states) >= 2500)
    assert model(bench) == pytest.approx([0.44, *[0.3] * 4, *[0.9] * 4], abs=0.02)
    H = bench.quantity("H")[: len(bench.states)] / LEVEL - 1.0
    assert np.abs(H[2200:]).max() < 0.02
    for node in estimators:  # killed
        graph.executor.remove_node(node)
    killed = len(bench.states)
    graph.until(lambda: bench.simulator.finished.done() and len(bench.states) >= 4000)
    assert model(bench) == pytest.approx(OF_THE_FILE, abs=0.01)
    assert np.abs(bench.quantity("H")[-500:] / LEVEL - 1.0).max() > 0.1
    assert largest_step(bench, killed) < 2.0 * largest_step(bench, 2000, killed)
    assert within_limits(bench) and {each[0] for each in bench.states} == {ControlState.ACTIVE}


class Reports:
    """Publishes one estimate of payload, `friction` of the links, and stiffness for each sample."""

    def __init__(self, graph, bench, status, value, sd, friction=()):
        self.friction = list(friction)
        self.node, self.given = graph.node("reports"), (int(status), float(value), float(sd))
        create = partial(self.node.create_publisher, qos_profile=qos.SAMPLES)
        topics = [(PayloadEstimate, "/reference_4dof/payload")]
        topics += [(StiffnessEstimate, f"/{joint}/stiffness") for joint in ARM.joints]
        self.publishers = [(create(kind, topic), kind()) for kind, topic in topics]
        bench.peer.create_subscription(ControlState, "/reference_4dof/control", self._report, qos.SAMPLES)

    def _report(self, state):
        for publisher, message in self.publishers:
            set_stamp(message.header.stamp, nanoseconds(state.header.stamp))
            message.status, message.value, message.standard_deviation = self.given
            if isinstance(message, PayloadEstimate) and self.friction:
                message.link_friction = self.friction
                message.link_friction_standard_deviation = [0.0] * len(self.friction)
            publisher.publish(message)


@pytest.mark.parametrize("status", [Status.WARMING_UP, Status.NOT_EXCITED, Status.IMPLAUSIBLE])
def test_estimates_that_are_not_ok_leave_the_model_of_the_file(graph, status):
    bench = ArmBench(graph, NODES["modal_limit_cycle"], {"adapt": True}, posture=REST, mode="lockstep", duration=0.2)
    Reports(graph, bench, status, 3.0, 0.0)
    graph.until(lambda: bench.simulator.finished.done() and len(bench.states) >= 200)
    assert np.array_equal(model(bench), OF_THE_FILE)


@pytest.mark.parametrize("friction", [(), (0.2, 0.2), (0.2, 0.2, 0.2, 0.2)])
def test_a_payload_is_used_with_and_without_friction_of_the_links(graph, friction):
    """Recorded or foreign messages may have none."""
    bench = ArmBench(
        graph, NODES["modal_limit_cycle"], {"adapt": True, "correction_time": 0.02}, posture=REST, mode="lockstep",
        duration=0.3,
    )  # fmt: skip
    Reports(graph, bench, Status.OK, 0.1, 0.0, friction)
    graph.until(lambda: bench.simulator.finished.done() and len(bench.states) >= 300)
    assert model(bench)[:5] == pytest.approx([0.1, *[0.2 * (len(friction) == 4)] * 4], abs=0.01)


@pytest.mark.parametrize(("value", "most"), [(1e9, 5.0), (np.nan, 0.0), (-1e9, 0.0)])
def test_wild_estimates_are_bounded_and_limits_hold(graph, value, most):
    bench = ArmBench(
        graph, NODES["modal_limit_cycle"], {"adapt": True, "correction_time": 0.05}, posture=REST, mode="lockstep",
        duration=0.3,
    )  # fmt: skip
    Reports(graph, bench, Status.OK, value, 0.0)
    graph.until(lambda: bench.simulator.finished.done() and len(bench.states) >= 300)
    payload, scales = bench.quantity("payload"), np.array([bench.quantity(name) for name in SCALES])
    assert payload.min() >= 0.0 and payload.max() <= most + 1e-9
    assert scales.min() >= 1.0 / 3.0 and scales.max() <= 3.0
    assert within_limits(bench)
