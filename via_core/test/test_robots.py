"""URDF and MJCF files: the bodies of MuJoCo, nothing dropped silently, no meshes needed, errors of one line."""

import re
from pathlib import Path

import mujoco
import numpy as np
import pinocchio
import pytest
from own_robot import URDF, write_robot
from via_core.devices import parse_device
from via_core.errors import DeviceError
from via_core.robots.description import (
    CAD,
    FRICTION,
    WITHOUT_ROTOR,
    Description,
    device_name,
    guess_gains,
    of_model,
    rigid_springs,
)
from via_core.robots.mjcf import read_mjcf
from via_core.robots.models import Robot, read_robot

ODD = """<mujoco><option gravity="1 -2 -9"/><worldbody>
 <body pos="0 0 1" euler="10 20 30"><freejoint name="base"/><geom size=".1" mass="3"/>
  <body name="a" pos=".1 0 -.2" euler="0 40 0"><joint name="twist" pos="0 .05 .02" axis="1 2 3" ref="20"/>
   <joint name="lift" type="slide" axis="0 .6 .8" armature=".3"/>
   <geom type="box" size=".1 .05 .02" pos=".1 0 0" mass="1.5"/>
   <body pos="0 .2 0"><geom size=".05" mass=".4" pos=".1 .1 0"/>
    <body pos=".3 0 0"><joint name="hand" type="ball" pos="0 0 .1"/><geom size=".04" mass=".2"/>
     <body pos="0 0 .1"><joint name="end" axis="0 1 0" armature=".01"/><geom type="capsule" size=".02 .1" pos="0 0 .1"/>
 </body></body></body></body></body></worldbody></mujoco>"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_robot(tmp_path)
    return tmp_path


def test_bodies_of_mjcf_have_the_dynamics_of_mujoco(tmp_path: Path) -> None:
    """Free, ball, hinge and slide joints, two joints of one body, anchors, references, rotated gravity."""
    (tmp_path / "odd.xml").write_text(ODD, encoding="utf-8")
    robot, model = read_mjcf(tmp_path / "odd.xml"), mujoco.MjModel.from_xml_string(ODD)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    data, mine, rng = mujoco.MjData(model), robot.model.createData(), np.random.default_rng(3)
    for _ in range(5):
        mujoco.mj_resetData(model, data)
        angles = {name: float(rng.normal()) for name in ("twist", "lift", "end")}
        for name, value in angles.items():
            data.joint(name).qpos = value
        data.qvel[6:], data.qacc[6:] = rng.normal(size=model.nv - 6), rng.normal(size=model.nv - 6)
        mujoco.mj_inverse(model, data)
        q = robot.configuration(angles)
        q[:7] = np.r_[data.qpos[:3], np.roll(data.qpos[3:7], -1)]  # quaternions end with w
        torque = pinocchio.rnea(robot.model, mine, q, data.qvel.copy(), data.qacc.copy())
        np.testing.assert_allclose(torque[6:], data.qfrc_inverse[6:], atol=1e-9)


def test_urdf_and_mjcf_of_one_arm_agree_with_the_closed_form(folder: Path) -> None:
    urdf, mjcf = read_robot(folder / "robot.urdf"), read_robot(folder / "robot.xml")
    inertia = 1.2 * 0.12**2 + 0.008 + 0.3 * 0.27**2 + 0.0002
    for robot in (urdf, mjcf):
        seen = robot.seen_at("elbow", {"shoulder": 0.3})
        assert seen.inertia == pytest.approx(inertia, rel=1e-6)
        assert seen.gravity_torque == pytest.approx((1.2 * 0.12 + 0.3 * 0.27) * 9.81, rel=1e-5)
        assert np.cos(seen.gravity_angle + 0.3) == pytest.approx(1.0)  # it hangs where the shoulder takes it
        stretched, folded = robot.seen_at("shoulder").inertia, robot.seen_at("shoulder", {"elbow": np.pi}).inertia
        assert stretched == pytest.approx(
            2.0 * 0.15**2 + 0.02 + 1.2 * 0.42**2 + 0.008 + 0.3 * 0.57**2 + 0.0002, rel=1e-6
        )
        ends = robot.seen_at("shoulder")
        assert ends.lowest <= folded * 1.02 and ends.highest <= stretched * (1.0 + 1e-9) and folded < stretched


def test_what_a_file_states_is_in_the_device_file_with_its_origin(folder: Path) -> None:
    robot = read_robot(folder / "robot.urdf")
    made = Description("elbow", "elbow", "via device new robot.urdf --joint elbow")
    of_model(made, robot, robot.joint("elbow"), {})
    made.numbers["rate"] = made.numbers["viscous_friction"]
    device = parse_device(made.text(), "elbow.yaml")
    assert device.link.viscous_friction == 0.15 and device.link.coulomb_friction == 0.0
    assert device.tolerances.link_inertia == WITHOUT_ROTOR and device.tolerances.link_friction == FRICTION
    assert device.tolerances.gravity == CAD
    assert "read: damping of the joint; tolerance 30%" in made.text()
    assert "guessed: the model states no friction" in made.text()
    remarks = " ".join(made.remarks)
    assert "reduction of 50" in remarks and "rotor" in remarks and "effort 20 N m" in remarks
    assert "follows joint elbow" in " ".join(robot.joint("finger_joint").remarks)


def test_a_position_actuator_is_seen_through_its_gear(folder: Path) -> None:
    robot = read_robot(folder / "robot.xml")
    shoulder, elbow = robot.joint("shoulder"), robot.joint("elbow")
    assert (shoulder.kp, shoulder.kd, shoulder.effort, shoulder.gear) == (160.0, 8.0, 40.0, 2.0)
    assert elbow.kp is None and elbow.effort == pytest.approx(20.0)
    assert (shoulder.damping, elbow.damping) == (0.3, 0.15)  # of the default class, and its own
    assert shoulder.high == pytest.approx(2.5, abs=1e-6)
    assert "meshes" not in robot.remarks and "assets are left out" in robot.remarks[0]
    made = Description("shoulder", "shoulder", "via")
    of_model(made, robot, shoulder, {})
    made.numbers["rate"] = made.numbers["kp"]
    device = parse_device(made.text(), "d")
    assert device.drive == "position" and device.servo is not None
    assert (device.servo.torque_limit, device.servo.limited) == (40.0, "sum")
    assert "`scale: 0.5`" in made.text()
    assert "effort 40" not in made.text()  # it is the limit of the drive, not one without an entry


def test_the_inertia_over_all_poses_includes_the_rotor(folder: Path) -> None:
    file = folder / "robot.xml"
    file.write_text(file.read_text().replace('name="shoulder" ', 'name="shoulder" armature="5" ', 1), encoding="utf-8")
    robot, made = read_robot(file), Description("shoulder", "shoulder", "via")
    of_model(made, robot, robot.joint("shoulder"), {})
    lowest, highest = (robot.seen_at("shoulder").lowest + 5.0, robot.seen_at("shoulder").highest + 5.0)
    assert f"({lowest:.3g} to {highest:.3g} over all poses), rotor 5 included" in made.text()
    assert lowest < highest and lowest <= made.numbers["inertia"].value <= highest


def test_gains_without_model_are_guesses_with_wide_tolerance() -> None:
    made = Description("a", "a", "via", drive="position")
    from via_core.robots.description import Number

    made.numbers |= {
        "inertia": Number(0.1, "read", "x", CAD),
        "viscous_friction": Number(0.0, "guessed", "x"),
        "rate": Number(100.0, "guessed", "x"),
    }
    guess_gains(made)
    device = parse_device(made.text(), "d")
    assert (
        device.tolerances.kp == 0.65
        and device.servo is not None
        and device.servo.kp == pytest.approx(0.1 * (10 * np.pi) ** 2, rel=1e-5)
    )


def test_a_joint_that_slides_has_its_own_units(tmp_path: Path) -> None:
    text = (
        URDF.replace('<mimic joint="elbow" multiplier="0.01"/>', "")
        .replace(
            '<link name="finger"/>',
            '<link name="finger"><inertial><mass value=".2"/>'
            '<inertia ixx="1e-5" ixy="0" ixz="0" iyy="1e-5" iyz="0" izz="1e-5"/></inertial></link>',
        )
        .replace('<axis xyz="1 0 0"/>', '<axis xyz="0 0 1"/>')
    )
    (tmp_path / "r.urdf").write_text(text, encoding="utf-8")
    robot = read_robot(tmp_path / "r.urdf")
    made = Description("finger", "finger_joint", "via")
    of_model(made, robot, robot.joint("finger_joint"), {})
    assert made.linear and "[kg] read" in made.text()
    assert any("constant -1.962 N" in each for each in made.remarks)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("a.urdf", "<robot", "not XML"),
        ("a.urdf", "<sdf/>", "neither URDF"),
        (
            "a.urdf",
            '<robot name="a" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:macro name="b"/></robot>',
            "xacro",
        ),
        ("a.xml", "<mujoco><worldbody><body><joint/></body></worldbody></mujoco>", "state <inertial>"),
        ("a.xml", "<mujoco><nonsense/></mujoco>", "MuJoCo cannot read it"),
    ],
)
def test_unreadable_models_give_one_line(tmp_path: Path, name: str, text: str, words: str) -> None:
    (tmp_path / name).write_text(text, encoding="utf-8")
    with pytest.raises(DeviceError, match=words) as error:
        read_robot(tmp_path / name)
    assert "\n" not in str(error.value)


def test_an_unknown_joint_names_the_joints(folder: Path) -> None:
    with pytest.raises(DeviceError, match="no joint 'hip'; there are: shoulder, elbow, finger_joint"):
        read_robot(folder / "robot.urdf").joint("hip")
    with pytest.raises(DeviceError, match="choose with --joint from: shoulder, elbow"):
        read_robot(folder / "robot.xml").joint("")


BAR = '<geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass="1"/>'  # weight 1.4715 N m, inertia 0.03151 kg m^2


def mjcf(folder: Path, actuators: str, joint: str = 'name="a"', rest: str = "", body: str = "") -> Robot:
    """A bar that hangs from a joint, with actuators."""
    text = (
        f'<mujoco>{rest}<compiler angle="radian"/><worldbody><body name="bar" {body}><joint {joint} axis="0 1 0"/>{BAR}'
        f"</body></worldbody><actuator>{actuators}</actuator></mujoco>"
    )
    (folder / "bar.xml").write_text(text, encoding="utf-8")
    return read_robot(folder / "bar.xml")


def described(robot: Robot, joint: str) -> Description:
    made = Description("d", joint, "via")
    of_model(made, robot, robot.joint(joint), {})
    return made


def values(robot: Robot, joint: str) -> dict[str, float]:
    return {name: number.value for name, number in described(robot, joint).numbers.items()}


def test_an_actuator_without_input_hides_no_other(tmp_path: Path) -> None:
    """MuJoCo numbers actuators and controls apart: the ranges belong to controls."""
    no_input = '<dcmotor name="cog" joint="a" input="none" resistance="1" motorconst="0 0" cogging="0.2 3 0"/>'
    joint = mjcf(tmp_path, f'{no_input}<position joint="a" kp="30" kv="2"/>').joint("a")
    assert (joint.drive, joint.kp, joint.kd) == ("position", 30.0, 2.0)
    assert joint.remarks == ("actuator 'cog' has no input: not used",)
    assert mjcf(tmp_path, f'{no_input}<motor joint="a" ctrlrange="-4 4"/>').joint("a").effort == 4.0


def test_actuators_add_damping_and_rotor_through_their_gear(tmp_path: Path) -> None:
    given = '<position joint="a" kp="30" kv="2" damping="0.5" armature="0.02" gear="3"/>'
    robot, model = mjcf(tmp_path, given), mujoco.MjModel.from_xml_path(str(tmp_path / "bar.xml"))
    data, mass = mujoco.MjData(model), np.zeros((1, 1))
    data.qvel[0] = 2.0
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, mass)
    seen = values(robot, "a")
    assert seen["inertia"] == pytest.approx(mass[0, 0]) == pytest.approx(0.03151 + 0.18, abs=1e-5)
    assert seen["viscous_friction"] == pytest.approx(-data.qfrc_passive[0] / 2.0) == pytest.approx(4.5)
    assert seen["kd"] == 18.0
    assert "damping 4.5 N m s/rad and rotor inertia 0.18 kg m^2: included" in described(robot, "a").text()


def test_polynomial_damping_of_an_actuator_is_named(tmp_path: Path) -> None:
    joint = mjcf(tmp_path, '<motor joint="a" damping="0.5 0.1"/>').joint("a")
    assert "polynomial damping of its actuators: only the linear part is used" in joint.remarks


def test_damping_of_a_position_actuator_without_kv_is_kd_beyond_the_torque_limit(tmp_path: Path) -> None:
    made = described(mjcf(tmp_path, '<position joint="a" kp="20" damping="0.8" forcerange="-3 3"/>'), "a")
    assert (made.numbers["kd"].value, made.limited, made.numbers["viscous_friction"].value) == (0.8, "proportional", 0)


def test_a_drive_with_an_integral_and_a_slow_goal_is_read(tmp_path: Path) -> None:
    """At the joint: gains times the gear squared, the integral's torque times the gear, speed over the gear."""
    pid = '<pid joint="a" kp="20" kv="0.8" ki="5" imax="0.4" slewmax="3" gear="2" forcerange="-3 3"/>'
    made = described(mjcf(tmp_path, pid), "a")
    numbers = dict(made.numbers)
    made.numbers["rate"] = numbers["kd"]
    servo = parse_device(made.text(), "a.yaml").servo
    assert servo is not None and (servo.ki, servo.speed_limit) == (20.0, 1.5)
    wanted = {"kp": 80.0, "kd": 3.2, "ki": 20.0, "integral_limit": 4.0, "speed_limit": 1.5, "torque_limit": 6.0}
    assert {name: numbers[name].value for name in wanted} == pytest.approx(wanted)
    plain = described(mjcf(tmp_path, '<pid joint="a" kp="20" ki="5"/>'), "a")
    assert plain.numbers["ki"].value == 5.0 and not {"integral_limit", "speed_limit"} & plain.numbers.keys()


