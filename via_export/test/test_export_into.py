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
    with pytest.raises(ParameterError, match="it is URDF: use --to urdf"):
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


RIGID = {"arrangement": "rigid", "motors": (), "springs": (), "damper": None}
WRITTEN = {  # numbers of a compiled model that defaults of a file can change
    "actuator": "gear gainprm biasprm dynprm gaintype biastype dyntype forcerange forcelimited damping dampingpoly "
    "armature delay",
    "jnt": "type stiffness stiffnesspoly range limited",
    "dof": "damping dampingpoly armature frictionloss",
    "tendon": "stiffness stiffnesspoly damping frictionloss lengthspring limited",
    "site": "pos",
}
DEFAULTS = """<default>
    <position kp="80" kv="4"/><general gear="50" forcerange="-2 2" damping="1 2 3" armature="0.5"/>
    <joint stiffness="4 5 6" damping="1 2 3" armature="2" frictionloss="0.5" range="-10 10"/>
    <site pos="1 2 3"/><tendon stiffness="3 4 5" damping="1" frictionloss="2" limited="true" range="0 1"/>
  </default>"""
ROD = """<mujoco model="rod"><compiler {compiler}/>{more}<worldbody><body name="rod"><joint name="knee" {joint}/>
  <geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass="1"/></body></worldbody>
  <actuator><motor name="m" joint="knee" {motor}/></actuator></mujoco>"""


def rod(path: Path, compiler: str = 'angle="radian"', more: str = "", joint: str = "", motor: str = "") -> Path:
    path.write_text(ROD.format(compiler=compiler, more=more, joint=joint, motor=motor))
    return path


def numbers_of_new_elements(text: str) -> dict[str, np.ndarray]:
    """Of all but the joints and actuators that the robot has itself."""
    model = mujoco.MjModel.from_xml_string(text)
    own = {"jnt": 2, "dof": 2}
    found = {
        f"{kind}_{key}": getattr(model, f"{kind}_{key}")[own.get(kind, 0) :] for kind in WRITTEN
        for key in WRITTEN[kind].split()
    }  # fmt: skip
    other = model.actuator("other").id
    return {key: np.delete(each, other, 0) if key.startswith("actuator") else each for key, each in found.items()}


@pytest.mark.parametrize(
    ("name", "effects"),
    [("dfki_simple_pendulum", EFFECTS[3:4]), ("xl330", ()), ("cubic_demo", ()), ("maccepavd", ()), ("qbmove_a", ())],
)
def test_defaults_of_the_file_do_not_change_what_is_written(robot: Path, name: str, effects: list[Effect]) -> None:
    device, motor = load_device(name), '<motor name="torque" joint="shoulder" gear="2"/>'

    def made(defaults: str, childclass: str = "") -> str:
        text = ROBOT.replace(motor, "").replace("<worldbody>", f"{defaults}<worldbody>", 1)
        robot.write_text(text.replace('name="torso"', f'name="torso"{childclass}'))
        return export(device, effects, "mjcf", into=robot, joint="shoulder").text

    plain = numbers_of_new_elements(made(""))
    in_class = DEFAULTS.replace("<default>", '<default><default class="c">') + "</default>"
    for text in (made(DEFAULTS), made(in_class, ' childclass="c"')):
        for key, numbers in numbers_of_new_elements(text).items():
            np.testing.assert_array_equal(numbers, plain[key], err_msg=key)
        assert mujoco.MjModel.from_xml_string(text).dof_dampingpoly[1].tolist() == [0.0, 0.0]


def test_defaults_of_an_included_file_do_not_either(tmp_path: Path) -> None:
    (tmp_path / "more.xml").write_text('<mujocoinclude><default><motor gear="50"/></default></mujocoinclude>')
    for more in ('<include file="more.xml"/>', '<default/><include file="more.xml"/>'):
        given = rod(tmp_path / "rod.xml", more=more)
        made = export(load_device("dfki_simple_pendulum"), (), "mjcf", into=given, joint="knee")
        (tmp_path / "made.xml").write_text(made.text)
        assert mujoco.MjModel.from_xml_path(str(tmp_path / "made.xml")).actuator("m").gear[0] == 1.0


