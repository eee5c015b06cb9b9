"""Compiled simulation loop around MuJoCo's mj_step: a drive with its controller, and torques that MuJoCo lacks.

In each substep the torques below are evaluated at the middle of the substep, where the joint will be to second order,
and held constant over it. Friction losses and dampings that depend on the state are written into the model, and mj_step
(RK4) integrates. mj_step is called by its address, since calls from Python would cost more than the physics.

Torques computed here: exponential springs; factors on a spring (hardening, drift, soft middle); a relaxing spring;
ripple; loss of torque with power; a position drive; presliding friction as a Dahl bristle, solved exactly for constant
speed over the substep, so that no step can overshoot.
"""

from __future__ import annotations

from collections import namedtuple
from math import copysign, cos, exp, isfinite, nan, sin, sqrt
from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic
from numpy.typing import NDArray
from via_core.signals import Array

from via_validation.sealed.physics import HARMONICS

MAX_ANGLE = 50.0  # [rad] beyond this a run has diverged
NO_SPRING, POLYNOMIAL, EXPONENTIAL, MACCEPA = range(4)

# Parameters of the loop in one flat row: name -> entries; 3 are one per axis, 2 one per motor or transmission.
SIZES = {
    "axes": 1, "first": 1, "servo": 1, "serial": 1,
    "step": 1, "loss": 3, "viscous": 3, "breakaway": 3, "stribeck_velocity": 3,
    "uneven": 3, "uneven_viscous": 3, "load_friction": 3, "texture": 3, "texture_order": 3, "warm_friction": 3,
    "warming_energy": 3, "bristle": 3, "bristle_length": 3, "kind": 2, "native": 2, "spring": 12, "gap": 2, "rest": 2,
    "hardening": 2, "drift": 2, "soften": 2, "relaxing": 2, "relaxation": 2, "ripple": 2 * HARMONICS,
    "ripple_order": 2 * HARMONICS, "ripple_phase": 2 * HARMONICS, "deadband": 2, "dead_zone": 2, "gear": 2 * HARMONICS,
    "gear_order": 2 * HARMONICS, "gear_phase": 2 * HARMONICS, "sag": 2, "preset_shift": 1, "damping_delay": 1,
    "offset": 3, "eccentricity": 3 * HARMONICS, "eccentric_order": 3 * HARMONICS, "eccentric_phase": 3 * HARMONICS,
    "quantum": 3, "limit": 2, "proportional": 2, "derivative": 2, "integral": 2, "smoothing": 1,
    "positioned": 1, "kp": 1, "kd": 1, "pull_limit": 1, "goal_speed": 1, "goal_delay": 1, "goal_band": 1,
    "drive_gain": 1, "integral_rate": 1, "lead": 1,
}  # fmt: skip
STARTS = np.concatenate(([0], np.cumsum(list(SIZES.values()))))
R: Any = namedtuple("Row", list(SIZES))(*(int(start) for start in STARTS[:-1]))  # type: ignore
_compiled = njit(cache=True, error_model="numpy")


@intrinsic
def _call(_context: Any, function: Any, model: Any, data: Any) -> Any:
    """Call function(model, data); all three are addresses as integers."""
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
    """Torque [N m] of transmission i without factors, at the deflection phi [rad] outside its backlash."""
    kind, c = int(p[R.kind + i]), R.spring + 6 * i
    if kind == POLYNOMIAL:
        return (p[c] + p[c + 1] * phi * phi) * phi
    if kind == EXPONENTIAL:
        return p[c] * exp(p[c + 2] * phi) - p[c + 1] * exp(-p[c + 2] * phi)
    if kind == MACCEPA:
        k, lever, base, free, drum = p[c], p[c + 1], p[c + 2], p[c + 3], p[c + 4]
        length = sqrt(lever * lever + base * base - 2.0 * lever * base * cos(phi))
        return k * (length - free + drum * preset) * lever * base * sin(phi) / length
    return 0.0


