"""Torques of one joint, compiled; the simulator integrates them, and the equations of a log contain them.

Equations (notation.md), for the axes link (M, q), motor 1 and motor 2 (B_i, theta_i), phi_i = q - theta_i:

    M qdd     + (Dq + d) qd + F_q    = tau_ext - sum_i tau_e,i(phi_i) - g(q) + effects
    B_i thdd_i + Dth_i thd_i + F_i   = tau_i + tau_e,i(phi_i) + effects

**Set-valued friction, no smoothed signs.** Within a step each axis with friction slips in one direction or sticks (zero
acceleration, friction balances all torque). Each transmission is within its gap or on one flank, its Maxwell element
sticks or slips, the wall is touched or not. The right-hand side is therefore smooth. `modes` stores these cases,
`find_modes` determines them from a state, and `violation` measures how far a state is outside of them.

**Memory is a function of travel.** Dahl's bristle dF/dx = s (1 - F sgn(v)/F_c) and the Maxwell slip element depend on
travel and not on speed. Within a mode both are closed forms of the travel since the beginning of the step. The
simulator (stages of a step) and the equations (encoder samples, never differentiated) share them without an integrator.
Sources: Dahl, A solid friction model, Aerospace Corp. TOR-0158 (1968); Piiroinen, Kuznetsov, An event-driven method to
simulate Filippov systems, ACM TOMS 34 (2008).
"""

from __future__ import annotations

from math import copysign, inf, sin
from typing import Any

from via_core.signals import Array
from via_core.spring_equations import (
    N_COEFFICIENTS,
    ODD_POLYNOMIAL,
    odd_polynomial,
    polynomial_slope,
    spring_stiffness,
    spring_torque,
)

from via_sim.joint.compiled import bare, inlined
from via_sim.joint.friction import breakaway, bristle_torque, dry_friction, feels_both_sides, has_friction
from via_sim.joint.layout import DAMPING, EXTERNAL, M1, M2, MODE, SMOOTH, STUCK, U, X
from via_sim.joint.parameters import AT_TRANSMISSION, POSITION_DRIVE, TORQUE_DRIVE, P
from via_sim.joint.position_drive import drive_torque
from via_sim.joint.structure import EVERYTHING
from via_sim.joint.terms import axis_torque, count_terms, input_error


@bare
def prepare(p: Array, modes: Array) -> None:
    """Set the entries of modes (N_MODES,) that are constant for a parameter row."""
    for i in range(3):
        modes[MODE.rare + i] = count_terms(p, modes, i) or p[P.bristle_torque + i] > 0.0
        modes[MODE.dry + i] = has_friction(p, i)
    paired = p[P.contact_stiffness] > 0.0
    for i in range(2):
        paired |= p[P.hysteresis_torque + i] > 0.0 or p[P.spring_damping + i] != 0.0
        modes[MODE.coefficients + i] = N_COEFFICIENTS
        while (
            p[P.spring_kind + i] == ODD_POLYNOMIAL
            and modes[MODE.coefficients + i] > 1
            and p[P.spring + i * N_COEFFICIENTS + modes[MODE.coefficients + i] - 1] == 0.0
        ):
            modes[MODE.coefficients + i] -= 1
    modes[MODE.paired], modes[MODE.lags] = paired, p[P.lag] > 0.0 or p[P.drive_speed_limit] < inf


@inlined
def deflection(p: Array, has: Any, i: int, q: float, motor: float) -> float:
    """Deflection phi_i [rad] of spring i."""
    phi = q - motor
    if has.adjusted is not None and p[P.serial] == 0.0:
        phi -= p[P.pretension_offset + i]
    if has.rest is not None and p[P.input_errors + i] != 0.0:
        phi -= input_error(p, 1 + i, motor)[0]
    return phi


@inlined
def on_motor(p: Array, has: Any, i: int, motor: float, torque: float) -> float:
    """Torque [N m] of spring i on its motor, by virtual work with an error at the input of the transmission."""
    if has.rest is not None and p[P.input_errors + i] != 0.0:
        return torque * (1.0 + input_error(p, 1 + i, motor)[1])
    return torque


