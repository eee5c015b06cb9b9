"""Torques of all lanes of a block, as `torques.forced`."""

from __future__ import annotations

from math import cos, exp, sin, sqrt
from typing import Any

from via_core.signals import Array
from via_core.spring_equations import EXPONENTIAL, MACCEPA, N_COEFFICIENTS, ODD_POLYNOMIAL, SINH

from via_sim.joint.compiled import bare, inlined
from via_sim.joint.parameters import P
from via_sim.joint.structure import EVERYTHING
from via_sim.joint.torques import preset_of, spring_law
from via_sim.lockstep.block import R, Terms, Z
from via_sim.lockstep.goals import read_link
from via_sim.lockstep.pack import LANES, add, any_above, choose, get, put
from via_sim.lockstep.terms import add_terms, corrected, find_input_errors, saturated

_ENOUGH = 1e300  # [N m] margin of an axis that does not stick


@inlined
def torques(z: Array, rows: Array, out: int, terms: Terms, sticks: bool, full: Any) -> None:
    """Torque on each axis without its viscous friction, at the motion `Z.at`, into three rows from `out` on.

    rows    (K, N_PARAMETERS) of the lanes
    sticks  whether an axis sticks in any lane
    full    True, or None without the terms that a block which `is_simple` lacks
    """
    if full is None:
        _simple_torques(z, rows, out, terms, sticks, full)
    else:
        _all_torques(z, rows, out, terms, sticks, full)


@bare
def _all_torques(z: Array, rows: Array, out: int, terms: Terms, sticks: bool, full: Any) -> None:
    link, first, second = get(z, Z.torque), get(z, Z.torque + 1), get(z, Z.torque + 2)
    if terms.gravity:
        link -= _gravity(z)
    if terms.coupled:
        link += get(z, Z.damping) * get(z, Z.at + 4)
        first += get(z, Z.damping) * get(z, Z.at + 3)
    if full is not None and terms.rare >> R.input & 3:
        find_input_errors(z)
    if terms.springs > 0:
        torque, geared = _spring(z, rows, 0, terms, full)
        link, first = link - torque, first + geared
    if terms.springs > 1:
        torque, geared = _spring(z, rows, 1, terms, full)
        link, second = link - torque, second + geared
    put(z, out, link)
    put(z, out + 1, first)
    put(z, out + 2, second)
    if full is not None and terms.rare != 0:
        _add_rare_torques(z, terms.axes, out, terms.rare)
    if full is None and terms.rare != 0:
        add_terms(z, terms.axes, out, terms.rare)
    for axis in range(terms.axes):
        if terms.friction >> axis & 1:
            _add_friction(z, axis, out, terms, sticks)


_simple_torques = inlined(_all_torques.py_func)


@inlined
def _gravity(z: Array) -> Any:
    return get(z, Z.gravity_torque) * sin(get(z, Z.at) - get(z, Z.gravity_angle))


@bare
def _add_friction(z: Array, axis: int, out: int, terms: Terms, sticks: bool) -> None:
    """Add dry friction to the torque on an axis, as `torques._driven`."""
    rare = terms.rare
    sign, speed = get(z, Z.sign + axis), get(z, Z.at + 3 + axis)
    if axis > 0:
        load = get(z, Z.geared_torque + axis - 1)
    elif terms.springs > 0:
        load = -(get(z, Z.spring_torque) + get(z, Z.spring_torque + 1))
    elif rare >> R.position & 1:
        load = get(z, Z.drive_torque) - get(z, Z.power) * get(z, Z.drive_damping) * speed
    else:
        load = get(z, Z.torque) - get(z, Z.other_torque)
    standing = 0.0 * load
    if rare >> R.loads & 1:
        counter = _counter(z, axis, terms)
        least = min(abs(load), abs(counter))
        sliding = abs(get(z, Z.load_friction + axis) * load - get(z, Z.counter_friction + axis) * counter)
        standing = abs(get(z, Z.load_stribeck + axis) * load - get(z, Z.counter_stribeck + axis) * counter)
        standing += choose(-load * counter, get(z, Z.load_quadratic + axis) * least * least, 0.0)
    else:
        sliding = get(z, Z.load_friction + axis) * abs(load)
    level = get(z, Z.kinetic_friction + axis) + sliding
    size = level + sign * get(z, Z.friction_asymmetry + axis) + get(z, Z.viscous_asymmetry + axis) * speed
    if terms.falls:
        ratio = speed * get(z, Z.inverse_stribeck_velocity + axis)
        size += get(z, Z.friction_excess + axis) * exp(-ratio * ratio)
    if rare >> R.loads & 1:
        ratio = speed * get(z, Z.inverse_load_velocity + axis)
        size += standing * exp(-ratio * ratio)
    torque = get(z, out + axis) - sign * size
    if sticks:  # friction balances all torque on a stuck axis, up to breakaway
        slips, skewed = 1.0 - get(z, Z.stuck + axis), get(z, Z.friction_asymmetry + axis)
        most = level + get(z, Z.friction_excess + axis) + standing
        room = min(most + skewed - torque, most - skewed + torque) + slips * _ENOUGH
        put(z, Z.margin, min(get(z, Z.margin), room))
        torque *= slips
    put(z, out + axis, torque)


