"""A lab's robot as a URDF and an MJCF file, and its recordings, simulated by MuJoCo with more friction than they state.

The files have what public ones have: meshes that are missing, fixed, continuous and mimic joints, a transmission;
defaults, an include, a gear, a position actuator.
"""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pandas

URDF = """<?xml version="1.0"?>
<robot name="lab_arm">
  <link name="world"/>
  <link name="base"><visual><geometry><mesh filename="package://lab_arm/meshes/base.dae"/></geometry></visual>
    <inertial><mass value="4"/><inertia ixx=".01" ixy="0" ixz="0" iyy=".01" iyz="0" izz=".01"/></inertial></link>
  <link name="upper"><collision><geometry><mesh filename="package://lab_arm/meshes/upper.stl"/></geometry></collision>
    <inertial><origin xyz="0 0 -.15"/><mass value="2.0"/>
      <inertia ixx=".02" ixy="0" ixz="0" iyy=".02" iyz="0" izz=".002"/></inertial></link>
  <link name="fore"><inertial><origin xyz="0 0 -.12"/><mass value="1.2"/>
      <inertia ixx=".008" ixy="0" ixz="0" iyy=".008" iyz="0" izz=".001"/></inertial></link>
  <link name="tool"><inertial><origin xyz="0 0 -.02"/><mass value=".3"/>
      <inertia ixx=".0002" ixy="0" ixz="0" iyy=".0002" iyz="0" izz=".0002"/></inertial></link>
  <link name="tip"/>
  <link name="finger"/>
  <joint name="ground" type="fixed"><parent link="world"/><child link="base"/></joint>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 1"/>
    <axis xyz="0 1 0"/><limit lower="-2.5" upper="2.5" effort="40" velocity="3"/><dynamics damping=".3"/></joint>
  <joint name="elbow" type="continuous"><parent link="upper"/><child link="fore"/><origin xyz="0 0 -.3"/>
    <axis xyz="0 1 0"/><limit effort="20" velocity="4"/><dynamics damping=".15"/></joint>
  <joint name="flange" type="fixed"><parent link="fore"/><child link="tool"/><origin xyz="0 0 -.25"/></joint>
  <joint name="tip_joint" type="fixed"><parent link="tool"/><child link="tip"/></joint>
  <joint name="finger_joint" type="prismatic"><parent link="tip"/><child link="finger"/><axis xyz="1 0 0"/>
    <limit lower="0" upper=".04" effort="10" velocity=".1"/><mimic joint="elbow" multiplier="0.01"/></joint>
  <transmission name="gears"><type>transmission_interface/SimpleTransmission</type><joint name="elbow">
    <hardwareInterface>hardware_interface/EffortJointInterface</hardwareInterface></joint>
    <actuator name="motor"><mechanicalReduction>50</mechanicalReduction></actuator></transmission>
</robot>
"""
DEFAULTS = """<mujocoinclude><default><default class="arm">
  <joint axis="0 1 0" damping="0.3"/><position kp="40" kv="2" forcerange="-20 20"/></default></default></mujocoinclude>
"""
MJCF = """<mujoco model="lab_arm">
  <compiler angle="degree" meshdir="meshes"/>
  <include file="defaults.xml"/>
  <asset><mesh name="upper" file="upper.stl"/></asset>
  <worldbody>
    <body name="upper" pos="0 0 1" childclass="arm">
      <inertial pos="0 0 -.15" mass="2" diaginertia=".02 .02 .002"/>
      <joint name="shoulder" range="-143.2394 143.2394"/><geom type="mesh" mesh="upper"/>
      <body name="fore" pos="0 0 -.3">
        <inertial pos="0 0 -.12" mass="1.2" diaginertia=".008 .008 .001"/><joint name="elbow" damping=".15"/>
        <body name="tool" pos="0 0 -.25"><inertial pos="0 0 -.02" mass=".3" diaginertia=".0002 .0002 .0002"/></body>
      </body>
    </body>
  </worldbody>
  <actuator><position class="arm" joint="shoulder" gear="2"/>
    <motor joint="elbow" gear="50" ctrlrange="-.4 .4"/></actuator>
</mujoco>
"""
FRICTION = {"shoulder": 0.5, "elbow": 0.25}  # [N m] that neither file states
STEP = 2.0 * np.pi / 16384  # [rad] of the encoders


def write_robot(folder: Path) -> None:
    """robot.urdf, robot.xml and the file that it includes."""
    for name, text in (("robot.urdf", URDF), ("robot.xml", MJCF), ("defaults.xml", DEFAULTS)):
        (folder / name).write_text(text, encoding="utf-8")


def moved(seconds: float, rate: float = 500.0, locked: bool = False) -> dict[str, np.ndarray]:
    """time, q and tau (N, 2) of shoulder and elbow under a controller; `locked`: the shoulder rests at 0."""
    text = MJCF.replace(
        '<include file="defaults.xml"/>',
        DEFAULTS.replace("mujocoinclude", "extension").split("<extension>")[1].split("</extension>")[0],
    )
    text = text.replace('<asset><mesh name="upper" file="upper.stl"/></asset>', "").replace(
        '<geom type="mesh" mesh="upper"/>', ""
    )
    text = text[: text.index("<actuator>")] + "</mujoco>"
    spec = mujoco.MjSpec.from_string(text)
    for name, friction in FRICTION.items():
        spec.joint(name).frictionloss = friction
    if locked:
        spec.delete(spec.joint("shoulder"))
    model = spec.compile()
    steps = 5
    model.opt.timestep = 1.0 / (rate * steps)
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    data = mujoco.MjData(model)
    gains, damping = np.array([60.0, 25.0])[-model.nv :], np.array([4.0, 1.5])[-model.nv :]
    time = np.arange(round(seconds * rate)) / rate
    wanted = np.stack(
        [0.8 * np.sin(1.1 * time) + 0.3 * np.sin(3.1 * time), 0.9 * np.sin(1.7 * time + 0.3) + 0.4 * np.sin(4.1 * time)]
    )[-model.nv :]
    q, tau = np.zeros((2, len(time), model.nv))
    for k in range(len(time)):
        q[k], tau[k] = data.qpos, gains * (wanted[:, k] - data.qpos) - damping * data.qvel
        data.qfrc_applied[:] = tau[k]
        for _ in range(steps):
            mujoco.mj_step(model, data)
    return {"time": time, "q": STEP * np.rint(q / STEP), "tau": tau}


def write_arm(path: Path, seconds: float = 12.0) -> None:
    """A Parquet file of both joints, numbered."""
    run = moved(seconds, 250.0)
    columns = {"t": run["time"], **{f"{what}_{k + 1}": run[what][:, k] for what in ("q", "tau") for k in (0, 1)}}
    pandas.DataFrame(columns).to_parquet(path)


def write_run(path: Path, seconds: float = 20.0) -> None:
    """A CSV of the elbow alone, in the units of a lab: ms, deg, mN m."""
    run = moved(seconds, locked=True)
    rows = np.column_stack([1e3 * run["time"], np.degrees(run["q"][:, 0]), 1e3 * run["tau"][:, 0]])
    np.savetxt(
        path, rows, delimiter=",", header="Time [ms],Elbow Position (deg),Elbow Torque (mNm)", comments="", fmt="%.9g"
    )
