"""Number 7 over DDS in lockstep: the hopper finds its rhythm, also with a payload that the model does not include."""

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, WrenchStamped
from via_controllers.nodes.single import NODES
from via_core.hopper import Hopper
from via_interfaces.srv import Hold, Push
from via_ros import qos
from via_sim.nodes.hopper_simulator import HopperSimulatorNode
from via_validation.control.cycles import Cycles, relative_sd
from via_validation.control.hopper import CROUCH, PAYLOAD, hop, reference_controller

PERIOD, TICKS = 1e-3, 6000


@pytest.mark.parametrize("payload", [0.0, PAYLOAD])
def test_the_hopper_finds_its_rhythm(graph, payload):
    """The height lost with a payload is relative to the offline run without it."""
    listener, height, force = graph.node("listener"), [], []
    listener.create_subscription(PoseStamped, "/hopper/base", lambda m: height.append(m.pose.position.z), qos.SAMPLES)
    listener.create_subscription(
        WrenchStamped, "/hopper/contact", lambda m: force.append(m.wrench.force.z), qos.SAMPLES
    )
    graph.add(NODES["hopping"])
    simulator = graph.add(
        HopperSimulatorNode, mode="lockstep", duration=TICKS * PERIOD, payload=payload * Hopper().trunk_mass
    )
    graph.until(lambda: simulator.finished.done() and min(len(height), len(force)) > TICKS)
    z, late = np.array(height[TICKS // 2 :]), np.array(force[TICKS // 2 :])
    cycles = Cycles(PERIOD * np.arange(len(z)), z, 0.5 * float(z.min() + z.max()))
    apexes = np.array([piece.max() for piece in cycles.each(z)]) - Hopper().leg_height(Hopper().standing(CROUCH)[:2])
    assert len(apexes) >= 5 and relative_sd(apexes) < 1e-2
    if payload:
        assert 0.92 < cycles.swings.mean() / hop(reference_controller(), 0.0, TICKS * PERIOD).amplitude < 1.0
    else:
        assert np.mean(late == 0.0) > 0.4


@pytest.mark.parametrize("request_", [Push.Request(impulse=[1.0] * 4), Hold.Request(duration=1.0)])
def test_nobody_pushes_or_holds_the_hopper(graph, request_):
    graph.add(HopperSimulatorNode, mode="lockstep")
    service = type(request_).__name__.split("_")[0]
    client = graph.node("peer").create_client(
        {"Push": Push, "Hold": Hold}[service], f"/hopper_simulator/{service.lower()}"
    )
    graph.until(client.service_is_ready)
    answer = client.call_async(request_)
    graph.until(answer.done)
    assert not answer.result().success and "hopper" in answer.result().message
