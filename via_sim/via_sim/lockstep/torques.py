"""Torques of all lanes of a block, as `torques.forced`: every operation is a loop over lanes that vectorises."""

from __future__ import annotations

from via_core.signals import Array
from via_core.spring_equations import EXPONENTIAL, N_COEFFICIENTS, ODD_POLYNOMIAL, SINH

from via_sim.joint.compiled import bare
from via_sim.joint.parameters import AT_TRANSMISSION, P
from via_sim.joint.torques import deflection, preset_of, transmission_torque
from via_sim.lockstep.block import R, Terms, Z, decay, sine
from via_sim.lockstep.terms import add_terms, find_input_errors

_ENOUGH = 1e300  # [N m] margin of an axis that does not stick


@bare
def torques(z: Array, rows: Array, first: int, out: int, terms: Terms, sticks: bool) -> None:
    """Torque on each axis without its viscous friction, at the motion `Z.at`, into three rows from `out` on.

    first   parameter row of the first lane
    sticks  whether an axis sticks in any lane
    """
    axes, rare = terms.axes, terms.rare
    p = rows[first]
    for lane in range(z.shape[1]):
        z[out, lane] = z[Z.torque, lane]
        z[out + 1, lane] = z[Z.torque + 1, lane]
        z[out + 2, lane] = z[Z.torque + 2, lane]
    if terms.gravity:
        for lane in range(z.shape[1]):
            z[out, lane] -= z[Z.gravity_torque, lane] * sine(z[Z.at, lane] - z[Z.gravity_angle, lane])
    if p[P.damper_site] == AT_TRANSMISSION:
        for lane in range(z.shape[1]):
            z[out, lane] += z[Z.damping, lane] * z[Z.at + 4, lane]
            z[out + 1, lane] += z[Z.damping, lane] * z[Z.at + 3, lane]
    if rare >> R.input & 3:
        find_input_errors(z)
    _springs(z, rows, first, terms.coefficients)
    count = int(p[P.transmissions])
    for i in range(count):
        for lane in range(z.shape[1]):
            z[out, lane] -= z[Z.spring_torque + i, lane]
            z[Z.geared_torque + i, lane] = z[Z.spring_torque + i, lane] * (1.0 + z[Z.input_slope + i, lane])
            z[out + (1 + i), lane] += z[Z.geared_torque + i, lane]
    if rare != 0:
        _rare_torques(z, axes, out, rare)
    for axis in range(axes):
        if terms.friction >> axis & 1:
            _friction(z, axis, count, out, terms, sticks)


@bare
def _friction(z: Array, axis: int, count: int, out: int, terms: Terms, sticks: bool) -> None:
    """Add dry friction to the torque on an axis of a joint with `count` transmissions, as `torques._driven`."""
    rare = terms.rare
    if count == 0:
        for lane in range(z.shape[1]):
            z[Z.load_torque, lane] = z[Z.torque, lane] - z[Z.other_torque, lane]
        if rare >> R.position & 1:
            for lane in range(z.shape[1]):
                z[Z.load_torque, lane] = z[Z.drive_torque, lane] - z[Z.drive_damping, lane] * z[Z.at + 3, lane]
    elif axis == 0:
        for lane in range(z.shape[1]):
            z[Z.load_torque, lane] = -(z[Z.spring_torque, lane] + z[Z.spring_torque + 1, lane])
    else:
        for lane in range(z.shape[1]):
            z[Z.load_torque, lane] = z[Z.geared_torque + axis - 1, lane]
    if rare >> R.loads & 1:
        _counter(z, axis, count, terms)
        for lane in range(z.shape[1]):
            load, counter = z[Z.load_torque, lane], z[Z.counter_torque, lane]
            squared = min(abs(load), abs(counter)) ** 2 if load * counter < 0.0 else 0.0
            sliding = z[Z.load_friction + axis, lane] * load - z[Z.counter_friction + axis, lane] * counter
            added = z[Z.load_stribeck + axis, lane] * load - z[Z.counter_stribeck + axis, lane] * counter
            z[Z.sliding_friction, lane] = abs(sliding)
            z[Z.standstill_friction, lane] = abs(added) + z[Z.load_quadratic + axis, lane] * squared
    else:
        for lane in range(z.shape[1]):
            z[Z.sliding_friction, lane] = z[Z.load_friction + axis, lane] * abs(z[Z.load_torque, lane])
    for lane in range(z.shape[1]):
        sign, v = z[Z.sign + axis, lane], z[Z.at + 3 + axis, lane]
        size = z[Z.kinetic_friction + axis, lane] + z[Z.sliding_friction, lane]
        size += sign * (z[Z.friction_asymmetry + axis, lane] + z[Z.viscous_asymmetry + axis, lane] * sign * v)
        z[out + axis, lane] -= sign * size
    if terms.falls:
        for lane in range(z.shape[1]):
            ratio = z[Z.at + 3 + axis, lane] * z[Z.inverse_stribeck_velocity + axis, lane]
            excess = z[Z.friction_excess + axis, lane] * decay(ratio * ratio)
            z[out + axis, lane] -= z[Z.sign + axis, lane] * excess
    if rare >> R.loads & 1:
        for lane in range(z.shape[1]):
            ratio = z[Z.at + 3 + axis, lane] * z[Z.inverse_load_velocity + axis, lane]
            z[out + axis, lane] -= z[Z.sign + axis, lane] * z[Z.standstill_friction, lane] * decay(ratio * ratio)
    if sticks:  # friction balances all torque on a stuck axis, up to breakaway
        for lane in range(z.shape[1]):
            stuck, torque = z[Z.stuck + axis, lane], z[out + axis, lane]
            skewed, most = z[Z.friction_asymmetry + axis, lane], z[Z.kinetic_friction + axis, lane]
            most += z[Z.friction_excess + axis, lane]
            most += z[Z.sliding_friction, lane]
            most += z[Z.standstill_friction, lane]
            room = min(most + skewed - torque, most - skewed + torque) + (1.0 - stuck) * _ENOUGH
            z[Z.margin, lane] = min(z[Z.margin, lane], room)
            z[out + axis, lane] = (1.0 - stuck) * torque


