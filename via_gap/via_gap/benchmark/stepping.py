"""The compiled loop round MuJoCo's mj_step: a drive with its controller, and torques for which MuJoCo has no part.

A substep of STEP: the few torques below are taken at the middle of the substep, where the joint will be to second
order, and held over it; friction losses and dampings that depend on the state are written into the model; mj_step (RK4)
does the rest. mj_step is called by its address: from Python the calls would cost more than the physics.

Own torques: exponential springs; what multiplies a spring (hardening, drift, a soft middle); a relaxing spring; ripple;
loss of torque with power; presliding friction as a bristle of Dahl, advanced exactly for the speed of the substep, so
that no step can overshoot.
"""

from __future__ import annotations

import ctypes
from collections import namedtuple
from dataclasses import dataclass
from math import copysign, cos, exp, pi, sin, sqrt
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic
from via_core.devices import Device, Exponential, Maccepa, Sinh, TorqueMotor
from via_core.errors import ParameterError
from via_core.signals import Array

from via_gap.benchmark.model import STEP, build, is_geometric, polynomial
from via_gap.benchmark.physics import Physics

MAX_ANGLE = 50.0  # [rad] beyond which a run has diverged
NO_LAW, POLYNOMIAL, EXPONENTIAL, MACCEPA = range(4)

# One flat row of numbers for the loop; of three entries each per axis, of two per motor or transmission.
_SIZES = {
    "axes": 1, "first": 1, "servo": 1, "serial": 1,
    "step": 1, "loss": 3, "viscous": 3, "breakaway": 3, "stribeck_velocity": 3,
    "uneven": 3, "uneven_viscous": 3, "load_friction": 3, "texture": 3, "texture_order": 3, "warm_friction": 3,
    "warming_energy": 3, "bristle": 3, "bristle_length": 3, "law": 2, "native": 2, "spring": 12, "gap": 2, "rest": 2,
    "hardening": 2, "drift": 2, "soften": 2, "relaxing": 2, "relaxation": 2, "ripple": 2, "ripple_order": 2,
    "ripple_phase": 2, "sag": 2, "preset_shift": 1, "damping_delay": 1, "offset": 3, "eccentricity": 3,
    "eccentric_order": 3, "eccentric_phase": 3, "quantum": 3, "limit": 2, "proportional": 2, "derivative": 2,
    "smoothing": 1,
}  # fmt: skip
_starts = np.concatenate(([0], np.cumsum(list(_SIZES.values()))))
R: Any = namedtuple("Row", list(_SIZES))(*(int(start) for start in _starts[:-1]))  # type: ignore
_compiled = njit(cache=True, error_model="numpy")


@intrinsic
def _call(_context: Any, function: Any, model: Any, data: Any) -> Any:
    """function(model, data): three addresses as whole numbers."""
    signature = types.void(types.int64, types.int64, types.int64)

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        pointer = ir.IntType(8).as_pointer()
        kind = ir.FunctionType(ir.VoidType(), [pointer, pointer])
        callee = builder.inttoptr(arguments[0], kind.as_pointer())
        builder.call(callee, [builder.inttoptr(each, pointer) for each in arguments[1:]])
        return context.get_dummy_value()

    return signature, generate


@_compiled
def spring(p: Array, i: int, phi: float, preset: float) -> float:
    """Torque [N m] of transmission i by its law alone, at the deflection phi [rad] outside its gap."""
    law, c = int(p[R.law + i]), R.spring + 6 * i
    if law == POLYNOMIAL:
        return (p[c] + p[c + 1] * phi * phi) * phi
    if law == EXPONENTIAL:
        return p[c] * exp(p[c + 2] * phi) - p[c + 1] * exp(-p[c + 2] * phi)
    if law == MACCEPA:
        k, lever, base, free, drum = p[c], p[c + 1], p[c + 2], p[c + 3], p[c + 4]
        length = sqrt(lever * lever + base * base - 2.0 * lever * base * cos(phi))
        return k * (length - free + drum * preset) * lever * base * sin(phi) / length
    return 0.0


@_compiled
def outside(phi: float, gap: float) -> float:
    """Deflection [rad] that is left of phi outside a gap around zero."""
    return copysign(max(abs(phi) - 0.5 * gap, 0.0), phi)


@_compiled
def read_angle(p: Array, axis: int, angle: float) -> float:
    """What the encoder of an axis shows at `angle` [rad]."""
    seen = angle + p[R.offset + axis]
    seen += p[R.eccentricity + axis] * sin(p[R.eccentric_order + axis] * angle + p[R.eccentric_phase + axis])
    quantum = p[R.quantum + axis]
    return quantum * np.rint(seen / quantum) + 0.0 if quantum > 0.0 else seen  # no -0


@_compiled
def read_angles(p: Array, axis: int, angles: Array) -> Array:
    """The same for (N,) angles."""
    return np.array([read_angle(p, axis, angle) for angle in angles])