@_compiled
def outside(phi: float, gap: float) -> float:
    """Deflection [rad] beyond a dead band of width `gap` around zero."""
    return copysign(max(abs(phi) - 0.5 * gap, 0.0), phi)


@_compiled
def read_smooth(p: Array, axis: int, angle: float) -> float:
    """Encoder measurement of an axis at `angle` [rad] before rounding."""
    seen = angle + p[R.offset + axis]
    for k in range(HARMONICS * axis, HARMONICS * (axis + 1)):
        if p[R.eccentricity + k] != 0.0:
            seen += p[R.eccentricity + k] * sin(p[R.eccentric_order + k] * angle + p[R.eccentric_phase + k])
    return seen


@_compiled
def read_angle(p: Array, axis: int, angle: float, noise: float = 0.0) -> float:
    """Encoder measurement of an axis at `angle` [rad]; `noise` [rad] is added before rounding."""
    seen = read_smooth(p, axis, angle) + noise
    quantum = p[R.quantum + axis]
    return quantum * np.rint(seen / quantum) + 0.0 if quantum > 0.0 else seen  # no -0


@_compiled
def read_angles(p: Array, axis: int, angles: Array, noise: Array) -> Array:
    """`read_angle` of (N,) angles and noises."""
    out = np.empty(len(angles))
    for k in range(len(angles)):
        out[k] = read_angle(p, axis, angles[k], noise[k])
    return out


@_compiled
def control(
    p: Array, i: int, angle: float, since: float, reference: float, rate: float, forward: float,
    shown: Array, speed: Array, integral: Array,
) -> float:  # fmt: skip
    """Torque [N m] of motor i's PID controller at a new measurement, `since` [s] after the last one.

    Updates the entries i of `shown` (2,) last measurement, `speed` (2,) its low-pass derivative, `integral` (2,).
    """
    speed[i] += (1.0 - exp(-p[R.smoothing] * since)) * ((angle - shown[i]) / since - speed[i])
    shown[i] = angle
    error = reference - angle
    integral[i] += p[R.integral + i] * error * since
    u = p[R.proportional + i] * error + p[R.derivative + i] * (rate - speed[i]) + integral[i]
    limit = p[R.limit + i]
    return min(max(u + forward, -limit), limit)


@_compiled
def add_drive_torque(p: Array, i: int, axis: int, angle: float, speed: float, command: float, torque: Array) -> None:
    """Add ripple and loss of torque with power of motor i to torque[axis]; angle and speed are those of the axis."""
    for n in range(HARMONICS * i, HARMONICS * (i + 1)):
        if p[R.ripple + n] != 0.0:
            torque[axis] += p[R.ripple + n] * sin(p[R.ripple_order + n] * angle + p[R.ripple_phase + n])
    if p[R.sag + i] != 0.0:
        power = abs(command * speed)
        torque[axis] -= command * min(p[R.sag + i] * power, 0.9)


@_compiled
def add_transmission_torque(
    p: Array, i: int, own: float, phi: float, preset: float, time: float, relaxed: Array, torque: Array, load: Array
) -> None:  # fmt: skip
    """Add the torque of transmission i at the deflection phi [rad] that MuJoCo lacks, and its total to the loads.

    own [rad] is the angle of its motor. A gear with a transmission error e has the deflection phi - e, and its motor
    carries 1 + de/dtheta times the torque.
    """
    known = spring(p, i, outside(phi, p[R.gap + i]), preset) if p[R.native + i] != 0.0 else 0.0
    ratio = 1.0
    for n in range(HARMONICS * i, HARMONICS * (i + 1)):
        if p[R.gear + n] != 0.0:
            turned = p[R.gear_order + n] * own + p[R.gear_phase + n]
            phi -= p[R.gear + n] * sin(turned)
            ratio += p[R.gear + n] * p[R.gear_order + n] * cos(turned)
    stretched = outside(phi, p[R.gap + i])
    tau = spring(p, i, stretched, preset)
    factor = (1.0 + p[R.hardening + i] * stretched * stretched) * (1.0 + p[R.drift + i] * time)
    if p[R.soften + i] > 0.0:
        factor *= phi * phi / (phi * phi + p[R.soften + i] * p[R.soften + i])
    whole = tau * factor
    if p[R.relaxing + i] > 0.0:
        relaxed[i] += (phi - relaxed[i]) * (1.0 - exp(-p[R.step] / p[R.relaxation + i]))
        whole += p[R.relaxing + i] * (phi - relaxed[i])
    torque[0] -= whole - known
    load[0] += tau * factor
    load[1 + i] = abs(tau * factor)
    if p[R.servo] == 0.0:
        torque[1 + i] += ratio * whole - known


