"""Nodes in a namespace and with remapped topics, as launch files of a lab with several robots start them."""

from __future__ import annotations

from functools import partial
from importlib.resources import files

import pytest
from sensor_msgs.msg import JointState
from via_controllers.nodes.single import NODES
from via_core.devices import load_device
from via_estimators.nodes.estimator import EstimatorNode
from via_estimators.nodes.payload import PayloadNode
from via_gap.nodes.monitor import MonitorNode
from via_interfaces.msg import StiffnessEstimate
from via_ros import qos
from via_sim.nodes.arm_simulator import ArmSimulatorNode
from via_sim.nodes.simulator import SimulatorNode

COMMON = {"/clock", "/diagnostics", "/parameter_events", "/rosout"}  # of all robots
JOINT = (
    (SimulatorNode, {"device": "qbmove_a", "truth": True}),
    (EstimatorNode, {"device": "qbmove_a"}),
    (NODES["equilibrium_preset"], {"device": "qbmove_a", "feedback": True}),
    (NODES["commanded_torque"], {"device": "qbmove_a"}),
    (MonitorNode, {"device": "qbmove_a"}),
)
ARM = (
    (ArmSimulatorNode, {}),
    (PayloadNode, {}),
    (NODES["modal_limit_cycle"], {"adapt": True}),
)


@pytest.mark.parametrize("kinds", [JOINT, ARM], ids=["joint", "arm"])
def test_all_topics_of_a_robot_are_in_the_namespace_of_its_nodes(graph, kinds):
    for kind, parameters in kinds:
        node = graph.add(partial(kind, namespace="left"), **parameters)
        topics = {name for name, _ in node.get_publisher_names_and_types_by_node(node.get_name(), "/left")}
        topics |= {name for name, _ in node.get_subscriber_names_and_types_by_node(node.get_name(), "/left")}
        assert "/left/joint_states" in topics
        assert {name for name in topics - COMMON if not name.startswith("/left/")} == set()


def test_two_robots_of_one_device_run_side_by_side(graph):
    heard = {"left": [], "right": []}
    robots = []
    for space, estimates in heard.items():
        inside = partial(partial, namespace=space)
        robots.append(graph.add(inside(SimulatorNode), device="qbmove_a", mode="lockstep", listeners=2))
        graph.add(inside(EstimatorNode), device="qbmove_a", method="modulated_torque")
        graph.add(inside(NODES["excitation"]), device="qbmove_a")
        graph.node("peer").create_subscription(
            StiffnessEstimate, f"/{space}/qbmove_a/stiffness", estimates.append, qos.SAMPLES
        )
    graph.until(lambda: all(len(each) > 100 for each in heard.values()))
    assert [robot._mixed for robot in robots] == [0, 0]


def test_a_second_simulator_on_a_remapped_topic_does_not_begin(graph):
    graph.node("peer").create_subscription(JointState, "/robot/joint_states", lambda _: None, qos.SAMPLES)
    remapped = partial(SimulatorNode, cli_args=["--ros-args", "-r", "joint_states:=/robot/joint_states"])
    first = graph.add(remapped, device="qbmove_a", rate=250.0)
    graph.until(lambda: first.ticks > 20)
    second = graph.add(remapped, device="qbmove_a", rate=250.0)
    graph.until(lambda: first.ticks > 300)
    assert second.ticks == 0


def test_a_command_topic_of_the_device_file_is_the_same_live_and_in_bags(graph, tmp_path):
    file = tmp_path / "device.yaml"
    shipped = (files("via_core") / "devices" / "qbmove_a.yaml").read_text(encoding="utf-8")
    for command, live in (("robot/motors", "/left/robot/motors"), ("/robot/motors", "/robot/motors")):
        file.write_text(f"{shipped}\nwire: {{command: {command}}}\n", encoding="utf-8")
        assert load_device(str(file)).command_topic == "/robot/motors"
        node = graph.add(partial(SimulatorNode, namespace="left"), device=str(file))
        assert node._commands.topic_name == live
        graph.remove(node)