@bare
def _springs(z: Array, rows: Array, first: int, coefficients: int) -> None:
    """Torque of each transmission; `coefficients` of the polynomials are not zero."""
    p = rows[first]
    for i in range(int(p[P.transmissions])):
        at, motor, spring, factor = Z.at, Z.at + (1 + i), Z.spring_torque + i, Z.spring_factor + i
        flank, half, stop = Z.flank + i, Z.half_gap + i, Z.stop + i
        hardening, offset, error = Z.spring_hardening + i, Z.pretension_offset + i, Z.input_error + i
        kind, rise, fall, growth = int(p[P.spring_kind + i]), Z.rise + i, Z.fall + i, Z.growth + i
        if kind != ODD_POLYNOMIAL and kind != SINH and kind != EXPONENTIAL:
            for lane in range(z.shape[1]):
                row = rows[min(first + lane, len(rows) - 1)]
                start = P.spring + i * N_COEFFICIENTS
                q, m1, m2 = z[at, lane], z[at + 1, lane], z[at + 2, lane]
                phi, preset = deflection(row, i, q, z[motor, lane]), preset_of(row, i, m1, m2)
                c = row[start : start + N_COEFFICIENTS]
                z[spring, lane] = transmission_torque(row, c, i, phi, preset, int(z[flank, lane]), z[factor, lane])
            continue
        for lane in range(z.shape[1]):
            phi = z[at, lane] - z[motor, lane] - z[offset, lane] - z[error, lane] - z[flank, lane] * z[half, lane]
            z[Z.phi, lane] = phi
            z[Z.inside, lane] = min(max(phi, -z[stop, lane]), z[stop, lane])
            z[spring, lane] = z[Z.slope, lane] = 0.0
        if kind == ODD_POLYNOMIAL:
            for k in range(coefficients - 1, -1, -1):
                coefficient, odd = Z.spring + (i * N_COEFFICIENTS + k), 2.0 * k + 1.0
                for lane in range(z.shape[1]):
                    square = z[Z.inside, lane] * z[Z.inside, lane]
                    z[spring, lane] = z[spring, lane] * square + z[coefficient, lane]
                    z[Z.slope, lane] = z[Z.slope, lane] * square + odd * z[coefficient, lane]
            for lane in range(z.shape[1]):
                z[spring, lane] *= z[Z.inside, lane]
        else:
            for lane in range(z.shape[1]):
                grown = decay(-z[growth, lane] * z[Z.inside, lane])
                pulled, released = z[rise, lane] * grown, z[fall, lane] / grown
                z[spring, lane] = pulled - released
                z[Z.slope, lane] = z[growth, lane] * (pulled + released)
        for lane in range(z.shape[1]):
            phi, inside = z[Z.phi, lane], z[Z.inside, lane]
            torque = z[spring, lane] + max(z[Z.slope, lane], 0.0) * (phi - inside)
            share = 1.0 + z[hardening, lane] * phi * phi
            share = share if phi == inside else max(share, 0.0)
            within = z[half, lane] > 0.0 and z[flank, lane] == 0.0
            z[spring, lane] = 0.0 if within else z[factor, lane] * share * torque