@_compiled
def run(
    p: Array, step: int, model: int, data: int, substeps: int, qpos: Array, qvel: Array, ctrl: Array, applied: Array,
    loss: Array, viscous: Array, references: Array, rates: Array, forward: Array, damping: Array, push: Array,
    motion: Array, commands: Array,
) -> bool:  # fmt: skip
    """N ticks -> motion (N+1, 6), commands (N, 2); False where the run diverged.

    step, model, data           addresses of mj_step, of its model and of its data
    qpos .. viscous             views of MuJoCo's own arrays
    references, rates, forward  (N, 2) [rad], [rad/s], [N m]: what the drive's controller is to follow
    damping, push               (N,) [N m s/rad] of the damper, [N m] on the link
    """
    axes, first, h = int(p[R.axes]), int(p[R.first]), p[R.step]
    drives = axes - first  # the drive of a rigid joint is at the link itself
    shown, speed = np.zeros(2), np.zeros(2)
    bristle, relaxed, heat = np.zeros(3), np.zeros(2), np.zeros(3)
    torque, load = np.zeros(3), np.zeros(3)
    for i in range(drives):
        shown[i] = read_angle(p, first + i, qpos[first + i])
    for k in range(len(references)):
        for i in range(axes):
            motion[k, i], motion[k, 3 + i] = qpos[i], qvel[i]
        for i in range(drives):
            if p[R.servo] != 0.0:
                commands[k, i] = references[k, i]
            else:
                now = read_angle(p, first + i, qpos[first + i])
                speed[i] += p[R.smoothing] * ((now - shown[i]) / (substeps * h) - speed[i])
                shown[i] = now
                u = p[R.proportional + i] * (references[k, i] - now) + p[R.derivative + i] * (rates[k, i] - speed[i])
                limit = p[R.limit + i]
                commands[k, i] = min(max(u + forward[k, i], -limit), limit)
        for j in range(substeps):
            time = (k * substeps + j + 0.5) * h
            late = max((k * substeps + j - int(p[R.damping_delay])) // substeps, 0)
            for i in range(3):
                torque[i] = load[i] = 0.0
            torque[0] = push[k]
            q = qpos[0] + 0.5 * h * qvel[0]
            for i in range(drives):
                ctrl[i] = commands[k, i]
                own = qpos[first + i] + 0.5 * h * qvel[first + i]
                if p[R.ripple + i] != 0.0:
                    torque[first + i] += p[R.ripple + i] * sin(p[R.ripple_order + i] * own + p[R.ripple_phase + i])
                if p[R.sag + i] != 0.0:
                    power = abs(commands[k, i] * qvel[first + i])
                    torque[first + i] -= commands[k, i] * min(p[R.sag + i] * power, 0.9)
                law = int(p[R.law + i])
                if law == NO_LAW:
                    load[0] += commands[k, i] if first == 0 else 0.0
                    continue
                preset = 0.0
                if p[R.serial] != 0.0:
                    preset = qpos[2] + 0.5 * h * qvel[2] + p[R.preset_shift]
                phi = q - own - p[R.rest + i]
                stretched = outside(phi, p[R.gap + i])
                tau = spring(p, i, stretched, preset)
                factor = (1.0 + p[R.hardening + i] * stretched * stretched) * (1.0 + p[R.drift + i] * time)
                if p[R.soften + i] > 0.0:
                    factor *= phi * phi / (phi * phi + p[R.soften + i] * p[R.soften + i])
                more = tau * factor - (tau if p[R.native + i] != 0.0 else 0.0)
                if p[R.relaxing + i] > 0.0:
                    relaxed[i] += (phi - relaxed[i]) * (1.0 - exp(-h / p[R.relaxation + i]))
                    more += p[R.relaxing + i] * (phi - relaxed[i])
                torque[0] -= more
                load[0] += tau * factor
                load[1 + i] = abs(tau * factor)
                if p[R.servo] == 0.0:
                    torque[1 + i] += more
                if p[R.serial] != 0.0 and p[R.native] != 0.0:
                    ctrl[drives] = preset
            load[0] = abs(load[0])
            for i in range(axes):
                v = qvel[i]
                dry = p[R.loss + i] + p[R.load_friction + i] * load[i] + p[R.warm_friction + i] * exp(-heat[i])
                if p[R.breakaway + i] > 0.0:
                    ratio = v / p[R.stribeck_velocity + i]
                    dry += p[R.breakaway + i] * exp(-ratio * ratio)
                if p[R.texture + i] > 0.0:
                    dry += p[R.texture + i] * (1.0 + sin(p[R.texture_order + i] * qpos[i]))
                if p[R.warm_friction + i] > 0.0:
                    heat[i] += h * dry * abs(v) / p[R.warming_energy + i]
                loss[i] = dry
                torque[i] -= p[R.uneven + i]
                wet = p[R.viscous + i]
                if p[R.uneven_viscous + i] != 0.0:
                    wet += p[R.uneven_viscous + i] * copysign(1.0, v)
                if i == 0:
                    wet += damping[late]
                viscous[i] = wet
                if p[R.bristle + i] > 0.0:  # z' = v (1 - sign(v) z / length), v constant over the substep
                    length = p[R.bristle_length + i]
                    end = copysign(length, v)
                    before = bristle[i]
                    bristle[i] = end + (before - end) * exp(-abs(v) * h / length)
                    torque[i] -= p[R.bristle + i] * 0.5 * (before + bristle[i]) / length
                applied[i] = torque[i]
            _call(step, model, data)
        if not abs(qpos[0]) < MAX_ANGLE:
            return False
    for i in range(axes):
        motion[-1, i], motion[-1, 3 + i] = qpos[i], qvel[i]
    return True


@dataclass(frozen=True)
class Drive:
    """What the lab's own drive does: a PD controller per motor on its quantised encoder, and a torque ahead of it."""

    references: Array  # (N, m) [rad] of the motors
    rates: Array  # (N, m) [rad/s]
    forward: Array  # (N, m) [N m], zero for servos
    damping: Array  # (N,) [0..1] command of the damper
    proportional: tuple[float, ...]  # [N m/rad]
    derivative: tuple[float, ...]  # [N m s/rad]
    rate: float  # [Hz] of ticks


@dataclass(frozen=True)
class Run:
    """What was: motion at the ticks, and what the drive commanded over them."""

    time: Array  # (N+1,) [s]
    angle: Array  # (N+1, 1+m) [rad] link, motors
    speed: Array  # (N+1, 1+m) [rad/s]
    commands: Array  # (N, m) [N m] or [rad]
    row: Array  # numbers of the loop, among them the sensors'


def simulate(
    device: Device, physics: Physics, drive: Drive, push: Array, initial: Array, step: float = STEP
) -> Run | None:
    """N ticks from rest at the angles `initial` (1+m,); None where the joint left all bounds.

    push  (N,) [N m] on the link, held over its tick
    """
    model = build(device, physics, step)
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
    motion, commands = np.zeros((ticks + 1, 6)), np.zeros((ticks, 2))
    done = run(
        row, _mj_step(), model._address, data._address, substeps, data.qpos, data.qvel, data.ctrl, data.qfrc_applied,
        model.dof_frictionloss, model.dof_damping, _two(drive.references), _two(drive.rates), _two(drive.forward),
        np.ascontiguousarray(device.damping_of(drive.damping)), np.ascontiguousarray(push, dtype=np.float64),
        motion, commands,
    )  # fmt: skip
    if not done or not np.all(np.isfinite(motion)):
        return None
    time = np.arange(ticks + 1) / drive.rate
    return Run(time, motion[:, :axes], motion[:, 3 : 3 + axes], commands[:, : max(axes - 1, 1)], row)


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
    """Before its first command a servo was told to stay where it is; a motor had no torque."""
    if physics.delay > 0.0 and device.drive == "servo":
        for i in range(device.n_motors):
            samples = int(model.actuator_history[i, 0])
            times = (np.arange(samples) - samples) * model.opt.timestep
            mujoco.mj_initCtrlHistory(model, data, i, times, np.full(samples, data.qpos[1 + i]))


def _row(device: Device, physics: Physics, drive: Drive, step: float) -> Array:
    row = np.zeros(int(_starts[-1]))
    for name in _SIZES:
        if hasattr(physics, name):
            value = getattr(physics, name)
            row[getattr(R, name) : getattr(R, name) + _SIZES[name]] = value
    row[R.axes], row[R.first] = 1 + device.n_motors, device.n_motors > 0
    row[R.servo] = device.drive == "servo"
    row[R.serial] = device.arrangement == "serial"
    row[R.step], row[R.damping_delay] = step, round(physics.delay / step)
    row[R.loss], row[R.viscous] = device.link.coulomb_friction, device.link.viscous_friction
    own, motors = device.sensors.link_quantum or 0.0, device.sensors.motor_quantum or 0.0
    row[R.quantum : R.quantum + 3] = np.maximum(physics.quantum, (own, motors, motors))
    row[R.limit : R.limit + 2] = np.inf
    row[R.smoothing] = 1.0 - np.exp(-2.0 * pi * 60.0 / drive.rate)  # a first-order low pass at 60 Hz
    for i, motor in enumerate(device.motors):
        if isinstance(motor, TorqueMotor):
            row[R.loss + 1 + i], row[R.viscous + 1 + i] = motor.coulomb_friction, motor.viscous_friction
            row[R.limit + i] = motor.torque_limit or np.inf
    row[R.proportional : R.proportional + len(drive.proportional)] = drive.proportional
    row[R.derivative : R.derivative + len(drive.derivative)] = drive.derivative
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
    raise ParameterError(f"springs.{i}: the blind joints have no law '{given.law}'")
