"""The hopper (`via_core.hopper.Hopper`) on flat ground, simulated by MuJoCo.

MuJoCo integrates links, rotors and springs together in steps of 0.25 ms. The ground yields by a fraction of a
millimetre and does not bounce the robot.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self
from xml.etree.ElementTree import Element, SubElement, tostring

import mujoco
import numpy as np
from via_core.errors import ParameterError
from via_core.hopper import GRAVITY, JOINTS, Hopper
from via_core.signals import Array, locked

from via_sim.robots.bodies import ArmState, Body

STEP = 2.5e-4  # [s]


@dataclass(frozen=True)
class HopperState(ArmState):
    """State of the hopper, joints in the order of JOINTS; the next step starts from `whole`, MuJoCo's full state."""

    time: float  # [s]
    trunk: Array  # (3,) x [m], z [m], pitch [rad]
    force: Array  # (2,) [N] normal force of the ground on the front and the rear foot
    whole: Array


@dataclass(frozen=True, eq=False)
class HopperPlant(Body[HopperState]):
    """A hopper in MuJoCo, dropped at the start. Not thread-safe: calls share the work memory of MuJoCo."""

    hopper: Hopper
    crouch: float = 0.6  # [rad] initial angle of the thighs, with relaxed springs
    drop: float = 0.03  # [m] initial height above ground

    @cached_property
    def _model(self) -> Any:
        return mujoco.MjModel.from_xml_string(_mjcf(self.hopper, STEP))

    @cached_property
    def _data(self) -> Any:
        return mujoco.MjData(self._model)

    @cached_property
    def _addresses(self) -> tuple[list[int], list[int], list[int]]:
        """Addresses of joints and motors, the same for angles and velocities, and numbers of the feet."""
        joints = [self._model.joint(name).qposadr[0] for name in JOINTS]
        motors = [self._model.joint(f"{name}_motor").qposadr[0] for name in JOINTS]
        return joints, motors, [self._model.geom(f"{side}_foot").id for side in ("front", "rear")]

    @property
    def name(self) -> str:
        return "hopper"

    @property
    def joints(self) -> tuple[str, ...]:
        return JOINTS

    def init(self) -> HopperState:
        motors = self.hopper.crouched(self.crouch)
        return self.start(motors, motors, self.drop)

    def start(self, q: Array, theta: Array, clearance: float, pitch: float = 0.0) -> HopperState:
        """State at rest at joint angles `q`, motor angles `theta` (4,) [rad] and trunk pitch `pitch` [rad].

        At zero pitch the lower sole would be `clearance` [m] above ground.
        """
        joints, motors, _ = self._addresses
        heights = [self.hopper.leg_height(leg) for leg in (q[:2], q[2:])]
        mujoco.mj_resetData(self._model, self._data)
        self._data.qpos[1:3] = max(heights) + clearance, pitch
        self._data.qpos[joints], self._data.qpos[motors] = q, theta
        mujoco.mj_forward(self._model, self._data)
        return self._state()

    def step(self, state: HopperState, torque: Array, period: float) -> HopperState:
        """State `period` [s] later, a multiple of STEP, under constant motor torques (4,) [N m], limited."""
        count = round(period / STEP)
        if count < 1 or abs(count * STEP - period) > 1e-9:
            raise ParameterError(f"period must be a multiple of {STEP} s, got {period}")
        mujoco.mj_setState(self._model, self._data, state.whole, mujoco.mjtState.mjSTATE_INTEGRATION)
        self._data.ctrl[:] = self.limited(state, torque)
        mujoco.mj_step(self._model, self._data, nstep=count)
        return self._state()

    def limited(self, state: HopperState, torque: Array) -> Array:
        return np.clip(torque, -self.hopper.torque_limit, self.hopper.torque_limit)

    def stopped(self, state: HopperState) -> HopperState:
        return self.init()

    def spring_torque(self, state: HopperState) -> Array:
        return self.hopper.spring_state(state.q - state.theta)[0]

    def contact_force(self, state: HopperState) -> Array:
        return np.array([0.0, 0.0, state.force.sum()])

    def base(self, state: HopperState) -> Array | None:
        x, z, pitch = state.trunk
        return np.array([x, 0.0, z, 0.0, np.sin(0.5 * pitch), 0.0, np.cos(0.5 * pitch)])

    def pushed(self, state: HopperState, impulse: Array, deflection: Array) -> HopperState:
        raise ParameterError("the hopper cannot be pushed; it starts by falling")

    def held(self, state: HopperState) -> Self:
        raise ParameterError("the hopper cannot be held: it has no end effector")

    def released(self) -> Self:
        return self

    def _state(self) -> HopperState:
        model, data, kind = self._model, self._data, mujoco.mjtState.mjSTATE_INTEGRATION
        joints, motors, feet = self._addresses
        whole = np.empty(mujoco.mj_stateSize(model, kind))
        mujoco.mj_getState(model, data, whole, kind)
        force, wrench = np.zeros(2), np.zeros(6)
        for contact in range(data.ncon):
            mujoco.mj_contactForce(model, data, contact, wrench)
            for foot, geom in enumerate(feet):
                if geom in data.contact[contact].geom:
                    force[foot] += wrench[0]
        q, v = np.array(data.qpos), np.array(data.qvel)
        return HopperState(
            q[joints], v[joints], q[motors], v[motors], float(data.time), q[:3], force, locked(whole, "whole")
        )