@inlined
def _spring(z: Array, rows: Array, i: int, terms: Terms, full: Any) -> Any:
    """Torques [N m] of transmission i on the link and on its motor."""
    phi, factor = get(z, Z.at) - get(z, Z.at + 1 + i) - get(z, Z.pretension_offset + i), get(z, Z.spring_factor + i)
    if full is not None:
        if terms.rare >> R.input & 3:
            phi -= get(z, Z.input_error + i)
        if terms.gaps > i:
            flank, half = get(z, Z.flank + i), get(z, Z.half_gap + i)
            phi -= flank * half
            factor = choose(half * (1.0 - abs(flank)), 0.0, factor)
        if terms.rare >> R.hardening & 1:
            share = 1.0 + get(z, Z.spring_hardening + i) * phi * phi
            factor *= choose(abs(phi) - get(z, Z.stop + i), max(share, 0.0), share)
    torque = factor * _law(z, rows, i, phi, terms, full)
    geared = torque
    if full is not None and terms.rare >> R.input & 3:
        geared *= 1.0 + get(z, Z.input_slope + i)
    if terms.friction != 0:
        put(z, Z.spring_torque + i, torque)
        put(z, Z.geared_torque + i, geared)
    return torque, geared


@inlined
def _law(z: Array, rows: Array, i: int, phi: Any, terms: Terms, full: Any) -> Any:
    """Spring law of transmission i at phi, see `torques.spring_law`."""
    if full is not None and terms.kinds[i] != ODD_POLYNOMIAL:
        if terms.kinds[i] == MACCEPA and not any_above(abs(phi), get(z, Z.stop + i)):
            return _maccepa(z, rows, i, phi)
        if terms.kinds[i] != SINH and terms.kinds[i] != EXPONENTIAL:
            return _each_law(z, rows, i, phi)
        if not any_above(abs(phi), get(z, Z.stop + i)):
            return _exponential(z, i, phi, 1.0)
    elif not any_above(abs(phi), get(z, Z.stop + i)):
        return _polynomial(z, i, phi, terms)
    return _stopped_law(z, i, phi, terms)


@inlined
def _polynomial(z: Array, i: int, phi: Any, terms: Terms) -> Any:
    """Odd polynomial of transmission i at phi."""
    start, square = Z.spring + i * N_COEFFICIENTS, phi * phi
    value = get(z, start + terms.coefficients - 1)
    for k in range(terms.coefficients - 2, -1, -1):
        value = value * square + get(z, start + k)
    return value * phi


@bare
def _exponential(z: Array, i: int, phi: Any, sign: float) -> Any:
    """Exponential spring law of transmission i at phi; with `sign` -1 its slope over its growth."""
    grown = exp(get(z, Z.growth + i) * phi)
    return get(z, Z.rise + i) * grown - sign * (get(z, Z.fall + i) / grown)


@bare
def _maccepa(z: Array, rows: Array, i: int, phi: Any) -> Any:
    """Spring law of a MACCEPA at phi, see `spring_equations.spring_torque`."""
    c, preset_motor = Z.spring + i * N_COEFFICIENTS, 2 if rows[0, P.serial] != 0.0 else 1 + i
    preset = get(z, Z.at + preset_motor) + get(z, Z.preset_offset + i)
    length = sqrt(get(z, c + 1) - get(z, c + 2) * cos(phi))
    return get(z, c) * sin(phi) * (1.0 + (get(z, c + 3) * preset - get(z, c + 4)) / length)


@bare
def _stopped_law(z: Array, i: int, phi: Any, terms: Terms) -> Any:
    """Spring law of transmission i at phi, beyond its stop along its tangent."""
    stop = get(z, Z.stop + i)
    inside = min(max(phi, -stop), stop)
    if terms.kinds[i] == ODD_POLYNOMIAL:
        torque, slope, power = _polynomial(z, i, inside, terms), 0.0 * inside, 1.0 + 0.0 * inside
        for k in range(terms.coefficients):
            slope += (2.0 * k + 1.0) * get(z, Z.spring + i * N_COEFFICIENTS + k) * power
            power *= inside * inside
    else:
        torque = _exponential(z, i, inside, 1.0)
        slope = get(z, Z.growth + i) * _exponential(z, i, inside, -1.0)
    return torque + max(slope, 0.0) * (phi - inside)


