"""Every launch file: `via launch` starts its nodes, data arrive, and Ctrl-C ends all of them."""

from __future__ import annotations

import signal
import subprocess
from pathlib import Path

import numpy as np
import psutil
import pytest
from rclpy.serialization import serialize_message
from via_bringup.cli.ros.launch_files import arguments, configured, described, nodes
from via_core.bags.writer import BagWriter
from via_core.devices import load_device
from via_core.errors import ParameterError, ViaError
from via_ros import qos
from via_ros.conversions import JointStateWriter
from via_ros.interfaces import message_class

ROOT = Path(__file__).resolve().parents[1]
FILES = {each.name.removesuffix(".launch.py"): each for each in (ROOT / "via_bringup" / "launch").glob("*.launch.py")}
INTERRUPTED = 130
PLAYED = load_device("cubic_demo")
# Arguments, and a topic whose messages need every node of the file.
CASES = {
    "arm": (["joints:=j1=cubic_demo", "methods:=auto"], "/j1/modulated_torque/stiffness"),
    "estimate": (["device:=cubic_demo", "bag:=played"], "/cubic_demo/stiffness"),
    "gap": (["device:=cubic_demo", "bag:=played"], "/cubic_demo/gap"),
    "hitting": (["mode:=lockstep"], "/reference_4dof/control"),
    "hopper": (["mode:=lockstep", "payload:=1"], "/hopper/control"),
    "joint": (["mode:=lockstep", "bag:=recorded"], "/cubic_demo/stiffness"),
    "limit_cycle": (["mode:=lockstep", "adapt:=true", "payload:=0.4"], "/reference_4dof/payload"),
    "ros2_control": (["mode:=lockstep", "files:=files"], "/qbmove_a/stiffness"),
    "throw": (["mode:=lockstep"], "/visco_elastic_demo/control"),
}


@pytest.fixture
def folder(tmp_path):
    """A folder with the bag `played`: five minutes of a moving joint at 100 Hz, longer than the test."""
    writer = JointStateWriter(PLAYED)
    writer.effort[1:] = 0.0
    with BagWriter(tmp_path / "played") as bag:
        bag.add_topic("/joint_states", "sensor_msgs/msg/JointState")
        for k in range(30_000):
            writer.position[:] = 0.2 * np.sin(0.05 * k)
            bag.write("/joint_states", serialize_message(writer.stamped(k * 10**7)), log_time=k * 10**7)
    return tmp_path


def test_every_launch_file_is_started():
    assert CASES.keys() == FILES.keys()


@pytest.mark.parametrize("name", CASES)
def test_data_arrive_and_ctrl_c_ends_every_node(graph, folder, name, monkeypatch):
    given, topic = CASES[name]
    monkeypatch.chdir(folder)  # a launch file may write files when its nodes are listed
    log = folder / "log.txt"
    with log.open("wb") as output:
        process = subprocess.Popen(["via", "launch", name, *given], cwd=folder, stdout=output, stderr=output)
    listener, received = graph.node("listener"), []

    def arrived():
        assert process.poll() is None, log.read_text()
        kinds = dict(listener.get_topic_names_and_types()).get(topic)
        if kinds and not list(listener.subscriptions):
            listener.create_subscription(message_class(kinds[0]), topic, received.append, qos.SAMPLES, raw=True)
        return bool(received)

    started: list[psutil.Process] = []
    try:
        graph.until(arrived)
        started = psutil.Process(process.pid).children()
        assert len(started) == len(described_nodes(name, given))
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == INTERRUPTED
    finally:
        left = [] if process.poll() is not None else psutil.Process(process.pid).children()
        for each in (process, *left):
            each.kill()
    assert not [each for each in started if each.is_running() and each.status() != psutil.STATUS_ZOMBIE]
    text = log.read_text()
    assert text.endswith("interrupted\n") and "Traceback" not in text and "exit code" not in text
    assert (folder / "recorded" / "metadata.yaml").is_file() or "bag:=recorded" not in given


def described_nodes(name, given):
    entities = described(FILES[name])
    return list(nodes(entities, configured(entities, dict(each.split(":=") for each in given))))


def test_arguments_have_the_types_of_the_parameters():
    (simulator, *_) = described_nodes("hopper", ["payload:=3"])
    words = simulator.command(configured(described(FILES["hopper"]), {"payload": "3"}))
    assert "payload:=3.0" in words and 'mode:="realtime"' in words
    assert words[words.index("--params-file") + 1].endswith("config/hopper.yaml")


def test_the_law_chooses_the_controller():
    def started(controller):
        return {each.executable for each in described_nodes("limit_cycle", [f"controller:={controller}"])}

    assert started("bang_bang") - started("modal_limit_cycle") == {"bang_bang"}


@pytest.mark.parametrize(
    ("given", "complaint"),
    [
        ({}, r"add device:=VALUE, device name or path"),
        (
            {"device": "cubic_demo", "speed": "1"},
            "no launch argument speed; there are: bag, device, discovery, method, rate",
        ),
    ],
)
def test_wrong_arguments_are_named(given, complaint):
    with pytest.raises(ParameterError, match=complaint):
        configured(described(FILES["estimate"]), given)


def test_a_launch_file_beyond_the_subset_is_refused(tmp_path):
    (tmp_path / "foreign.launch.py").write_text("from launch.actions import ExecuteProcess\n")
    with pytest.raises(ViaError, match=r"ExecuteProcess.*ROS's own `launch`"):
        described(tmp_path / "foreign.launch.py")


def test_every_argument_is_described():
    assert all(each.description for file in FILES.values() for each in arguments(described(file)))
