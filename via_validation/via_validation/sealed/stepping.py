"""One run of a joint in MuJoCo: the drive, the joint and its Physics as the numbers of the compiled loop."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass, replace
from math import inf, pi
from pathlib import Path

import mujoco
import numpy as np
from via_core.device_parts import Exponential, Maccepa, Sinh, TorqueMotor
from via_core.devices import Device
from via_core.errors import ParameterError
from via_core.signals import Array

from via_validation.sealed.loop import EXPONENTIAL, MACCEPA, POLYNOMIAL, SIZES, STARTS, R, run
from via_validation.sealed.model import STEP, build, is_geometric, polynomial
from via_validation.sealed.physics import Physics

FILTER = 2.0 * pi * 60.0  # [rad/s] low pass of the measured speed


@dataclass(frozen=True)
class Servo:
    """A drive that follows a goal angle: tau = clip(kp (goal - q), +-torque_limit) - kd qd."""

    kp: float  # [N m/rad]
    kd: float  # [N m s/rad]
    torque_limit: float = inf  # [N m]
    speed_limit: float = inf  # [rad/s] at most so fast its own goal follows the command
    delay: float = 0.0  # [s] dead time of the goal


@dataclass(frozen=True)
class Drive:
    """The drive: a PID controller per motor on its quantised encoder, with feedforward torque."""

    references: Array  # (N, m) [rad] of the motors
    rates: Array  # (N, m) [rad/s]
    forward: Array  # (N, m) [N m], zero for servos
    damping: Array  # (N,) [0..1] command of the damper
    proportional: tuple[float, ...]  # [N m/rad]
    derivative: tuple[float, ...]  # [N m s/rad]
    rate: float  # [Hz] of ticks
    integral: tuple[float, ...] = ()  # [N m/(rad s)]; empty: none
    servo: Servo | None = None  # of a position drive, which gets `references` as its goal


@dataclass(frozen=True)
class Run:
    """The result of a simulation: motion at the ticks, and the commands between them."""

    time: Array  # (N+1,) [s]
    angle: Array  # (N+1, 1+m) [rad] link, motors
    speed: Array  # (N+1, 1+m) [rad/s]
    commands: Array  # (N, m) [N m] or [rad]; NaN where the controller missed the tick
    acted: Array  # (N,) [s] when it acted
    mean: Array  # (N, m) what was commanded on average over the tick; of a position drive its torque [N m]
    last: Array  # (N, m) the command that acted at the end of the tick
    row: Array  # numbers of the loop, among them the sensors'


def simulate(
    device: Device, physics: Physics, drive: Drive, push: Array, initial: Array, step: float = STEP,
    acts: Array | None = None,
) -> Run | None:  # fmt: skip
    """N ticks from rest at the angles `initial` (1+m,); None where the run diverged.

    push  (N,) [N m] on the link, held over its tick
    acts  (N,) [s] how late in each tick the controller acts, NaN where it misses the tick; without it always in time
    """
    model = build(device, replace(physics, delay=0.0) if drive.servo else physics, step)
    data = mujoco.MjData(model)
    ticks, axes = len(drive.references), 1 + device.n_motors
    substeps = round(1.0 / (drive.rate * step))
    if abs(substeps * step * drive.rate - 1.0) > 1e-9:
        raise ParameterError(f"a tick of {1.0 / drive.rate} s is no whole number of steps of {step} s")
    row = _row(device, physics, drive, step)
    data.qpos[:axes] = initial
    data.qpos[axes:] = initial[0]  # a follower starts unstretched
    _fill_delays(model, data, device, physics)
    _relax(model, data)
    motion, (commands, mean, last) = np.zeros((ticks + 1, 6)), np.zeros((3, ticks, 2))
    when = np.zeros(ticks) if acts is None else acts
    act = np.where(np.isfinite(when), np.clip(np.nan_to_num(when) / step, 0, substeps - 1), -1).astype(np.int64)
    done = run(
        row, _mj_step(), model._address, data._address, substeps, data.qpos, data.qvel, data.ctrl, data.qfrc_applied,
        model.dof_frictionloss, model.dof_damping, _two(drive.references), _two(drive.rates), _two(drive.forward),
        np.ascontiguousarray(device.damping_of(drive.damping)), np.ascontiguousarray(push, dtype=np.float64),
        act, motion, commands, mean, last,
    )  # fmt: skip
    if not done or not np.all(np.isfinite(motion)):
        return None
    time, m = np.arange(ticks + 1) / drive.rate, max(axes - 1, 1)
    acted = time[:-1] + np.maximum(act, 0) * step
    return Run(time, motion[:, :axes], motion[:, 3 : 3 + axes], commands[:, :m], acted, mean[:, :m], last[:, :m], row)


def _two(columns: Array) -> Array:
    """(N, 2) of (N, m)."""
    out = np.zeros((len(columns), 2))
    out[:, : columns.shape[1]] = columns
    return out


def _mj_step() -> int:
    (library,) = Path(mujoco.__file__).parent.glob("libmujoco.so*")  # the one that is loaded already
    address = ctypes.cast(ctypes.CDLL(str(library)).mj_step, ctypes.c_void_p).value
    assert address is not None
    return address


def _relax(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Tendons that yield start without torque: rest lengths where they are."""
    mujoco.mj_fwdPosition(model, data)
    for tendon, address in enumerate(model.tendon_plasticadr):
        if address >= 0:
            data.plastic[address : address + 2] = data.ten_length[tendon]


