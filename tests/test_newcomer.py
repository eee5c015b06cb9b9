"""What somebody new reads: nodes log what they do, which device they took, and what they wait for."""

from __future__ import annotations

import signal
import subprocess
import threading
from dataclasses import replace
from functools import partial

import pytest
from rclpy.parameter import Parameter
from std_msgs.msg import String
from via_controllers.methods import CONTROLLERS
from via_controllers.nodes.controller import ControllerNode
from via_core.devices import load_device
from via_gap.nodes.monitor import MonitorNode
from via_ros import qos
from via_ros.conversions import JointStateWriter
from via_ros.spin import STEADY

LIVE = {
    "modal_limit_cycle": {"level": 0.03, "gain": 2.0, "damping_ratio": 0.5},
    "bang_bang": {"amplitude": 0.04, "threshold": 0.6, "adaptation": 40.0},
    "hopping": {"amplitude": 0.05},
    "bang_bang_joint": {"amplitude": 0.02, "threshold": 0.2},
}


@pytest.fixture
def printed(graph, tmp_path):
    """Function that runs a command until it has printed every one of these texts, and ends it with Ctrl-C."""

    def run(command, *texts):
        process = subprocess.Popen(
            command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )  # fmt: skip
        lines: list[str] = []
        reader = threading.Thread(target=lambda: lines.extend(iter(process.stdout.readline, "")))
        reader.start()
        try:
            graph.until(lambda: all(text in "".join(lines) for text in texts) or process.poll() is not None, 200.0)
            process.send_signal(signal.SIGINT)
            assert process.wait(60) == 0
        finally:
            process.kill()
            reader.join()
        missing = [text for text in texts if text not in "".join(lines)]
        assert not missing, lines

    return run


def test_the_simulator_names_its_device_its_topics_and_what_it_waits_for(printed):
    printed(
        ["via", "run", "via_sim", "simulator"],
        "simulates cubic_demo at 1000 Hz, realtime: publishes /joint_states, takes /cubic_demo/command",
        "subscribers needed to start: 1",
        "no device was given, so 'cubic_demo' is used; choose one with -p device:=NAME",
    )


def test_the_recorder_names_wanted_topics_that_nobody_publishes(graph, printed):
    node = graph.node("talker")
    node.create_publisher(String, "/spoken", 10)
    node.create_timer(6.0, lambda: node.create_publisher(String, "/spoken_later", 10), clock=STEADY)
    printed(
        ["via", "bag", "record", "rec", "/joint_stats"],
        "records /joint_stats into rec as messages arrive; Ctrl-C ends the bag",
        "nobody publishes /joint_stats yet; published are: ",
        "/spoken",
        "/spoken_later",
    )


def test_the_estimator_says_when_the_first_sample_arrives(graph, printed):
    node, writer = graph.node("robot"), JointStateWriter(load_device("cubic_demo"))
    samples, k = node.create_publisher(type(writer.stamped(0)), "/joint_states", qos.SAMPLES), 0

    def publish():
        nonlocal k
        k += 1
        samples.publish(writer.stamped(k * 1_000_000))

    node.create_timer(0.01, publish)
    printed(
        ["via", "run", "via_estimators", "estimator", "--ros-args", "-p", "device:=cubic_demo"],
        "estimates cubic_demo by modulated_torque; waits for samples on /joint_states",
        "first sample of cubic_demo: modulated_torque publishes /cubic_demo/stiffness, /cubic_demo/motor",
    )


def values(part, name):
    """All values of fields of this name in a dataclass and its parts."""
    for key, value in getattr(part, "__dict__", {}).items():
        if key == name:
            yield value
        elif hasattr(value, "__dataclass_fields__"):
            yield from values(value, name)


@pytest.mark.parametrize("name", LIVE)
def test_a_tuned_controller_is_the_one_that_is_built_with_the_new_parameters(name):
    parameters = CONTROLLERS[name]()
    changed = replace(parameters, **LIVE[name])
    tuned, built = changed.tuned(parameters.build().supervisor), changed.build().supervisor
    for key, value in LIVE[name].items():
        assert list(values(tuned, key)) == list(values(built, key)) and value in values(tuned, key)


def test_a_controller_and_the_monitor_take_changes_while_they_run(graph):
    controller = graph.add(partial(ControllerNode, "bang_bang_joint"))
    before = controller._supervisor
    assert controller.set_parameters([Parameter("amplitude", value=0.02)])[0].successful
    assert 0.02 in values(controller._supervisor, "amplitude") and controller._supervisor is not before
    assert not controller.set_parameters([Parameter("amplitude", value=-1.0)])[0].successful
    assert not controller.set_parameters([Parameter("device", value="qbmove_a")])[0].successful
    assert 0.02 in values(controller._supervisor, "amplitude")
    monitor = graph.add(MonitorNode)
    assert monitor.set_parameters([Parameter("every", value=0.0)])[0].successful
    assert monitor.monitor._parameters.every == 0.0
    refused = monitor.set_parameters([Parameter("recent", value=40.0)])[0]
    assert (refused.successful, refused.reason) == (False, "parameter recent must lie in [0.5, 20] s, got 40")
