"""URDF, SDF, Isaac Lab, BAM and ros2_control: read again by their parsers, with the numbers of the device."""

from __future__ import annotations

import ast
import json
from xml.etree import ElementTree

import mujoco
import numpy as np
import pinocchio
import pytest
import yaml
from via_core.devices import device_names, load_device
from via_core.errors import ParameterError
from via_export import FORMATS, Export, export, ros2_control_topics
from via_sim.effects import Effect

LINK_EFFECTS = [
    Effect("coulomb_friction", "link", {"torque": 0.1}),
    Effect("viscous_friction", "link", {"coefficient": 0.02}),
    Effect("payload", "link", {"mass": 0.45, "distance": 0.5}),
]


def number(made: Export, path: str) -> float:
    found = ElementTree.fromstring(made.text).find(path)
    assert found is not None, path
    return float(found.text or "nan")


@pytest.mark.parametrize("name", device_names())
def test_pinocchio_reads_the_inertia_and_gravity_of_a_device(name: str) -> None:
    made = export(load_device(name), (), "urdf")
    model = pinocchio.buildModelFromXML(made.text)
    data, q = model.createData(), np.array([0.4])
    assert pinocchio.crba(model, data, q)[0, 0] == pytest.approx(made.target.rigid_inertia, rel=1e-8)
    gravity = made.target.gravity_torque * np.sin(0.4 - made.target.gravity_angle) * 9.81 / 9.80665
    assert pinocchio.computeGeneralizedGravity(model, data, q)[0] == pytest.approx(gravity, abs=1e-8)


@pytest.mark.parametrize("name", device_names())
def test_mujoco_loads_every_device(name: str) -> None:
    mujoco.MjModel.from_xml_string(export(load_device(name)).text)


def test_urdf_holds_effects_of_the_link() -> None:
    made = export(load_device("dfki_simple_pendulum"), LINK_EFFECTS, "urdf")
    model = pinocchio.buildModelFromXML(made.text)
    assert model.lowerDryFrictionLimit[0] == pytest.approx(-0.28)
    assert model.damping[0] == pytest.approx(0.067)
    assert pinocchio.crba(model, model.createData(), np.zeros(1))[0, 0] == pytest.approx(0.1495185 + 0.45 * 0.25)
    assert [loss.item for loss in made.losses] == ["sensors: steps and noise"]


def test_urdf_measures_the_angle_of_an_encoder_with_offset() -> None:
    device = load_device("dfki_simple_pendulum")
    plain, shifted = (
        pinocchio.buildModelFromXML(export(device, effects, "urdf").text)
        for effects in ((), [Effect("encoder_offset", "sensor", {"offset": 0.3})])
    )
    at = pinocchio.computeGeneralizedGravity(plain, plain.createData(), np.array([0.5]))
    again = pinocchio.computeGeneralizedGravity(shifted, shifted.createData(), np.array([0.8]))
    assert again == pytest.approx(at)


def test_sdf_has_a_link_for_the_motor_and_a_spring() -> None:
    device = load_device("visco_elastic_demo")
    made = export(device, [Effect("preset_error", "transmission", {"offset": 0.1}, 1)], "sdf")
    root = ElementTree.fromstring(made.text)
    assert [each.get("name") for each in root.iter("link")] == [f"{device.name}_{x}" for x in ("base", "motor", "link")]
    axis = f"model/joint[@name='{device.link_joint}']/axis/dynamics"
    assert number(made, f"{axis}/spring_stiffness") == pytest.approx(device.springs[0].k)
    assert number(made, f"{axis}/spring_reference") == pytest.approx(0.1)
    parents = {each.findtext("child"): each.findtext("parent") for each in root.iter("joint")}
    assert parents[f"{device.name}_link"] == f"{device.name}_motor"
    assert number(made, f"model/link[@name='{device.name}_motor']/inertial/inertia/izz") == device.motors[0].inertia


def test_sdf_has_a_spring_to_the_base_where_its_joint_is_that_of_the_link() -> None:
    spring = Effect("link_spring", "link", {"stiffness": 0.7, "rest": -0.2})
    made = export(load_device("xl330"), [spring, Effect("encoder_offset", "sensor", {"offset": 0.05})], "sdf")
    axis = "model/joint[@name='xl330_shaft_joint']/axis/dynamics"
    assert number(made, f"{axis}/spring_stiffness") == 0.7
    assert number(made, f"{axis}/spring_reference") == pytest.approx(-0.15)
    lost = export(load_device("cubic_demo"), [spring], "sdf").losses
    assert "link_spring" in [loss.item for loss in lost]