def test_position_and_speed_actuators_are_one_drive(tmp_path: Path) -> None:
    pair = '<velocity name="v" joint="a" kv="5"/><position joint="a" kp="50"/><motor name="m" joint="a"/>'
    joint = mjcf(tmp_path, pair).joint("a")
    assert (joint.kp, joint.kd) == (50.0, 5.0)
    assert "velocity actuator 'v' is part of the position drive" in joint.remarks[0]
    assert "'m' is a motor beside another drive: not used" in joint.remarks[1]


def test_a_servo_of_speed_is_no_servo_of_position(tmp_path: Path) -> None:
    joint = mjcf(tmp_path, '<intvelocity name="iv" joint="a" kp="30" kv="2" actrange="-1 1"/>').joint("a")
    assert joint.kp is None and joint.remarks == ("actuator 'iv' is neither a motor nor a position servo: not used",)


def test_units_bias_and_limits_of_a_torque_actuator(tmp_path: Path) -> None:
    motor = '<motor joint="a" gear="50" ctrlrange="-1 1" ctrllimited="true" forcerange="-3 3" forcelimited="true"/>'
    made = described(mjcf(tmp_path, motor), "a")
    assert "`scale: 50`" in made.text() and "effort 50 N m" in made.text()
    asymmetric = described(mjcf(tmp_path, '<motor joint="a" gear="-2" forcerange="-3 8"/>'), "a").text()
    assert "effort 16 N m" in asymmetric and "its force range is -16 to 6" in asymmetric
    late = described(mjcf(tmp_path, '<motor joint="a" delay="0.02" nsample="20"/>'), "a").text()
    assert "delay 0.02 s of its actuator: not used" in late
    general = '<general joint="a" gainprm="12" biastype="affine" biasprm="3 -12 -0.4" gear="2"/>'
    assert "adds a constant 6 N m: not used; write `offset: 0.125`" in " ".join(
        described(mjcf(tmp_path, general), "a").remarks
    )


