"""A joint written into a given model: only that joint changes, and it moves as the exported joint alone."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pinocchio
import pytest
from export_joints import RATE, angles_in_via_sim, commands_of, difference, start_of
from via_core.devices import load_device
from via_core.errors import ParameterError
from via_export import export
from via_export.mujoco_joint import QUEUE, MujocoJoint
from via_sim.effects import Effect
from via_sim.plants import JointPlant
from via_sim.simulate import command_rows, initial_state

MASS, DISTANCE = 2.9959316 / 9.80665 / 0.4, 0.4  # weight of the pendulum's device file
ROBOT = f"""<mujoco model="robot">
  <!-- kept -->
  <compiler angle="degree"/>
  <option timestep="0.00025" integrator="RK4" gravity="0 0 -9.80665"/>
  <worldbody>
    <body name="torso" pos="0 0 1">
      <joint name="waist" axis="0 0 1"/>
      <geom size=".1"/>
      <body name="arm" pos="0 .1 0">
        <joint name="shoulder" axis="0 -1 0" range="-170 170" damping="0.5" armature="0.01"/>
        <inertial pos="0 0 {-DISTANCE}" mass="{MASS}" diaginertia=".02 {0.1395185 - MASS * DISTANCE**2} .02"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="torque" joint="shoulder" gear="2"/><motor name="other" joint="waist"/></actuator>