@bare
def _rare_torques(z: Array, axes: int, out: int, rare: int) -> None:
    """Add the rare terms to three rows from `out` on."""
    if rare >> R.position & 1:  # `position_drive.drive_torque`
        for lane in range(z.shape[1]):
            reach = z[Z.drive_limit, lane]
            torque = min(max(z[Z.drive_stiffness, lane] * (z[Z.goal, lane] - z[Z.at, lane]), -reach), reach)
            z[Z.drive_torque, lane] = z[Z.drive_gain, lane] * torque + z[Z.drive_bias, lane]
            z[out, lane] += z[Z.drive_torque, lane]
    add_terms(z, axes, out, rare)
    for axis in range(axes):
        if rare >> (R.bristle + axis) & 1:
            for lane in range(z.shape[1]):
                z[out + axis, lane] -= bristle_torque(z, axis, lane)
    for i in range(2):
        if rare >> (R.maxwell + i) & 1:
            for lane in range(z.shape[1]):
                torque = maxwell_torque(z, i, lane)
                z[out, lane] -= torque
                z[out + 1 + i, lane] += torque
        if rare >> R.spring_damping & 1:  # coupling part of the dampers; the diagonal part is in `weigh`
            for lane in range(z.shape[1]):
                rub = z[Z.spring_damping + i, lane]
                z[out, lane] += rub * z[Z.at + 4 + i, lane]
                z[out + 1 + i, lane] += rub * z[Z.at + 3, lane]
    if rare >> R.wall & 1:
        for lane in range(z.shape[1]):
            z[out, lane] += wall_torque(z, lane)


@bare
def bristle_torque(z: Array, axis: int, lane: int) -> float:
    """`friction.bristle_torque` at `Z.at`; constant for a stuck axis, zero for an axis without a bristle."""
    sign, held = z[Z.sign + axis, lane], z[Z.bristle + axis, lane]
    end, travel = sign * z[Z.bristle_torque + axis, lane], z[Z.at + axis, lane] - z[Z.start + axis, lane]
    return end + (held - end) * decay(max(sign * travel * z[Z.bristle_rate + axis, lane], -1.0))


@bare
def maxwell_torque(z: Array, i: int, lane: int) -> float:
    """`torques.maxwell_torque` at `Z.at`."""
    slip, motor = z[Z.slip + i, lane], 1 + i
    travel = (z[Z.at, lane] - z[Z.at + motor, lane]) - (z[Z.start, lane] - z[Z.start + motor, lane])
    stuck = z[Z.maxwell + i, lane] + z[Z.slip_stiffness + i, lane] * travel
    return slip * z[Z.slip_torque + i, lane] + (1.0 - abs(slip)) * stuck


@bare
def wall_torque(z: Array, lane: int) -> float:
    """`torques.contact_torque` at `Z.at`, zero where the wall is not touched."""
    side, depth = z[Z.contact_side, lane], z[Z.at, lane] - z[Z.contact_angle, lane]
    push = side * (z[Z.contact_stiffness, lane] * depth + z[Z.contact_damping, lane] * z[Z.at + 3, lane])
    return -z[Z.touch, lane] * side * max(push, 0.0)


@bare
def _counter(z: Array, axis: int, count: int, terms: Terms) -> None:
    """`torques.counter_torque` of an axis of a joint with `count` transmissions."""
    if axis > 0:
        for lane in range(z.shape[1]):
            z[Z.counter_torque, lane] = z[Z.torque + axis, lane] - z[Z.other_torque + axis, lane]
        return
    for lane in range(z.shape[1]):
        z[Z.counter_torque, lane] = z[Z.other_torque, lane] if count == 0 else z[Z.torque, lane]
    if terms.gravity:
        for lane in range(z.shape[1]):
            z[Z.counter_torque, lane] -= z[Z.gravity_torque, lane] * sine(z[Z.at, lane] - z[Z.gravity_angle, lane])
    if terms.rare >> R.wall & 1:
        for lane in range(z.shape[1]):
            z[Z.counter_torque, lane] += wall_torque(z, lane)


@bare
def apply_lag(z: Array, moment: int) -> None:
    """`actuation.supply` at the beginning (0), the middle (1) or the end (2) of a step."""
    kept = Z.lag_left + moment
    for axis in range(3):
        for lane in range(z.shape[1]):
            asked = z[Z.commanded + axis, lane]
            torque = asked + (z[Z.lagged + axis, lane] - asked) * z[kept, lane]
            z[Z.torque + axis, lane] = (
                z[Z.other_torque + axis, lane] + z[Z.torque_gain + axis, lane] * torque + z[Z.torque_bias + axis, lane]
            )
