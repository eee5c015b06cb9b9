"""One simulation of a joint in MuJoCo: drive, joint and Physics are converted to parameters of the compiled loop."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass, replace
from math import inf, pi
from pathlib import Path

import mujoco
import numpy as np
from via_core.device_parts import TorqueMotor
from via_core.devices import Device
from via_core.errors import ParameterError
from via_core.signals import Array
from via_core.springs import ExponentialSpring, MaccepaSpring, SinhSpring

from via_validation.sealed.loop import EXPONENTIAL, MACCEPA, POLYNOMIAL, SIZES, STARTS, R, run
from via_validation.sealed.model import STEP, build, is_geometric, polynomial
from via_validation.sealed.physics import Physics

FILTER = 2.0 * pi * 60.0  # [rad/s] low pass of the measured speed


@dataclass(frozen=True)
class Servo:
    """A position drive: tau = clip(kp (goal - q), +-torque_limit) - kd qd."""

    kp: float  # [N m/rad]
    kd: float  # [N m s/rad]
    torque_limit: float = inf  # [N m]
    speed_limit: float = inf  # [rad/s] rate limit of its goal
    delay: float = 0.0  # [s] dead time of the goal


@dataclass(frozen=True)
class Drive:
    """A PID controller per motor on its quantised encoder, with feedforward torque."""

    references: Array  # (N, m) [rad] of the motors
    rates: Array  # (N, m) [rad/s]
    forward: Array  # (N, m) [N m], zero for servos
    damping: Array  # (N,) [0..1] command of the damper
    proportional: tuple[float, ...]  # [N m/rad]
    derivative: tuple[float, ...]  # [N m s/rad]
    rate: float  # [Hz] of ticks
    integral: tuple[float, ...] = ()  # [N m/(rad s)]; empty: none
    servo: Servo | None = None  # position drive; `references` are its goals
    acts: Array | None = None  # (N,) [s] delay of the controller in each tick, NaN: misses the tick; None: on time


@dataclass(frozen=True)
class Run:
    """The result of a simulation: motion at the ticks, and the commands between them."""

    time: Array  # (N+1,) [s]
    angle: Array  # (N+1, 1+m) [rad] link, motors
    speed: Array  # (N+1, 1+m) [rad/s]
    commands: Array  # (N, m) [N m] or [rad]; NaN if the controller missed the tick
    acted: Array  # (N,) [s] when the controller acted
    mean: Array  # (N, m) mean command over the tick; for a position drive its torque [N m]
    last: Array  # (N, m) command in force at the end of the tick
    row: Array  # parameters of the loop, including the sensors


def simulate(
    device: Device, physics: Physics, drive: Drive, push: Array, initial: Array, step: float = STEP
) -> Run | None:
    """N ticks from rest at the angles `initial` (1+m,); None if the run diverged.

    push  (N,) [N m] on the link, constant over its tick
    step  [s] of the integration
    """
    model = build(device, replace(physics, delay=0.0) if drive.servo else physics, step)
    data = mujoco.MjData(model)
    ticks, axes = len(drive.references), 1 + device.n_motors
    substeps = round(1.0 / (drive.rate * step))
    if abs(substeps * step * drive.rate - 1.0) > 1e-9:
        raise ParameterError(f"a tick of {1.0 / drive.rate} s must be an integer number of steps of {step} s")
    row = _row(device, physics, drive, step)
    data.qpos[:axes] = initial
    data.qpos[axes:] = initial[0]  # a follower starts unstretched
    _fill_delays(model, data, device, physics)
    _relax(model, data)
    motion, (commands, mean, last) = np.zeros((ticks + 1, 6)), np.zeros((3, ticks, 2))
    late = np.zeros(ticks) if drive.acts is None else drive.acts
    act = np.where(np.isfinite(late), np.clip(np.nan_to_num(late) / step, 0, substeps - 1), -1).astype(np.int64)
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
    """(N, m) columns padded with zeros to (N, 2)."""
    out = np.zeros((len(columns), 2))
    out[:, : columns.shape[1]] = columns
    return out


def _mj_step() -> int:
    (library,) = Path(mujoco.__file__).parent.glob("libmujoco.so*")  # already loaded by mujoco
    address = ctypes.cast(ctypes.CDLL(str(library)).mj_step, ctypes.c_void_p).value
    assert address is not None
    return address


def _relax(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Set the rest lengths of yielding tendons to their present lengths, so that they start without torque."""
    mujoco.mj_fwdPosition(model, data)
    for tendon, address in enumerate(model.tendon_plasticadr):
        if address >= 0:
            data.plastic[address : address + 2] = data.ten_length[tendon]


def _fill_delays(model: mujoco.MjModel, data: mujoco.MjData, device: Device, physics: Physics) -> None:
    """Fill the delay buffers of servos with their initial angle; motors start with zero torque."""
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
        kp, kd = servo.kp * physics.position_gain, servo.kd * physics.gain[0]
        row[R.positioned], row[R.kp], row[R.kd], row[R.pull_limit] = 1.0, kp, kd, servo.torque_limit
        row[R.drive_gain] = physics.gain[0]
        row[R.goal_speed], row[R.goal_delay] = min(servo.speed_limit, physics.goal_speed), round(delay / step)
        row[R.lead] = physics.feedforward * servo.kd / kp
        row[R.viscous] += kd
    row[R.loss : R.loss + 3] += physics.friction
    row[R.viscous : R.viscous + 3] += physics.viscous
    for i in range(device.n_transmissions):
        kind, coefficients = _spring(device, i)
        row[R.kind + i], row[R.native + i] = kind, kind == POLYNOMIAL or is_geometric(device, physics, i)
        row[R.spring + 6 * i : R.spring + 6 * i + len(coefficients)] = coefficients
    return row


def _spring(device: Device, i: int) -> tuple[int, tuple[float, ...]]:
    given, powers = device.springs[i], polynomial(device, i)
    if powers is not None:
        return POLYNOMIAL, powers
    if isinstance(given, SinhSpring):
        return EXPONENTIAL, (0.5 * given.k, 0.5 * given.k, given.a)
    if isinstance(given, ExponentialSpring):
        return EXPONENTIAL, (given.k * given.rise, given.k * given.fall, given.a)
    if isinstance(given, MaccepaSpring):
        return MACCEPA, (given.k, given.lever, given.base, given.free_length, given.drum_radius)
    raise ParameterError(f"springs.{i}: the benchmark has no spring '{type(given).__name__}'")
