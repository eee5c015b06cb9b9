"""Launch and parameter files fit what they start: a stock Jazzy runs them, this machine at least reads them."""

import ast
import re
from dataclasses import fields
from pathlib import Path

import pytest
import yaml
from via_bringup.control.bang_bang import MOTORS, damped_arm
from via_bringup.control.hitting import stand_of
from via_bringup.demo.scenes import PUT_ASIDE, WALL_AT
from via_controllers.nodes.bang_bang import BangBangParameters
from via_controllers.nodes.excitation import ExcitationParameters
from via_controllers.nodes.hopping import HoppingParameters
from via_controllers.nodes.max_velocity import MaxVelocityParameters
from via_controllers.nodes.modal_limit_cycle import ModalLimitCycleParameters
from via_estimators.nodes.estimator import BankParameters, EstimatorParameters
from via_gap.nodes.monitor import MonitorParameters
from via_ros.nodes.player import Parameters as PlayerParameters
from via_ros.nodes.recorder import Parameters as RecorderParameters
from via_sim.nodes.arm_simulator import ArmSimulatorParameters
from via_sim.nodes.hopper_simulator import HopperSimulatorParameters
from via_sim.nodes.simulator import SimulatorParameters

PACKAGE = Path(__file__).resolve().parent.parent
ROOT = PACKAGE.parent
LAUNCH_FILES = sorted((PACKAGE / "launch").glob("*.launch.py"))
PARAMETERS = {
    "joint.yaml": {
        "simulator": SimulatorParameters,
        "excitation": ExcitationParameters,
        "estimator": EstimatorParameters,
    },
    "gap.yaml": {"gap_monitor": MonitorParameters},
    "modal_limit_cycle.yaml": {
        "arm_simulator": ArmSimulatorParameters,
        "modal_limit_cycle": ModalLimitCycleParameters,
    },
    "bang_bang.yaml": {"arm_simulator": ArmSimulatorParameters, "bang_bang": BangBangParameters},
    "hitting.yaml": {"arm_simulator": ArmSimulatorParameters, "bang_bang": BangBangParameters},
    "hopper.yaml": {"hopper_simulator": HopperSimulatorParameters, "hopping": HoppingParameters},
    "throw.yaml": {"simulator": SimulatorParameters, "max_velocity": MaxVelocityParameters},
}
OWN = {  # what executables take in launch files
    **{executable: kind for each in PARAMETERS.values() for executable, kind in each.items()},
    "estimator_bank": BankParameters,
    "player": PlayerParameters,
    "recorder": RecorderParameters,
}
ROBOTS = {"hitting.launch.py", "hopper.launch.py"}  # these start one robot and no other


def calls(file: Path, name: str) -> list[ast.Call]:
    tree = ast.parse(file.read_text(encoding="utf-8"))
    return [
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == name
    ]


def given(call: ast.Call, key: str) -> object:
    return next(ast.literal_eval(each.value) for each in call.keywords if each.arg == key)


def test_there_are_launch_files():
    assert {file.name for file in LAUNCH_FILES} >= {"arm.launch.py", "joint.launch.py", "estimate.launch.py"}


@pytest.mark.parametrize("file", LAUNCH_FILES, ids=lambda file: file.name)
def test_every_node_is_an_installed_executable(file):
    nodes = calls(file, "Node")
    assert nodes
    for node in nodes:
        package, executable = given(node, "package"), given(node, "executable")
        assert f'"{executable} = {package}.nodes.' in (ROOT / str(package) / "setup.py").read_text(encoding="utf-8")


@pytest.mark.parametrize("file", LAUNCH_FILES, ids=lambda file: file.name)
def test_every_parameter_is_one_that_its_node_has(file):
    for node in calls(file, "Node"):
        known = {item.name for item in fields(OWN[str(given(node, "executable"))])}
        entries = next(each.value for each in node.keywords if each.arg == "parameters")
        told = {
            ast.literal_eval(key)
            for each in ast.walk(entries)
            if isinstance(each, ast.Dict)
            for key in each.keys
            if key
        }
        assert told <= known


@pytest.mark.parametrize("file", LAUNCH_FILES, ids=lambda file: file.name)
def test_every_parameter_file_named_is_there(file):
    named = set(re.findall(r'"(\w+\.yaml)"', file.read_text(encoding="utf-8")))
    assert named <= {each.name for each in (PACKAGE / "config").iterdir()}


@pytest.mark.parametrize("file", LAUNCH_FILES, ids=lambda file: file.name)
def test_every_configuration_is_declared_with_a_description(file):
    declared = {ast.literal_eval(call.args[0]) for call in calls(file, "DeclareLaunchArgument")}
    asked = [*calls(file, "LaunchConfiguration"), *calls(file, "text")]
    used = {call.args[0].value for call in asked if isinstance(call.args[0], ast.Constant)}
    assert used == declared
    assert declared & {"device", "joints", "arm"} or file.name in ROBOTS
    assert all(given(call, "description") for call in calls(file, "DeclareLaunchArgument"))


@pytest.mark.parametrize("file", PARAMETERS)
def test_parameter_file_names_parameters_that_exist(file):
    content = yaml.safe_load((PACKAGE / "config" / file).read_text(encoding="utf-8"))
    assert content.keys() == PARAMETERS[file].keys()
    for node, section in content.items():
        kind = PARAMETERS[file][node]
        known = {item.name: item for item in fields(kind)}
        values = section["ros__parameters"]
        assert values.keys() <= known.keys()
        kind(**{name: tuple(value) if isinstance(value, list) else value for name, value in values.items()})


def test_the_wall_of_the_launch_file_is_that_of_the_scene():
    content = yaml.safe_load((PACKAGE / "config" / "hitting.yaml").read_text(encoding="utf-8"))
    given, stand = content["arm_simulator"]["ros__parameters"], stand_of(WALL_AT, PUT_ASIDE)
    assert given["posture"] == pytest.approx(stand.start, abs=1e-3)
    assert given["walls"] == pytest.approx([*stand.face, *-stand.along], abs=1e-3)
    assert given["link_friction"] == pytest.approx(damped_arm().link_friction, abs=5e-3)
    assert content["bang_bang"]["ros__parameters"]["motors"] == list(MOTORS)
