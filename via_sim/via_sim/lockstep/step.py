"""One Krogstad step of all lanes of a block, and the check whether each lane has kept its modes."""

from __future__ import annotations

from via_core.signals import Array

from via_sim.joint.compiled import bare
from via_sim.joint.step import PER_AXIS, W
from via_sim.lockstep.block import R, Terms, Z, add, copy
from via_sim.lockstep.terms import find_input_errors
from via_sim.lockstep.torques import apply_lag, bristle_torque, maxwell_torque, torques


@bare
def step(z: Array, rows: Array, first: int, terms: Terms, sticks: bool) -> None:
    """One Krogstad step of the block in place, as `kernel._step`; it is valid in lanes whose margin stays positive.

    first   parameter row of the first lane
    sticks  whether an axis sticks in any lane
    """
    axes, friction, rare = terms.axes, terms.friction, terms.rare
    lags = rare >> R.lag & 1 != 0
    copy(z, Z.start, Z.at, 6)
    if lags:
        apply_lag(z, 0)
    torques(z, rows, first, Z.n, terms, sticks)
    for axis in range(axes):
        for lane in range(z.shape[1]):
            z[Z.a + axis, lane] = 0.0
    _stage(z, axes, W.half, W.a_n, Z.n, W.b_a, Z.a)
    if friction != 0:
        copy(z, Z.at + 3, Z.midpoint, axes)
    if lags:
        apply_lag(z, 1)
    torques(z, rows, first, Z.a, terms, sticks)
    _stage(z, axes, W.half, W.b_n, Z.n, W.b_a, Z.a)
    if friction != 0:
        add(z, Z.at + 3, Z.midpoint, axes)  # twice the midpoint velocity
        _check_modes(z, Z.midpoint, axes, friction, 0)
    torques(z, rows, first, Z.b, terms, sticks)
    _stage(z, axes, W.full, W.c_n, Z.n, W.c_b, Z.b)
    if lags:
        apply_lag(z, 2)
    torques(z, rows, first, Z.c, terms, sticks)
    add(z, Z.b, Z.a, axes)
    _stage(z, axes, W.full, W.end_n, Z.n, W.end_ab, Z.a)
    for axis in range(axes):
        w = Z.weight + PER_AXIS * axis
        for lane in range(z.shape[1]):
            z[Z.at + axis, lane] += z[w + W.end_c + 1, lane] * z[Z.c + axis, lane]
            z[Z.at + 3 + axis, lane] += z[w + W.end_c, lane] * z[Z.c + axis, lane]
    if rare >> R.input & 3:
        find_input_errors(z)
    _check_modes(z, Z.at + 3, axes, friction, terms.gaps)
    if sticks:  # for the margin of stuck axes at the end of the step
        torques(z, rows, first, Z.n, terms, sticks)
    if rare != 0:
        _check_rare_modes(z, rare)
        _update_memory(z, axes, rare)
    copy(z, Z.at, Z.start, 6)


@bare
def _stage(z: Array, axes: int, base: int, one: int, torque_one: int, two: int, torque_two: int) -> None:
    """Motion into `Z.at`: linear part with weights `base`, plus weights `one` and `two` times two torques."""
    for axis in range(axes):
        w, n, m = Z.weight + PER_AXIS * axis, torque_one + axis, torque_two + axis
        for lane in range(z.shape[1]):
            first, second, speed = z[n, lane], z[m, lane], z[Z.start + 3 + axis, lane]
            z[Z.at + axis, lane] = (
                z[Z.start + axis, lane]
                + z[w + base + 1, lane] * speed
                + z[w + one + 1, lane] * first
                + z[w + two + 1, lane] * second
            )
            z[Z.at + 3 + axis, lane] = z[w + base, lane] * speed + z[w + one, lane] * first + z[w + two, lane] * second


@bare
def _check_modes(z: Array, velocity: int, axes: int, friction: int, transmissions: int) -> None:
    """Margin <= 0 where a slipping axis has stopped or reversed (velocities in rows `velocity`) or has left a flank."""
    for axis in range(axes):
        if friction >> axis & 1:
            for lane in range(z.shape[1]):
                sign = z[Z.sign + axis, lane]
                ahead = sign * z[velocity + axis, lane] + 1.0 - abs(sign)
                z[Z.margin, lane] = min(z[Z.margin, lane], ahead)
    for i in range(transmissions):
        for lane in range(z.shape[1]):
            half, flank = z[Z.half_gap + i, lane], z[Z.flank + i, lane]
            phi = z[Z.at, lane] - z[Z.at + 1 + i, lane] - z[Z.pretension_offset + i, lane] - z[Z.input_error + i, lane]
            beyond, inside = flank * phi - half, half - abs(phi)
            kept = abs(flank) * beyond + (1.0 - abs(flank)) * inside + z[Z.no_gap + i, lane]
            z[Z.margin, lane] = min(z[Z.margin, lane], kept)


@bare
def _check_rare_modes(z: Array, rare: int) -> None:
    """Margin <= 0 where a Maxwell element begins or ceases to slip, or the wall is met or left."""
    for i in range(2):
        if rare >> (R.maxwell + i) & 1:
            for lane in range(z.shape[1]):
                slip, absent = z[Z.slip + i, lane], 1.0 if z[Z.slip_torque + i, lane] == 0.0 else 0.0
                sliding = slip * (z[Z.at + 3, lane] - z[Z.at + 4 + i, lane])
                sticking = z[Z.slip_torque + i, lane] - abs(maxwell_torque(z, i, lane))
                kept = abs(slip) * sliding + (1.0 - abs(slip)) * sticking + absent
                z[Z.margin, lane] = min(z[Z.margin, lane], kept)
    if rare >> R.wall & 1:
        for lane in range(z.shape[1]):
            depth = z[Z.contact_side, lane] * (z[Z.at, lane] - z[Z.contact_angle, lane])
            z[Z.margin, lane] = min(z[Z.margin, lane], (2.0 * z[Z.touch, lane] - 1.0) * depth + z[Z.no_wall, lane])


@bare
def _update_memory(z: Array, axes: int, rare: int) -> None:
    """`torques.remember` from `Z.start` to `Z.at`, and the lag of the drives over the step."""
    for axis in range(axes):
        if rare >> (R.bristle + axis) & 1:
            for lane in range(z.shape[1]):
                z[Z.bristle + axis, lane] = bristle_torque(z, axis, lane)
    for i in range(2):
        if rare >> (R.maxwell + i) & 1:
            for lane in range(z.shape[1]):
                most = z[Z.slip_torque + i, lane]
                z[Z.maxwell + i, lane] = min(max(maxwell_torque(z, i, lane), -most), most)
    if rare >> R.lag & 1:
        for axis in range(3):
            for lane in range(z.shape[1]):
                asked = z[Z.commanded + axis, lane]
                z[Z.lagged + axis, lane] = asked + (z[Z.lagged + axis, lane] - asked) * z[Z.lag_left + 2, lane]