def _fill_delays(model: mujoco.MjModel, data: mujoco.MjData, device: Device, physics: Physics) -> None:
    """Before its first command a servo holds its angle; a motor has no torque."""
    if physics.delay > 0.0 and device.drive == "servo":
        for i in range(device.n_motors):
            samples = int(model.actuator_history[i, 0])
            times = (np.arange(samples) - samples) * model.opt.timestep
            mujoco.mj_initCtrlHistory(model, data, i, times, np.full(samples, data.qpos[1 + i]))


def _row(device: Device, physics: Physics, drive: Drive, step: float) -> Array:
    row = np.zeros(int(STARTS[-1]))
    for name in SIZES:
        if hasattr(physics, name):
            value = getattr(physics, name)
            row[getattr(R, name) : getattr(R, name) + SIZES[name]] = value
    row[R.axes], row[R.first] = 1 + device.n_motors, device.n_motors > 0
    row[R.servo] = device.drive == "servo"
    row[R.serial] = device.arrangement == "serial"
    row[R.step], row[R.damping_delay] = step, round(physics.delay / step)
    row[R.loss], row[R.viscous] = device.link.coulomb_friction, device.link.viscous_friction
    own, motors = device.sensors.link_quantum or 0.0, device.sensors.motor_quantum or 0.0
    row[R.quantum : R.quantum + 3] = np.maximum(physics.quantum, (own, motors, motors))
    row[R.limit : R.limit + 2] = np.inf
    row[R.smoothing] = FILTER
    for i, motor in enumerate(device.motors):
        if isinstance(motor, TorqueMotor):
            row[R.loss + 1 + i], row[R.viscous + 1 + i] = motor.coulomb_friction, motor.viscous_friction
            row[R.limit + i] = motor.torque_limit or np.inf
    row[R.proportional : R.proportional + len(drive.proportional)] = drive.proportional
    row[R.derivative : R.derivative + len(drive.derivative)] = drive.derivative
    row[R.integral : R.integral + len(drive.integral)] = drive.integral
    if drive.servo is not None:
        servo, delay = drive.servo, drive.servo.delay + physics.delay
        row[R.positioned], row[R.kp], row[R.kd], row[R.pull_limit] = 1.0, servo.kp, servo.kd, servo.torque_limit
        row[R.goal_speed], row[R.goal_delay] = min(servo.speed_limit, physics.goal_speed), round(delay / step)
        row[R.viscous] += servo.kd
    row[R.loss : R.loss + 3] += physics.friction
    row[R.viscous : R.viscous + 3] += physics.viscous
    for i in range(device.n_transmissions):
        law, coefficients = _law(device, i)
        row[R.law + i], row[R.native + i] = law, law == POLYNOMIAL or is_geometric(device, physics, i)
        row[R.spring + 6 * i : R.spring + 6 * i + len(coefficients)] = coefficients
    return row


def _law(device: Device, i: int) -> tuple[int, tuple[float, ...]]:
    given, powers = device.springs[i], polynomial(device, i)
    if powers is not None:
        return POLYNOMIAL, powers
    if isinstance(given, Sinh):
        return EXPONENTIAL, (0.5 * given.k, 0.5 * given.k, given.a)
    if isinstance(given, Exponential):
        return EXPONENTIAL, (given.k * given.rise, given.k * given.fall, given.a)
    if isinstance(given, Maccepa):
        return MACCEPA, (given.k, given.lever, given.base, given.free_length, given.drum_radius)
    raise ParameterError(f"springs.{i}: the joints of the benchmark have no law '{given.law}'")