def test_sdf_springs_are_unloaded_where_the_encoders_measure_no_deflection() -> None:
    offsets = [Effect("encoder_offset", "sensor", {"offset": value}, at) for at, value in ((0, 0.2), (1, 0.05))]
    device = load_device("visco_elastic_demo")
    made = export(device, [*offsets, Effect("preset_error", "transmission", {"offset": 0.1}, 1)], "sdf")
    axis = f"model/joint[@name='{device.link_joint}']/axis/dynamics"
    turned = {}
    for part in ("motor", "link"):
        pose = ElementTree.fromstring(made.text).findtext(f"model/link[@name='{device.name}_{part}']/pose", "")
        turned[part] = float(pose.split()[5])  # about z
    at_zero = turned["link"] - turned["motor"]  # deflection where the joint's angle is 0
    assert at_zero == pytest.approx(-0.2 + 0.05)
    assert number(made, f"{axis}/spring_reference") + at_zero == pytest.approx(0.1)


@pytest.mark.parametrize("name", device_names())
def test_sdf_springs_are_stable_and_its_version_is_one_that_older_gazebos_read(name: str) -> None:
    root = ElementTree.fromstring(export(load_device(name), (), "sdf").text)
    assert root.get("version") == "1.9"
    assert all(float(each.text or "nan") >= 0.0 for each in root.iter("spring_stiffness"))


def test_friction_that_depends_on_an_unknown_load_is_left_out() -> None:
    grows = Effect("load_dependent_friction", "link", {"coefficient": 0.2})
    hanging, free = (export(load_device(name), [grows]) for name in ("dfki_simple_pendulum", "visco_elastic_demo"))
    dry = [mujoco.MjModel.from_xml_string(made.text).dof_frictionloss[0] for made in (hanging, free)]
    plain = [load_device(name).link.coulomb_friction for name in ("dfki_simple_pendulum", "visco_elastic_demo")]
    assert dry[0] - plain[0] == pytest.approx(0.2 * 2.0 / np.pi * 2.9959316) and dry[1] == plain[1]
    assert [next(loss.slot.kind for loss in made.losses) for made in (hanging, free)] == ["substitute", "none"]


def test_sdf_wall_and_position_controller() -> None:
    wall = Effect("contact", "environment", {"angle": 0.3, "stiffness": 50.0, "damping": 0.5, "side": 1.0})
    made = export(load_device("xl330"), [wall], "sdf")
    limit = "model/joint[@name='xl330_shaft_joint']/axis/limit"
    assert [number(made, f"{limit}/{key}") for key in ("upper", "stiffness", "dissipation")] == [0.3, 50.0, 0.5]
    assert number(made, "model/plugin/p_gain") == pytest.approx(0.80884)
    assert number(made, "model/plugin/cmd_max") == pytest.approx(0.70276)


def test_isaac_lab_configuration_is_python_with_the_numbers_of_the_drive() -> None:
    effects = [
        Effect("actuator_delay", "command", {"delay": 0.02}),
        Effect("coulomb_friction", "link", {"torque": 0.01}),
        Effect("torque_gain", "motor", {"gain": 0.9}, 1),
    ]
    tree = ast.parse(export(load_device("xl330"), effects, "isaaclab").text)
    call = next(node for node in ast.walk(tree) if isinstance(node, ast.Call))
    values = {each.arg: ast.literal_eval(each.value) for each in call.keywords}
    assert ast.unparse(call.func) == "DelayedPDActuatorCfg"
    assert values["min_delay"] == values["max_delay"] == 4
    assert values["stiffness"] == pytest.approx(0.9 * 0.80884) and values["damping"] == pytest.approx(0.9 * 0.037256)
    assert values["effort_limit"] == pytest.approx(0.9 * 0.70276)
    assert values["friction"] == values["dynamic_friction"] == pytest.approx(0.01)
    assert values["viscous_friction"] == pytest.approx(0.0037)


