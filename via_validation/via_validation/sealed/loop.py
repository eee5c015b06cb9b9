"""The compiled loop round MuJoCo's mj_step: a drive with its controller, and torques for which MuJoCo has no part.

A substep: the few torques below are evaluated at the middle of the substep, where the joint will be to second order,
and held over it; friction losses and dampings that depend on the state are written into the model; mj_step (RK4) does
the rest. mj_step is called by its address: from Python the calls would cost more than the physics.

Torques computed here: exponential springs; factors on a spring (hardening, drift, a soft middle); a relaxing spring;
ripple; loss of torque with power; the law of a position drive; presliding friction as a Dahl bristle, advanced exactly
for the speed of the substep, so that no step can overshoot.
"""

from __future__ import annotations

from collections import namedtuple
from math import copysign, cos, exp, sin, sqrt
from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic
from numpy.typing import NDArray
from via_core.signals import Array

from via_validation.sealed.physics import HARMONICS

MAX_ANGLE = 50.0  # [rad] beyond which a run has diverged
NO_LAW, POLYNOMIAL, EXPONENTIAL, MACCEPA = range(4)

# One flat row of numbers for the loop; of three entries each per axis, of two per motor or transmission.
SIZES = {
    "axes": 1, "first": 1, "servo": 1, "serial": 1,
    "step": 1, "loss": 3, "viscous": 3, "breakaway": 3, "stribeck_velocity": 3,
    "uneven": 3, "uneven_viscous": 3, "load_friction": 3, "texture": 3, "texture_order": 3, "warm_friction": 3,
    "warming_energy": 3, "bristle": 3, "bristle_length": 3, "law": 2, "native": 2, "spring": 12, "gap": 2, "rest": 2,
    "hardening": 2, "drift": 2, "soften": 2, "relaxing": 2, "relaxation": 2, "ripple": 2 * HARMONICS,
    "ripple_order": 2 * HARMONICS, "ripple_phase": 2 * HARMONICS, "sag": 2, "preset_shift": 1, "damping_delay": 1,
    "offset": 3, "eccentricity": 3 * HARMONICS, "eccentric_order": 3 * HARMONICS, "eccentric_phase": 3 * HARMONICS,
    "quantum": 3, "limit": 2, "proportional": 2, "derivative": 2, "integral": 2, "smoothing": 1,
    "positioned": 1, "kp": 1, "kd": 1, "pull_limit": 1, "goal_speed": 1, "goal_delay": 1,
}  # fmt: skip
STARTS = np.concatenate(([0], np.cumsum(list(SIZES.values()))))
R: Any = namedtuple("Row", list(SIZES))(*(int(start) for start in STARTS[:-1]))  # type: ignore
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
def read_smooth(p: Array, axis: int, angle: float) -> float:
    """Reading of the encoder of an axis at `angle` [rad] before it is rounded."""
    seen = angle + p[R.offset + axis]
    for k in range(HARMONICS * axis, HARMONICS * (axis + 1)):
        if p[R.eccentricity + k] != 0.0:
            seen += p[R.eccentricity + k] * sin(p[R.eccentric_order + k] * angle + p[R.eccentric_phase + k])
    return seen


@_compiled
def read_angle(p: Array, axis: int, angle: float, noise: float = 0.0) -> float:
    """Reading of the encoder of an axis at `angle` [rad]; `noise` [rad] is added before it is rounded."""
    seen = read_smooth(p, axis, angle) + noise
    quantum = p[R.quantum + axis]
    return quantum * np.rint(seen / quantum) + 0.0 if quantum > 0.0 else seen  # no -0


@_compiled
def read_angles(p: Array, axis: int, angles: Array, noise: Array) -> Array:
    """The same for (N,) angles and noises."""
    out = np.empty(len(angles))
    for k in range(len(angles)):
        out[k] = read_angle(p, axis, angles[k], noise[k])
    return out