def test_a_delay_beyond_that_of_device_files_is_no_number_of_the_model(tmp_path: Path) -> None:
    for delay, origin in (("0.16", "guessed"), ("0.05", "read")):
        actuator = f'<position joint="a" kp="30" kv="2" delay="{delay}" nsample="100"/>'
        number = described(mjcf(tmp_path, actuator), "a").numbers["delay"]
        assert number.origin == origin and number.value == min(float(delay), 0.1)
    assert "0.16 s" in described(mjcf(tmp_path, actuator.replace("0.05", "0.16")), "a").numbers["delay"].note


def test_compensated_and_disabled_gravity(tmp_path: Path) -> None:
    assert values(mjcf(tmp_path, ""), "a")["gravity_torque"] == pytest.approx(1.4715)
    compensated = mjcf(tmp_path, "", body='gravcomp="0.5"')
    assert values(compensated, "a")["gravity_torque"] == pytest.approx(0.73575)
    assert values(compensated, "a")["inertia"] == pytest.approx(0.03151, abs=1e-5)
    _, lift = compensated.reduced(["a"])
    assert lift is not None and lift.inertias[1].mass == 0.5
    none = mjcf(tmp_path, "", rest='<option><flag gravity="disable"/></option>')
    assert values(none, "a")["gravity_torque"] == 0.0


