"""Two robots as a newcomer brings them, simulated by MuJoCo itself with physics that their models lack.

`vendor_arm`  URDF of a vendor whose meshes are not there; a MATLAB log in deg, mN m and ms
`bench_arm`   MJCF of a lab; a bag in sqlite3 with plain joint states and control_msgs/DynamicJointState
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path

import mujoco
import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.io import savemat

LOAD, REACH, FRICTION = 0.6, 0.2132, 1.1  # [kg] at the tool, [m] from the elbow, [N m]
WALL, STIFFNESS, BENCH_FRICTION = 0.75, 400.0, 0.35  # [rad], [N m/rad], [N m]
STEP = 0.00025  # [s]
BRAKE = 1e6  # [kg m^2] rotor of a joint whose brake is on

URDF = """<?xml version="1.0"?>
<robot name="vendor_arm">
  <link name="base_link">
    <visual><geometry><mesh filename="package://vendor_description/meshes/base.dae"/></geometry></visual>
    <inertial><origin xyz="0 0 0.05"/><mass value="4.0"/>
      <inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.015"/></inertial>
  </link>
  <joint name="shoulder_lift_joint" type="revolute">
    <parent link="base_link"/><child link="upper_arm_link"/><origin xyz="0 0.12 0.15" rpy="0 1.5708 0"/>
    <axis xyz="0 1 0"/><limit lower="-3.1" upper="3.1" effort="150" velocity="3.1"/>
    <dynamics damping="0.8" friction="0"/>
  </joint>
  <link name="upper_arm_link">
    <collision><geometry><mesh filename="package://vendor_description/meshes/upper.stl"/></geometry></collision>
    <inertial><origin xyz="0 0 0.12"/><mass value="4.2"/>
      <inertia ixx="0.075" ixy="0" ixz="0" iyy="0.075" iyz="0" izz="0.008"/></inertial>
  </link>
  <joint name="elbow_joint" type="revolute">
    <parent link="upper_arm_link"/><child link="forearm_link"/><origin xyz="0 -0.09 0.24"/><axis xyz="0 1 0"/>
    <limit lower="-2.9" upper="2.9" effort="60" velocity="3.1"/><dynamics damping="0.4" friction="0"/>
    <safety_controller k_position="100" k_velocity="40" soft_lower_limit="-2.8" soft_upper_limit="2.8"/>
  </joint>
  <link name="forearm_link">
    <visual><geometry><mesh filename="package://vendor_description/meshes/forearm.dae"/></geometry></visual>
    <inertial><origin xyz="0 0 0.11"/><mass value="2.1"/>
      <inertia ixx="0.018" ixy="0" ixz="0" iyy="0.018" iyz="0" izz="0.0035"/></inertial>
  </link>
  <joint name="tool0_fixed" type="fixed">
    <parent link="forearm_link"/><child link="tool0"/><origin xyz="0 0 0.2132"/>
  </joint>
  <link name="tool0"/>
  <transmission name="elbow_trans">
    <type>transmission_interface/SimpleTransmission</type>
    <joint name="elbow_joint"><hardwareInterface>hardware_interface/EffortJointInterface</hardwareInterface></joint>
    <actuator name="elbow_motor"><mechanicalReduction>101</mechanicalReduction></actuator>
  </transmission>
</robot>
"""
MJCF = """<mujoco model="bench_arm">
  <compiler angle="radian" autolimits="true" meshdir="assets"/>
  <option gravity="0 0 -9.81"/>
  <default><default class="drive"><joint damping="0.12" armature="0.021"/></default></default>
  <worldbody>
    <body name="upper" pos="0 0 0.8">
      <joint class="drive" name="shoulder" axis="0 1 0" range="-1.6 1.6"/>
      <inertial pos="0.15 0 0" mass="1.8" diaginertia="0.002 0.014 0.014"/>
      <body name="fore" pos="0.3 0 0">
        <joint class="drive" name="elbow" axis="0 1 0" range="-2.2 2.2"/>
        <inertial pos="0.12 0 0" mass="0.9" diaginertia="0.0008 0.006 0.006"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="shoulder_motor" joint="shoulder" ctrlrange="-40 40"/>
    <motor name="elbow_motor" joint="elbow" ctrlrange="-15 15"/>
  </actuator>
