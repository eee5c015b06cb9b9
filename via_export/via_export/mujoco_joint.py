"""A joint's MuJoCo model, driven by the command rows of via_sim.

joint = MujocoJoint(xml, target)
data = joint.start(state, rows_before)
measured = joint.run(data, rows)        # (n + 1, axes) [rad] by the encoders
"""

from __future__ import annotations

from math import exp
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from via_core.errors import ParameterError
from via_core.signals import Array
from via_core.springs import MaccepaSpring
from via_sim.joint.layout import ARM, DAMPING, EXTERNAL, GOAL, M1, POWER, X
from via_sim.joint.parameters import LINK, POSITION_DRIVE, P

from via_export.mjcf_given import compiled
from via_export.mjcf_timing import ROUND, steps_late
from via_export.target import Target

LOCKED = 1e6  # [kg m^2] armature of the joints of a given model that are not driven
TOLERANCE = 1e-12  # [(rad/s^2)^2] of the constraint solver, which would need 100 iterations for a tolerance of 0
QUEUE = 400  # ticks of commands before a run that a delay can need
GROUP = 5  # of the drive of a position-controlled joint, which is disabled while the drive is off
_JOINT, _ACTUATOR = mujoco.mjtObj.mjOBJ_JOINT, mujoco.mjtObj.mjOBJ_ACTUATOR
_TENDON, _SENSOR = mujoco.mjtObj.mjOBJ_TENDON, mujoco.mjtObj.mjOBJ_SENSOR