@inlined
def preset_of(p: Array, i: int, m1: float, m2: float) -> float:
    """Motor angle [rad] that is the second argument of spring law i."""
    return (m2 if p[P.serial] != 0.0 or i == 1 else m1) + p[P.pretension_offset + i]


@bare
def spring_factor(p: Array, i: int, age: float) -> float:
    """Torque of spring i relative to its spring law [-] at the age `age` [s] of the run."""
    return p[P.spring_scale + i] * max(1.0 + p[P.stiffness_rate + i] * age, 0.0)


@bare
def _hardened(hardening: float, phi: float, stop: float) -> float:
    """Torque relative to the spring law; beyond the stop never negative: a softened spring is slack there."""
    share = 1.0 + hardening * phi * phi
    return share if abs(phi) <= stop else max(share, 0.0)


@inlined
def transmission_torque(
    p: Array, has: Any, modes: Array, i: int, phi: float, preset: float, flank: int, factor: float
) -> float:  # fmt: skip
    """tau_e,i [N m] at deflection phi; `flank` is 0 inside the backlash gap, else its side -1 or +1."""
    if has.rest is not None:
        gap = p[P.backlash + i]
        if gap > 0.0:
            if flank == 0:
                return 0.0
            phi -= flank * 0.5 * gap
        if p[P.spring_hardening + i] != 0.0:
            factor *= _hardened(p[P.spring_hardening + i], phi, p[P.stop + i])
    torque = spring_law(p, has, modes[MODE.coefficients + i], i, phi, preset)
    return torque if has.adjusted is None else factor * torque


@inlined
def spring_law(p: Array, has: Any, count: int, i: int, phi: float, preset: float) -> float:
    """Spring law i at phi [rad]; beyond the stop its tangent, because it may overflow or end there."""
    stop = p[P.stop + i] if has.rest is not None else has.stops[i]
    inside = 0.0  # of a polynomial, computed once for a step and the measurement before it
    if has.curves is None:
        inside = odd_polynomial(has.polynomials[i], phi)
    if abs(phi) > stop:
        edge = copysign(stop, phi)
        slope = max(_law_stiffness(p, has, count, i, edge, preset), 0.0)
        return _law_torque(p, has, count, i, edge, preset) + slope * (phi - edge)
    return inside if has.curves is None else _law_torque(p, has, count, i, phi, preset)


@inlined
def _law_torque(p: Array, has: Any, count: int, i: int, phi: float, preset: float) -> float:
    """Torque [N m] of spring law i."""
    if has.curves is None:
        return odd_polynomial(has.polynomials[i], phi)
    kind, first = int(p[P.spring_kind + i]), P.spring + i * N_COEFFICIENTS
    if kind == ODD_POLYNOMIAL:
        return odd_polynomial(p[first : first + count], phi)
    return spring_torque(kind, p[first : first + N_COEFFICIENTS], phi, preset)


@inlined
def _law_stiffness(p: Array, has: Any, count: int, i: int, phi: float, preset: float) -> float:
    """Stiffness [N m/rad] of spring law i."""
    if has.curves is None:
        return polynomial_slope(has.polynomials[i], phi)
    kind, first = int(p[P.spring_kind + i]), P.spring + i * N_COEFFICIENTS
    if kind == ODD_POLYNOMIAL:
        return polynomial_slope(p[first : first + count], phi)
    return spring_stiffness(kind, p[first : first + N_COEFFICIENTS], phi, preset)