</mujoco>"""
EFFECTS = [
    Effect("payload", "link", {"mass": 0.45, "distance": 0.5}),
    Effect("link_inertia", "link", {"inertia": 0.02}),
    Effect("encoder_offset", "sensor", {"offset": 0.1}),
    Effect("torque_ripple", "motor", {"amplitude": 0.2, "order": 7.0, "phase": 0.3}, 1),
    Effect("coulomb_friction", "link", {"torque": 0.1}),
    Effect("link_spring", "link", {"stiffness": 0.6, "rest": 0.5}),
    Effect("actuator_lag", "command", {"time_constant": 0.02}),
]
URDF = """<robot name="r"><link name="base"/><link name="arm"><inertial><origin xyz="0 0 -0.4"/><mass value="0.7"/>
<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 -1 0"/>
<limit lower="-2" upper="2" effort="5" velocity="3"/></joint></robot>"""


@pytest.fixture
def robot(tmp_path: Path) -> Path:
    path = tmp_path / "robot.xml"
    path.write_text(ROBOT)
    return path


def test_the_joint_in_a_robot_moves_as_alone(robot: Path) -> None:
    device = load_device("dfki_simple_pendulum")
    made = export(device, EFFECTS, "mjcf", into=robot, joint="shoulder")
    model = MujocoJoint(made.text, made.target, "shoulder", RATE)
    state = initial_state(JointPlant.from_device(device), RATE, start_of(device), 0)
    commands = commands_of(device, 1.0)
    moved = model.run(model.start(state, np.zeros((QUEUE, 6))), command_rows(device, commands, commands.time))
    truth = angles_in_via_sim(device, EFFECTS, 1.0)
    assert difference(truth, moved) < 2e-3
    assert difference(truth, angles_in_via_sim(device, (), 1.0)) > 0.1


def test_only_the_joint_changes(robot: Path) -> None:
    made = export(load_device("dfki_simple_pendulum"), EFFECTS, "mjcf", into=robot, joint="shoulder")
    assert "<!-- kept -->" in made.text
    root = ElementTree.fromstring(made.text)
    names = [each.get("name") for each in root.findall("actuator/*")]
    assert names == ["torque", "other", "shoulder_ripple_1"]
    model = mujoco.MjModel.from_xml_string(made.text)
    shoulder = model.joint("shoulder")
    assert np.degrees(shoulder.range) == pytest.approx([-170.0 + np.degrees(0.1), 170.0 + np.degrees(0.1)])
    assert shoulder.damping[0] == pytest.approx(0.047) and shoulder.frictionloss[0] == pytest.approx(0.28)
    assert shoulder.armature[0] == pytest.approx(0.03)
    assert model.joint("waist").damping[0] == 0.0
    assert any("range and ref are shifted" in note for note in made.notes)


@pytest.mark.parametrize("name", ["qbmove_a", "maccepavd", "edinburgh_vsa"])
def test_motors_and_springs_are_placed_at_the_joint(robot: Path, name: str) -> None:
    device = load_device(name)
    made = export(device, (), "mjcf", into=robot, joint="shoulder")
    model = MujocoJoint(made.text, made.target, "shoulder", RATE)
    state = np.array([0.3, 0.1, 0.4, 0.0, 0.0, 0.0])
    data = model.start(state, np.zeros((QUEUE, 6)))
    torque = -float(np.sum(device.torque_each(0.3, state[1 : 1 + device.n_motors])))
    assert data.qfrc_passive[model.dofs[0]] == pytest.approx(torque, rel=2e-3)


def test_a_replaced_motor_keeps_its_limits(robot: Path) -> None:
    device = load_device("dfki_simple_pendulum")
    robot.write_text(ROBOT.replace('gear="2"', 'gear="2" ctrlrange="-3 4" forcerange="-2.5 5"'))
    model = mujoco.MjModel.from_xml_string(export(device, (), "mjcf", into=robot, joint="shoulder").text)
    drive = model.actuator("torque")
    assert drive.ctrllimited and drive.ctrlrange == pytest.approx([-6.0, 8.0])  # torques at the joint
    assert drive.forcelimited and drive.forcerange == pytest.approx([-5.0, 10.0])
    limited = [Effect("torque_saturation", "motor", {"limit": 7.0}, 1)]
    model = mujoco.MjModel.from_xml_string(export(device, limited, "mjcf", into=robot, joint="shoulder").text)
    assert model.actuator("torque").ctrlrange == pytest.approx([-6.0, 7.0])


def test_a_replaced_position_drive_keeps_the_range_of_its_goals(robot: Path) -> None:
    servo = '<position name="torque" joint="shoulder" gear="2" kp="3" ctrlrange="-1 2"/>'
    robot.write_text(ROBOT.replace('<motor name="torque" joint="shoulder" gear="2"/>', servo))
    model = mujoco.MjModel.from_xml_string(export(load_device("xl330"), (), "mjcf", into=robot, joint="shoulder").text)
    assert model.actuator("torque").ctrlrange == pytest.approx([-0.5, 1.0])  # [rad]


def test_elements_with_memory_need_an_integrator_that_updates_them(robot: Path) -> None:
    sticks = Effect("stribeck_friction", "link", {"breakaway": 0.3, "kinetic": 0.1, "velocity": 0.5})
    notes = export(load_device("dfki_simple_pendulum"), [sticks], "mjcf", into=robot, joint="shoulder").notes
    assert any("needs 6.25e-05 s, best with Euler" in note for note in notes)
    assert any("RK4 holds bristles" in note for note in notes)


@pytest.mark.parametrize(("side", "ends"), [(1.0, (-170.0, 40.0)), (-1.0, (40.0, 170.0))])
def test_a_wall_replaces_one_end_of_the_range(robot: Path, side: float, ends: tuple[float, float]) -> None:
    wall = Effect(
        "contact", "environment", {"angle": np.radians(40.0), "stiffness": 300.0, "damping": 1.0, "side": side}
    )
    made = export(load_device("dfki_simple_pendulum"), [wall], "mjcf", into=robot, joint="shoulder")
    assert np.degrees(mujoco.MjModel.from_xml_string(made.text).joint("shoulder").range) == pytest.approx(ends)
    assert any("replaced by the wall" in note for note in made.notes)


def test_a_urdf_keeps_its_limits_and_gets_friction_and_payload(tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(URDF)
    made = export(load_device("dfki_simple_pendulum"), EFFECTS[:2], "urdf", into=path, joint="shoulder")
    model = pinocchio.buildModelFromXML(made.text)
    assert model.upperPositionLimit[0] == 2.0 and model.damping[0] == pytest.approx(0.047)
    inertia = pinocchio.crba(model, model.createData(), np.zeros(1))[0, 0]
    assert inertia == pytest.approx(0.1 + 0.7 * 0.16 + 0.45 * 0.25 + 0.02)
    torque = pinocchio.computeGeneralizedGravity(model, model.createData(), np.array([0.5 * np.pi]))[0]
    assert abs(torque) == pytest.approx(9.81 * (0.7 * 0.4 + 0.45 * 0.5), rel=1e-6)
    assert made.notes == ()


def test_what_does_not_change_keeps_its_form(tmp_path: Path) -> None:
    source = """<?xml version="1.0"?>
