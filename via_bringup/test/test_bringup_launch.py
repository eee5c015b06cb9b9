"""Launch and parameter files match the nodes they start. `launch` is not on PyPI, so a stub reads the files."""

from __future__ import annotations

import re
import runpy
import sys
from collections.abc import Callable, Iterator
from dataclasses import fields
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import yaml
from via_bringup.demo.reference import ARM, MOTORS, damped_arm, wall_scene
from via_bringup.demo.scenes import START_AT, WALL_AT
from via_controllers.arm_methods import BangBangParameters, HoppingParameters, ModalLimitCycleParameters
from via_controllers.joint_methods import CommandedTorqueParameters, ExcitationParameters, MaxVelocityParameters
from via_core.devices import load_device
from via_estimators.nodes.dynamic_joint_states import DynamicJointStatesParameters
from via_estimators.nodes.estimator import BankParameters, EstimatorParameters
from via_estimators.nodes.payload import PayloadNodeParameters
from via_gap.run.monitor import MonitorParameters
from via_ros.nodes.player import Parameters as PlayerParameters
from via_ros.nodes.recorder import Parameters as RecorderParameters
from via_sim.nodes.arm_simulator import ArmSimulatorParameters
from via_sim.nodes.hopper_simulator import HopperSimulatorParameters
from via_sim.nodes.simulator import SimulatorParameters

PACKAGE = Path(__file__).resolve().parent.parent
ROOT = PACKAGE.parent
LAUNCH_FILES = sorted((PACKAGE / "launch").glob("*.launch.py"))
SIMULATIONS = [file for file in LAUNCH_FILES if file.name.split(".")[0] not in ("arm", "estimate", "gap")]
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
OWN = {  # parameter classes of the executables in launch files
    **{executable: kind for each in PARAMETERS.values() for executable, kind in each.items()},
    "commanded_torque": CommandedTorqueParameters,
    "dynamic_joint_states": DynamicJointStatesParameters,
    "estimator_bank": BankParameters,
    "payload": PayloadNodeParameters,
    "player": PlayerParameters,
    "recorder": RecorderParameters,
}
ROBOTS = {"hitting.launch.py", "hopper.launch.py"}  # these have no argument for the device


class Part:
    """Stub of any class of `launch`; keeps its arguments."""

    def __init__(self, *args: Any, **options: Any) -> None:
        self.args, self.options = args, options

    def parts(self) -> Iterator[Part]:
        """This part and, recursively, the parts among its arguments."""
        yield self
        for each in _inside([self.args, self.options]):
            yield from each.parts()


def _inside(value: Any) -> Iterator[Part]:
    if isinstance(value, Part):
        yield value
    elif isinstance(value, dict):
        yield from _inside([*value, *value.values()])
    elif isinstance(value, list | tuple):
        for each in value:
            yield from _inside(each)


class Node(Part): ...


class DeclareLaunchArgument(Part): ...


class LaunchConfiguration(Part):
    def perform(self, context: Context) -> str:
        return context[self.args[0]]


class OpaqueFunction(Part): ...


class Context(dict[str, Any]):
    """Values of the launch arguments; records which were read."""

    def __init__(self, declared: list[Part]) -> None:
        super().__init__({each.args[0]: each.options.get("default_value") for each in declared})
        self.read: list[str] = []

    def __getitem__(self, name: str) -> Any:
        self.read.append(name)
        return super().__getitem__(name)


@pytest.fixture
def described(monkeypatch: pytest.MonkeyPatch) -> Callable[[Path], list[Part]]:
    """Function that returns all parts of a launch file, with the default values of its arguments."""
    own = (Node, DeclareLaunchArgument, LaunchConfiguration, OpaqueFunction)
    for name in ("launch", "launch.actions", "launch.conditions", "launch.substitutions", "launch_ros",
                 "launch_ros.actions", "launch_ros.parameter_descriptions", "launch_ros.substitutions"):  # fmt: skip
        module = ModuleType(name)
        module.__getattr__ = lambda _: Part  # type: ignore[method-assign]
        vars(module).update({kind.__name__: kind for kind in own})
        monkeypatch.setitem(sys.modules, name, module)
    # Imports `launching` with the stubs, for this test only.
    monkeypatch.delitem(sys.modules, "via_bringup.launching", raising=False)

    def describe(file: Path) -> list[Part]:
        found = list(runpy.run_path(str(file))["generate_launch_description"]().parts())
        context = Context(of(found, DeclareLaunchArgument))
        for each in of(found, OpaqueFunction):
            found += [part for made in each.options["function"](context) for part in made.parts()]
        return [*found, *map(LaunchConfiguration, context.read)]

    yield describe
    sys.modules.pop("via_bringup.launching", None)


def of(parts: list[Part], kind: type[Part]) -> list[Part]:
    return [each for each in parts if isinstance(each, kind)]


def own_nodes(parts: list[Part]) -> list[Part]:
    """The nodes of VIA; with ros2_control installed, a launch file also starts nodes of ROS."""
    return [each for each in of(parts, Node) if each.options["package"].startswith("via_")]


def console_scripts(package: str) -> list[str]:
    """Entry points in the setup.py of a package."""
    given: dict[str, Any] = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("setuptools.setup", given.update)
        patch.chdir(ROOT / package)
        runpy.run_path("setup.py")
    return list(given["entry_points"]["console_scripts"])