def test_a_model_gets_the_class_of_new_elements_once(robot: Path) -> None:
    robot.write_text(ROBOT.replace("<worldbody>", f"{DEFAULTS}<worldbody>", 1))
    robot.write_text(export(load_device("xl330"), (), "mjcf", into=robot, joint="shoulder").text)
    made = export(load_device("dfki_simple_pendulum"), (), "mjcf", into=robot, joint="waist").text
    assert made.count('<default class="via_export">') == 1
    assert mujoco.MjModel.from_xml_string(made).actuator("other").gear[0] == 1.0


def test_the_unit_of_angles_is_that_which_mujoco_uses(tmp_path: Path) -> None:
    (tmp_path / "unit.xml").write_text('<mujocoinclude><compiler angle="radian"/></mujocoinclude>')
    given = rod(tmp_path / "rod.xml", "", '<include file="unit.xml"/>', 'range="-1.5 1.5"')
    made = export(load_device("dfki_simple_pendulum"), [EFFECTS[2], EFFECTS[5]], "mjcf", into=given, joint="knee")
    written = next(each for each in ElementTree.fromstring(made.text).iter("joint"))
    assert float(written.get("ref", "")) == pytest.approx(0.1) and written.get("springref") == "0.6"
    offset = [Effect("encoder_offset", "sensor", {"offset": 0.1}, 1)]  # of a motor, whose joint is new
    for unit in ("radian", "degree"):
        given = rod(tmp_path / "rod.xml", f'angle="{unit}"')
        made = export(load_device("visco_elastic_demo"), offset, "mjcf", into=given, joint="knee")
        assert mujoco.MjModel.from_xml_string(made.text).qpos0 == pytest.approx([0.0, 0.1])


def test_attributes_of_the_joint_do_not_change_what_is_written(tmp_path: Path) -> None:
    given = rod(tmp_path / "rod.xml", joint='springdamper="0.1 0.8" margin="0.2"')
    wall = Effect("contact", "environment", {"angle": 0.5, "stiffness": 200.0, "damping": 1.0, "side": 1.0})
    model = mujoco.MjModel.from_xml_string(
        export(load_device("dfki_simple_pendulum"), [wall], "mjcf", into=given, joint="knee").text
    )
    assert model.dof_damping[0] == pytest.approx(0.047) and model.jnt_margin[0] == 0.0
    assert model.jnt_stiffness[0] == pytest.approx(mujoco.MjModel.from_xml_path(str(given)).jnt_stiffness[0])


def test_a_slide_keeps_metres_and_gets_mass(tmp_path: Path) -> None:
    device = load_device("visco_elastic_demo").model_copy(update=RIGID)
    given = rod(tmp_path / "rod.xml", 'angle="degree"', joint='type="slide" range="-1 1"')
    effects = [
        Effect("contact", "environment", {"angle": 0.5, "stiffness": 200.0, "damping": 1.0, "side": 1.0}),
        Effect("payload", "link", {"mass": 0.5, "distance": 0.3}),
    ]
    made = export(device, effects, "mjcf", into=given, joint="knee")
    model = mujoco.MjModel.from_xml_string(made.text)
    assert model.jnt_range[0] == pytest.approx([-1.0, 0.5]) and model.dof_armature[0] == pytest.approx(0.045)
    assert any("adds mass times distance squared: 0.045 kg" in note for note in made.notes)
    assert any("its control is now the force in N; a control of 1 was 1 N" in note for note in made.notes)


def test_a_joint_alone_turns_and_a_note_says_so_unless_the_device_does() -> None:
    for name, silent in (("dfki_simple_pendulum", True), ("visco_elastic_demo", False)):
        for to in ("mjcf", "urdf", "sdf"):
            made = export(load_device(name), (), to)
            assert (made.notes == ()) == silent
            assert silent or ("written as one that turns" in made.notes[0] and made.notes[0] in made.text)