@inlined
def transmission_stiffness(
    p: Array, has: Any, modes: Array, i: int, phi: float, preset: float, factor: float
) -> float:  # fmt: skip
    """Stiffness sigma_i [N m/rad] at deflection phi."""
    if has.rest is not None and p[P.backlash + i] > 0.0:
        gap = p[P.backlash + i]
        if abs(phi) < 0.5 * gap:
            return 0.0
        phi -= copysign(0.5 * gap, phi)
    stop, count = p[P.stop + i], modes[MODE.coefficients + i]
    edge = copysign(stop, phi) if abs(phi) > stop else phi
    slope = _law_stiffness(p, has, count, i, edge, preset)
    if abs(phi) > stop:
        slope = max(slope, 0.0)
    hardening = p[P.spring_hardening + i]
    if has.rest is not None and hardening != 0.0:
        share = _hardened(hardening, phi, stop)
        if share == 0.0:
            return 0.0
        torque = _law_torque(p, has, count, i, edge, preset) + slope * (phi - edge)
        return factor * (slope * share + 2.0 * hardening * phi * torque)
    return factor * slope


@bare
def maxwell_torque(p: Array, i: int, slip: int, held: float, travel: float) -> float:
    """Torque [N m] of the Maxwell element parallel to spring i after `travel` [rad], starting at `held` [N m]."""
    if slip != 0:
        return slip * p[P.hysteresis_torque + i]
    return held + p[P.hysteresis_stiffness + i] * travel


@bare
def contact_torque(p: Array, q: float, w: float) -> float:
    """Torque [N m] of the wall on a link that touches it: spring and damper, never pulling."""
    side = p[P.contact_side]
    push = p[P.contact_stiffness] * side * (q - p[P.contact_angle]) + p[P.contact_damping] * side * w
    return -side * max(push, 0.0)


@inlined
def _rare_torque(p: Array, modes: Array, x: Array, axis: int, angle: float, speed: float) -> float:
    """Rare torques [N m] of one axis: terms of the catalogue, and the bristle."""
    torque = axis_torque(p, modes, axis, angle, speed)
    if p[P.bristle_torque + axis] > 0.0:
        torque -= bristle_torque(p, axis, modes[axis], x[X.bristle + axis], angle - x[axis])
    return torque


@inlined
def motive_torques(
    p: Array, has: Any, modes: Array, u: Array, x: Array,
    q: float, m1: float, m2: float, w: float, w1: float, w2: float,
) -> tuple[float, float, float, float, float, float]:  # fmt: skip
    """Torque [N m] on link, motor 1 and motor 2 without their own friction; then the loads on them, see friction.py.

    x is the state at the beginning of the step, with its elements with memory; angles q, m1, m2 [rad] and velocities
    w, w1, w2 [rad/s] are those of the stage.
    """
    link, first, second = u[EXTERNAL], u[M1], u[M2]
    load, load1, load2 = link - u[U.beside], 0.0, 0.0
    if has.rest is not None and p[P.link_drive] == POSITION_DRIVE:
        load = drive_torque(p, u[U.acting], u[U.held], u[U.on], q, w)
        link, load = link + load, load - u[U.on] * p[P.drive_damping] * w
    if has.gravity is not None and p[P.gravity_torque] != 0.0:
        link -= p[P.gravity_torque] * sin(q - p[P.gravity_angle])
    if has.spring is not None and (has.rest is None or p[P.transmissions] > 0.0):
        phi, preset = deflection(p, has, 0, q, m1), preset_of(p, 0, m1, m2)
        torque = transmission_torque(p, has, modes, 0, phi, preset, modes[MODE.flank], u[U.spring])
        link -= torque
        load, load1 = -torque, on_motor(p, has, 0, m1, torque)
        first += load1
    if has.second is not None and (has.rest is None or p[P.transmissions] > 1.0):
        phi, preset = deflection(p, has, 1, q, m2), preset_of(p, 1, m1, m2)
        torque = transmission_torque(p, has, modes, 1, phi, preset, modes[MODE.flank + 1], u[U.spring + 1])
        link -= torque
        load, load2 = load - torque, on_motor(p, has, 1, m2, torque)
        second += load2
    if has.damper is not None and p[P.damper_site] == AT_TRANSMISSION:
        # at transmission 1; the diagonal part is in `viscous_rate`
        link += u[DAMPING] * w1
        first += u[DAMPING] * w
    if has.rest is not None:
        if modes[MODE.rare] != 0:
            link += _rare_torque(p, modes, x, 0, q, w)
        if modes[MODE.rare + 1] != 0:
            first += _rare_torque(p, modes, x, 1, m1, w1)
        if modes[MODE.rare + 2] != 0:
            second += _rare_torque(p, modes, x, 2, m2, w2)
    if has.rest is not None and modes[MODE.paired] != 0:
        if modes[MODE.touch] != 0:
            link += contact_torque(p, q, w)
        d1, d2 = p[P.spring_damping], p[P.spring_damping + 1]
        h1 = h2 = 0.0
        if p[P.hysteresis_torque] > 0.0:
            h1 = maxwell_torque(p, 0, modes[MODE.slip], x[X.hysteresis], (q - m1) - (x[0] - x[1]))
        if p[P.hysteresis_torque + 1] > 0.0:
            h2 = maxwell_torque(p, 1, modes[MODE.slip + 1], x[X.hysteresis + 1], (q - m2) - (x[0] - x[2]))
        link += d1 * w1 + d2 * w2 - h1 - h2  # only the coupling part of the dampers, as above
        first += d1 * w + h1
        second += d2 * w + h2
    return link, first, second, load, load1, load2


