"""Damping of all lanes of a block, and the weights of steps with it, which change with it."""

from __future__ import annotations

from via_core.dampers import damper_value
from via_core.signals import Array

from via_sim.joint.compiled import bare
from via_sim.joint.layout import DAMPING
from via_sim.joint.parameters import AT_TRANSMISSION, DYNAMIC, NO_DAMPER, P
from via_sim.joint.phi_functions import SHORT_REACH, SHORT_SERIES, phi_series
from via_sim.joint.step import PER_AXIS, axis_weights, weigh
from via_sim.lockstep.block import Z
from via_sim.lockstep.pack import any_above, get, put


@bare
def set_damping(rows: Array, piece: int, first: bool, weights: Array, z: Array) -> None:
    """Damping that acts on the links in a piece of a tick, and the weights of its steps; weights (N_WEIGHTS,): memory.

    first  whether no damping was set before
    """
    changed = first
    for lane, p in enumerate(rows):
        damping = z[Z.power, lane] * z[Z.drive_damping, lane]
        if p[P.damper_site] != NO_DAMPER:
            damping += damper_value(int(p[P.damper_kind]), p[P.damper : P.damper + 3], z[Z.command + DAMPING, lane])
        changed |= damping != z[Z.weighed + piece, lane]
        z[Z.damping, lane] = z[Z.weighed + piece, lane] = damping
    if not changed:
        return
    if first or not _reweigh(rows, piece, z):
        for lane, p in enumerate(rows):
            weigh(p, z[Z.piece_length + piece, lane], z[Z.damping, lane], weights)
            for k in range(3 * PER_AXIS):
                z[Z.piece_weight + 3 * PER_AXIS * piece + k, lane] = weights[k]


@bare
def _reweigh(rows: Array, piece: int, z: Array) -> bool:
    """Weights of the axes that the damper acts on; False, and not all of them, where a short series is not exact."""
    h = get(z, Z.piece_length + piece)
    for axis in range(2 if rows[0, P.damper_site] == AT_TRANSMISSION else 1):
        if rows[0, P.axis_kind + axis] != DYNAMIC:
            continue
        k = h / get(z, Z.inertia + axis)
        decay = k * (get(z, Z.viscous_friction + axis) + get(z, Z.damping))
        if any_above(decay, 0.0 * decay + SHORT_REACH):
            return False
        full, half = phi_series(-decay, SHORT_SERIES), phi_series(-0.5 * decay, SHORT_SERIES)
        start, of_axis = Z.piece_weight + PER_AXIS * (3 * piece + axis), axis_weights(h, k, full, half)
        for j in range(PER_AXIS):
            put(z, start + j, of_axis[j])
    return True
