"""Between the rows of one joint (parameters, state, commands) and its lane of a block."""

from __future__ import annotations

from math import ceil, exp, inf

from via_core.signals import Array
from via_core.spring_equations import EXPONENTIAL, N_COEFFICIENTS, ODD_POLYNOMIAL, SINH

from via_sim.joint.actuation import servo_bandwidth
from via_sim.joint.compiled import bare
from via_sim.joint.friction import feels_both_sides, has_friction, viscous_friction
from via_sim.joint.kernel import queued_at
from via_sim.joint.layout import ARM, EXTERNAL, GOAL, NEIGHBOUR, POWER, QUEUED, X
from via_sim.joint.parameters import (
    ABSENT,
    AT_TRANSMISSION,
    DYNAMIC,
    POSITION_DRIVE,
    SERVO,
    TORQUE_DRIVE,
    P,
)
from via_sim.joint.position_drive import brake_inside, drive_torque, integral_reach, led
from via_sim.joint.step import PER_AXIS
from via_sim.joint.structure import EVERYTHING
from via_sim.joint.torques import deflection
from via_sim.lockstep.block import COPIED, R, Terms, Z
from via_sim.lockstep.pack import get, put
from via_sim.lockstep.terms import saturated, term_bits


@bare
def load_parameters(p: Array, z: Array, lane: int) -> None:
    """Copy a parameter row into its lane."""
    for slot, row in COPIED:
        z[row, lane] = p[slot]
    for axis in range(3):
        z[Z.viscous_friction + axis, lane] = viscous_friction(p, axis, 0.0)
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
    z[Z.drive_gain, lane], z[Z.drive_bias, lane] = p[P.torque_gain], p[P.torque_bias]
    z[Z.drive_damping, lane] = p[P.drive_damping] if p[P.link_drive] == POSITION_DRIVE else 0.0
    z[Z.drive_limit, lane] = p[P.drive_torque_limit]
    z[Z.drive_brake, lane] = brake_inside(p)
    z[Z.lead, lane] = led(p, 1.0, 0.0, p[P.tick]) - 1.0 if p[P.link_drive] == POSITION_DRIVE else 0.0
    z[Z.integral_reach, lane] = integral_reach(p) if p[P.integral_rate] > 0.0 else 0.0
    limited, lags = p[P.drive_speed_limit] < inf, p[P.lag] > 0.0
    z[Z.slews, lane], z[Z.drive_speed_limit, lane] = limited, p[P.drive_speed_limit] if limited else 1.0
    z[Z.lags, lane], z[Z.lag, lane] = lags, p[P.lag] if lags else 1.0
    for i in range(2):
        z[Z.pretension_offset + i, lane] = p[P.pretension_offset + i] if p[P.serial] == 0.0 else 0.0
        z[Z.preset_offset + i, lane] = p[P.pretension_offset + i]
        if p[P.axis_kind + 1 + i] == SERVO:
            z[Z.bandwidth + i, lane] = servo_bandwidth(p, i)
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
def early_part(p: Array, late: int) -> float:
    """Part of a tick [s] before its command arrives, for a dead time of `late` whole ticks and a part of one."""
    rest = p[P.delay] - late * p[P.tick]
    return rest if rest >= 1e-9 * p[P.tick] else 0.0


@bare
def steps_of(p: Array, late: int) -> tuple[int, int]:
    """Steps of a tick before and after its command arrives, as many as `kernel.take_tick` takes."""
    early = early_part(p, late) / p[P.tick]
    if early == 0.0:
        return 0, max(1, int(p[P.substeps]))
    before = max(1, ceil(p[P.substeps] * early - 1e-9))
    return before, max(1, ceil(p[P.substeps] * (1.0 - early) - 1e-9))


@bare
def divide_tick(p: Array, late: int, steps: tuple[int, int], z: Array, lane: int) -> None:
    """Length of the steps of a lane and share of a lag left in them, before and after the command of a tick arrives."""
    early = early_part(p, late)
    for piece, duration in enumerate((early, p[P.tick] - early)):
        h = duration / max(steps[piece], 1)
        z[Z.piece_length + piece, lane] = h
        for moment in range(3):
            left = exp(-0.5 * moment * h / p[P.lag]) if p[P.lag] > 0.0 else 0.0
            z[Z.piece_lag_left + 3 * piece + moment, lane] = left


