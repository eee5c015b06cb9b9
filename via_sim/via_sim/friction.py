"""Friction of one axis, compiled: viscous, dry (Coulomb, Stribeck, with the load), and Dahl's bristle.

**Load.** A gear presses its teeth together with the torque T that comes to the axis through its transmissions and
with the counter torque C from the other side: on a link T is what the springs give and C gravity, walls and external
torque; on a motor T is what the spring gives and C the torque of its drive; on the link of a rigid joint T is the
torque of its drive (of a position drive with its damping: what passes through the gear) and C again gravity, walls and
everything else. Friction at speed v > 0 gets

    |c T - k C| + exp(-(v/velocity)^2) (|c_s T - k_s C| + quadratic min(|T|, |C|)^2 [T C < 0])

c `load_friction`, k `counter_friction`, c_s `load_stribeck`, k_s `counter_stribeck`. This is what the models M3 (c =
k), M4 (and c_s = k_s), M5 (all apart) and M6 (with `quadratic`) of Duclusaud, Passault, Padois, Ly, Extended friction
models for the physics simulation of servo actuators, arXiv 2410.08650 (2024) add to M1 and M2, with two restrictions:
the exponent of the Stribeck curve is 2, and M6 has one quadratic coefficient, not one for either side. With two its
friction would jump where |T| = |C|, which is where a joint moves evenly.
"""

from __future__ import annotations

from math import exp

from via_core.signals import Array

from via_sim.compiled import bare, inlined
from via_sim.parameters import AT_TRANSMISSION, DYNAMIC, NO_DAMPER, POSITION_DRIVE, P


@bare
def bristle_torque(p: Array, axis: int, mode: int, held: float, travel: float) -> float:
    """Dahl's friction [N m] after `travel` [rad] in the direction of `mode`, from `held` [N m] on; opposes positive."""
    level = p[P.bristle_torque + axis]
    if level <= 0.0 or abs(mode) != 1:
        return held
    end = mode * level
    # A trial step may run backwards past the reversal that ends it: no further than what keeps numbers small.
    spent = min(-mode * travel * p[P.bristle_stiffness + axis] / level, 1.0)
    return end + (held - end) * exp(spent)


@bare
def viscous_friction(p: Array, axis: int, damping: float) -> float:
    """Torque per speed [N m s/rad] of an axis, damper and drive included; mean of both directions."""
    site, viscous = p[P.damper_site], p[P.viscous_friction + axis]
    rubs = site != NO_DAMPER or p[P.link_drive] == POSITION_DRIVE
    if (axis == 0 and rubs) or (axis == 1 and site == AT_TRANSMISSION):
        viscous += damping
    return viscous + (p[P.spring_damping] + p[P.spring_damping + 1] if axis == 0 else p[P.spring_damping + axis - 1])


@bare
def viscous_rate(p: Array, axis: int, damping: float) -> float:
    """a = viscous friction / inertia [1/s] of an axis, damper included."""
    return viscous_friction(p, axis, damping) / p[P.inertia + axis]


@bare
def has_friction(p: Array, axis: int) -> bool:
    """Whether the torque on an axis changes its form with the direction of motion."""
    return p[P.axis_kind + axis] == DYNAMIC and (
        p[P.breakaway_friction + axis] > 0.0
        or p[P.load_friction + axis] > 0.0
        or p[P.bristle_torque + axis] > 0.0
        or p[P.viscous_asymmetry + axis] != 0.0
        or feels_both_sides(p, axis)
    )


@bare
def feels_both_sides(p: Array, axis: int) -> bool:
    """Whether friction depends on the load of an axis by more than one coefficient."""
    return p[P.both_sides + axis] != 0.0


@bare
def _gear_friction(p: Array, axis: int, speed: float, load: float, counter: float) -> float:
    """Friction [N m] at a speed >= 0 from the torques `load` and `counter` [N m]."""
    sliding = abs(p[P.load_friction + axis] * load - p[P.counter_friction + axis] * counter)
    standing = abs(p[P.load_stribeck + axis] * load - p[P.counter_stribeck + axis] * counter)
    if load * counter < 0.0:
        least = min(abs(load), abs(counter))
        standing += p[P.load_quadratic + axis] * least * least
    ratio = speed / p[P.load_velocity + axis]
    return sliding + standing * exp(-ratio * ratio)


@inlined
def _load_friction(p: Array, axis: int, speed: float, load: float, counter: float) -> float:
    """The same, quick where only the load counts."""
    if feels_both_sides(p, axis):
        return _gear_friction(p, axis, speed, load, counter)
    return p[P.load_friction + axis] * abs(load)


@bare
def dry_friction(p: Array, axis: int, direction: int, speed: float, load: float, counter: float) -> float:
    """Magnitude [N m] of the friction on an axis that slips in `direction` with speed >= 0 under a load [N m]."""
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
    """Torque [N m] in `direction` up to which an axis stays stuck under a load [N m]."""
    dry = p[P.breakaway_friction + axis] + direction * p[P.friction_asymmetry + axis]
    return dry + _load_friction(p, axis, 0.0, load, counter)
