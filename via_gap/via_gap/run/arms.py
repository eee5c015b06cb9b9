"""Arms of rigid joints: each joint is diagnosed alone, with the torque of the rest of the arm as a known input.

The rigid bodies (a URDF, recursive Newton-Euler in pinocchio) give the torques that the measured motion of all joints
requires. Beyond inertia and gravity of its own device file, the rest of the arm acts on joint i with

    tau_arm,i = M_i qdd_i + g_i(q_i) - [M(q) qdd + c(q, qd) + g(q)]_i

as the command channel `arm_torque`. The diagnosis of one joint is used unchanged. A missing torque T is part of the
measured qdd, so that M_i (qdd - qdd_simulated) = T for any M_i: fitted sizes are unbiased although the joint's inertia
changes with the arm's pose (docs/adr/0006). The angle of the next joint is the channel `neighbour`.

    arm = load_arm("dfki_double_pendulum")
    reports = diagnose_arm(arm, [run], [held_out])       # one GapReport per joint, base first
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import pinocchio
from numpy.typing import NDArray
from pydantic import Field
from scipy.signal import savgol_filter
from via_core.arm_files import ArmFile, read_arm
from via_core.devices import Device, load_device, parse_device
from via_core.errors import DeviceError, SignalError
from via_core.recordings.entries import Constants
from via_core.robots.models import is_model, read_robot
from via_core.signals import Array, Signals

from via_gap.diagnosis import diagnose
from via_gap.logs.log import JointLog, read_log
from via_gap.report.report import GapReport
from via_gap.run.describe import Recorded, described

SMOOTHING = 0.03  # [s] half width of the cubic smoothing filter for velocity and acceleration
UNITS = {"external_torque": "N m", "neighbour": "rad", "arm_torque": "N m"}


class RigidArmFile(ArmFile):
    """One YAML per arm: its joints base first; those of its URDF have the names of the devices' links."""

    name: str
    title: str
    source: Annotated[tuple[str, ...], Field(min_length=1)]
    confidence: str
    joints: Annotated[tuple[str, ...], Field(min_length=2)]  # device names, or paths beside this file
    rotors: tuple[Annotated[float, Field(ge=0.0)], ...] = ()  # [kg m^2] seen at the joints; none: in the URDF's links


@dataclass(frozen=True, eq=False)
class Arm:
    """Rigid joints and the bodies between them."""

    name: str
    devices: tuple[Device, ...]  # one per joint, base first
    model: pinocchio.Model  # rotors as armature
    order: NDArray[np.intp]  # (n,) index of each device's joint in the model's vectors
    reference: Array | None = None  # (n,) [rad] angles in the zero pose of the model; None: 0

    def torques(self, angle: Array, velocity: Array, acceleration: Array) -> Array:
        """Drive torques (N, n) [N m] of a motion (N, n each) [rad, rad/s, rad/s^2] without any friction."""
        data = self.model.createData()
        out = np.empty_like(angle)
        v, a = np.zeros(self.model.nv), np.zeros(self.model.nv)
        for k in range(len(angle)):
            v[self.order], a[self.order] = velocity[k], acceleration[k]
            out[k] = pinocchio.rnea(self.model, data, self._configuration(angle[k]), v, a)[self.order]
        return out

    def _configuration(self, angle: Array) -> Array:
        """pinocchio's q: a joint without end stops is represented by cosine and sine."""
        q = pinocchio.neutral(self.model)
        angle = angle if self.reference is None else angle - self.reference
        for joint, value in zip(self.model.joints[1:], angle[np.argsort(self.order)], strict=True):
            q[joint.idx_q : joint.idx_q + joint.nq] = (np.cos(value), np.sin(value)) if joint.nq == 2 else value
        return q


def load_arm(name_or_path: str | Path) -> Arm:
    """The shipped arm of that name, or the one a YAML file describes. Raises DeviceError in one line."""
    path, file, model = read_arm(RigidArmFile, "arms", name_or_path)
    beside = [path.parent / joint if joint.endswith((".yaml", ".yml")) else joint for joint in file.joints]
    return _built(path.name, file, tuple(map(load_device, beside)), model)


def find_arm(name: str, recording: Path) -> Arm:
    """The arm of a URDF or MJCF file, with the joints in the recording, or the one that `load_arm` finds."""
    return arm_of_model(Path(name), recording) if is_model(name) else load_arm(name)


def arm_of_model(model: Path, recording: Path) -> Arm:
    """The arm of a URDF or MJCF file, with the joints that a recording contains; the others are fixed at zero.

    Raises ViaError where the recording has positions of no joint of the model.
    """
    robot = read_robot(model)
    recorded = Recorded.of(recording, robot)
    seen = {guess.joint for guess in recorded.guesses if guess.quantity == "position"}
    joints = [each for each in robot.joints if each.name in seen and not each.mimic]
    if not joints:
        there = ", ".join(sorted(seen - {""})) or "none with a name"
        names = ", ".join(each.name for each in robot.joints)
        raise SignalError(f"{recording}: has no joint of {model}, which has: {names}; the recording has: {there}")
    texts = [described("arm", robot, each.name, recorded, {}, Constants()).text() for each in joints]
    devices = tuple(parse_device(text, each.name) for text, each in zip(texts, joints, strict=True))
    reduced = robot.reduced([each.name for each in joints])
    order = np.array([reduced.joints[reduced.getJointId(each.name)].idx_v for each in joints], dtype=np.intp)
    return Arm(robot.name, devices, reduced, order, np.array([each.reference for each in joints]))