def test_an_actuator_in_an_included_file_is_refused(tmp_path: Path) -> None:
    actuator = '<mujocoinclude><actuator><motor joint="knee" gear="50"/></actuator></mujocoinclude>'
    (tmp_path / "drive.xml").write_text(actuator)
    given = rod(tmp_path / "rod.xml", more='<include file="drive.xml"/>')
    with pytest.raises(ParameterError, match="an actuator of joint 'knee' is in an included file"):
        export(load_device("dfki_simple_pendulum"), (), "mjcf", into=given, joint="knee")


@pytest.mark.parametrize(
    ("device", "old", "note"),
    [
        ("dfki_simple_pendulum", '<motor joint="knee" gear="50"/>', "now the torque in N m; a control of 1 was 50 N m"),
        ("xl330", '<position joint="knee" kp="3" gear="2"/>', "now the angle in rad; a control of 1 was 0.5 rad"),
        ("xl330", '<motor joint="knee" gear="3"/>', "now the angle in rad; a control of 1 was 3 N m"),
        ("xl330", '<velocity joint="knee" kv="3"/>', "now the angle in rad; the control of the old one was of another"),
    ],
)
def test_a_note_states_what_the_control_is(tmp_path: Path, device: str, old: str, note: str) -> None:
    given = rod(tmp_path / "rod.xml")
    given.write_text(given.read_text().replace('<motor name="m" joint="knee" />', old))
    notes = export(load_device(device), (), "mjcf", into=given, joint="knee").notes
    assert any(f"its control is {note}" in each for each in notes), notes


def test_limits_act_in_a_file_without_autolimits(tmp_path: Path) -> None:
    given = rod(tmp_path / "rod.xml", 'autolimits="false"')
    limited = [Effect("torque_saturation", "motor", {"limit": 0.4}, 1)]
    for name in ("dfki_simple_pendulum", "xl330"):
        model = mujoco.MjModel.from_xml_string(export(load_device(name), limited, "mjcf", given, "knee").text)
        assert (model.actuator_ctrllimited[0], model.actuator_forcelimited[0]) == (name[0] == "d", name[0] == "x")


def test_a_model_that_does_not_load_is_refused(robot: Path) -> None:
    device = load_device("dfki_simple_pendulum")
    robot.write_text(export(device, EFFECTS[:1], "mjcf", into=robot, joint="shoulder").text)
    with pytest.raises(ParameterError, match=r"robot\.xml: the edited model does not load.*repeated name.*payload_1"):
        export(device, EFFECTS[:1], "mjcf", into=robot, joint="shoulder")


def test_a_joint_within_frames_is_edited(tmp_path: Path) -> None:
    def of(first: str, second: str) -> mujoco.MjModel:
        given = rod(tmp_path / "rod.xml", joint='axis="0 1 0"')
        text = given.read_text().replace('<joint name="knee" axis="0 1 0"/>', 'X<joint name="knee" axis="0 1 0"/>Y')
        text = text.replace('<body name="rod">', f'{first}<body name="rod">').replace("</body>", "</body>" + second)
        given.write_text(text.replace("X", first).replace("Y", second))
        return mujoco.MjModel.from_xml_string(export(load_device("qbmove_a"), (), "mjcf", given, "knee").text)

    plain, framed = of("", ""), of('<frame pos="0 0 0"><frame euler="0 0 0">', "</frame></frame>")
    np.testing.assert_array_equal(plain.body_pos, framed.body_pos)
    turned = of('<frame pos="0 0 0.2">', "</frame>")
    assert turned.body_pos[2:, 2] == pytest.approx(turned.body_pos[1, 2] + turned.jnt_pos[0, 2])


