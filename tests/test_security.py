"""The SROS2 policy allows each node what it does in the graph, and nothing else.

`python tests/test_security.py` writes via_bringup/security/policy.xml from the entries of the nodes in the graph.
"""

from __future__ import annotations

import gc
import os
import re
import shutil
import subprocess
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from xml.etree import ElementTree

import pytest
import rclpy
from rclpy.action import ActionServer
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from test_docs_wire import generic
from test_executables import COMMON, DEVICE, EXECUTABLES, NEEDS, Needs, started, until_it_publishes
from via_bringup import security
from via_bringup.cli.ros.launch_files import configured, described, nodes
from via_bringup.cli.ros.session import session
from via_controllers.nodes.single import NODES as CONTROLLERS
from via_core.bags.writer import BagWriter
from via_core.errors import ViaError
from via_core.vsa_arms import load_vsa_arm
from via_core.wire import SECOND
from via_estimators.methods import METHODS
from via_estimators.nodes import dynamic_joint_states
from via_estimators.nodes.estimator import BANK, EstimatorNode
from via_estimators.nodes.payload import PayloadNode
from via_gap.nodes.monitor import MonitorNode
from via_ros.conversions import JointStateWriter
from via_ros.domains import reserved_domain
from via_ros.nodes.player import Player
from via_ros.nodes.recorder import Recorder
from via_ros.spin import close_all, make_executor, remove, spin_until
from via_sim.nodes.arm_simulator import ArmSimulatorNode
from via_sim.nodes.hopper_simulator import HopperSimulatorNode
from via_sim.nodes.simulator import SimulatorNode

ROOT = Path(__file__).resolve().parents[1]
LAUNCH = ROOT / "via_bringup" / "launch" / "joint.launch.py"
POLICY = ROOT / "via_bringup" / "security" / "policy.xml"
HEAD = """<?xml version="1.0" encoding="UTF-8"?>
<!-- What each node of VIA may do, as `ros2 security` reads it, with placeholders: {device}, {method} of a device, {arm}
     and {joint} of an arm. `via security` fills them in. Written by tests/test_security.py: do not edit. -->
"""
Permissions = dict[tuple[str, str], set[str]]  # (kind, rule) -> names
ARM, JOINTS = "reference_4dof", ("cubic_demo", "compact_vpda")
# Per node: how to make it, and sets of parameters whose entries are united.
NODES: dict[str, tuple[Callable[..., Any], tuple[dict[str, Any], ...]]] = {
    "simulator": (SimulatorNode, ({"mode": "free", "truth": True},)),
    "arm_simulator": (ArmSimulatorNode, ({"mode": "free"},)),
    "hopper_simulator": (HopperSimulatorNode, ({"mode": "free"},)),
    "estimator": (EstimatorNode, tuple({"device": each} for each in (*JOINTS, "maccepavd"))),
    "estimator_bank": (
        partial(EstimatorNode, BANK), tuple({"device": each, "methods": ["all"]} for each in (*JOINTS, "maccepavd")),
    ),
    "dynamic_joint_states": (dynamic_joint_states.DynamicJointStatesNode, ({},)),
    "payload": (PayloadNode, ({},)),
    "gap_monitor": (MonitorNode, ({},)),
    **{name: (node, ({},)) for name, node in CONTROLLERS.items()},
    "equilibrium_preset": (CONTROLLERS["equilibrium_preset"], ({"feedback": True},)),
    "modal_limit_cycle": (CONTROLLERS["modal_limit_cycle"], ({"adapt": True},)),
    "recorder": (Recorder, ({"bag": "{folder}/new"},)),
    "player": (Player, ({"bag": "{folder}/bag"},)),
}  # fmt: skip
RENAMED = ("simulator", "excitation")  # arm.launch.py gives them the name of the device, too
DEADLINE = 600.0  # [s] after which something hangs
SIMULATORS = ("simulator", "arm_simulator", "hopper_simulator")
SESSION = "_via_*"  # node of a command


def entries(probe: Any, name: str) -> Permissions:
    """What a node has in the graph, its own names beginning with ~."""
    found: Permissions = defaultdict(set)
    for key, names in (
        (("topics", "publish"), probe.get_publisher_names_and_types_by_node(name, "/")),
        (("topics", "subscribe"), probe.get_subscriber_names_and_types_by_node(name, "/")),
        (("services", "reply"), probe.get_service_names_and_types_by_node(name, "/")),
        (("services", "request"), probe.get_client_names_and_types_by_node(name, "/")),
    ):
        for each, _ in names:
            own = "~" + each.removeprefix(f"/{name}") if each.startswith(f"/{name}/") else each
            action, hidden, _ = own.partition("/_action/")
            rule = {"reply": "execute", "publish": "execute"}.get(key[1], "call")
            found[("actions", rule) if hidden else key].add(action)
    return dict(found)


