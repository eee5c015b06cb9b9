"""The hopper on flat ground, by MuJoCo: joints, motors and feet under held motor torques.

MuJoCo integrates links, rotors and springs together (`via_core.hopper.Hopper.mjcf`) in steps of a quarter of a
millisecond; its ground gives way by a fraction of a millimetre and does not make a robot bounce by itself.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np
from via_core.errors import ParameterError
from via_core.hopper import JOINTS, Hopper
from via_core.signals import Array, locked

STEP = 2.5e-4  # [s]


@dataclass(frozen=True)
class HopperState:
    """The whole of it; `whole` is MuJoCo's own state, from which the next step starts."""

    time: float  # [s]
    q: Array  # (4,) [rad] joints, order of JOINTS
    velocity: Array  # (4,) [rad/s]
    theta: Array  # (4,) [rad] motors
    motor_velocity: Array  # (4,) [rad/s]
    trunk: Array  # (3,) x [m], z [m], pitch [rad]
    trunk_velocity: Array  # (3,)
    force: Array  # (2,) [N] of the ground on the front and the rear foot, upwards
    whole: Array


@dataclass(frozen=True, eq=False)
class HopperPlant:
    """A hopper in MuJoCo. Not to be used by two threads at once: MuJoCo's workspace belongs to the plant."""

    hopper: Hopper
    _model: Any = field(init=False, repr=False)
    _data: Any = field(init=False, repr=False)
    _joints: Any = field(init=False, repr=False)
    _motors: Any = field(init=False, repr=False)
    _feet: Any = field(init=False, repr=False)

    def __post_init__(self) -> None:
        model = mujoco.MjModel.from_xml_string(self.hopper.mjcf(STEP))
        object.__setattr__(self, "_model", model)
        object.__setattr__(self, "_data", mujoco.MjData(model))
        # every joint moves by one number: addresses of angles and velocities agree
        object.__setattr__(self, "_joints", [model.joint(name).qposadr[0] for name in JOINTS])
        object.__setattr__(self, "_motors", [model.joint(f"{name}_motor").qposadr[0] for name in JOINTS])
        object.__setattr__(self, "_feet", [model.geom(f"{side}_foot").id for side in ("front", "rear")])

    @property
    def model(self) -> Any:
        """MuJoCo's model, to render it."""
        return self._model

    def start(self, q: Array, theta: Array, clearance: float, pitch: float = 0.0) -> HopperState:
        """At rest at joint angles `q` and motor angles `theta` (4,) [rad], the trunk turned by `pitch` [rad].

        Turned back, the soles would be `clearance` [m] above ground.
        """
        heights = [self.hopper.leg_height(leg) for leg in (q[:2], q[2:])]
        mujoco.mj_resetData(self._model, self._data)
        self._data.qpos[1:3] = max(heights) + clearance, pitch
        self._data.qpos[self._joints], self._data.qpos[self._motors] = q, theta
        mujoco.mj_forward(self._model, self._data)
        return self._state()

    def step(self, state: HopperState, torque: Array, duration: float) -> HopperState:
        """`duration` [s] later, a multiple of STEP, under held motor torques (4,) [N m], cut to their limits."""
        count = round(duration / STEP)
        if count < 1 or abs(count * STEP - duration) > 1e-9:
            raise ParameterError(f"duration must be a multiple of {STEP} s, got {duration}")
        mujoco.mj_setState(self._model, self._data, state.whole, mujoco.mjtState.mjSTATE_INTEGRATION)
        self._data.ctrl[:] = np.clip(torque, -self.hopper.torque_limit, self.hopper.torque_limit)
        mujoco.mj_step(self._model, self._data, nstep=count)
        return self._state()

    def _state(self) -> HopperState:
        model, data, kind = self._model, self._data, mujoco.mjtState.mjSTATE_INTEGRATION
        whole = np.empty(mujoco.mj_stateSize(model, kind))
        mujoco.mj_getState(model, data, whole, kind)
        force, wrench = np.zeros(2), np.zeros(6)
        for contact in range(data.ncon):
            mujoco.mj_contactForce(model, data, contact, wrench)
            for foot, geom in enumerate(self._feet):
                if geom in data.contact[contact].geom:
                    force[foot] += wrench[0]
        q, v = np.array(data.qpos), np.array(data.qvel)
        return HopperState(
            time=float(data.time),
            q=q[self._joints],
            velocity=v[self._joints],
            theta=q[self._motors],
            motor_velocity=v[self._motors],
            trunk=q[:3],
            trunk_velocity=v[:3],
            force=force,
            whole=locked(whole, "whole"),
        )
