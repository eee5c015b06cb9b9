"""Between the rows of one joint (parameters, state, commands) and its lane of a block."""

from __future__ import annotations

from math import exp, floor, inf

from via_core.dampers import damper_value
from via_core.signals import Array
from via_core.spring_equations import EXPONENTIAL, N_COEFFICIENTS, SINH

from via_sim.joint.compiled import bare
from via_sim.joint.friction import feels_both_sides, has_friction
from via_sim.joint.kernel import queued_at
from via_sim.joint.layout import ARM, DAMPING, EXTERNAL, GOAL, NEIGHBOUR, POWER, QUEUED, X
from via_sim.joint.parameters import ABSENT, DYNAMIC, NO_DAMPER, POSITION_DRIVE, TORQUE_DRIVE, P
from via_sim.joint.position_drive import drive_torque
from via_sim.joint.terms import saturated
from via_sim.joint.torques import deflection, spring_factor
from via_sim.lockstep.block import COPIED, R, Terms, Z
from via_sim.lockstep.terms import term_bits


@bare
def is_supported(p: Array) -> bool:
    """Whether lockstep implements all terms of a parameter row."""
    whole = floor(p[P.delay] / p[P.tick] + 1e-9)
    fraction = p[P.delay] - whole * p[P.tick] >= 1e-9 * p[P.tick]
    known = not fraction
    for axis in range(1, 3):
        known &= p[P.axis_kind + axis] <= DYNAMIC
    if p[P.link_drive] == POSITION_DRIVE:
        known &= p[P.lag] <= 0.0 and p[P.drive_speed_limit] == inf and p[P.encoder_harmonics] == 0.0
    return known


@bare
def load_parameters(p: Array, z: Array, lane: int) -> None:
    """Copy a parameter row into its lane."""
    for slot, row in COPIED:
        z[row, lane] = p[slot]
    for axis in range(3):
        kinetic, excess = p[P.kinetic_friction + axis], p[P.breakaway_friction + axis] - p[P.kinetic_friction + axis]
        slips, level = has_friction(p, axis), max(p[P.bristle_torque + axis], 0.0)
        z[Z.kinetic_friction + axis, lane] = kinetic if slips else 0.0
        z[Z.friction_excess + axis, lane] = excess if slips else 0.0
        z[Z.inverse_stribeck_velocity + axis, lane] = 1.0 / p[P.stribeck_velocity + axis]
        z[Z.inverse_load_velocity + axis, lane] = 1.0 / p[P.load_velocity + axis]
        z[Z.bristle_torque + axis, lane] = level
        z[Z.bristle_rate + axis, lane] = p[P.bristle_stiffness + axis] / level if level > 0.0 else 0.0
        driven = p[P.link_drive] == TORQUE_DRIVE if axis == 0 else p[P.axis_kind + axis] == DYNAMIC
        z[Z.torque_gain + axis, lane] = p[P.torque_gain + axis] if driven else 0.0
        z[Z.torque_bias + axis, lane] = p[P.torque_bias + axis] if driven else 0.0
        share = 0.5 * axis * p[P.tick] / max(1.0, floor(p[P.substeps]))
        z[Z.lag_left + axis, lane] = exp(-share / p[P.lag]) if p[P.lag] > 0.0 else 0.0
    z[Z.drive_limit, lane] = min(p[P.drive_torque_limit], p[P.saturation])
    for i in range(2):
        z[Z.pretension_offset + i, lane] = p[P.pretension_offset + i] if p[P.serial] == 0.0 else 0.0
        z[Z.half_gap + i, lane] = 0.5 * p[P.backlash + i]
        z[Z.no_gap + i, lane] = 0.0 if p[P.backlash + i] > 0.0 else inf
        start, kind = P.spring + i * N_COEFFICIENTS, int(p[P.spring_kind + i])
        if kind == SINH:
            z[Z.rise + i, lane] = z[Z.fall + i, lane] = 0.5 * p[start]
            z[Z.growth + i, lane] = p[start + 1]
        elif kind == EXPONENTIAL:
            z[Z.rise + i, lane], z[Z.fall + i, lane], z[Z.growth + i, lane] = p[start], p[start + 1], p[start + 2]
        slips = p[P.hysteresis_torque + i] > 0.0
        z[Z.no_maxwell + i, lane] = 0.0 if slips else inf
        z[Z.slip_torque + i, lane] = p[P.hysteresis_torque + i] if slips else 0.0
        z[Z.slip_stiffness + i, lane] = p[P.hysteresis_stiffness + i] if slips else 0.0
    there = p[P.contact_stiffness] > 0.0
    z[Z.contact_stiffness, lane] = p[P.contact_stiffness] if there else 0.0
    z[Z.contact_damping, lane] = p[P.contact_damping] if there else 0.0
    z[Z.no_wall, lane] = 0.0 if there else inf