@bare
def counter_torque(p: Array, modes: Array, u: Array, axis: int, q: float, w: float) -> float:
    """Counter torque [N m] on an axis, see friction.py; 0 where its friction does not depend on it.

    q [rad] and w [rad/s] are angle and velocity of the link.
    """
    if not feels_both_sides(p, axis):
        return 0.0
    if axis > 0:
        return u[axis - 1] - u[U.beside + axis]
    torque = u[U.beside] if p[P.link_drive] == TORQUE_DRIVE else u[EXTERNAL]
    if p[P.gravity_torque] != 0.0:
        torque -= p[P.gravity_torque] * sin(q - p[P.gravity_angle])
    if modes[MODE.touch] != 0:
        torque += contact_torque(p, q, w)
    return torque


@bare
def find_modes(p: Array, x: Array, u: Array, modes: Array) -> None:
    """Modes of state x into modes (N_MODES,), after `prepare`."""
    modes[MODE.switches] = 0
    for i in range(2):
        half = 0.5 * p[P.backlash + i]
        if half > 0.0:
            phi = deflection(p, EVERYTHING, i, x[0], x[1 + i])
            modes[MODE.flank + i] = 0 if abs(phi) < half else (1 if phi > 0.0 else -1)
            modes[MODE.switches] = 1
    for i in range(2):
        level, held = p[P.hysteresis_torque + i], x[X.hysteresis + i]
        if level > 0.0:
            slips = abs(held) >= level and held * (x[3] - x[4 + i]) > 0.0
            modes[MODE.slip + i] = (1 if held > 0.0 else -1) if slips else 0
            modes[MODE.switches] = 1
    if p[P.contact_stiffness] > 0.0:
        depth = p[P.contact_side] * (x[0] - p[P.contact_angle])
        modes[MODE.touch] = depth > 0.0 or (depth == 0.0 and p[P.contact_side] * x[3] > 0.0)
        modes[MODE.switches] = 1
    for i in range(3):
        modes[i] = SMOOTH
        if modes[MODE.dry + i] != 0:
            modes[i] = STUCK
            modes[MODE.switches] = 1
    if modes[MODE.switches] != 0:
        t = motive_torques(p, EVERYTHING, modes, u, x, x[0], x[1], x[2], x[3], x[4], x[5])
        for i in range(3):
            if modes[i] != SMOOTH:
                if x[3 + i] != 0.0:
                    modes[i] = 1 if x[3 + i] > 0.0 else -1
                    continue
                counter = 0.0
                if feels_both_sides(p, i):
                    counter = counter_torque(p, modes, u, i, x[0], x[3])
                if t[i] > breakaway(p, i, 1, t[3 + i], counter):
                    modes[i] = 1
                elif -t[i] > breakaway(p, i, -1, t[3 + i], counter):
                    modes[i] = -1