def shortened(name: str) -> str:
    """A name with placeholders."""
    for method in METHODS:
        name = name.replace(f"/{method}/", "/<method>/")
    for device in (*JOINTS, "maccepavd", "qbmove_a", "visco_elastic_demo"):
        name = re.sub(rf"/{device}(?=/|$)", "/<device>", name)
    return re.sub(r"<(\w+)>", r"{\1}", generic(name))


@contextmanager
def alone(context: Any, kind: Callable[..., Any], parameters: dict[str, Any], folder: str) -> Iterator[Any]:
    """A node that runs as long as its entry is read."""
    filled = {key: each.format(folder=folder) if key == "bag" else each for key, each in parameters.items()}
    node = kind(context=context, parameter_overrides=[Parameter(name, value=each) for name, each in filled.items()])
    try:
        yield node
    finally:
        close_all([node])


def is_complete(probe: Any, node: Any) -> bool:
    """Whether the graph has all that a node of this process has."""
    if node.get_name() not in probe.get_node_names():
        return False
    seen = entries(probe, node.get_name())
    own = f"/{node.get_name()}/"

    def listed(kind: str, rule: str, names: Iterable[str]) -> bool:
        return {f"~/{each[len(own) :]}" if each.startswith(own) else each for each in names} <= seen.get(
            (kind, rule), set()
        )

    acts = any(isinstance(each, ActionServer) for each in node.waitables)
    return (
        listed("topics", "publish", (each.topic_name for each in node.publishers))
        and listed("topics", "subscribe", (each.topic_name for each in node.subscriptions))
        and listed("services", "reply", (each.service_name for each in node.services))
        and acts == (("actions", "execute") in seen)
    )


def write_bag(folder: Path) -> None:
    """A bag with ten samples in ten seconds."""
    writer = JointStateWriter(DEVICE)
    with BagWriter(folder / "bag") as bag:
        bag.add_topic("/joint_states", "sensor_msgs/msg/JointState")
        for k in range(1, 11):
            bag.write("/joint_states", serialize_message(writer.stamped(k * SECOND)), log_time=k * SECOND)


def observed(context: Any) -> dict[str, Permissions]:
    """Permissions of all nodes, generic, from the graph."""
    probe, found = rclpy.create_node("probe", context=context), dict[str, Permissions]()
    executor = make_executor(context=context)
    executor.add_node(probe)
    stubs = pytest.MonkeyPatch()
    if dynamic_joint_states.DynamicJointState is None:  # only its topic counts
        stubs.setattr(dynamic_joint_states, "DynamicJointState", JointState)
    with TemporaryDirectory() as folder:
        write_bag(Path(folder))
        for name, (kind, sets) in NODES.items():
            united: Permissions = defaultdict(set)
            for parameters in sets:
                with alone(context, kind, parameters, folder) as node:
                    assert spin_until(executor, partial(is_complete, probe, node), DEADLINE), name
                    for key, names in entries(probe, name).items():
                        united[key] |= {shortened(each) for each in names}
            found[name] = dict(united)
    stubs.undo()
    remove(executor, probe)
    executor.shutdown()
    close_all([probe])
    return with_choices(found)


def with_choices(found: dict[str, Permissions]) -> dict[str, Permissions]:
    """Add what the entries do not show: a simulator that looks for a second one, and what the other three are for."""
    publish, subscribe = ("topics", "publish"), ("topics", "subscribe")
    nodes = set(found)

    def union(key: tuple[str, str], names: set[str] = nodes) -> set[str]:
        called = {each: {each, f"{{device}}_{each}"} if each in RENAMED else {each} for each in names}
        return {
            f"/{name}{each[1:]}" if each.startswith("~") else each
            for node in names
            for each in found[node].get(key, ())
            for name in called[node]
        }

    topics = union(publish) | union(subscribe)
    estimates = {each for each in union(publish, {"estimator", "estimator_bank", "payload"}) if "{" in each}
    found["cli"] = {
        publish: {"/{device}/reference", "/parameter_events"},
        subscribe: topics,
        ("services", "request"): union(("services", "reply")),
        ("services", "reply"): {f"/{SESSION}/get_type_description"},
        ("actions", "call"): union(("actions", "execute")),
    }
    found["recorder"][subscribe] = topics
    found["player"] |= {publish: topics, subscribe: estimates}
    for each in SIMULATORS:
        found[each][subscribe] |= {"/joint_states"}
    return found