@bare
def load_state(p: Array, x: Array, late: int, z: Array, lane: int) -> None:
    """Copy state x into its lane, for a dead time of `late` whole ticks."""
    for i in range(6):
        z[Z.start + i, lane] = x[i]
    for axis in range(3):
        z[Z.bristle + axis, lane] = x[X.bristle + axis] if p[P.bristle_torque + axis] > 0.0 else 0.0
        z[Z.lagged + axis, lane] = x[X.lag + axis]
    for i in range(2):
        z[Z.maxwell + i, lane] = x[X.hysteresis + i] if p[P.hysteresis_torque + i] > 0.0 else 0.0
    last = queued_at(x, int(x[X.tick]) % ((x.size - X.queue) // QUEUED), late + 1)
    z[Z.behind, lane], z[Z.sent, lane], z[Z.power, lane] = x[X.behind], x[last + GOAL], x[last + POWER] > 0.5
    z[Z.integral, lane], z[Z.held, lane] = x[X.integral], 0.0
    place(p, z, lane)


@bare
def place(p: Array, z: Array, lane: int) -> None:
    """Which frictions stick or slip, which flanks and walls touch: what follows from the motion of a lane."""
    for axis in range(3):
        speed, sign, stuck = z[Z.start + 3 + axis, lane], 0.0, 0.0
        if has_friction(p, axis):
            stuck = speed == 0.0
            sign = 0.0 if stuck else (1.0 if speed > 0.0 else -1.0)
        z[Z.sign + axis, lane], z[Z.stuck + axis, lane] = sign, stuck
    q, turning = z[Z.start, lane], z[Z.start + 3, lane]
    for i in range(2):
        phi, half = deflection(p, EVERYTHING, i, q, z[Z.start + 1 + i, lane]), 0.5 * p[P.backlash + i]
        z[Z.flank + i, lane] = 0.0 if half <= 0.0 or abs(phi) < half else (1.0 if phi > 0.0 else -1.0)
        level, torque = p[P.hysteresis_torque + i], z[Z.maxwell + i, lane]
        slips = abs(torque) >= level > 0.0 and torque * (turning - z[Z.start + 4 + i, lane]) > 0.0
        z[Z.slip + i, lane] = (1.0 if torque > 0.0 else -1.0) if slips else 0.0
    depth = p[P.contact_side] * (q - p[P.contact_angle])
    touches = depth > 0.0 or (depth == 0.0 and p[P.contact_side] * turning > 0.0)
    z[Z.touch, lane] = 1.0 if touches and p[P.contact_stiffness] > 0.0 else 0.0


@bare
def store_state(p: Array, z: Array, row: int, lane: int, x: Array) -> None:
    """Copy motion and torques of the elements with memory from rows `row` (`Z.start` or `Z.before`) into state x."""
    for i in range(6):
        x[i] = z[row + i, lane]
    for i in range(10 if p[P.lag] > 0.0 or _moves_goal(p) else 5):
        x[X.bristle + i] = z[row + 6 + i, lane]


@bare
def take_commands(p: Array, z: Array, elapsed: float) -> None:
    """Inputs that act `elapsed` [s] after the beginning of the run, as in `kernel.take_tick`; p: row of any lane."""
    age, period, neighbour = get(z, Z.age) + elapsed, p[P.tick], get(z, Z.command + NEIGHBOUR)
    link = (get(z, Z.coupling) + get(z, Z.coupling + 1) + get(z, Z.coupling + 2)) * neighbour
    link += get(z, Z.command + ARM)
    if p[P.link_drive] != TORQUE_DRIVE:
        link += get(z, Z.external)
    overlap = min(age + period, get(z, Z.pulse_stop)) - max(age, get(z, Z.pulse_start))
    put(z, Z.other_torque, link + get(z, Z.pulse_torque) * max(overlap, 0.0) / period)
    put(z, Z.commanded, saturated(z, 0, get(z, Z.command + EXTERNAL)))
    for i in range(2):
        limit = get(z, Z.torque_limit + i)
        put(z, Z.other_torque + 1 + i, -get(z, Z.coupling + 1 + i) * neighbour)
        put(z, Z.commanded + 1 + i, saturated(z, 1 + i, min(max(get(z, Z.command + i), -limit), limit)))
        drifted = max(1.0 + get(z, Z.stiffness_rate + i) * (age + 0.5 * period), 0.0)
        put(z, Z.spring_factor + i, get(z, Z.spring_scale + i) * drifted)
    for axis in range(3):
        torque = get(z, Z.torque_gain + axis) * get(z, Z.commanded + axis) + get(z, Z.torque_bias + axis)
        put(z, Z.torque + axis, get(z, Z.other_torque + axis) + torque)
    put(z, Z.power, get(z, Z.command + POWER) > 0.5)
    put(z, Z.sent, get(z, Z.command + GOAL))
    put(z, Z.acting, get(z, Z.sent))


@bare
def begin_piece(z: Array, piece: int) -> None:
    """Length, weights and lags of the steps of a piece."""
    put(z, Z.length, get(z, Z.piece_length + piece))
    for k in range(3 * PER_AXIS):
        put(z, Z.weight + k, get(z, Z.piece_weight + 3 * PER_AXIS * piece + k))
    for moment in range(3):
        put(z, Z.lag_left + moment, get(z, Z.piece_lag_left + 3 * piece + moment))


@bare
def store_inputs(p: Array, x: Array, command: Array, z: Array, lane: int) -> None:
    """Copy the inputs that acted last from the lane into state x, as `kernel.advance_tick` does."""
    x[X.beside], x[X.external] = z[Z.other_torque, lane], z[Z.torque, lane]
    drive_damping = z[Z.power, lane] * z[Z.drive_damping, lane]
    x[X.damping] = z[Z.damping, lane] - drive_damping
    if p[P.link_drive] == POSITION_DRIVE:
        pull = drive_torque(p, z[Z.acting, lane], z[Z.held, lane], z[Z.power, lane], x[0], x[3])
        x[X.external] += pull - drive_damping * x[3]
    elif p[P.lag] <= 0.0:
        for axis in range(3):
            x[X.lag + axis] = z[Z.commanded + axis, lane]
    for i in range(2):
        x[X.reported_torque + i] = min(max(command[i], -p[P.torque_limit + i]), p[P.torque_limit + i])
        servo = p[P.axis_kind + 1 + i] == SERVO
        x[X.motor_torque + i] = z[Z.command + i, lane] if servo else z[Z.torque + 1 + i, lane]


@bare
def terms_of(rows: Array) -> Terms:
    """Terms of parameter rows (K, N_PARAMETERS).

    A function of its own: inside the caller numba would compile `step` for every type that the values have meanwhile.
    """
    axes = coefficients = friction = gaps = rare = 0
    gravity = falls = False
    for p in rows:
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
    kinds = int(rows[0, P.spring_kind]), int(rows[0, P.spring_kind + 1])
    count, coupled = int(rows[0, P.transmissions]), rows[0, P.damper_site] == AT_TRANSMISSION
    return Terms(axes, count, kinds, coefficients, gravity, coupled, friction, falls, gaps, rare)


@bare
def is_simple(terms: Terms) -> bool:
    """Whether a block has polynomial springs, gravity, a damper, dry friction and terms of the catalogue at most."""
    kinds, rest = terms.kinds, terms.rare & ((1 << R.terms) - 1)
    return rest == 0 and terms.gaps == 0 and kinds[0] == kinds[1] == ODD_POLYNOMIAL


@bare
def _moves_goal(p: Array) -> bool:
    """Whether the goal of a position drive differs from the commanded one, or has an integral beside it."""
    moves = p[P.lag] > 0.0 or p[P.drive_speed_limit] < inf or p[P.integral_rate] > 0.0
    moves |= p[P.feedforward] != 0.0
    return p[P.link_drive] == POSITION_DRIVE and moves


@bare
def _rare_bits(p: Array) -> int:
    """Bits of the rare terms of a parameter row."""
    positioned = p[P.link_drive] == POSITION_DRIVE
    bits = term_bits(p) | int(p[P.contact_stiffness] > 0.0) << R.wall
    bits |= int(p[P.lag] > 0.0 and not positioned) << R.lag | int(positioned) << R.position
    bits |= int(_moves_goal(p)) << R.goal | int(positioned and p[P.encoder_harmonics] > 0.0) << R.eccentric
    for axis in range(3):
        bits |= int(p[P.bristle_torque + axis] > 0.0) << (R.bristle + axis)
        bits |= int(feels_both_sides(p, axis)) << R.loads
    for i in range(2):
        bits |= int(p[P.hysteresis_torque + i] > 0.0) << (R.maxwell + i)
        bits |= int(p[P.spring_damping + i] != 0.0) << R.spring_damping
        bits |= int(p[P.input_errors + i] != 0.0) << (R.input + i)
        bits |= int(p[P.spring_hardening + i] != 0.0) << R.hardening
        if p[P.axis_kind + 1 + i] == SERVO:
            bits |= 1 << (R.servo + i) | int(p[P.saturation + 1 + i] != inf) << R.limited
    return bits