@_compiled
def dry_friction(p: Array, i: int, angle: float, speed: float, load: float, heat: Array) -> float:
    """Magnitude [N m] of dry friction on axis i; updates heat[i], the dissipated energy over the warming energy."""
    dry = p[R.loss + i] + p[R.load_friction + i] * load + p[R.warm_friction + i] * exp(-heat[i])
    if p[R.breakaway + i] > 0.0:
        ratio = speed / p[R.stribeck_velocity + i]
        dry += p[R.breakaway + i] * exp(-ratio * ratio)
    if p[R.texture + i] > 0.0:
        dry += p[R.texture + i] * (1.0 + sin(p[R.texture_order + i] * angle))
    if p[R.warm_friction + i] > 0.0:
        heat[i] += p[R.step] * dry * abs(speed) / p[R.warming_energy + i]
    return dry


@_compiled
def bristle_torque(p: Array, i: int, speed: float, bristle: Array) -> float:
    """Mean torque [N m] of the bristle of axis i over a substep; updates its deflection bristle[i] [rad].

    z' = v (1 - sign(v) z / length), v constant over the substep.
    """
    length = p[R.bristle_length + i]
    end = copysign(length, speed)
    before = bristle[i]
    bristle[i] = end + (before - end) * exp(-abs(speed) * p[R.step] / length)
    return p[R.bristle + i] * 0.5 * (before + bristle[i]) / length