def document(found: dict[str, Permissions]) -> str:
    """The policy as XML."""
    root = ElementTree.Element("policy", version="0.2.0")
    enclaves = ElementTree.SubElement(root, "enclaves")
    for name, permissions in sorted(found.items()):
        enclave = ElementTree.SubElement(enclaves, "enclave", path=f"/via/{name}")
        profiles = ElementTree.SubElement(enclave, "profiles")
        for node in (name, f"{{device}}_{name}") if name in RENAMED else (name,):
            profile = ElementTree.SubElement(profiles, "profile", ns="/", node=node)
            for (kind, rule), names in sorted(permissions.items()):
                group = ElementTree.SubElement(profile, kind, {rule: "ALLOW"})
                for each in sorted(names):
                    ElementTree.SubElement(group, kind[:-1]).text = each
    ElementTree.indent(root)
    return HEAD + ElementTree.tostring(root, encoding="unicode") + "\n"


def profiles(text: str) -> dict[str, Permissions]:
    """Permissions of each node of a policy."""
    return {
        str(profile.get("node")): {
            (group.tag, next(iter(group.attrib))): {str(each.text) for each in group} for group in profile
        }
        for profile in ElementTree.fromstring(text.encode()).iter("profile")
    }


@pytest.fixture
def context() -> Iterator[Any]:
    """In a domain of its own: lifecycle nodes of a test that failed stay in the graph as long as its error."""
    with reserved_domain() as domain:
        own = rclpy.Context()
        rclpy.init(args=[], context=own, domain_id=domain)
        yield own
        own.try_shutdown()
        gc.collect()  # lifecycle nodes lie in cycles of references, and would stay in the graph of later tests


def test_the_shipped_policy_is_what_the_nodes_have_in_the_graph(context):
    assert POLICY.read_text(encoding="utf-8") == document(observed(context))


def test_every_executable_has_an_enclave():
    """Those of single methods are the node `estimator` with a fixed method, and have none."""
    executables = {name for _, name in EXECUTABLES} - set(METHODS) - {"via"}
    paths = {each.get("path") for each in ElementTree.parse(POLICY).iter("enclave")}
    assert paths == {f"/via/{name}" for name in {*executables, "cli"}}


@pytest.fixture
def folder(tmp_path):
    """A folder with the bag that the player needs."""
    write_bag(tmp_path)
    return tmp_path


STARTED = [each for each in NODES if each != "dynamic_joint_states"]


def is_listed(probe: Any, name: str) -> bool:
    """Whether the graph knows a node with its services and with topics that not every node has."""
    if name not in probe.get_node_names():
        return False
    seen = entries(probe, name)
    return ("services", "reply") in seen and bool(seen.get(("topics", "publish"), set()) - COMMON)


@pytest.mark.parametrize("name", STARTED)
def test_a_started_node_does_nothing_that_the_policy_for_its_device_forbids(graph, folder, name):
    package = next(package for package, executable in EXECUTABLES if executable == name)
    process = started(package, name, folder)
    try:
        until_it_publishes(graph, process, NEEDS.get(name, Needs()).samples)
        (tester,) = [each for each in graph.nodes if each.get_name() == "tester"]
        graph.until(lambda: is_listed(tester, name))
        seen = entries(tester, name)
    finally:
        process.kill()
        process.communicate()
    allowed = profiles(security.policy([DEVICE.name], ["reference_2dof"]))[name]
    for key, names in seen.items():
        assert names <= allowed.get(key, set()), key


def test_the_commands_do_nothing_that_the_policy_forbids(graph, monkeypatch):
    allowed = profiles(security.policy([], []))["cli"]
    probe = graph.node("probe")
    with session() as now:
        name = now.node.get_name()
        graph.until(lambda: name in probe.get_node_names())
        graph.until(lambda: ("services", "reply") in entries(probe, name))
        seen = entries(probe, name)
    for key, names in seen.items():
        full = {each.replace("~", f"/{SESSION}") for each in names}
        assert full <= allowed[key]


def test_placeholders_are_filled_for_every_device_and_joint():
    found = profiles(security.policy(["left=qbmove_a", "compact_vpda"], ["reference_2dof"]))
    assert "{" not in security.policy(["left=qbmove_a"], ["reference_2dof"])
    assert {"/left/command", "/compact_vpda/command"} <= found["simulator"]["topics", "subscribe"]
    assert "/left/modulated_torque/stiffness" in found["estimator_bank"]["topics", "publish"]
    joints = load_vsa_arm("reference_2dof").joints
    assert {f"/{each}/stiffness" for each in joints} <= found["modal_limit_cycle"]["topics", "subscribe"]
    assert {"left_simulator", "compact_vpda_excitation"} <= found.keys()
    nobody = profiles(security.policy([], []))
    assert "{" not in security.policy([], []) and ("topics", "subscribe") in nobody["hopping"]
    assert ("topics", "publish") in nobody["excitation"] and not [
        each for each in nobody["excitation"]["topics", "publish"] if each.endswith("/command")
    ]