def test_there_are_launch_files():
    assert {file.name for file in LAUNCH_FILES} >= {"arm.launch.py", "joint.launch.py", "estimate.launch.py"}


@pytest.mark.parametrize("file", LAUNCH_FILES, ids=lambda file: file.name)
def test_every_node_is_an_installed_executable(file, described):
    nodes = own_nodes(described(file))
    assert len(nodes) > 1
    for node in nodes:
        package, executable = node.options["package"], node.options["executable"]
        assert any(script.startswith(f"{executable} = {package}.nodes.") for script in console_scripts(package))
        assert node.options["output"] == "screen"


def test_adapt_starts_the_estimators_of_payload_and_joints(described, monkeypatch):
    monkeypatch.setattr(Context, "__init__", lambda self, declared: adapting(self, declared))

    def adapting(context, declared):
        dict.__init__(context, {each.args[0]: each.options.get("default_value") for each in declared}, adapt="true")
        context.read = []

    nodes = of(described(PACKAGE / "launch" / "limit_cycle.launch.py"), Node)
    given = {node.options["executable"]: node.options["parameters"][-1] for node in nodes}
    assert given["payload"] == {"arm": "reference_4dof"} and given["arm_simulator"]["listeners"] == 3
    assert [load_device(name).name for name in given["estimator"]["devices"]] == list(ARM.joints)


@pytest.mark.parametrize("file", LAUNCH_FILES, ids=lambda file: file.name)
def test_every_parameter_exists_in_its_node(file, described):
    for node in own_nodes(described(file)):
        known = {item.name for item in fields(OWN[node.options["executable"]])}
        given = {name for each in node.options["parameters"] if isinstance(each, dict) for name in each}
        assert given <= known


@pytest.mark.parametrize("file", LAUNCH_FILES, ids=lambda file: file.name)
def test_every_parameter_file_exists(file, described):
    named = {word for part in described(file) for word in re.findall(r"\w+\.yaml", str(part.args))}
    assert named <= {each.name for each in (PACKAGE / "config").iterdir()}
    assert (
        named
        or "parameters" not in {part.args[0] for part in of(described(file), DeclareLaunchArgument)}
        or file.name == "limit_cycle.launch.py"  # its parameter file is named after the controller
    )


@pytest.mark.parametrize("file", LAUNCH_FILES, ids=lambda file: file.name)
def test_every_configuration_is_declared_with_a_description(file, described):
    parts = described(file)
    arguments = of(parts, DeclareLaunchArgument)
    declared = [each.args[0] for each in arguments]
    assert len(declared) == len(set(declared))
    assert {each.args[0] for each in of(parts, LaunchConfiguration)} == set(declared)
    assert {"device", "joints", "arm"} & set(declared) or file.name in ROBOTS
    assert all(each.options["description"] for each in arguments)


@pytest.mark.parametrize("file", LAUNCH_FILES, ids=lambda file: file.name)
def test_nodes_are_found_on_this_host_unless_opened(file, described):
    parts = described(file)
    (argument,) = [each for each in of(parts, DeclareLaunchArgument) if each.args[0] == "discovery"]
    given = argument.options["default_value"]
    assert (given.args, given.options) == (("ROS_AUTOMATIC_DISCOVERY_RANGE",), {"default_value": "LOCALHOST"})
    setting = [each for each in parts if each.args[:1] == ("ROS_AUTOMATIC_DISCOVERY_RANGE",) and len(each.args) == 2]
    assert [each.args[1].args for each in setting] == [("discovery",)]
    nodes = [at for at, each in enumerate(parts) if isinstance(each, Node)]
    assert parts.index(setting[0]) < min(nodes)


@pytest.mark.parametrize("file", SIMULATIONS, ids=lambda file: file.name)
def test_a_bag_starts_exactly_the_recorder(file, described):
    conditional = []
    for node in of(described(file), Node):
        conditions = of(list(node.options.get("condition", Part()).parts()), LaunchConfiguration)
        conditional += [node for each in conditions if each.args == ("bag",)]
    assert [node.options["executable"] for node in conditional] == ["recorder"]


@pytest.mark.parametrize("file", PARAMETERS)
def test_parameter_file_contains_parameters_that_exist(file):
    content = yaml.safe_load((PACKAGE / "config" / file).read_text(encoding="utf-8"))
    assert content.keys() == PARAMETERS[file].keys()
    for node, section in content.items():
        kind = PARAMETERS[file][node]
        known = {item.name: item for item in fields(kind)}
        values = section["ros__parameters"]
        assert values.keys() <= known.keys()
        kind(**{name: tuple(value) if isinstance(value, list) else value for name, value in values.items()})


def test_the_wall_of_the_launch_file_equals_that_of_the_scene():
    content = yaml.safe_load((PACKAGE / "config" / "hitting.yaml").read_text(encoding="utf-8"))
    given, scene = content["arm_simulator"]["ros__parameters"], wall_scene(WALL_AT, START_AT)
    assert given["posture"] == pytest.approx(scene.start, abs=1e-3)
    assert given["walls"] == pytest.approx([*scene.face, *-scene.along], abs=1e-3)
    assert given["link_friction"] == pytest.approx(damped_arm().link_friction, abs=5e-3)
    assert content["bang_bang"]["ros__parameters"]["motors"] == list(MOTORS)
