"""A stock controller_manager drives a joint over topics: tried with stand-ins that send and receive its messages."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from math import nan
from pathlib import Path

import numpy as np
import pytest
import yaml
from ros2_control_stand_in import TORQUE, TopicHardware
from sensor_msgs.msg import JointState
from test_joint_nodes import JointBench
from via_bringup.cli.ros.launch_files import configured, described, messages, nodes
from via_controllers.nodes.single import NODES
from via_core.bags.definitions import typestore_of
from via_core.devices import load_device
from via_core.errors import ParameterError
from via_core.status import Status
from via_export import ros2_control_topics as topics
from via_interfaces.msg import ControlState, DampingEstimate, StiffnessEstimate, VsaCommand
from via_ros import qos
from via_ros.conversions import efforts_of, set_stamp

ROOT = Path(__file__).resolve().parents[1]
LAUNCH = ROOT / "via_bringup" / "launch" / "ros2_control.launch.py"
NAME = "qbmove_a"
DEVICE = load_device(NAME)
PACKAGES = {
    "controller_manager": ("ros2_control_node", "spawner"),
    "robot_state_publisher": ("robot_state_publisher",),
    **dict.fromkeys(("joint_state_topic_hardware_interface", "joint_state_broadcaster"), ()),
    "forward_command_controller": (),
}
MANIFEST = """<package format="3">
  <name>control_msgs</name><version>5.0.0</version><description>stand-in</description>
  <maintainer email="a@b.org">a</maintainer><license>Apache-2.0</license>
  <buildtool_depend>ament_cmake</buildtool_depend><build_depend>rosidl_default_generators</build_depend>
  <depend>std_msgs</depend><member_of_group>rosidl_interface_packages</member_of_group>
  <export><build_type>ament_cmake</build_type></export>