class MujocoJoint:
    """A compiled model, and where the axes and drives of the joint are in it.

    target  joint that was exported
    link    name of its link's joint in the model; empty: that of the device
    rate    [Hz] of command rows; the time step divides its period
    folder  where a given model finds its meshes and included files

    Raises ParameterError if MuJoCo does not accept the model, or if it does not contain the joint.
    """

    def __init__(
        self, xml: str, target: Target, link: str = "", rate: float = 1000.0, folder: Path | None = None
    ) -> None:
        self.model = model = compiled(xml, folder)
        self.target = target
        self.names = (link or target.names[0], *target.names[1:])
        joints = [self._id(_JOINT, name) for name in self.names]
        self.qpos, self.dofs = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
        model.dof_armature[np.setdiff1d(np.arange(model.nv), self.dofs)] = LOCKED
        model.stat.meaninertia = model.dof_M0[self.dofs].min()  # the tolerance's scale; of heavy servos: too coarse
        model.opt.tolerance = TOLERANCE
        self.steps = max(1, int(np.ceil(1.0 / rate / model.opt.timestep - 1e-6)))
        model.opt.timestep = 1.0 / rate / self.steps
        self._set_delays()
        self.controls = self._controls()
        sensors = [self._id(_SENSOR, f"{name}_position") for name in self.names]
        self.sensors = model.sensor_adr[sensors]
        self.scale = np.ones(len(self.names))  # coordinate of an axis per angle
        spring = target.device.springs[0] if target.device.springs else None
        if target.device.arrangement == "serial" and isinstance(spring, MaccepaSpring):
            self.scale[2] = spring.drum_radius
        self.offsets = self.scale * [target.of_axis(P.encoder_offset, axis) for axis in range(len(self.names))]
        self.positioned = target.row[P.link_drive] == POSITION_DRIVE
        drive = self._drive_of(LINK) if not target.device.n_motors else -1
        self._drive, self._damping = drive, float(model.actuator_damping[drive]) if self.positioned else 0.0

    def _id(self, kind: Any, name: str) -> int:
        found = mujoco.mj_name2id(self.model, kind, name)
        if found < 0:
            raise ParameterError(f"the model has no {mujoco.mju_type2Str(kind)} '{name}'")
        return int(found)

    def _drive_of(self, axis: int) -> int:
        """The actuator of a drive; in a given model it can have another name."""
        model, name = self.model, self.names[axis]
        named = mujoco.mj_name2id(model, _ACTUATOR, f"{name}_drive")
        if named >= 0:
            return int(named)
        joint = self._id(_JOINT, name)
        on = (model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_JOINT)) & (model.actuator_trnid[:, 0] == joint)
        found = np.flatnonzero(on & (model.actuator_ctrlnum > 0))
        if not found.size:
            raise ParameterError(f"the model has no actuator of joint '{name}'")
        return int(found[0])

    def _set_delays(self) -> None:
        """Delays in whole time steps, which may differ from that of the file."""
        model, h = self.model, self.model.opt.timestep
        late = steps_late(self.target, h)
        for actuator in np.flatnonzero(model.actuator_delay > 0.0):
            most = int(model.actuator_history[actuator, 0]) - 1
            model.actuator_delay[actuator] = (min(late, most) - ROUND) * h

    def _controls(self) -> dict[int, int]:
        """Control -> column of a command row."""
        device, found = self.target.device, {}
        for axis in self.target.drives:
            column = GOAL if device.drive == "position" else M1 + axis - 1 if axis else EXTERNAL
            found[int(self.model.actuator_ctrladr[self._drive_of(axis)])] = column
        if device.damper is not None:
            for k in range(1, 2 if device.damper.map == "linear" else 3):
                found[int(self.model.actuator_ctrladr[self._id(_ACTUATOR, f"{device.name}_damper_{k}")])] = DAMPING
        return found

    def start(self, state: Array, before: Array) -> Any:
        """Data at the beginning of a run.

        state   (6 ..) row of via_sim: angles and velocities; longer ones also contain lags and elements with memory
        before  (n, N_COMMANDS) command rows of the ticks before, the last one first
        """
        model = self.model
        data = mujoco.MjData(model)
        self.place(data, np.arange(len(self.names)), state)
        times = -np.arange(1, 1 + QUEUE * self.steps) * model.opt.timestep
        for actuator in np.flatnonzero(model.actuator_delay > 0.0):
            control = int(model.actuator_ctrladr[actuator])
            count = int(model.actuator_history[actuator, 0])
            ticks = np.minimum((np.arange(count) // self.steps), len(before) - 1)
            values = before[ticks, self.controls.get(control, 0)]
            mujoco.mj_initCtrlHistory(model, data, actuator, times[:count][::-1].copy(), values[::-1, None].copy())
        if len(state) > X.queue:
            self._set_lags(data, state, before)
            self.remember(data, state[X.bristle : X.bristle + 5])
        self.slide(data)
        mujoco.mj_forward(model, data)
        return data

    def _sensor_history(self, data: Any, sensor: int) -> None:
        """The motion before, continued backwards with the present speed."""
        model = self.model
        count = int(model.sensor_history[sensor, 0])
        times = data.time - np.arange(count, 0, -1) * model.opt.timestep
        axis = int(np.flatnonzero(self.sensors == model.sensor_adr[sensor])[0])
        speed = data.qvel[self.dofs[axis]] / self.scale[axis]
        now = data.qpos[self.qpos[axis]] / self.scale[axis]
        mujoco.mj_initSensorHistory(model, data, sensor, times, (now + speed * (times - data.time))[:, None], 0.0)

    def place(self, data: Any, axes: Any, state: Array) -> None:
        """Set angles and velocities of some axes to those of a state (6 ..)."""
        for axis in axes:
            data.qpos[self.qpos[axis]] = self.scale[axis] * state[axis] + self.offsets[axis]
            data.qvel[self.dofs[axis]] = self.scale[axis] * state[3 + axis]
        for sensor in np.flatnonzero(self.model.sensor_delay > 0.0):
            self._sensor_history(data, int(sensor))

    def remember(self, data: Any, held: Array) -> None:
        """Set the torques [N m] (5,) of bristles of link and motors and of Maxwell elements of the transmissions."""
        model, target = self.model, self.target
        for axis, name in enumerate(self.names):
            torque, stiffness = target.bristle(axis)
            if torque > 0.0:
                data.act[model.actuator_actadr[self._id(_ACTUATOR, f"{name}_presliding")]] = held[axis] / stiffness
        for i in range(target.device.n_transmissions):
            if target.row[P.hysteresis_torque + i] > 0.0:
                tendon = self._id(_TENDON, f"{self.names[1 + i]}_hysteresis")
                first = int(model.tendon_plasticadr[tendon])
                length = data.qpos[self.qpos[0]] - data.qpos[self.qpos[1 + i]]
                data.plastic[first : first + 2] = length - held[3 + i] / target.row[P.hysteresis_stiffness + i]

    def _set_lags(self, data: Any, state: Array, before: Array) -> None:
        """Filters and slew rates of the drives as in a state of via_sim."""
        model, row = self.model, self.target.row
        for axis in self.target.drives:
            actuator = self._drive_of(axis)
            count, first = model.actuator_actnum[actuator], model.actuator_actadr[actuator]
            if self.positioned and row[P.integral_rate] > 0.0:  # the integral of the error is its last element
                data.act[first + count - 1] = state[X.integral] / row[P.integral_rate]
                count -= 1
            if count == 0:
                continue
            value = state[X.lag + axis]
            if self.positioned:
                late = min(int(float(row[P.delay]) * 1.0 / (self.steps * model.opt.timestep)), len(before) - 1)
                value = before[late, GOAL] - state[X.behind] - state[X.lag]
            data.act[first] = value

    def slide(self, data: Any) -> None:
        """Bristles of Stribeck friction of axes that move: they slide."""
        model, target = self.model, self.target
        for axis, name in enumerate(self.names):
            breakaway, kinetic, speed = target.dry(axis)
            v = float(data.qvel[self.dofs[axis]])
            if breakaway > kinetic and v != 0.0:
                actuator = self._id(_ACTUATOR, f"{name}_stribeck")
                stiffness = float(model.actuator_dynprm[actuator].max())
                force = kinetic + (breakaway - kinetic) * exp(-((v / speed) ** 2))
                data.act[model.actuator_actadr[actuator]] = np.sign(v) * force / max(stiffness, 1e-9)

    def run(self, data: Any, rows: Array) -> Array:
        """Advance by command rows (n, N_COMMANDS); angles (n + 1, axes) [rad] as the encoders measure them."""
        model = self.model
        out = np.empty((len(rows) + 1, len(self.names)))
        controls, columns = np.array([*self.controls.keys()]), np.array([*self.controls.values()])
        beside = ARM if not self.target.device.n_motors and not self.positioned else EXTERNAL
        for k, row in enumerate(rows):
            data.ctrl[controls] = row[columns]
            data.qfrc_applied[self.dofs[LINK]] = row[ARM] + (row[EXTERNAL] if beside == EXTERNAL else 0.0)
            if self.positioned:
                self._power(data, row[POWER] > 0.5)
            mujoco.mj_step(model, data)
            out[k] = data.sensordata[self.sensors]
            if self.steps > 1:
                mujoco.mj_step(model, data, self.steps - 1)
        mujoco.mj_forward(model, data)
        out[-1] = data.sensordata[self.sensors]
        return out

    def _power(self, data: Any, on: bool) -> None:
        """Switch a position drive; the goal of a drive that is off is the measured angle."""
        model, drive = self.model, self._drive
        model.actuator_group[drive] = GROUP
        model.opt.disableactuator = 0 if on else 1 << GROUP
        model.actuator_damping[drive] = self._damping if on else 0.0
        count, first = model.actuator_actnum[drive], model.actuator_actadr[drive]
        if on or not count:
            return
        data.act[first] = data.qpos[self.qpos[0]]
        if self.target.row[P.integral_rate] > 0.0:
            data.act[first + count - 1] = 0.0
