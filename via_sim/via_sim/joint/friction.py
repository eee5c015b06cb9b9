"""Friction of one axis, compiled: viscous, dry (Coulomb, Stribeck, load-dependent), and Dahl's bristle.

**Load.** The teeth of a gear are pressed together by the load T, the torque on the axis through its transmissions, and
by the counter torque C from the other side. On a link, T is the spring torque and C is gravity, walls and external
torque. On a motor, T is the spring torque and C the torque of its drive. On the link of a rigid joint, T is the torque
of its drive (with the damping of a position drive, which passes through the gear) and C is all other torque. Friction
at speed v > 0 increases by

    |c T - k C| + exp(-(v/velocity)^2) (|c_s T - k_s C| + quadratic min(|T|, |C|)^2 [T C < 0])

with c `load_friction`, k `counter_friction`, c_s `load_stribeck`, k_s `counter_stribeck`.

Source: models M3 (c = k), M4 (also c_s = k_s), M5 (all different) and M6 (with `quadratic`) of Duclusaud, Passault,
Padois, Ly, Extended friction models for the physics simulation of servo actuators, arXiv 2410.08650 (2024), with two
restrictions. The exponent of the Stribeck curve is 2. M6 has one quadratic coefficient for both sides: with two,
friction would be discontinuous at |T| = |C|, which holds whenever a joint moves at constant speed.
"""

from __future__ import annotations

from math import exp

from via_core.signals import Array

from via_sim.joint.compiled import bare, inlined
from via_sim.joint.parameters import AT_TRANSMISSION, DYNAMIC, NO_DAMPER, POSITION_DRIVE, P


@bare
def bristle_torque(p: Array, axis: int, mode: int, held: float, travel: float) -> float:
    """Dahl's friction [N m] after `travel` [rad] in the direction of `mode`, starting at `held` [N m]."""
    level = p[P.bristle_torque + axis]
    if level <= 0.0 or abs(mode) != 1:
        return held
    end = mode * level
    # A trial step may continue beyond a reversal; the bound prevents overflow there.
    spent = min(-mode * travel * p[P.bristle_stiffness + axis] / level, 1.0)
    return end + (held - end) * exp(spent)


@bare
def viscous_friction(p: Array, axis: int, damping: float) -> float:
    """Viscous friction [N m s/rad] of an axis with damper and drive; mean of both directions."""
    site, viscous = p[P.damper_site], p[P.viscous_friction + axis]
    damped = site != NO_DAMPER or p[P.link_drive] == POSITION_DRIVE
    if (axis == 0 and damped) or (axis == 1 and site == AT_TRANSMISSION):
        viscous += damping
    return viscous + (p[P.spring_damping] + p[P.spring_damping + 1] if axis == 0 else p[P.spring_damping + axis - 1])


@bare
def viscous_rate(p: Array, axis: int, damping: float) -> float:
    """a = viscous friction / inertia [1/s] of an axis, damper included."""
    return viscous_friction(p, axis, damping) / p[P.inertia + axis]


@bare
def has_friction(p: Array, axis: int) -> bool:
    """Whether the torque on an axis depends on the direction of its motion."""
    return p[P.axis_kind + axis] == DYNAMIC and (
        p[P.breakaway_friction + axis] > 0.0
        or p[P.load_friction + axis] > 0.0
        or p[P.bristle_torque + axis] > 0.0
        or p[P.viscous_asymmetry + axis] != 0.0
        or feels_both_sides(p, axis)
    )


@inlined
def feels_both_sides(p: Array, axis: int) -> bool:
    """Whether the friction of an axis depends on load and counter torque, or on the load by several coefficients."""
    return p[P.both_sides + axis] != 0.0


@bare
def _gear_friction(p: Array, axis: int, speed: float, load: float, counter: float) -> float:
    """Friction [N m] at a speed >= 0 due to the torques `load` and `counter` [N m]."""
    sliding = abs(p[P.load_friction + axis] * load - p[P.counter_friction + axis] * counter)
    standing = abs(p[P.load_stribeck + axis] * load - p[P.counter_stribeck + axis] * counter)
    if load * counter < 0.0:
        least = min(abs(load), abs(counter))
        standing += p[P.load_quadratic + axis] * least * least
    ratio = speed / p[P.load_velocity + axis]
    return sliding + standing * exp(-ratio * ratio)


@inlined
def _load_friction(p: Array, axis: int, speed: float, load: float, counter: float) -> float:
    """`_gear_friction`, with a fast path for friction proportional to the load."""
    if feels_both_sides(p, axis):
        return _gear_friction(p, axis, speed, load, counter)
    return p[P.load_friction + axis] * abs(load)


@bare
def dry_friction(p: Array, axis: int, direction: int, speed: float, load: float, counter: float) -> float:
    """Dry friction [N m] of an axis that slips in `direction` with speed >= 0 under a load [N m]."""
    kinetic = p[P.kinetic_friction + axis]
    excess = p[P.breakaway_friction + axis] - kinetic
    skewed = direction * (p[P.friction_asymmetry + axis] + p[P.viscous_asymmetry + axis] * speed)
    kinetic += skewed + _load_friction(p, axis, speed, load, counter)
    if excess == 0.0:
        return kinetic
    ratio = speed / p[P.stribeck_velocity + axis]
    return kinetic + excess * exp(-ratio * ratio)


@bare
def breakaway(p: Array, axis: int, direction: int, load: float, counter: float) -> float:
    """Largest torque [N m] in `direction` at which an axis sticks under a load [N m]."""
    dry = p[P.breakaway_friction + axis] + direction * p[P.friction_asymmetry + axis]
    return dry + _load_friction(p, axis, 0.0, load, counter)
