"""What all joints of an arm feel, written into its model: the new model needs the torques of the arm with the cause."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from via_core.devices import load_device
from via_core.errors import ParameterError, ViaError
from via_core.robots.models import read_robot
from via_export import add_arm_cause
from via_gap.run.arm_body import BodyError
from via_gap.run.arm_cause import ArmCause, with_causes
from via_gap.run.arm_gravity import Gravity
from via_gap.run.arm_model import Arm
from via_gap.run.arm_offset import AngleOffset
from via_gap.run.arm_payload import Payload

MJCF = """<mujoco model="robot"><compiler angle="degree"/>
  <worldbody>
    <body name="upper" pos="0 0 .4">
      <joint name="lift" axis="0 1 0" pos=".02 0 .01" range="-90 90" ref="10"/>
      <inertial pos=".1 0.02 .03" quat=".8 .6 0 0" mass="2" diaginertia=".02 .03 .025"/>
      <body name="fore" pos=".3 0 .02" euler="20 0 10">
        <joint name="elbow" axis="0 .6 .8"/>
        <geom type="capsule" size=".03" fromto="0 0 0 .2 .05 0" mass="1.1"/>
      </body>
    </body>
  </worldbody>
</mujoco>"""
URDF = """<robot name="r"><link name="base"/>
<link name="upper"><inertial><origin xyz=".1 0.02 .03" rpy=".3 .2 -.4"/><mass value="2"/>
<inertia ixx=".02" iyy=".03" izz=".025" ixy=".001" ixz="0" iyz="-.002"/></inertial></link>
<link name="fore"><inertial><origin xyz=".1 .02 0"/><mass value="1.1"/>
<inertia ixx=".002" iyy=".004" izz=".004" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="lift" type="revolute"><origin xyz="0 0 .4" rpy=".1 0 .2"/><parent link="base"/><child link="upper"/>
<axis xyz="0 1 0"/><limit lower="-1.5" upper="1.5" effort="5" velocity="3"/></joint>
<joint name="elbow" type="continuous"><origin xyz=".3 0 .02" rpy=".3 0 .1"/><parent link="upper"/><child link="fore"/>
<axis xyz="0 .6 .8"/></joint></robot>"""
SOURCES = {"mjcf": MJCF, "urdf": URDF}
PAYLOAD = Payload("elbow", (), 0.4, 0.01, (0.1, 0.05, -0.1), (0.01, 0.01, 0.01), 0.9)
SHIFTED = BodyError("elbow", (), (0.1, 0.02, -0.01, 0.03, 0.02, 0.002, 0.025, -0.006, 0.003, 0.02), 10 * (0.0,), 0.9)
HEAVIER = BodyError("lift", (), (0.4, 0.04, 0.01, 0.01, 0.01, 0.0, 0.01, 0.0, 0.0, 0.01), 10 * (0.0,), 0.9, 0.2, 0.01)
TILTED = Gravity((0.5, -0.3, -9.7), (0.01, 0.01, 0.01), (0.0, 0.0, -9.81), (), 0.9)
CAUSES = [
    PAYLOAD,
    replace(PAYLOAD, mass=-0.05, position=(0.1, 0.025, 0.0)),
    SHIFTED,
    HEAVIER,
    AngleOffset("lift", (), 0.05, 0.001, 0.9),
]
CAUSES += [AngleOffset("elbow", (), -0.08, 0.001, 0.9)]


def arm_of(path: Path) -> Arm:
    """Both joints of a model; their devices only have names."""
    robot = read_robot(path)
    device = load_device("dfki_simple_pendulum")
    devices = tuple(device.model_copy(update={"name": each.name}) for each in robot.joints)
    order = np.array([robot.model.joints[robot.model.getJointId(each.name)].idx_v for each in robot.joints])
    return Arm("robot", devices, robot.model, order, np.array([each.reference for each in robot.joints]))


Write = Callable[[ArmCause, str], Path]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """The model with a cause, as a file; without one, the model itself."""

    def made(cause: ArmCause | None, to: str) -> Path:
        source, path = (tmp_path / f"{name}.{'xml' if to == 'mjcf' else 'urdf'}" for name in ("source", "made"))
        source.write_text(SOURCES[to])
        if cause is None:
            return source
        path.write_text(add_arm_cause(cause, to, source, "with a cause"))
        return path

    return made


@pytest.mark.parametrize("cause", CAUSES, ids=lambda each: f"{each.name}_{each.link}")
@pytest.mark.parametrize("to", ["urdf", "mjcf"])
def test_the_model_has_the_torques_of_the_arm_with_the_cause(to: str, cause: ArmCause, write: Write) -> None:
    q, v, a = np.random.default_rng(3).normal(size=(3, 20, 2))
    before, after = arm_of(write(None, to)), arm_of(write(cause, to))
    wanted = with_causes(before, [cause]).torques(q, v, a)
    np.testing.assert_allclose(after.torques(q, v, a), wanted, rtol=1e-6, atol=1e-6)
    assert np.abs(wanted - before.torques(q, v, a)).max() > 0.01


def test_gravity_is_an_option_of_mjcf_and_nothing_of_a_urdf(write: Write) -> None:
    q, v, a = np.random.default_rng(3).normal(size=(3, 20, 2))
    before, after = arm_of(write(None, "mjcf")), arm_of(write(TILTED, "mjcf"))
    np.testing.assert_allclose(after.torques(q, v, a), with_causes(before, [TILTED]).torques(q, v, a), atol=1e-6)
    with pytest.raises(ParameterError, match="turn the robot's base in its world"):
        write(TILTED, "urdf")
    with pytest.raises(ParameterError, match="its model is right"):
        write(replace(TILTED, gravity=(0.01, 0.0, 0.02)), "mjcf")


@pytest.mark.parametrize(("to", "low", "high"), [("urdf", -1.45, 1.55), ("mjcf", -1.5208, 1.6208)])
def test_limits_move_with_the_zero(to: str, low: float, high: float, write: Write) -> None:
    joint = read_robot(write(AngleOffset("lift", (), 0.05, 0.001, 0.9), to)).joint("lift")
    assert (joint.low, joint.high) == (pytest.approx(low, abs=1e-4), pytest.approx(high, abs=1e-4))


def test_a_joint_of_mjcf_may_slide_and_lie_within_a_frame(tmp_path: Path) -> None:
    (path := tmp_path / "framed.xml").write_text(
        MJCF.replace('<joint name="elbow" axis="0 .6 .8"/>', '<frame><joint name="elbow" type="slide"/></frame>')
    )
    text = add_arm_cause(AngleOffset("elbow", (), 0.05, 0.001, 0.9), "mjcf", path)
    assert mujoco.MjModel.from_xml_string(text).joint("elbow").qpos0[0] == pytest.approx(0.05)


def test_a_model_that_does_not_load_is_refused(write: Write) -> None:
    (again := write(PAYLOAD, "mjcf").with_name("again.xml")).write_text(write(PAYLOAD, "mjcf").read_text())
    with pytest.raises(ParameterError, match="repeated name 'elbow_payload'"):
        add_arm_cause(PAYLOAD, "mjcf", again)


def test_what_no_file_can_have_is_refused(write: Write, tmp_path: Path) -> None:
    for to in ("urdf", "mjcf"):
        with pytest.raises(ParameterError, match=r"the body at elbow would have -0\.3 kg"):
            write(replace(PAYLOAD, mass=-1.4), to)
        with pytest.raises(ViaError, match="no joint 'nobody'; there are: "):
            write(replace(PAYLOAD, link="nobody"), to)
    with pytest.raises(ParameterError, match="mjcf or urdf, got 'sdf'"):
        add_arm_cause(PAYLOAD, "sdf", tmp_path / "source.xml")
    with pytest.raises(ParameterError, match="is MJCF, not URDF"):
        add_arm_cause(PAYLOAD, "urdf", tmp_path / "source.xml")
    (geoms := tmp_path / "geoms.xml").write_text(
        MJCF.replace('angle="degree"', 'angle="degree" inertiafromgeom="true"')
    )
    with pytest.raises(ParameterError, match="inertias come from geoms"):
        add_arm_cause(SHIFTED, "mjcf", geoms)