@bare
def _each_law(z: Array, rows: Array, i: int, phi: Any) -> Any:
    """Spring law of transmission i at phi, lane by lane: for kinds of springs without a form for packs."""
    put(z, Z.spring_torque + i, phi)
    for lane in range(LANES):
        p, at = rows[min(lane, len(rows) - 1)], z[Z.spring_torque + i, lane]
        preset = preset_of(p, i, z[Z.at + 1, lane], z[Z.at + 2, lane])
        z[Z.spring_torque + i, lane] = spring_law(p, EVERYTHING, N_COEFFICIENTS, i, at, preset)
    return get(z, Z.spring_torque + i)


@bare
def _add_rare_torques(z: Array, axes: int, out: int, rare: int) -> None:
    """Add the rare terms to three rows from `out` on."""
    if rare >> R.position & 1:  # `position_drive.drive_torque`
        reach, brake = get(z, Z.drive_limit), get(z, Z.drive_brake) * get(z, Z.at + 3)
        torque = get(z, Z.drive_stiffness) * (corrected(z, get(z, Z.acting) - read_link(z, rare)) + get(z, Z.held))
        torque = saturated(z, 0, min(max(torque - brake, -reach), reach)) + brake
        put(z, Z.drive_torque, get(z, Z.power) * (get(z, Z.drive_gain) * torque + get(z, Z.drive_bias)))
        add(z, out, get(z, Z.drive_torque))
    add_terms(z, axes, out, rare)
    for axis in range(axes):
        if rare >> (R.bristle + axis) & 1:
            add(z, out + axis, -bristle_torque(z, axis))
    for i in range(2):
        if rare >> (R.maxwell + i) & 1:
            torque = maxwell_torque(z, i)
            add(z, out, -torque)
            add(z, out + 1 + i, torque)
        if rare >> R.spring_damping & 1:  # coupling part of the dampers; the diagonal part is in `weigh`
            rub = get(z, Z.spring_damping + i)
            add(z, out, rub * get(z, Z.at + 4 + i))
            add(z, out + 1 + i, rub * get(z, Z.at + 3))
    if rare >> R.wall & 1:
        add(z, out, _wall_torque(z))


@bare
def bristle_torque(z: Array, axis: int) -> Any:
    """`friction.bristle_torque` at `Z.at`; constant for a stuck axis, zero for an axis without a bristle."""
    sign, held = get(z, Z.sign + axis), get(z, Z.bristle + axis)
    end, travel = sign * get(z, Z.bristle_torque + axis), get(z, Z.at + axis) - get(z, Z.start + axis)
    return end + (held - end) * exp(min(-sign * travel * get(z, Z.bristle_rate + axis), 1.0))


@bare
def maxwell_torque(z: Array, i: int) -> Any:
    """`torques.maxwell_torque` at `Z.at`."""
    slip = get(z, Z.slip + i)
    travel = (get(z, Z.at) - get(z, Z.at + 1 + i)) - (get(z, Z.start) - get(z, Z.start + 1 + i))
    stuck = get(z, Z.maxwell + i) + get(z, Z.slip_stiffness + i) * travel
    return slip * get(z, Z.slip_torque + i) + (1.0 - abs(slip)) * stuck


@bare
def _wall_torque(z: Array) -> Any:
    """`torques.contact_torque` at `Z.at`, zero where the wall is not touched."""
    side, depth = get(z, Z.contact_side), get(z, Z.at) - get(z, Z.contact_angle)
    push = side * (get(z, Z.contact_stiffness) * depth + get(z, Z.contact_damping) * get(z, Z.at + 3))
    return -get(z, Z.touch) * side * max(push, 0.0)


@bare
def _counter(z: Array, axis: int, terms: Terms) -> Any:
    """`torques.counter_torque` of an axis."""
    if axis > 0:
        return get(z, Z.torque + axis) - get(z, Z.other_torque + axis)
    counter = get(z, Z.other_torque) if terms.springs == 0 else get(z, Z.torque)
    if terms.gravity:
        counter -= _gravity(z)
    if terms.rare >> R.wall & 1:
        counter += _wall_torque(z)
    return counter


@bare
def apply_lag(z: Array, moment: int) -> None:
    """`actuation.supply` at the beginning (0), the middle (1) or the end (2) of a step."""
    for axis in range(3):
        torque = get(z, Z.torque_gain + axis) * lagged(z, axis, moment) + get(z, Z.torque_bias + axis)
        put(z, Z.torque + axis, get(z, Z.other_torque + axis) + torque)


@inlined
def lagged(z: Array, axis: int, moment: int) -> Any:
    """Drive torque [N m] behind the lag, see `apply_lag`."""
    commanded = get(z, Z.commanded + axis)
    return commanded + (get(z, Z.lagged + axis) - commanded) * get(z, Z.lag_left + moment)