def test_nodes_join_under_the_enclave_of_their_executable(graph):
    entities = described(LAUNCH)
    (entity,) = [each for each in nodes(entities, configured(entities, {})) if each.executable == "excitation"]
    assert list(entity.ros_arguments) == ["--enclave", "/via/excitation"]
    process = subprocess.Popen(["via", "run", "via_sim", "simulator"], stderr=subprocess.DEVNULL)
    probe = graph.node("probe")
    try:
        found = probe.get_node_names_and_namespaces_with_enclaves
        graph.until(lambda: ("simulator", "/", "/via/simulator") in found())
    finally:
        process.kill()
        process.wait()


def test_the_key_store_is_made_by_ros2_security(tmp_path, monkeypatch):
    """With a stand-in for the command, which notes its arguments."""
    tool = tmp_path / "bin" / "ros2"
    tool.parent.mkdir()
    tool.write_text('#!/bin/sh\nif [ -n "$ROS_SECURITY_ENABLE" ]; then exit 1; fi\necho "$@" > "$4/arguments"\n')
    tool.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tool.parent}:{os.environ['PATH']}")
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
    store = tmp_path / "keys"
    security.make_key_store(store, ["qbmove_a"], [])
    assert (store / "arguments").read_text() == f"security generate_artifacts -k {store} -p {store}/policy.xml\n"
    assert "<id>7</id>" in (store / "enclaves" / "governance.xml").read_text()
    assert (store / "policy.xml").read_text() == security.policy(["qbmove_a"], [])
    (store / "enclaves" / "governance.p7s").touch()
    (store / "enclaves" / "governance.xml").write_text("signed")
    security.make_key_store(store, ["qbmove_b"], [])
    assert (store / "enclaves" / "governance.xml").read_text() == "signed"
    tool.write_text("#!/bin/sh\necho 'invalid choice: security' >&2\nexit 2\n")
    with pytest.raises(ViaError, match=r"invalid choice: security; if it is missing, on a stock Jazzy: sudo apt"):
        security.make_key_store(store, [], [])


@pytest.mark.skipif(shutil.which("ros2") is not None, reason="ros2 is installed here")
def test_without_ros2_security_one_line_has_the_remedy(tmp_path):
    done = subprocess.run(["via", "security", "keys"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert (
        "keys has policy and governance, but no keys; on a stock Jazzy: sudo apt install ros-jazzy-sros2" in done.stderr
    )
    assert (tmp_path / "keys" / "policy.xml").is_file()


def test_sros2_signs_the_permissions_of_every_enclave(tmp_path):
    pytest.importorskip("sros2", reason="SROS2 has no wheel")
    security.make_key_store(tmp_path, ["qbmove_a"], ["reference_2dof"])
    paths = [each.get("path") for each in ElementTree.parse(POLICY).iter("enclave")]
    assert all((tmp_path / "enclaves" / str(path)[1:] / "permissions.p7s").is_file() for path in paths)


@pytest.mark.skipif("_ROS_WHEELS_BOOTSTRAP_COMPLETE" not in os.environ, reason="ROS does not come from wheels here")
def test_the_middleware_of_the_wheels_refuses_security(domain, tmp_path):
    """A node that has to be secure does not start, instead of starting without security."""
    enclave = tmp_path / "enclaves" / "via" / "simulator"
    enclave.mkdir(parents=True)
    for name in ("identity_ca.cert.pem", "permissions_ca.cert.pem", "cert.pem", "key.pem"):
        (enclave / name).touch()
    for name in ("governance.p7s", "permissions.p7s"):
        (enclave / name).touch()
    secured = {"ENABLE": "true", "STRATEGY": "Enforce", "KEYSTORE": str(tmp_path)}
    own = os.environ | {f"ROS_SECURITY_{name}": value for name, value in secured.items()}
    run = ["via", "run", "via_sim", "simulator"]
    done = subprocess.run(run, env=own, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 2
    assert "This Fast DDS version doesn't have the security libraries" in done.stderr
    assert "Traceback" not in done.stderr


if __name__ == "__main__":
    with reserved_domain() as number:
        made = rclpy.Context()
        rclpy.init(args=[], context=made, domain_id=number)
        POLICY.write_text(document(observed(made)), encoding="utf-8")
        made.try_shutdown()