</package>
"""
CMAKE = """cmake_minimum_required(VERSION 3.8)
project(control_msgs)
find_package(ament_cmake REQUIRED)
find_package(std_msgs REQUIRED)
find_package(rosidl_default_generators REQUIRED)
rosidl_generate_interfaces(${PROJECT_NAME} msg/InterfaceValue.msg msg/DynamicJointState.msg DEPENDENCIES std_msgs)
ament_package()
"""


class ControlledBench(JointBench):
    """A simulated joint in lockstep, driven through the hardware interface.

    control  returns efforts (2,) [N m] for the hardware and the number of samples so far; None: nothing is sent
    """

    def __init__(self, graph, control, duration, **parameters):
        super().__init__(graph, NAME, NODES["commanded_torque"], parameters, duration=duration, listeners=3)
        self.hardware = TopicHardware(graph.node("controller_manager"), topics.robot(DEVICE))

        def update(_):
            efforts = control(self.hardware, len(self.samples)) if self.hardware.states else None
            if efforts is not None:
                self.hardware.write(np.asarray(efforts, dtype=float))

        self.peer.create_subscription(JointState, "/joint_states", update, qos.SAMPLES)
        self.finish()


def test_a_controller_moves_the_motors_to_their_references(graph):
    goal = np.array([0.3, -0.2])  # [rad]
    gain, damping = 20.0, 0.6  # [N m/rad], [N m s/rad]
    before = {}

    def control(hardware, tick):
        theta = np.array([hardware.states[each][0] for each in DEVICE.motor_joints])
        rate = (theta - before.get("theta", theta)) / 1e-3
        before["theta"] = theta
        return gain * (goal - theta) - damping * rate

    bench = ControlledBench(graph, control, 2.0, timeout=0.1)
    reached = np.array([bench.hardware.states[each][0] for each in DEVICE.motor_joints])
    assert set(bench.hardware.states) == {DEVICE.link_joint, *DEVICE.motor_joints}
    assert bench.hardware.commanded == list(DEVICE.motor_joints)
    spring = np.abs(DEVICE.torque_each(bench.hardware.states[DEVICE.link_joint][0], reached))
    assert np.abs(reached - goal) == pytest.approx(spring / gain, abs=0.02)  # a proportional controller under load
    assert {activity for activity, _, _ in bench.states} == {ControlState.ACTIVE}


def test_limits_hold_whatever_is_commanded(graph):
    bench = ControlledBench(graph, lambda *_: [1e3, -1e3], 0.5, timeout=0.1)
    limits = np.array([each.torque_limit for each in DEVICE.motors])
    torques = np.array([motor for _, _, motor in bench.commands])
    assert (np.abs(torques) <= limits).all() and np.abs(torques).max() > 0.5 * limits.max()
    speeds = np.abs(np.diff(bench.joint[:, 0, 1:], axis=0)) / 1e-3
    assert speeds.max() <= max(each.speed_limit for each in DEVICE.motors)
    assert any(limited for _, limited, _ in bench.states)


def test_torque_ends_when_the_controller_manager_is_silent(graph):
    bench = ControlledBench(graph, lambda _, tick: [1.0, -1.0] if tick < 200 else None, 0.4)
    answers = bench.answers
    age, torques = bench.quantity("age"), np.array([answers[stamp] for stamp in sorted(answers)])
    silent = ~(age <= 0.02 + 1e-9)  # NaN before the first command
    assert not torques[silent].any()
    assert silent[-100:].all() and not silent[100:200].all()
    assert torques[~silent].any(axis=1).all()
    assert np.abs(bench.joint[-1, 2, 1:]).max() == 0.0  # the simulator's motors, too


@pytest.mark.parametrize("efforts", [[np.nan, np.nan], [1.0, np.inf]])
def test_commands_without_numbers_are_no_torque(graph, efforts):
    bench = ControlledBench(graph, lambda *_: efforts, 0.1)
    assert not any(motor.any() for _, _, motor in bench.commands)


def test_efforts_belong_to_the_joints_that_have_commands():
    joints = DEVICE.motor_joints
    others = [*joints, DEVICE.link_joint]
    assert efforts_of(JointState(name=others, effort=[1.0, 2.0]), joints).tolist() == [1.0, 2.0]
    assert efforts_of(JointState(name=others[::-1], effort=[0.0, 2.0, 1.0]), joints).tolist() == [1.0, 2.0]
    assert efforts_of(JointState(name=[DEVICE.link_joint, *joints], effort=[1.0, 2.0]), joints).tolist() == [1.0, 2.0]
    for given in (JointState(name=others), JointState(name=others, effort=[1.0]), JointState(effort=[1.0, 2.0])):
        assert np.isnan(efforts_of(given, joints)).all()


def test_the_topic_of_the_description_is_that_of_the_node(graph):
    node = graph.add(NODES["commanded_torque"], device=NAME)
    assert topics.command_topic(DEVICE) in {each.topic_name for each in node.subscriptions}


def test_a_device_without_torque_motors_is_refused():
    with pytest.raises(ParameterError, match="torques of motors"):
        topics.robot(load_device("maccepavd"))


def launched(tmp_path, **given):
    """Messages, and executables to start, of the launch file."""
    entities = described(LAUNCH)
    context = configured(entities, {"files": str(tmp_path / "files"), **given})
    return list(messages(entities, context)), [each.executable for each in nodes(entities, context)]


def prefix(folder):
    """An installation of the stand-in packages."""
    for package, executables in PACKAGES.items():
        marker = folder / "share/ament_index/resource_index/packages" / package
        marker.parent.mkdir(parents=True, exist_ok=True)
        marker.touch()
        for name in executables:
            path = folder / "lib" / package / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(f"#!{sys.executable}\nfrom ros2_control_stand_in import main\nmain({name!r})\n")
            path.chmod(0o755)
    return folder


def test_without_ros2_control_one_line_has_the_remedy_and_the_rest_starts(tmp_path, monkeypatch):
    own = [each for each in os.environ["AMENT_PREFIX_PATH"].split(":") if not each.startswith("/opt/ros")]
    monkeypatch.setenv("AMENT_PREFIX_PATH", ":".join(own))
    said, started = launched(tmp_path)
    assert len(said) == 1 and "sudo apt install ros-jazzy-controller-manager ros-jazzy-joint-state-topic" in said[0]
    assert started == ["simulator", "commanded_torque", "estimator"]
    assert launched(tmp_path, simulated="false")[1] == ["commanded_torque", "estimator"]


def test_with_ros2_control_its_nodes_start_with_the_files_of_the_user(tmp_path, monkeypatch):
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{prefix(tmp_path)}:{os.environ['AMENT_PREFIX_PATH']}")
    (tmp_path / "files").mkdir()
    own = tmp_path / "files" / f"{NAME}_controllers.yaml"
    own.write_text("mine: {}\n")
    _, started = launched(tmp_path)
    assert started[-3:] == ["robot_state_publisher", "ros2_control_node", "spawner"]
    assert own.read_text() == "mine: {}\n"
    assert (tmp_path / "files" / f"{NAME}.urdf").read_text() == topics.robot(DEVICE)


@pytest.fixture(scope="module")
def control_msgs(tmp_path_factory):
    """Folder of an installed stand-in of control_msgs: the two messages, built as every interface package."""
    folder = tmp_path_factory.mktemp("control_msgs")
    (folder / "src" / "msg").mkdir(parents=True)
    (folder / "src" / "package.xml").write_text(MANIFEST)
    (folder / "src" / "CMakeLists.txt").write_text(CMAKE)
    for name, fields in (
        ("InterfaceValue", "string[] interface_names\nfloat64[] values\n"),
        ("DynamicJointState", "std_msgs/Header header\nstring[] joint_names\nInterfaceValue[] interface_values\n"),
    ):
        (folder / "src" / "msg" / f"{name}.msg").write_text(fields)
        assert f"control_msgs/msg/{name}" in typestore_of(f"control_msgs/msg/{name}").fielddefs
    build = "colcon build --merge-install --base-paths src --cmake-args -DBUILD_TESTING=OFF"
    done = subprocess.run(
        [*build.split(), f"-DPython3_EXECUTABLE={sys.executable}"], cwd=folder, capture_output=True, text=True,
        timeout=900, env={**os.environ, "CMAKE_PREFIX_PATH": os.environ["AMENT_PREFIX_PATH"]}, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return folder / "install"


def with_ros2_control(folder, control_msgs):
    """Environment in which the stand-ins are installed."""
    (packages,) = control_msgs.glob("lib/python3*/site-packages")
    environment = dict(os.environ)
    for name, paths in {
        "AMENT_PREFIX_PATH": (prefix(folder / "ros"), control_msgs),
        "PYTHONPATH": (packages, ROOT / "tests"),
        "LD_LIBRARY_PATH": (control_msgs / "lib",),
    }.items():
        environment[name] = ":".join([*map(str, paths), environment.get(name, "")])
    return environment


def ended(process):
    process.send_signal(signal.SIGINT)
    process.wait(60)


def echoed(graph, environment, field):
    """What `via topic echo` prints of the next state, while the graph runs."""
    words = ["--once", "--field", field, "/dynamic_joint_states", "control_msgs/msg/DynamicJointState"]
    echo = subprocess.Popen(["via", "topic", "echo", *words], env=environment, stdout=subprocess.PIPE, text=True)
    graph.until(lambda: echo.poll() is not None)
    return yaml.safe_load(echo.stdout.read().split("---")[0])


def test_the_launch_file_connects_all_nodes(graph, tmp_path, control_msgs):
    """All messages of the stock controller_manager over DDS, from the description to /dynamic_joint_states."""
    environment, log, commands = with_ros2_control(tmp_path, control_msgs), tmp_path / "log.txt", []
    with log.open("wb") as output:
        process = subprocess.Popen(
            ["via", "launch", "ros2_control"], cwd=tmp_path, env=environment, stdout=output, stderr=output
        )

    def commanded():
        assert process.poll() is None and "ended" not in log.read_text(), log.read_text()
        return any(any(each.motor) for each in commands)

    try:
        peer = graph.node("peer")
        peer.create_subscription(VsaCommand, DEVICE.command_topic, commands.append, qos.SAMPLES)
        graph.until(commanded)
        assert {tuple(each.motor) for each in commands if any(each.motor)} == {(TORQUE, -TORQUE)}
        assert echoed(graph, environment, "joint_names") == [DEVICE.link_joint]
    finally:
        ended(process)
    assert "Traceback" not in log.read_text() and "apt install" not in log.read_text()


@pytest.mark.parametrize(
    ("status", "expected"), [(Status.OK, [6.0, 0.5, 0.2, 0.1]), (Status.NOT_EXCITED, [nan, nan, 0.2, 0.1])]
)
def test_stiffness_and_damping_are_state_interfaces(graph, tmp_path, control_msgs, status, expected):
    environment, peer = with_ros2_control(tmp_path, control_msgs), graph.node("peer")
    stiffness = peer.create_publisher(StiffnessEstimate, f"/{NAME}/stiffness", qos.SAMPLES)
    damping = peer.create_publisher(DampingEstimate, f"/{NAME}/damping", qos.SAMPLES)
    sample = [0]

    def estimate():
        sample[0] += 1
        for publisher, kind, values, state in (
            (stiffness, StiffnessEstimate, (6.0, 0.5), status), (damping, DampingEstimate, (0.2, 0.1), Status.OK),
        ):  # fmt: skip
            message = kind(value=values[0], standard_deviation=values[1], status=int(state))
            set_stamp(message.header.stamp, sample[0] * 1_000_000)
            publisher.publish(message)

    run = ["via", "run", "via_estimators", "dynamic_joint_states", "--ros-args", "-p", f"device:={NAME}"]
    process = subprocess.Popen(run, env=environment)
    try:
        graph.until(lambda: min(each.get_subscription_count() for each in (stiffness, damping)) == 1)
        peer.create_timer(0.01, estimate)
        graph.until(lambda: sample[0] > 100)  # both publishers are discovered
        values = echoed(graph, environment, "interface_values.0")
    finally:
        ended(process)
    assert values["interface_names"] == [
        "stiffness", "stiffness_standard_deviation", "damping", "damping_standard_deviation",
    ]  # fmt: skip
    assert values["values"] == pytest.approx(expected, nan_ok=True)