def test_what_acts_elsewhere_in_an_mjcf_file_is_named(tmp_path: Path) -> None:
    text = f"""<mujoco><option density="1000"/><worldbody><body><freejoint name="root"/><geom size=".1" mass="1"/>
      <body><joint name="hip" axis="0 1 0" ref="20"/>{BAR}<site name="s"/>
      <body pos="0 0 -.3"><joint name="knee" axis="0 1 0" stiffness="7"/>{BAR}</body></body></body></worldbody>
      <actuator><motor name="tip" site="s" gear="1 0 0 0 0 0"/></actuator></mujoco>"""
    (tmp_path / "r.xml").write_text(text, encoding="utf-8")
    robot = read_robot(tmp_path / "r.xml")
    assert robot.remarks == (
        "joints root are free or ball joints: taken as fixed",
        "actuators tip act on tendons, sites or bodies: not used",
        "fluid of density 1000 and viscosity 0: not used",
    )
    assert "as the model draws them (hip at 0.3491, else 0)" in described(robot, "knee").text()
    assert "joint knee, which it moves, has a spring of 7 N m/rad" in rigid_springs(robot, "hip")[0]
    assert rigid_springs(robot, "knee") == []


def pair(folder: Path, joints: str, mass: str = "0.1") -> Path:
    """A URDF file with bars along x at two joints `a` and `b`, whose elements are given."""
    link = (
        f'<link name="{{}}"><inertial><origin xyz="0.05 0 0"/><mass value="{mass}"/>'
        '<inertia ixx="1e-5" ixy="0" ixz="0" iyy="1e-5" iyz="0" izz="1e-5"/></inertial></link>'
    )
    text = f'<robot name="r"><link name="base"/>{link.format("f1")}{link.format("f2")}{joints}</robot>'
    (folder / "r.urdf").write_text(text, encoding="utf-8")
    return folder / "r.urdf"


