"""The tables of docs/wire.md equal what the nodes declare; `python tests/test_docs_wire.py` writes them."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import rclpy
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from via_controllers.nodes.adaptive_limit_cycle import AdaptiveLimitCycleNode
from via_controllers.nodes.commanded_torque import CommandedTorqueNode
from via_controllers.nodes.controller import ControllerNode
from via_controllers.nodes.equilibrium_preset import EquilibriumPresetNode
from via_core.vsa_arms import load_vsa_arm
from via_estimators.nodes.estimator import BANK, EstimatorNode
from via_estimators.nodes.payload import PayloadNode
from via_gap.nodes.monitor import MonitorNode
from via_ros.domains import reserved_domain
from via_ros.spin import close_all
from via_sim.nodes.arm_simulator import ArmSimulatorNode
from via_sim.nodes.simulator import SimulatorNode

PAGE = Path(__file__).resolve().parents[1] / "docs" / "wire.md"
BEGIN, END = "<!-- begin of the tables -->\n", "<!-- end of the tables -->\n"
NODES: tuple[tuple[Callable[..., Any], dict[str, Any]], ...] = (
    (SimulatorNode, {"mode": "free"}),  # the mode that publishes /clock
    (EstimatorNode, {}),
    (EstimatorNode, {"device": "compact_vpda"}),
    (partial(EstimatorNode, BANK), {"methods": ["modulated_torque"]}),
    (partial(ControllerNode, "excitation"), {}),
    (CommandedTorqueNode, {}),
    (EquilibriumPresetNode, {"feedback": True}),
    (MonitorNode, {}),
    (ArmSimulatorNode, {}),
    (AdaptiveLimitCycleNode, {"adapt": True}),
    (PayloadNode, {}),
)
# Of every node, or of every lifecycle node; not a contract of VIA.
COMMON = re.compile(
    r"/(rosout|parameter_events|transition_event|change_state|get_parameter_types|get_type_description)$"
    r"|_parameters(_atomically)?$|/get_(state|available_states|available_transitions|transition_graph)$"
)


def tables(context: Any) -> str:
    """Topics and services of the nodes as Markdown."""
    topics: dict[tuple[str, str], tuple[set[str], set[str]]] = defaultdict(lambda: (set(), set()))
    services: dict[tuple[str, str], set[str]] = defaultdict(set)
    for kind, parameters in NODES:
        overrides = [Parameter(name, value=value) for name, value in parameters.items()]
        node = kind(context=context, parameter_overrides=overrides)
        try:
            own = node.get_name()
            for way, ends in enumerate((node.publishers, node.subscriptions)):
                for end in ends:
                    name = generic(end.topic_name)
                    if not COMMON.search(name):
                        topics[name, type_of(end.msg_type)][way].add(f"`{own}` ({depth(end.qos_profile)})")
            for service in node.services:
                name = generic(service.service_name)
                if not COMMON.search(name):
                    services[name, type_of(service.srv_type)].add(f"`{own}`")
        finally:
            close_all([node])
    lines = ["| Topic | Type | Published by | Subscribed by |\n|---|---|---|---|\n"]
    for (topic, message), ends in sorted(topics.items()):
        lines.append(f"| `{topic}` | {message} | {listed(ends[0])} | {listed(ends[1])} |\n")
    lines.append("\n| Service | Type | Offered by |\n|---|---|---|\n")
    lines += [f"| `{name}` | {service} | {listed(who)} |\n" for (name, service), who in sorted(services.items())]
    return "".join(lines)


def generic(name: str) -> str:
    """A topic or service with placeholders for device, arm, its joints and method."""
    for device in ("cubic_demo", "compact_vpda", "qbmove_a"):
        name = re.sub(rf"/{device}(?=/|$)", "/<device>", name)
    for joint in load_vsa_arm("reference_4dof").joints:
        name = re.sub(rf"/{joint}(?=/|$)", "/<joint>", name)
    return re.sub(r"/(reference_4dof)(?=/|$)", "/<arm>", name).replace("/modulated_torque/", "/<method>/")


def type_of(kind: Any) -> str:
    """The ROS name of a message or service class, without its middle part."""
    package, _, _ = kind.__module__.partition(".")
    return f"{package}/{kind.__name__}"


def depth(profile: Any) -> int:
    """Depth of a profile, which is reliable and volatile like those of all topics in the table."""
    assert profile.reliability == ReliabilityPolicy.RELIABLE
    assert profile.durability == DurabilityPolicy.VOLATILE
    return profile.depth


def listed(nodes: set[str]) -> str:
    """Nodes, or a dash."""
    return ", ".join(sorted(nodes)) or "-"


def parts(page: str) -> tuple[str, str, str]:
    """The page before, between and after the marks."""
    before, _, rest = page.partition(BEGIN)
    between, _, after = rest.partition(END)
    return before, between, after


@pytest.fixture
def context(domain: int) -> Iterator[Any]:
    own = rclpy.Context()
    rclpy.init(args=[], context=own, domain_id=domain)
    yield own
    own.try_shutdown()


def test_the_tables_equal_what_the_nodes_declare(context: Any):
    assert parts(PAGE.read_text(encoding="utf-8"))[1] == tables(context)


if __name__ == "__main__":
    with reserved_domain() as number:
        made = rclpy.Context()
        rclpy.init(args=[], context=made, domain_id=number)
        before, _, after = parts(PAGE.read_text(encoding="utf-8"))
        PAGE.write_text(before + BEGIN + tables(made) + END + after, encoding="utf-8")
        made.try_shutdown()