@bare
def load_state(p: Array, x: Array, z: Array, lane: int) -> bool:
    """Copy state x into its lane; whether an axis with friction is at standstill there."""
    sticks = False
    for i in range(6):
        z[Z.start + i, lane] = x[i]
    for axis in range(3):
        sign = stuck = 0.0
        if has_friction(p, axis):
            if x[3 + axis] == 0.0:
                stuck, sticks = 1.0, True
            else:
                sign = 1.0 if x[3 + axis] > 0.0 else -1.0
        z[Z.sign + axis, lane], z[Z.stuck + axis, lane] = sign, stuck
        z[Z.bristle + axis, lane] = x[X.bristle + axis] if p[P.bristle_torque + axis] > 0.0 else 0.0
        z[Z.lagged + axis, lane] = x[X.lag + axis]
    for i in range(2):
        phi, half = deflection(p, i, x[0], x[1 + i]), 0.5 * p[P.backlash + i]
        z[Z.flank + i, lane] = 0.0 if half <= 0.0 or abs(phi) < half else (1.0 if phi > 0.0 else -1.0)
        level = p[P.hysteresis_torque + i]
        torque = x[X.hysteresis + i] if level > 0.0 else 0.0
        slips = abs(torque) >= level > 0.0 and torque * (x[3] - x[4 + i]) > 0.0
        z[Z.maxwell + i, lane] = torque
        z[Z.slip + i, lane] = (1.0 if torque > 0.0 else -1.0) if slips else 0.0
    depth = p[P.contact_side] * (x[0] - p[P.contact_angle])
    touches = depth > 0.0 or (depth == 0.0 and p[P.contact_side] * x[3] > 0.0)
    z[Z.touch, lane] = 1.0 if touches and p[P.contact_stiffness] > 0.0 else 0.0
    return sticks


@bare
def load_inputs(p: Array, x: Array, command: Array, slot: int, late: int, age: float, z: Array, lane: int) -> None:
    """Put the command into the queue of state x at `slot`, and the inputs that act during this tick into the lane."""
    queued = queued_at(x, slot, late)
    for i in range(QUEUED):
        x[X.queue + QUEUED * slot + i] = command[i]
    neighbour = command[NEIGHBOUR]
    link = (p[P.coupling] + p[P.coupling + 1] + p[P.coupling + 2]) * neighbour + command[ARM]
    if p[P.link_drive] != TORQUE_DRIVE:
        link += command[EXTERNAL]
    if p[P.pulse_torque] != 0.0:
        overlap = min(age + p[P.tick], p[P.pulse_stop]) - max(age, p[P.pulse_start])
        link += p[P.pulse_torque] * max(overlap, 0.0) / p[P.tick]
    z[Z.other_torque, lane], z[Z.commanded, lane] = link, saturated(p, 0, x[queued + EXTERNAL])
    if p[P.link_drive] == TORQUE_DRIVE:
        link += p[P.torque_gain] * z[Z.commanded, lane] + p[P.torque_bias]
    if p[P.link_drive] == POSITION_DRIVE:
        power = 1.0 if x[queued + POWER] > 0.5 else 0.0
        z[Z.goal, lane], z[Z.drive_damping, lane] = x[queued + GOAL] - p[P.encoder_offset], power * p[P.drive_damping]
        z[Z.drive_gain, lane], z[Z.drive_bias, lane] = power * p[P.torque_gain], power * p[P.torque_bias]
    z[Z.torque, lane] = link
    for i in range(2):
        limit = p[P.torque_limit + i]
        asked = saturated(p, 1 + i, min(max(x[queued + i], -limit), limit))
        z[Z.commanded + 1 + i, lane] = asked
        if p[P.axis_kind + 1 + i] == DYNAMIC:
            torque = p[P.torque_gain + 1 + i] * asked + p[P.torque_bias + 1 + i] - p[P.coupling + 1 + i] * neighbour
            z[Z.torque + 1 + i, lane] = torque
            z[Z.other_torque + 1 + i, lane] = -p[P.coupling + 1 + i] * neighbour
            z[Z.spring_factor + i, lane] = spring_factor(p, i, age + 0.5 * p[P.tick])
    damping = 0.0
    if p[P.damper_site] != NO_DAMPER:
        damping = damper_value(int(p[P.damper_kind]), p[P.damper : P.damper + 3], x[queued + DAMPING])
    z[Z.damping, lane] = damping + z[Z.drive_damping, lane]