@_compiled
def run(
    p: Array, step: int, model: int, data: int, substeps: int, qpos: Array, qvel: Array, ctrl: Array, applied: Array,
    loss: Array, viscous: Array, references: Array, rates: Array, forward: Array, damping: Array, push: Array,
    acts: NDArray[np.int64], motion: Array, commands: Array, mean: Array, last: Array,
) -> bool:  # fmt: skip
    """N ticks -> motion (N+1, 6), commands, mean and last (N, 2); False where the run diverged.

    step, model, data           addresses of mj_step, of its model and of its data
    qpos .. viscous             views of MuJoCo's own arrays
    references, rates, forward  (N, 2) [rad], [rad/s], [N m]: what the drive's controller is to follow
    damping, push               (N,) [N m s/rad] of the damper, [N m] on the link
    acts                        (N,) substep of each tick in which the controller acts, -1 where it misses the tick
    commands                    what it commanded in each tick, NaN where it missed the tick
    mean, last                  command that acted over the tick, on average and at its end; of a position drive torque
    """
    axes, first, h = int(p[R.axes]), int(p[R.first]), p[R.step]
    drives = axes - first  # the drive of a rigid joint is at the link itself
    follows = p[R.servo] != 0.0 or p[R.positioned] != 0.0  # its commands are angles
    shown, speed, held, piled = np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(2)
    bristle, relaxed, heat = np.zeros(3), np.zeros(2), np.zeros(3)
    torque, load = np.zeros(3), np.zeros(3)
    for i in range(drives):
        shown[i] = read_angle(p, first + i, qpos[first + i])
        held[i] = qpos[first + i] if follows else 0.0
    goal, goal_delay, acted = held[0], int(p[R.goal_delay]), -substeps
    asked = np.full(len(references) * substeps if p[R.positioned] != 0.0 else 1, goal)
    for k in range(len(references)):
        for i in range(axes):
            motion[k, i], motion[k, 3 + i] = qpos[i], qvel[i]
        for i in range(drives):
            commands[k, i], mean[k, i] = np.nan, 0.0
        for j in range(substeps):
            now = k * substeps + j
            if acts[k] == j:
                for i in range(drives):
                    held[i] = references[k, i]
                    if not follows:
                        angle, since = read_angle(p, first + i, qpos[first + i]), (now - acted) * h
                        speed[i] += (1.0 - exp(-p[R.smoothing] * since)) * ((angle - shown[i]) / since - speed[i])
                        shown[i] = angle
                        error = references[k, i] - angle
                        piled[i] += p[R.integral + i] * error * since
                        u = p[R.proportional + i] * error + p[R.derivative + i] * (rates[k, i] - speed[i]) + piled[i]
                        limit = p[R.limit + i]
                        held[i] = min(max(u + forward[k, i], -limit), limit)
                    commands[k, i] = held[i]
                acted = now
            time = (now + 0.5) * h
            late = max((now - int(p[R.damping_delay])) // substeps, 0)
            for i in range(3):
                torque[i] = load[i] = 0.0
            torque[0] = push[k]
            q = qpos[0] + 0.5 * h * qvel[0]
            for i in range(drives):
                ctrl[i] = held[i]
                if p[R.positioned] != 0.0:
                    asked[now] = held[0]
                    reach = p[R.goal_speed] * h
                    goal += min(max(asked[max(now - goal_delay, 0)] - goal, -reach), reach)
                    pull = p[R.kp] * (goal - read_smooth(p, 0, q))
                    ctrl[0] = min(max(pull, -p[R.pull_limit]), p[R.pull_limit])
                    load[0] = ctrl[0] - p[R.kd] * qvel[0]
                    mean[k, 0] += load[0] / substeps
                else:
                    mean[k, i] += held[i] / substeps
                own = qpos[first + i] + 0.5 * h * qvel[first + i]
                for n in range(HARMONICS * i, HARMONICS * (i + 1)):
                    if p[R.ripple + n] != 0.0:
                        torque[first + i] += p[R.ripple + n] * sin(p[R.ripple_order + n] * own + p[R.ripple_phase + n])
                if p[R.sag + i] != 0.0:
                    power = abs(ctrl[i] * qvel[first + i])
                    torque[first + i] -= ctrl[i] * min(p[R.sag + i] * power, 0.9)
                law = int(p[R.law + i])
                if law == NO_LAW:
                    if first == 0 and p[R.positioned] == 0.0:
                        load[0] += held[i]
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
        for i in range(drives):
            last[k, i] = held[i]
        if not abs(qpos[0]) < MAX_ANGLE:
            return False
    for i in range(axes):
        motion[-1, i], motion[-1, 3 + i] = qpos[i], qvel[i]
    return True
