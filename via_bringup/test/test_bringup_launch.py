"""Launch and parameter files fit what they start: a stock Jazzy runs them, this machine at least reads them."""

import ast
from dataclasses import fields
from pathlib import Path

import pytest
import yaml
from via_controllers.nodes.bang_bang import BangBangParameters
from via_controllers.nodes.excitation import ExcitationParameters
from via_controllers.nodes.modal_limit_cycle import ModalLimitCycleParameters
from via_estimators.nodes.estimator import EstimatorParameters
from via_gap.nodes.monitor import MonitorParameters
from via_sim.nodes.arm_simulator import ArmSimulatorParameters
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
}


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
def test_every_configuration_is_declared_with_a_description(file):
    declared = {ast.literal_eval(call.args[0]) for call in calls(file, "DeclareLaunchArgument")}
    asked = [*calls(file, "LaunchConfiguration"), *calls(file, "text")]
    used = {call.args[0].value for call in asked if isinstance(call.args[0], ast.Constant)}
    assert used == declared
    assert declared & {"device", "joints", "arm"}
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
