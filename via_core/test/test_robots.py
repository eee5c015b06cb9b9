"""URDF and MJCF files: the bodies of MuJoCo, nothing dropped silently, no meshes needed, errors of one line."""

from pathlib import Path

import mujoco
import numpy as np
import pinocchio
import pytest
from own_robot import URDF, write_robot
from via_core.devices import parse_device
from via_core.errors import DeviceError
from via_core.robots.description import CAD, FRICTION, WITHOUT_ROTOR, Description, device_name, guess_gains, of_model
from via_core.robots.mjcf import read_mjcf
from via_core.robots.models import read_robot

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


def test_names_of_devices() -> None:
    assert [device_name(each) for each in ("Elbow-Joint", "panda/joint1", "1", "é")] == [
        "elbow_joint",
        "panda_joint1",
        "joint_1",
        "joint",
    ]