def _mjcf(hopper: Hopper, step: float) -> str:
    """The robot above flat ground as MuJoCo XML with integration step `step` [s]; motors in the order of JOINTS.

    The motors are hinges beside the robot, connected by springs as by tendons: rotors spin but do not swing along.
    """
    top = Element("mujoco", model="hopper")
    option = {"integrator": "implicitfast", "cone": "elliptic", "impratio": "20"}  # against creeping feet
    SubElement(top, "option", attrib=option, timestep=f"{step}", gravity=f"0 0 -{GRAVITY}")
    world = SubElement(top, "worldbody")
    ball = {"friction": f"{hopper.foot_friction} 0.005 0.0001", "solref": "0.004 1"}
    SubElement(world, "geom", name="ground", type="plane", size="10 1 .1", attrib=ball)
    trunk = SubElement(world, "body", name="trunk")
    for name, axis, kind in (("x", "1 0 0", "slide"), ("z", "0 0 1", "slide"), ("pitch", "0 1 0", "hinge")):
        SubElement(trunk, "joint", name=name, type=kind, axis=axis)
    half = f"{0.5 * hopper.trunk_length} .1 {0.5 * hopper.trunk_height}"
    free = {"contype": "0", "conaffinity": "0"}
    SubElement(trunk, "geom", type="box", size=half, mass=f"{hopper.trunk_mass + hopper.payload}", attrib=free)
    for side, x in (("front", 0.5 * hopper.trunk_length), ("rear", -0.5 * hopper.trunk_length)):
        parent, at = trunk, f"{x} 0 0"
        for part, joint, mass in (("thigh", "hip", hopper.thigh_mass), ("shank", "knee", hopper.shank_mass)):
            body = SubElement(parent, "body", name=f"{side}_{part}", pos=at)
            name = f"{side}_{joint}"
            # a rotation about -y moves a hanging leg forward
            SubElement(body, "joint", name=name, type="hinge", axis="0 -1 0", damping=f"{hopper.joint_damping}")
            ends = f"0 0 0 0 0 -{hopper.segment_length}"
            SubElement(body, "geom", type="capsule", fromto=ends, size=".01", mass=f"{mass}", attrib=free)
            parent, at = body, f"0 0 -{hopper.segment_length}"
        foot = {"name": f"{side}_foot", "pos": at, "size": f"{hopper.foot_radius}", "mass": "0"}
        SubElement(parent, "geom", type="sphere", attrib=foot | ball)
    tendons, actuators = SubElement(top, "tendon"), SubElement(top, "actuator")
    for name, stiffness in zip(JOINTS, hopper.stiffness, strict=True):
        rotor, about = SubElement(world, "body", name=f"{name}_rotor", pos="0 1 0"), f"{hopper.rotor_inertia}"
        SubElement(rotor, "inertial", pos="0 0 0", mass="1", diaginertia=" ".join([about] * 3))
        SubElement(rotor, "joint", name=f"{name}_motor", type="hinge", axis="0 -1 0")
        spring = SubElement(tendons, "fixed", name=f"{name}_spring", stiffness=f"{stiffness}", springlength="0")
        SubElement(spring, "joint", joint=name, coef="1")
        SubElement(spring, "joint", joint=f"{name}_motor", coef="-1")
        limit = f"-{hopper.strongest} {hopper.strongest}"
        SubElement(actuators, "motor", name=name, joint=f"{name}_motor", ctrlrange=limit, ctrllimited="true")
    return tostring(top, encoding="unicode")