@_compiled
def run(
    p: Array, step: int, model: int, data: int, substeps: int, qpos: Array, qvel: Array, ctrl: Array, applied: Array,
    loss: Array, viscous: Array, references: Array, rates: Array, forward: Array, damping: Array, push: Array,
    acts: NDArray[np.int64], motion: Array, commands: Array, mean: Array, last: Array,
) -> bool:  # fmt: skip
    """Simulate N ticks into motion (N+1, 6), commands, mean and last (N, 2); False if the run diverged.

    step, model, data           addresses of mj_step, of its model and of its data
    qpos .. viscous             views of MuJoCo's own arrays
    references, rates, forward  (N, 2) [rad], [rad/s], [N m]: references of the drive's controller
    damping, push               (N,) [N m s/rad] of the damper, [N m] on the link
    acts                        (N,) substep of each tick in which the controller acts, -1 if it misses the tick
    commands                    command of each tick, NaN if the controller missed the tick
    mean, last                  command in force over the tick: mean, and at its end; for a position drive the torque
    """
    axes, first, h = int(p[R.axes]), int(p[R.first]), p[R.step]
    drives = axes - first  # the drive of a rigid joint acts on the link itself
    follows = p[R.servo] != 0.0 or p[R.positioned] != 0.0  # its commands are angles
    shown, speed, command, integral = np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(2)
    bristle, relaxed, heat = np.zeros(3), np.zeros(2), np.zeros(3)
    torque, load = np.zeros(3), np.zeros(3)
    for i in range(drives):
        shown[i] = read_angle(p, first + i, qpos[first + i])
        command[i] = qpos[first + i] if follows else 0.0
    goal, goal_delay, acted = command[0], int(p[R.goal_delay]), -substeps
    held, sent, led = (
        0.0,
        nan,
        0.0,
    )  # integral, last command and lead of the goal of a position drive
    goals = np.full(len(references) * substeps if p[R.positioned] != 0.0 else 1, goal)
    for k in range(len(references)):
        for i in range(axes):
            motion[k, i], motion[k, 3 + i] = qpos[i], qvel[i]
        for i in range(drives):
            commands[k, i], mean[k, i] = np.nan, 0.0
        for j in range(substeps):
            now = k * substeps + j
            if acts[k] == j:
                for i in range(drives):
                    command[i] = references[k, i]
                    if not follows:
                        command[i] = control(
                            p, i, read_angle(p, first + i, qpos[first + i]), (now - acted) * h, references[k, i],
                            rates[k, i], forward[k, i], shown, speed, integral,
                        )  # fmt: skip
                    commands[k, i] = command[i]
                acted = now
            late = max((now - int(p[R.damping_delay])) // substeps, 0)
            for i in range(3):
                torque[i] = load[i] = 0.0
            torque[0] = push[k]
            q = qpos[0] + 0.5 * h * qvel[0]
            for i in range(drives):
                ctrl[i] = command[i] if abs(command[i]) >= p[R.deadband + i] else 0.0
                ctrl[i] = copysign(max(abs(ctrl[i]) - p[R.dead_zone + i], 0.0), ctrl[i])
                if p[R.positioned] != 0.0:
                    if acted == now:
                        led = p[R.lead] * (command[0] - sent) / (substeps * h) if isfinite(sent) else 0.0
                        sent = command[0]
                    elif j == 0:
                        led = 0.0
                    goals[now] = command[0] + led
                    reach = p[R.goal_speed] * h
                    goal += min(max(goals[max(now - goal_delay, 0)] - goal, -reach), reach)
                    away = goal - read_smooth(p, 0, q)
                    pull = p[R.kp] * away if abs(away) >= p[R.goal_band] else 0.0
                    most = p[R.pull_limit] / p[R.kp]
                    held = min(max(held + p[R.integral_rate] * h * away, -most), most)
                    pull += p[R.kp] * held
                    ctrl[0] = min(max(pull, -p[R.pull_limit]), p[R.pull_limit])
                    load[0] = p[R.drive_gain] * ctrl[0] - p[R.kd] * qvel[0]
                    mean[k, 0] += load[0] / substeps
                else:
                    mean[k, i] += command[i] / substeps
                own = qpos[first + i] + 0.5 * h * qvel[first + i]
                add_drive_torque(p, i, first + i, own, qvel[first + i], ctrl[i], torque)
                if int(p[R.kind + i]) == NO_SPRING:
                    if first == 0 and p[R.positioned] == 0.0:
                        load[0] += command[i]
                    continue
                preset = 0.0
                if p[R.serial] != 0.0:
                    preset = qpos[2] + 0.5 * h * qvel[2] + p[R.preset_shift]
                phi = q - own - p[R.rest + i]
                add_transmission_torque(p, i, own, phi, preset, (now + 0.5) * h, relaxed, torque, load)
                if p[R.serial] != 0.0 and p[R.native] != 0.0:
                    ctrl[drives] = preset
            load[0] = abs(load[0])
            for i in range(axes):
                loss[i] = dry_friction(p, i, qpos[i], qvel[i], load[i], heat)
                torque[i] -= p[R.uneven + i]
                wet = p[R.viscous + i]
                if p[R.uneven_viscous + i] != 0.0:
                    wet += p[R.uneven_viscous + i] * copysign(1.0, qvel[i])
                if i == 0:
                    wet += damping[late]
                viscous[i] = wet
                if p[R.bristle + i] > 0.0:
                    torque[i] -= bristle_torque(p, i, qvel[i], bristle)
                applied[i] = torque[i]
            _call(step, model, data)
        for i in range(drives):
            last[k, i] = command[i]
        if not abs(qpos[0]) < MAX_ANGLE:
            return False
    for i in range(axes):
        motion[-1, i], motion[-1, 3 + i] = qpos[i], qvel[i]
    return True