def joint(name: str, parent: str, child: str, inside: str, kind: str = "revolute") -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/><axis xyz="0 1 0"/>'
        f'<limit lower="-1" upper="1" effort="5" velocity="3"/>{inside}</joint>'
    )


def test_joints_that_follow_another_belong_to_it(tmp_path: Path) -> None:
    """Inertia by the square of the factor, gravity by the factor, also of one that follows a follower."""
    friction = '<dynamics damping="0.1" friction="0.2"/>'
    beside = joint("b", "base", "f2", f'<mimic joint="a" multiplier="-3"/>{friction}')
    robot = read_robot(pair(tmp_path, joint("a", "base", "f1", friction) + beside))
    seen, bar = values(robot, "a"), 1e-5 + 0.1 * 0.05**2
    assert seen["inertia"] == pytest.approx(bar + 9.0 * bar)
    assert (seen["viscous_friction"], seen["coulomb_friction"]) == (pytest.approx(1.0), pytest.approx(0.8))
    assert "b follows it by a factor -3: its inertia, friction and gravity are included" in robot.joint("a").remarks
    model, _ = robot.reduced(["a"])
    assert pinocchio.crba(model, model.createData(), np.zeros(1))[0, 0] == pytest.approx(bar + 9.0 * bar)
    equal = joint("b", "base", "f2", '<mimic joint="a"/>')
    seen = values(read_robot(pair(tmp_path, joint("a", "base", "f1", "") + equal)), "a")
    assert seen["gravity_torque"] == pytest.approx(2.0 * 0.1 * 0.05 * 9.81)
    behind = joint("b", "f1", "f2", '<mimic joint="a" multiplier="2" offset="0.3"/>')
    robot = read_robot(pair(tmp_path, joint("a", "base", "f1", "") + behind))
    energy = [
        pinocchio.computePotentialEnergy(robot.model, robot.model.createData(), np.array([q, 2.0 * q + 0.3]))
        for q in (0.4 - 1e-5, 0.4 + 1e-5)
    ]
    moved = np.array([1.0, 2.0])
    weight = pinocchio.computeGeneralizedGravity(robot.model, robot.model.createData(), robot.configuration({"a": 0.4}))
    assert moved @ weight == pytest.approx((energy[1] - energy[0]) / 2e-5, rel=1e-5)
    assert any("no sine: the stated one is wrong by up to" in each for each in described(robot, "a").remarks)