@pytest.mark.parametrize(
    ("parameters", "model"),
    [
        ({"coefficient": 0.2}, "m5"),
        ({"coefficient": 0.2, "counter_coefficient": 0.2}, "m3"),
        ({"coefficient": 0.2, "counter_coefficient": 0.2, "stribeck": 0.1, "counter_stribeck": 0.1}, "m4"),
        ({"coefficient": 0.2, "quadratic": 0.01}, "m6"),
    ],
)
def test_bam_takes_the_smallest_model_with_all_terms(parameters: dict[str, float], model: str) -> None:
    made = export(load_device("xl330"), [Effect("load_dependent_friction", "link", parameters)], "bam", supply=7.3)
    values = json.loads(made.text)
    assert values["model"] == model
    assert values["load_friction_base" if model in ("m3", "m4") else "load_friction_motor"] == 0.2
    assert "load_dependent_friction" not in [loss.item for loss in made.losses]
    # kt V / R is the torque at full duty, kt^2 / R the back EMF
    assert values["kt"] * 7.3 / values["R"] == pytest.approx(0.70276)
    assert values["kt"] ** 2 / values["R"] == pytest.approx(0.037256)


def test_bam_updates_a_given_file(tmp_path) -> None:
    given = tmp_path / "m6.json"
    given.write_text(json.dumps({"kt": 0.3, "R": 2.0, "model": "m6", "actuator": "xl330", "friction_base": 0.5}))
    offset = Effect("encoder_offset", "sensor", {"offset": 0.1})
    values = json.loads(export(load_device("xl330"), [offset], "bam", into=given).text)
    assert values["kt"] == 0.3 and values["actuator"] == "xl330"
    assert values["friction_base"] == 0.0 and values["model"] == "m1" and values["q_offset"] == 0.1


def test_ros2_control_has_limits_gains_and_offset() -> None:
    effects = [
        Effect("encoder_offset", "sensor", {"offset": 0.1}),
        Effect("torque_saturation", "motor", {"limit": 0.5}, 1),
    ]
    made = export(load_device("xl330"), effects, "ros2_control")
    root = ElementTree.fromstring(made.text)
    assert [each.get("name") for each in root.iter("command_interface")] == ["position"]
    assert number(made, "transmission/joint/offset") == -0.1
    values = yaml.safe_load(made.parameters)
    assert values["joint_limits"]["xl330_shaft_joint"]["max_effort"] == 0.5
    gains = values["xl330_pid_controller"]["ros__parameters"]["gains"]["xl330_shaft_joint"]
    assert gains["p"] == pytest.approx(0.80884) and gains["u_clamp_max"] == 0.5


@pytest.mark.parametrize("name", ["qbmove_a", "visco_elastic_demo"])
def test_a_controller_manager_gets_a_robot_whose_controllers_fit_it(name: str) -> None:
    device = load_device(name)
    text = ros2_control_topics.robot(device)
    model = pinocchio.buildModelFromXML(text)
    assert set(model.names[1:]) == {device.link_joint, *device.motor_joints}
    joints = {each.get("name"): each for each in ElementTree.fromstring(text).find("ros2_control").findall("joint")}
    commanded = [each for each, joint in joints.items() if joint.find("command_interface[@name='effort']") is not None]
    values = yaml.safe_load(ros2_control_topics.controllers(device))
    manager = values["controller_manager"]["ros__parameters"]
    assert values["motor_torques"]["ros__parameters"]["joints"] == commanded == list(device.motor_joints)
    assert values.keys() - {"controller_manager"} == manager.keys() - {"update_rate"}
    assert 1.0 / manager["update_rate"] < 0.02  # commands act for 20 ms


def test_losses_are_in_the_file() -> None:
    drag = Effect("quadratic_drag", "link", {"coefficient": 0.1})
    for name in FORMATS:
        made = export(load_device("dfki_simple_pendulum"), [drag], name)
        lost = [loss for loss in made.losses if loss.item == "quadratic_drag"]
        assert bool(lost) == (name != "mjcf")
        if name != "bam":
            assert all(str(loss) in made.text for loss in lost)


def test_unknown_formats_and_joints_are_refused(tmp_path) -> None:
    device = load_device("xl330")
    with pytest.raises(ParameterError, match="must be one of mjcf, urdf"):
        export(device, (), "gazebo")
    with pytest.raises(ParameterError, match="is written as a fragment"):
        export(device, (), "isaaclab", into=tmp_path / "x.py")
    for name in ("urdf", "sdf", "mjcf"):
        given = tmp_path / f"model.{name}"
        given.write_text(export(device, (), name).text)
        with pytest.raises(ParameterError, match="no joint 'elbow'"):
            export(device, (), name, into=given, joint="elbow")
    broken = tmp_path / "broken.urdf"
    broken.write_text("<robot>")
    with pytest.raises(ParameterError, match=r"broken\.urdf"):
        export(device, (), "urdf", into=broken)