</mujoco>
"""
INTERFACE = "control_msgs/msg/InterfaceValue", "string[] interface_names\nfloat64[] values\n"
DYNAMIC = (
    "control_msgs/msg/DynamicJointState",
    "std_msgs/Header header\nstring[] joint_names\ncontrol_msgs/InterfaceValue[] interface_values\n",
)
Control = Callable[[float, float, float], float]  # torque [N m] from time, angle, speed


def write_vendor_arm(folder: Path) -> None:
    """`arm.urdf` and `elbow_run3.mat`: the robot has a load, dry friction and a rotor that the URDF lacks."""
    (folder / "arm.urdf").write_text(URDF)
    bare = re.sub(r"<(visual|collision)>.*?</\1>", "", URDF, flags=re.DOTALL)
    spec = mujoco.MjSpec.from_string(bare.replace('<link name="tool0"/>', f"""<link name="tool0"><inertial>
        <origin xyz="0 0 0"/><mass value="{LOAD}"/><inertia ixx="4e-4" iyy="4e-4" izz="4e-4" ixy="0" ixz="0" iyz="0"/>
        </inertial></link>"""))  # fmt: skip
    spec.joint("shoulder_lift_joint").armature = BRAKE
    spec.joint("elbow_joint").frictionloss, spec.joint("elbow_joint").armature = FRICTION, 0.012

    def control(t: float, q: float, v: float) -> float:
        goal = 0.7 * np.sin(1.45 * t) + 0.35 * np.sin(4.46 * t + 0.4) + 0.12 * np.sin(11.9 * t)
        return float(120.0 * (min(1.0, 0.5 * t) * goal - q) - 9.0 * v)

    t, q, v, tau = np.array(list(_moved(spec.compile(), "elbow_joint", control, 12.0, 0.004))).T
    rng = np.random.default_rng(3)
    step = 2.0 * np.pi / 2**17
    log = {
        "Time_ms": 1e3 * t,
        "ElbowAngle_deg": np.degrees(step * np.rint((q + rng.normal(0.0, 2e-5, len(q))) / step)),
        "ElbowSpeed": np.degrees(v + rng.normal(0.0, 1e-3, len(v))),  # deg/s, which the name does not say
        "ElbowTorqueCmd_mNm": 1e3 * tau,
        "Temp_C": 31.0 + 0.01 * t,
    }
    savemat(folder / "elbow_run3.mat", {"log": log, "operator": "mk", "sw_version": 4.2})


def write_bench_arm(folder: Path) -> None:
    """`bench_arm.xml` and bag `run_07`: the robot has dry friction and ends at a cable before its limit.

    The motion reaches the cable about every 6 s.
    """
    (folder / "bench_arm.xml").write_text(MJCF)
    spec = mujoco.MjSpec.from_string(MJCF)
    spec.joint("shoulder").armature = BRAKE
    spec.joint("elbow").frictionloss = BENCH_FRICTION

    def control(t: float, q: float, v: float) -> float:
        goal = 0.65 * np.sin(1.068 * t) + 0.3 * np.sin(3.77 * t) + 0.08 * np.sin(13.82 * t)
        return float(45.0 * (min(1.0, 0.5 * t) * goal - q) - 2.2 * v - 0.848 * np.cos(q))

    def cable(q: float, v: float) -> float:
        return -max(STIFFNESS * (q - WALL) + 1.5 * v, 0.0) if q > WALL else 0.0

    rows = np.array(list(_moved(spec.compile(), "elbow", control, 30.0, 0.004, cable)))
    _write_bag(folder / "run_07", rows)


def _moved(
    model: mujoco.MjModel, joint: str, control: Control, duration: float, period: float,
    outside: Callable[[float, float], float] = lambda _q, _v: 0.0,
) -> Iterator[tuple[float, float, float, float]]:  # fmt: skip
    """Time, angle, speed and torque from then on, once per period of the controller."""
    model.opt.timestep, model.opt.integrator = STEP, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    data = mujoco.MjData(model)
    dof = int(model.joint(joint).dofadr[0])
    for k in range(round(duration / period)):
        q, v = float(data.qpos[dof]), float(data.qvel[dof])
        torque = control(k * period, q, v)
        yield k * period, q, v, torque
        for _ in range(round(period / STEP)):
            mujoco.mj_step1(model, data)
            data.qfrc_applied[dof] = torque + outside(float(data.qpos[dof]), float(data.qvel[dof]))
            mujoco.mj_step2(model, data)


def _write_bag(folder: Path, rows: np.ndarray) -> None:
    """Joint states whose effort is the torque over the interval that ends at the stamp, as drivers report it."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, text in (INTERFACE, DYNAMIC):
        store.register(get_types_from_msg(text, name))
    header, stamp = store.types["std_msgs/msg/Header"], store.types["builtin_interfaces/msg/Time"]
    state, value = store.types["sensor_msgs/msg/JointState"], store.types[INTERFACE[0]]
    rng = np.random.default_rng(5)
    with Writer(folder, version=9, storage_plugin=StoragePlugin.SQLITE3) as bag:
        plain = bag.add_connection("/joint_states", state.__msgtype__, typestore=store)
        dynamic = bag.add_connection("/dynamic_joint_states", DYNAMIC[0], typestore=store)
        before = 0.0
        for t, q, v, torque in rows:
            ns = 1_764_000_000_000_000_000 + round(t * 1e9)
            head = header(stamp(*divmod(ns, 10**9)), "")
            position, speed = (
                np.array([0.0, q]) + rng.normal(0.0, 2e-5, 2),
                np.array([0.0, v]) + rng.normal(0.0, 2e-3, 2),
            )
            effort = np.array([0.0, before])
            message = state(head, ["shoulder", "elbow"], position, speed, effort)
            bag.write(plain, ns + 350_000, store.serialize_cdr(message, state.__msgtype__))
            names = ["position", "velocity", "effort", "temperature"]
            values = [value(names, np.array([position[k], speed[k], effort[k], 30.0])) for k in (0, 1)]
            message = store.types[DYNAMIC[0]](head, ["shoulder", "elbow"], values)
            bag.write(dynamic, ns + 360_000, store.serialize_cdr(message, DYNAMIC[0]))
            before = torque