def _built(shown: str, file: RigidArmFile, devices: tuple[Device, ...], model: pinocchio.Model) -> Arm:
    for device in devices:
        if device.arrangement != "rigid":
            raise DeviceError(f"{shown}: joint '{device.name}' is {device.arrangement}, an arm's joints must be rigid")
        if not model.existJointName(device.link_joint):
            raise DeviceError(f"{shown}: no joint '{device.link_joint}' of '{device.name}' in {file.urdf}")
    if model.nv != len(devices):
        raise DeviceError(f"{shown}: {file.urdf} has {model.nv} joints that move, {len(devices)} are described")
    if len(file.rotors) not in (0, len(devices)):
        raise DeviceError(f"{shown}: rotors needs 0 or {len(devices)} numbers, got {len(file.rotors)}")
    order = np.array([model.joints[model.getJointId(device.link_joint)].idx_v for device in devices], dtype=np.intp)
    if file.rotors:
        armature = np.zeros(model.nv)
        armature[order] = file.rotors
        model.armature = armature
    return Arm(file.name, devices, model, order)


def read_arm_log(path: str | Path, arm: Arm) -> list[JointLog]:
    """One log per joint of a recording of the whole arm, base first. Raises SignalError where a joint is missing."""
    return arm_logs([read_log(path, device) for device in arm.devices], arm)


def arm_logs(logs: Sequence[JointLog], arm: Arm) -> list[JointLog]:
    """Logs of all joints, recorded together, with the channels `arm_torque` and `neighbour` added."""
    time = logs[0].measured.time
    for log in logs:
        if len(log.measured) != len(time) or not np.array_equal(log.measured.time, time):
            raise SignalError(f"{log.name}: '{log.device.name}' was not recorded with the rest of the arm")
        if log.torque is None and not log.motors_commanded:
            raise SignalError(f"{log.name}: neither torque nor goal of the drive of '{log.device.name}' was recorded")
    angle, velocity, acceleration = _motion(time, np.stack([log.measured["q"] for log in logs], axis=1))
    whole = arm.torques(angle, velocity, acceleration)
    made = []
    for i, log in enumerate(logs):
        link = log.device.link
        own = link.inertia * acceleration[:, i] + link.gravity_torque * np.sin(angle[:, i] - link.gravity_angle)
        sent = Signals(time, {}, {}) if log.commands is None else log.commands.resample(time)
        known = {"arm_torque": own - whole[:, i], "neighbour": angle[:, i + 1 if i + 1 < len(logs) else i - 1]}
        channels = {**sent.channels, **known}
        commands = Signals(time, channels, {**sent.units, **UNITS}, frozenset(channels))
        made.append(replace(log, commands=commands))
    return made


def _motion(time: Array, angle: Array) -> tuple[Array, Array, Array]:
    """Smoothed angles, velocities and accelerations (N, n each) at the stamps; gaps are interpolated."""
    period = float(np.median(np.diff(time)))
    half = max(2, round(SMOOTHING / period))
    if len(time) <= 2 * half + 1:
        raise SignalError(f"{len(time)} samples are too few for velocities")
    grid = np.linspace(time[0], time[-1], round((time[-1] - time[0]) / period) + 1)
    there = np.isfinite(angle)
    even = [np.interp(grid, time[seen], column[seen]) for column, seen in zip(angle.T, there.T, strict=True)]

    def derivative(order: int) -> Array:
        smooth = [savgol_filter(each, 2 * half + 1, 3, deriv=order, delta=grid[1] - grid[0]) for each in even]
        return np.stack([np.interp(time, grid, each) for each in smooth], axis=1)

    return derivative(0), derivative(1), derivative(2)


def diagnose_arm(
    arm: Arm,
    logs: Sequence[Sequence[JointLog]],
    holdout: Sequence[Sequence[JointLog]] = (),
    progress: Callable[[str, float], None] | None = None,
) -> tuple[GapReport, ...]:
    """One report per joint, base first, from recordings of the whole arm (each as `read_arm_log` returns it)."""
    notify = progress or (lambda _what, _share: None)

    def diagnosed(i: int, device: Device) -> GapReport:
        def report_share(what: str, share: float) -> None:
            notify(f"{device.name}: {what}", (i + share) / len(arm.devices))

        own, held = [run[i] for run in logs], [run[i] for run in holdout]
        return diagnose(own, device, held or None, report_share, only_equations=True)

    return tuple(diagnosed(i, device) for i, device in enumerate(arm.devices))