def test_followers_of_each_other_are_an_error(tmp_path: Path) -> None:
    ring = joint("a", "base", "f1", '<mimic joint="b"/>') + joint("b", "base", "f2", '<mimic joint="a"/>')
    with pytest.raises(DeviceError, match="joints a, b mimic each other"):
        read_robot(pair(tmp_path, ring))


def test_transmissions_are_named_wherever_they_are(tmp_path: Path) -> None:
    file = pair(tmp_path, joint("a", "base", "f1", "") + joint("b", "f1", "f2", '<dynamics spring_stiffness="60"/>'))
    control = (
        '<ros2_control><joint name="a"><command_interface name="effort"/></joint><transmission name="t">'
        '<joint name="a"><mechanical_reduction>50</mechanical_reduction><offset>0.1</offset></joint></transmission>'
        "</ros2_control>"
    )
    file.write_text(file.read_text().replace("</robot>", f"{control}</robot>"), encoding="utf-8")
    robot = read_robot(file)
    assert "states a reduction of 50 and an offset of 0.1 rad" in robot.joint("a").remarks[0]
    assert robot.joint("a").drive == "torque"
    assert "joint b, which it moves, has a spring of 60 N m/rad: taken as rigid" in rigid_springs(robot, "a")[0]


@pytest.mark.parametrize(
    ("joints", "mass", "words"),
    [
        (joint("a", "base", "nolink", ""), "1", "child link [nolink] of joint [a] not found"),
        (joint("a", "base", "f1", "").replace("limit", "dropped"), "1", "type REVOLUTE but it does not specify limits"),
        (
            joint("a", "base", "f1", '<dynamics damping="1,5"/>') + joint("b", "f1", "f2", ""),
            "1",
            "joint 'a' states damping '1,5', which is no finite number",
        ),
        (
            joint("a", "base", "f1", '<dynamics armature="1.2.3"/>') + joint("b", "f1", "f2", ""),
            "1",
            "joint 'a' states armature '1.2.3'",
        ),
        (
            joint("a", "base", "f1", '<dynamics friction="-2"/>') + joint("b", "f1", "f2", ""),
            "1",
            "joint 'a' states friction -2; it must be 0 or more",
        ),
        (joint("a", "base", "f1", ""), "-1", "link 'f1': <inertial> states mass -1; it must be 0 or more"),
        (joint("a", "base", "f1", ""), "nan", "link 'f1': <inertial> states value 'nan', which is no finite number"),
        (joint("a", "f1", "f2", "") + joint("b", "f2", "f1", ""), "1", "links f2, f1 form a cycle"),
    ],
)
def test_a_urdf_that_is_wrong_gives_its_reason_in_one_line(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], joints: str, mass: str, words: str
) -> None:
    with pytest.raises(DeviceError, match=re.escape(words)) as error:
        read_robot(pair(tmp_path, joints, mass))
    assert "\n" not in str(error.value)
    assert capfd.readouterr().err == ""


def test_names_of_devices() -> None:
    assert [device_name(each) for each in ("Elbow-Joint", "panda/joint1", "1", "é")] == [
        "elbow_joint",
        "panda_joint1",
        "joint_1",
        "joint",
    ]