@inlined
def _driven(
    p: Array, modes: Array, u: Array, axis: int, torque: float, speed: float, load: float, q: float, w: float
) -> float:
    """Torque [N m] on an axis with dry friction in its mode; q, w: angle and velocity of the link."""
    mode = modes[axis]
    if mode == STUCK:
        return 0.0
    if mode != SMOOTH:
        counter = 0.0
        if feels_both_sides(p, axis):
            counter = counter_torque(p, modes, u, axis, q, w)
        torque -= mode * dry_friction(p, axis, mode, mode * speed, load, counter)
    return torque


@bare
def forced(
    p: Array, modes: Array, u: Array, x: Array,
    q: float, m1: float, m2: float, w: float, w1: float, w2: float,
) -> tuple[float, float, float]:  # fmt: skip
    """Torque [N m] on each axis without its viscous friction, which the exponential integrator covers."""
    t0, t1, t2, l0, l1, l2 = motive_torques(p, EVERYTHING, modes, u, x, q, m1, m2, w, w1, w2)
    return (
        _driven(p, modes, u, 0, t0, w, l0, q, w),
        _driven(p, modes, u, 1, t1, w1, l1, q, w),
        _driven(p, modes, u, 2, t2, w2, l2, q, w),
    )


@bare
def violation(p: Array, x: Array, y: Array, u: Array, modes: Array) -> float:
    """Violation of the modes by state y, reached from x: > 0 outside; continuous in y."""
    worst = -inf
    t = motive_torques(p, EVERYTHING, modes, u, x, y[0], y[1], y[2], y[3], y[4], y[5])
    for i in range(3):
        if modes[i] == STUCK:
            load, counter = t[3 + i], 0.0
            if feels_both_sides(p, i):
                counter = counter_torque(p, modes, u, i, y[0], y[3])
            worst = max(worst, t[i] - breakaway(p, i, 1, load, counter), -t[i] - breakaway(p, i, -1, load, counter))
        elif modes[i] != SMOOTH:
            worst = max(worst, -modes[i] * y[3 + i])
    for i in range(2):
        half = 0.5 * p[P.backlash + i]
        if half > 0.0:
            phi, flank = deflection(p, EVERYTHING, i, y[0], y[1 + i]), modes[MODE.flank + i]
            worst = max(worst, abs(phi) - half if flank == 0 else half - flank * phi)
    if modes[MODE.paired] != 0:
        for i in range(2):
            level, slip = p[P.hysteresis_torque + i], modes[MODE.slip + i]
            if level > 0.0:
                travel = (y[0] - y[1 + i]) - (x[0] - x[1 + i])
                stretched = abs(maxwell_torque(p, i, slip, x[X.hysteresis + i], travel)) - level
                worst = max(worst, stretched if slip == 0 else -slip * (y[3] - y[4 + i]))
        if p[P.contact_stiffness] > 0.0:
            depth = p[P.contact_side] * (y[0] - p[P.contact_angle])
            worst = max(worst, -depth if modes[MODE.touch] != 0 else depth)
    return worst


@bare
def remember(p: Array, modes: Array, x: Array, y: Array) -> None:
    """Advance the elements with memory in x from the angles of x to those of y (>= 3,)."""
    for i in range(3):
        if p[P.bristle_torque + i] > 0.0:
            x[X.bristle + i] = bristle_torque(p, i, modes[i], x[X.bristle + i], y[i] - x[i])
    for i in range(2):
        level = p[P.hysteresis_torque + i]
        if level > 0.0:
            travel = (y[0] - y[1 + i]) - (x[0] - x[1 + i])
            held = maxwell_torque(p, i, modes[MODE.slip + i], x[X.hysteresis + i], travel)
            x[X.hysteresis + i] = min(max(held, -level), level)