<!-- of the vendor -->
<robot name="r">

    <link name="base"/>   <!-- stands -->
    <link name="arm"><inertial><origin xyz="0 0 -0.4"/><mass value="0.7"/>
        <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
    <joint name="shoulder" type="revolute">
        <parent link="base"/><child link="arm"/>
        <axis xyz="0 -1 0"/>
        <limit lower="-2" upper="2" effort="5" velocity="3"/>
    </joint>
</robot>
<!-- end -->
"""
    path = tmp_path / "robot.urdf"
    path.write_text(source)
    made = export(load_device("dfki_simple_pendulum"), EFFECTS[:1], "urdf", into=path, joint="shoulder")
    before, after = source.splitlines(), made.text.splitlines()
    assert [line for line in before if line not in after] == []
    added = [line for line in after if line not in before]
    assert '        <dynamics damping="0.047" friction="0.18"/>' in added
    assert '    <link name="shoulder_payload_1">' in added and after[-1] == "<!-- end -->"


def test_a_payload_becomes_a_link_of_an_sdf(tmp_path: Path) -> None:
    device, path = load_device("dfki_simple_pendulum"), tmp_path / "robot.sdf"
    path.write_text(export(device, (), "sdf").text)
    made = export(device, EFFECTS[:1], "sdf", into=path)
    root = ElementTree.fromstring(made.text)
    link = root.find(f".//link[@name='{device.link_joint}_payload_1']")
    assert link is not None and float(link.findtext("inertial/mass") or 0.0) == 0.45
    pose = link.find("pose")
    assert pose is not None and pose.get("relative_to") == "dfki_simple_pendulum_link"
    assert [float(each) for each in str(pose.text).split()[:3]] == pytest.approx([0.0, 0.0, -0.5])
    assert root.find(f".//joint[@name='{device.link_joint}_payload_1_fixed']") is not None and made.notes == ()


def test_a_urdf_is_no_model_to_write_mjcf_into(tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(URDF)
    with pytest.raises(ParameterError, match="is a URDF: use --to urdf"):
        export(load_device("dfki_simple_pendulum"), (), "mjcf", into=path, joint="shoulder")


def test_gravity_of_the_other_sign_is_left_to_the_user(robot: Path) -> None:
    device = load_device("dfki_simple_pendulum")
    reversed_ = Effect("gravity_error", "link", {"torque": -2.0 * device.link.gravity_torque, "angle": 0.0})
    made = export(device, [reversed_], "mjcf", into=robot, joint="shoulder")
    (note,) = [each for each in made.notes if each.startswith("gravity torque: change mass times distance")]
    assert float(note.split(" by ")[1].split()[0]) == pytest.approx(-2.0 * MASS * DISTANCE, rel=1e-3)


def test_an_sdf_gets_friction_and_a_spring_to_the_base(tmp_path: Path) -> None:
    device = load_device("dfki_simple_pendulum")
    path = tmp_path / "robot.sdf"
    path.write_text(export(device, (), "sdf").text)
    effects = [
        Effect("coulomb_friction", "link", {"torque": 0.1}),
        Effect("link_spring", "link", {"stiffness": 0.6, "rest": 0.5}),
    ]
    made = ElementTree.fromstring(export(device, effects, "sdf", into=path).text)
    for entry, value in (("friction", 0.28), ("spring_stiffness", 0.6), ("spring_reference", 0.5)):
        assert float(made.findtext(f".//axis/dynamics/{entry}") or 0.0) == pytest.approx(value)
