"""One Krogstad step of all lanes of a block, and the check whether each lane has kept its modes."""

from __future__ import annotations

from typing import Any

from via_core.signals import Array

from via_sim.joint.compiled import bare, inlined
from via_sim.joint.step import PER_AXIS, W
from via_sim.lockstep.block import R, Terms, Z
from via_sim.lockstep.goals import keep_goals, move_goals
from via_sim.lockstep.pack import add, get, put
from via_sim.lockstep.servos import END, MIDDLE, find_servos, place_servos
from via_sim.lockstep.terms import find_input_errors
from via_sim.lockstep.torques import apply_lag, bristle_torque, lagged, maxwell_torque, torques


@bare
def step(z: Array, rows: Array, terms: Terms, sticks: bool, full: Any) -> None:
    """One Krogstad step of the block in place, as `step.krogstad_step`; valid in lanes whose margin stays positive.

    rows    (K, N_PARAMETERS) of the lanes
    sticks  whether an axis sticks in any lane
    full    True, or None without the terms that a block which `is_simple` lacks
    """
    axes, friction, rare = terms.axes, terms.friction, terms.rare
    for row in range(6):
        put(z, Z.at + row, get(z, Z.start + row))
    if full is not None and rare >> R.servo & 3:
        find_servos(z, rows, rare)
    if full is not None:
        _supply(z, 0, rare)
    torques(z, rows, Z.n, terms, sticks, full)
    for axis in range(axes):
        put(z, Z.a + axis, 0.0)
    _stage(z, axes, W.half, W.a_n, W.b_a, Z.a)
    if full is not None:
        place_servos(z, rare, MIDDLE)
    if friction != 0:
        for axis in range(axes):
            put(z, Z.midpoint + axis, get(z, Z.at + 3 + axis))
    if full is not None:
        _supply(z, 1, rare)
    torques(z, rows, Z.a, terms, sticks, full)
    _stage(z, axes, W.half, W.b_n, W.b_a, Z.a)
    if full is not None:
        place_servos(z, rare, MIDDLE)
    if friction != 0:
        for axis in range(axes):  # twice the midpoint velocity
            add(z, Z.midpoint + axis, get(z, Z.at + 3 + axis))
        _check_modes(z, Z.midpoint, axes, friction, 0)
    torques(z, rows, Z.b, terms, sticks, full)
    _stage(z, axes, W.full, W.c_n, W.c_b, Z.b)
    if full is not None:
        place_servos(z, rare, END)
    if full is not None:
        _supply(z, 2, rare)
    torques(z, rows, Z.c, terms, sticks, full)
    for axis in range(axes):
        add(z, Z.a + axis, get(z, Z.b + axis))
    _stage(z, axes, W.full, W.end_n, W.end_ab, Z.a)
    for axis in range(axes):
        w, last = Z.weight + PER_AXIS * axis + W.end_c, get(z, Z.c + axis)
        add(z, Z.at + axis, get(z, w + 1) * last)
        add(z, Z.at + 3 + axis, get(z, w) * last)
    if full is not None:
        place_servos(z, rare, END)
    if full is not None and rare >> R.input & 3:
        find_input_errors(z)
    if friction != 0 or terms.gaps != 0:
        _check_modes(z, Z.at + 3, axes, friction, terms.gaps)
    if sticks:  # for the margin of stuck axes at the end of the step
        torques(z, rows, Z.n, terms, sticks, full)
    if full is not None and rare != 0:
        _check_rare_modes(z, rare)
        _update_memory(z, axes, rare)
    for row in range(6):
        put(z, Z.start + row, get(z, Z.at + row))


@inlined
def _stage(z: Array, axes: int, base: int, one: int, two: int, second: int) -> None:
    """Motion into `Z.at`: linear part with weights `base`, weights `one` times `Z.n`, `two` times rows `second`."""
    for axis in range(3):
        if axis >= axes:
            break
        w, n, m, v = Z.weight + PER_AXIS * axis, get(z, Z.n + axis), get(z, second + axis), get(z, Z.start + 3 + axis)
        angle = get(z, Z.start + axis) + get(z, w + base + 1) * v
        put(z, Z.at + axis, angle + get(z, w + one + 1) * n + get(z, w + two + 1) * m)
        put(z, Z.at + 3 + axis, get(z, w + base) * v + get(z, w + one) * n + get(z, w + two) * m)


@inlined
def _supply(z: Array, moment: int, rare: int) -> None:
    """Torques and goals at the beginning (0), the middle (1) or the end (2) of a step, as `actuation.supply`."""
    if rare >> R.lag & 1:
        apply_lag(z, moment)
    if rare >> R.goal & 1:
        move_goals(z, moment)


@inlined
def _keep(z: Array, room: Any) -> None:
    put(z, Z.margin, min(get(z, Z.margin), room))


@bare
def _check_modes(z: Array, velocity: int, axes: int, friction: int, transmissions: int) -> None:
    """Margin <= 0 where a slipping axis has stopped or reversed (velocities in rows `velocity`) or has left a flank."""
    for axis in range(axes):
        if friction >> axis & 1:
            sign = get(z, Z.sign + axis)
            _keep(z, sign * get(z, velocity + axis) + 1.0 - abs(sign))
    for i in range(transmissions):
        half, flank = get(z, Z.half_gap + i), get(z, Z.flank + i)
        phi = get(z, Z.at) - get(z, Z.at + 1 + i) - get(z, Z.pretension_offset + i) - get(z, Z.input_error + i)
        beyond, inside = flank * phi - half, half - abs(phi)
        _keep(z, abs(flank) * beyond + (1.0 - abs(flank)) * inside + get(z, Z.no_gap + i))


@bare
def _check_rare_modes(z: Array, rare: int) -> None:
    """Margin <= 0 where a Maxwell element begins or ceases to slip, or the wall is met or left."""
    for i in range(2):
        if rare >> (R.maxwell + i) & 1:
            slip = get(z, Z.slip + i)
            sliding = slip * (get(z, Z.at + 3) - get(z, Z.at + 4 + i))
            sticking = get(z, Z.slip_torque + i) - abs(maxwell_torque(z, i))
            _keep(z, abs(slip) * sliding + (1.0 - abs(slip)) * sticking + get(z, Z.no_maxwell + i))
    if rare >> R.wall & 1:
        depth = get(z, Z.contact_side) * (get(z, Z.at) - get(z, Z.contact_angle))
        _keep(z, (2.0 * get(z, Z.touch) - 1.0) * depth + get(z, Z.no_wall))


@bare
def _update_memory(z: Array, axes: int, rare: int) -> None:
    """`torques.remember` from `Z.start` to `Z.at`, and the lag of the drives over the step."""
    for axis in range(axes):
        if rare >> (R.bristle + axis) & 1:
            put(z, Z.bristle + axis, bristle_torque(z, axis))
    for i in range(2):
        if rare >> (R.maxwell + i) & 1:
            most = get(z, Z.slip_torque + i)
            put(z, Z.maxwell + i, min(max(maxwell_torque(z, i), -most), most))
    if rare >> R.lag & 1:
        for axis in range(3):
            put(z, Z.lagged + axis, lagged(z, axis, 2))
    if rare >> R.goal & 1:
        keep_goals(z)