def test_the_format_of_a_given_file_is_named(tmp_path: Path) -> None:
    given = rod(tmp_path / "rod.xml")
    for to in ("urdf", "sdf"):
        with pytest.raises(ParameterError, match="it is MJCF: use --to mjcf"):
            export(load_device("dfki_simple_pendulum"), (), to, into=given, joint="knee")


def test_an_encoder_offset_turns_or_moves_the_origin_of_a_urdf(tmp_path: Path) -> None:
    path, device = tmp_path / "robot.urdf", load_device("dfki_simple_pendulum")
    offset = [Effect("encoder_offset", "sensor", {"offset": 0.2})]
    for kind, joint in (("turns", URDF), ("slides", URDF.replace("revolute", "prismatic"))):
        path.write_text(joint)
        made = export(device, offset, "urdf", into=path, joint="shoulder")
        before, after = (pinocchio.buildModelFromXML(each) for each in (joint, made.text))
        places = []
        for model, angle in ((before, 0.5), (after, 0.7)):
            data = model.createData()
            pinocchio.forwardKinematics(model, data, np.array([angle]))
            places.append(data.oMi[1].homogeneous)
        np.testing.assert_allclose(places[0], places[1], atol=1e-9, err_msg=kind)
        assert [after.lowerPositionLimit[0], after.upperPositionLimit[0]] == pytest.approx([-1.8, 2.2])
        assert any("shifted by the encoder offset of 0.2" in note for note in made.notes)


@pytest.mark.parametrize("to", ["mjcf", "urdf", "sdf"])
def test_what_cannot_be_written_into_a_model_is_left_to_the_user(tmp_path: Path, to: str) -> None:
    device, path = load_device("dfki_simple_pendulum"), tmp_path / f"robot.{to}"
    path.write_text(export(device, (), to).text)
    effects = [
        Effect("gravity_error", "link", {"torque": 0.980665, "angle": 0.3}),
        Effect("encoder_offset", "sensor", {"offset": 0.2}),
    ]
    notes = "\n".join(export(device, effects, to, into=path).notes)
    assert "change mass times distance of the centre of" in notes and "by 0.1 kg m" in notes
    assert "turn the centre of mass of" in notes and "by -0.3 rad" in notes
    assert to != "sdf" or ("by -0.2 rad about the axis" in notes and "add 0.2 rad to limits" in notes)


def test_a_urdf_slide_gets_mass_and_keeps_what_the_device_does_not_know(tmp_path: Path) -> None:
    path, device = tmp_path / "robot.urdf", load_device("visco_elastic_demo")
    device = device.model_copy(update=RIGID)
    dynamics = '<dynamics damping="0.7" friction="0.2" armature="0.04" spring_stiffness="2"/>'
    path.write_text(URDF.replace("revolute", "prismatic").replace("<limit", f"{dynamics}<limit"))
    made = export(device, [Effect("link_inertia", "link", {"inertia": 0.5})], "urdf", into=path, joint="shoulder")
    model = pinocchio.buildModelFromXML(made.text)
    assert model.inertias[1].mass == pytest.approx(0.7 + 0.5)
    assert 'armature="0.04" spring_stiffness="2"' in made.text
    assert any("the device replaces dynamics damping 0.7 by" in note for note in made.notes)


def test_an_sdf_keeps_its_spring_and_gets_a_position_controller(tmp_path: Path) -> None:
    device, path = load_device("xl330"), tmp_path / "robot.sdf"
    source = export(device, (), "sdf").text
    path.write_text(source.replace("<spring_stiffness>0<", "<spring_stiffness>3<").replace("p_gain>", "old_gain>"))
    made = export(device, [Effect("coulomb_friction", "link", {"torque": 0.1})], "sdf", into=path)
    root = ElementTree.fromstring(made.text)
    assert root.findtext(".//axis/dynamics/spring_stiffness") == "3"
    assert [each.findtext("p_gain") for each in root.iter("plugin")] == ["0.80884"]
    assert any("position controller of joint" in note for note in made.notes)