@bare
def store_inputs(p: Array, x: Array, command: Array, slot: int, late: int, z: Array, lane: int) -> None:
    """Copy the inputs that acted last from the lane into state x, as `kernel.advance_tick` does."""
    queued = queued_at(x, slot, late)
    x[X.beside] = z[Z.other_torque, lane]
    x[X.external], x[X.damping] = z[Z.torque, lane], z[Z.damping, lane] - z[Z.drive_damping, lane]
    positioned = p[P.link_drive] == POSITION_DRIVE  # without speed limit and lag, see `is_supported`
    if positioned:
        x[X.external] += drive_torque(p, x[queued + GOAL], 1.0 if x[queued + POWER] > 0.5 else 0.0, x[0])
        x[X.external] -= z[Z.drive_damping, lane] * x[3]
    else:
        x[X.lag] = saturated(p, 0, x[queued + EXTERNAL])
    for i in range(2):
        limit = p[P.torque_limit + i]
        x[X.reported_torque + i] = min(max(command[i], -limit), limit)
        x[X.motor_torque + i] = z[Z.torque + 1 + i, lane]
        if not positioned:
            x[X.lag + 1 + i] = saturated(p, 1 + i, min(max(x[queued + i], -limit), limit))


@bare
def terms_of(rows: Array, first: int, count: int) -> Terms:
    """Terms of `count` parameter rows from `first` on.

    A function of its own: inside the caller numba would compile `step` for every type that the values have meanwhile.
    """
    axes = coefficients = friction = gaps = rare = 0
    gravity = falls = False
    for lane in range(count):
        p = rows[first + lane]
        gravity |= p[P.gravity_torque] != 0.0
        rare |= _rare_bits(p)
        for axis in range(3):
            if p[P.axis_kind + axis] != ABSENT:
                axes = axis + 1
            friction |= int(has_friction(p, axis)) << axis
            falls |= p[P.breakaway_friction + axis] != p[P.kinetic_friction + axis]
        for i in range(2):
            if p[P.backlash + i] > 0.0:
                gaps = i + 1
            for k in range(N_COEFFICIENTS):
                if p[P.spring + i * N_COEFFICIENTS + k] != 0.0:
                    coefficients = max(coefficients, k + 1)
    return Terms(axes, coefficients, gravity, friction, falls, gaps, rare)


@bare
def _rare_bits(p: Array) -> int:
    """Bits of the rare terms of a parameter row."""
    bits = term_bits(p) | int(p[P.contact_stiffness] > 0.0) << R.wall | int(p[P.lag] > 0.0) << R.lag
    bits |= int(p[P.link_drive] == POSITION_DRIVE) << R.position
    for axis in range(3):
        bits |= int(p[P.bristle_torque + axis] > 0.0) << (R.bristle + axis)
        bits |= int(feels_both_sides(p, axis)) << R.loads
    for i in range(2):
        bits |= int(p[P.hysteresis_torque + i] > 0.0) << (R.maxwell + i)
        bits |= int(p[P.spring_damping + i] != 0.0) << R.spring_damping
        bits |= int(p[P.input_errors + i] != 0.0) << (R.input + i)
        bits |= int(p[P.spring_hardening + i] != 0.0) << R.hardening
    return bits
