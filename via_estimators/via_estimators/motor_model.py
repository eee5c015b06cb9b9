"""Process model of the Kalman filters: one motor behind a spring, its parameters among the states.

    B thdd + D thd + F s(thd) - tau_e(q - theta) = tau,    s(v) = v / sqrt(v^2 + v_s^2)

The state x (n,) is X followed by the coefficients of `spring_series`: angle theta, velocity v, and the parameters, all
divided by the inertia in units of its prior B_0, that is B_0/B, D B_0/B, F B_0/B and a B_0/B. In these the acceleration
is linear, so that a filter of the first order loses little:

    B_0 vd = x_B tau + tau_e(q - theta; x_a) - x_F s(v) - x_D v

Time step: damping may be fast (D/B up to 12700 1/s at 1 kHz) and is integrated exactly, dry friction with it as the
damper x_F / sqrt(v^2 + v_s^2). Its v and the other torques are those in the middle of the step, which a half step
finds. This is the exponential midpoint rule, S. M. Cox and P. C.
Matthews, Exponential time differencing for stiff systems, J. Comput. Phys. 176, 2002, eq. (22) with its second stage
in the middle. With z = h rate, acceleration g of the other torques and phi_1(z) = (1 - e^-z)/z, phi_2 = (1 - phi_1)/z,

    theta+ = theta + h phi_1 v + h^2 phi_2 g,    v+ = e^-z v + h phi_1 g        first h = T/2, g at the start;
                                                                                 then h = T, g in the middle

A negative x_D or x_F, which an uncertain estimate may be, counts as one of the other torques: no exponential grows.

Input: tau is constant over the interval that ends at the stamp; q is interpolated between its two measurements.
"""

from __future__ import annotations

from math import exp, sqrt

from numba import njit
from via_core.signals import Array

from via_estimators.slots import slots
from via_estimators.spring_series import power

X = slots("angle", "velocity", "inverse_inertia", "damping", "friction")
MODEL = slots("order", "deflection_scale", "inertia", "friction_velocity")  # of a motor; B_0
INPUT = slots("step", "q", "next_q", "torque")  # of a time step: T [s], q at both ends [rad], tau [N m]
# Of half a step and of a whole one: e^-z, h phi_1, h^2 phi_2 and their derivatives by the damping rate.
FACTORS = slots("keep", "first", "second", "keep_slope", "first_slope", "second_slope")
_SMALL, _SERIES = 0.5, 10  # z below which phi_3 is summed, and the number of terms


@njit(cache=True, error_model="numpy")
def factors(rate: float, h: float, out: Array) -> None:
    """FACTORS for the damping rate [1/s] and a step h [s] into out (6,).

    From phi_k = 1/k! - z phi_(k+1), phi_1' = phi_2 - phi_1 and phi_2' = 2 phi_3 - phi_2, with phi_3 as a series where
    the differences would cancel.
    """
    z = rate * h
    if z < _SMALL:
        third, term = 0.0, 1.0 / 6.0
        for k in range(_SERIES):
            third += term
            term *= -z / (k + 4)
        second = 0.5 - z * third
        first = 1.0 - z * second
        keep = 1.0 - z * first
    else:
        keep = exp(-z)
        first = (1.0 - keep) / z
        second = (1.0 - first) / z
        third = (0.5 - second) / z
    out[FACTORS.keep], out[FACTORS.first], out[FACTORS.second] = keep, h * first, h * h * second
    out[FACTORS.keep_slope] = -h * keep
    out[FACTORS.first_slope] = h * h * (second - first)
    out[FACTORS.second_slope] = h * h * h * (2.0 * third - second)


@njit(cache=True, error_model="numpy")
def spring(model: Array, x: Array, phi: float, f: Array, g: Array) -> tuple[float, float]:
    """Torque [N m] and stiffness [N m/rad] at phi [rad], both times B_0/B.

    f [rad], g [-]  (n - X.size,) of each term, overwritten
    """
    order, scale = int(model[MODEL.order]), model[MODEL.deflection_scale]
    z, torque, stiffness = phi / scale, 0.0, 0.0
    odd, even = 1.0, 1.0
    for j in range(f.size):
        p = power(j, order)
        if j < order:
            g[j] = odd
            odd *= z * z
        elif p == 0:
            g[j] = 0.0
        else:
            g[j] = even * z
            even *= z * z
        f[j] = scale * z * g[j] / p if p > 0 else scale
        torque += x[X.size + j] * f[j]
        stiffness += x[X.size + j] * g[j]
    return torque, stiffness


@njit(cache=True, error_model="numpy")
def bend(model: Array, x: Array, phi: float) -> float:
    """Derivative of the stiffness by phi [N m/rad^2], times B_0/B."""
    order, scale, total = int(model[MODEL.order]), model[MODEL.deflection_scale], 0.0
    for j in range(x.size - X.size):
        p = power(j, order)
        if p > 1:
            total += x[X.size + j] * (p - 1) * (phi / scale) ** (p - 2) / scale
    return total


@njit(cache=True, error_model="numpy", forceinline=True)
def _size(model: Array, v: float) -> float:
    """sqrt(v^2 + v_s^2) [rad/s]."""
    return sqrt(v * v + model[MODEL.friction_velocity] ** 2)


@njit(cache=True, error_model="numpy", forceinline=True)
def damping_rate(model: Array, x: Array, v: float) -> float:
    """Rate [1/s] of the exponentials: damping, and dry friction as a damper of F / sqrt(v^2 + v_s^2)."""
    dry = max(x[X.friction], 0.0) / _size(model, v)
    return (max(x[X.damping], 0.0) + dry) / model[MODEL.inertia]


@njit(cache=True, error_model="numpy", forceinline=True)
def _acceleration(model: Array, x: Array, torque: float, of_spring: float, v: float) -> float:
    """Acceleration [rad/s^2] without damping and dry friction, unless they are negative."""
    other = min(x[X.friction], 0.0) * v / _size(model, v) + min(x[X.damping], 0.0) * v
    return (x[X.inverse_inertia] * torque + of_spring - other) / model[MODEL.inertia]


@njit(cache=True, error_model="numpy")
def advance(model: Array, x: Array, given: Array, work: Array) -> tuple[float, float]:
    """Angle and velocity after the time step `given` (INPUT) from x (n,); work (4, n) is overwritten."""
    half, whole, f, g = work[0], work[1], work[2, : x.size - X.size], work[3, : x.size - X.size]
    theta, v, T, torque = x[X.angle], x[X.velocity], given[INPUT.step], given[INPUT.torque]
    factors(damping_rate(model, x, v), 0.5 * T, half)
    a = _acceleration(model, x, torque, spring(model, x, given[INPUT.q] - theta, f, g)[0], v)
    middle, w = _moved(half, theta, v, a)
    factors(damping_rate(model, x, w), T, whole)
    phi = 0.5 * (given[INPUT.q] + given[INPUT.next_q]) - middle
    a = _acceleration(model, x, torque, spring(model, x, phi, f, g)[0], w)
    return _moved(whole, theta, v, a)


@njit(cache=True, error_model="numpy", forceinline=True)
def _moved(of: Array, theta: float, v: float, a: float) -> tuple[float, float]:
    """Angle and velocity at constant acceleration `a` without damping, by the FACTORS."""
    return theta + of[FACTORS.first] * v + of[FACTORS.second] * a, of[FACTORS.keep] * v + of[FACTORS.first] * a


@njit(cache=True, error_model="numpy")
def derivatives(model: Array, x: Array, given: Array, work: Array, jacobian: Array) -> tuple[float, float]:
    """`advance` with its derivatives by x into jacobian (2, n): rows of angle and velocity."""
    half, whole, f, g = work[0], work[1], work[2, : x.size - X.size], work[3, : x.size - X.size]
    theta, v, T, torque = x[X.angle], x[X.velocity], given[INPUT.step], given[INPUT.torque]
    factors(damping_rate(model, x, v), 0.5 * T, half)
    of_spring, stiffness = spring(model, x, given[INPUT.q] - theta, f, g)
    a = _acceleration(model, x, torque, of_spring, v)
    middle, w = _moved(half, theta, v, a)
    factors(damping_rate(model, x, w), T, whole)
    jacobian[:, :] = 0.0
    jacobian[0, X.angle] = jacobian[1, X.velocity] = 1.0
    _chain(model, x, torque, stiffness, v, f, jacobian)
    _spread(model, x, half, v, a, v, jacobian)
    of_spring, stiffness = spring(model, x, 0.5 * (given[INPUT.q] + given[INPUT.next_q]) - middle, f, g)
    a = _acceleration(model, x, torque, of_spring, w)
    _chain(model, x, torque, stiffness, w, f, jacobian)
    _spread(model, x, whole, v, a, w, jacobian)
    return _moved(whole, theta, v, a)


@njit(cache=True, error_model="numpy", forceinline=True)
def _chain(model: Array, x: Array, torque: float, stiffness: float, v: float, f: Array, jacobian: Array) -> None:
    """From the derivatives (2, n) of angle and velocity to that of `_acceleration` at them, into the first row."""
    inertia, size = model[MODEL.inertia], _size(model, v)
    by_velocity = min(x[X.friction], 0.0) * model[MODEL.friction_velocity] ** 2 / size**3 + min(x[X.damping], 0.0)
    for j in range(x.size):
        slope = -stiffness * jacobian[0, j] - by_velocity * jacobian[1, j]
        if j >= X.size:
            slope += f[j - X.size]
        jacobian[0, j] = slope / inertia
    jacobian[0, X.inverse_inertia] += torque / inertia
    jacobian[0, X.friction] -= v / size / inertia if x[X.friction] < 0.0 else 0.0
    jacobian[0, X.damping] -= v / inertia if x[X.damping] < 0.0 else 0.0


@njit(cache=True, error_model="numpy", forceinline=True)
def _spread(model: Array, x: Array, of: Array, v: float, a: float, speed: float, jacobian: Array) -> None:
    """From the derivatives (2, n) of the acceleration, and of the speed of `damping_rate`, to those of `_moved`."""
    size, inertia = _size(model, speed), model[MODEL.inertia]
    by_rate = (of[FACTORS.first_slope] * v + of[FACTORS.second_slope] * a) / inertia
    w_by_rate = (of[FACTORS.keep_slope] * v + of[FACTORS.first_slope] * a) / inertia
    by_speed = -max(x[X.friction], 0.0) * speed / size**3
    for j in range(x.size):
        slope, of_rate = jacobian[0, j], by_speed * jacobian[1, j]
        if j == X.damping and x[j] >= 0.0:
            of_rate += 1.0
        elif j == X.friction and x[j] >= 0.0:
            of_rate += 1.0 / size
        jacobian[0, j] = of[FACTORS.second] * slope + by_rate * of_rate
        jacobian[1, j] = of[FACTORS.first] * slope + w_by_rate * of_rate
    jacobian[0, X.angle] += 1.0
    jacobian[0, X.velocity] += of[FACTORS.first]
    jacobian[1, X.velocity] += of[FACTORS.keep]


@njit(cache=True, error_model="numpy")
def noise(
    model: Array, x: Array, P: Array, given: Array, torque_noise: float, position_noise: float, work: Array
) -> float:  # fmt: skip
    """Variance of the acceleration [(rad/s^2)^2] in the time step from x, P: noise of torque and q, products of errors.

    Products are what the first order leaves out, and they are not small before parameters are known: of stiffness and
    deflection in the middle of the step, damping and velocity, friction and the velocity's sign. The product of
    independent errors has the product of their variances (the second-order term of a bilinear function, Gelb 1974,
    Section 6.1).
    """
    f, g, half = work[2, : x.size - X.size], work[3, : x.size - X.size], 0.5 * given[INPUT.step]
    stiffness = spring(model, x, given[INPUT.q] - x[X.angle], f, g)[1]
    of_stiffness, blur, square = 0.0, position_noise * position_noise, model[MODEL.friction_velocity] ** 2
    for j in range(g.size):
        for k in range(g.size):
            of_stiffness += g[j] * P[X.size + j, X.size + k] * g[k]
    of_velocity = P[X.velocity, X.velocity]
    of_angle = P[X.angle, X.angle] + half * (2.0 * P[X.angle, X.velocity] + half * of_velocity)
    of_sign = min(of_velocity * square * square / (x[X.velocity] ** 2 + square) ** 3, 1.0)
    return (
        (x[X.inverse_inertia] ** 2 + P[X.inverse_inertia, X.inverse_inertia]) * torque_noise * torque_noise
        + stiffness * stiffness * blur
        + max(of_stiffness, 0.0) * (blur + of_angle)
        + P[X.damping, X.damping] * of_velocity
        + P[X.friction, X.friction] * of_sign
    ) / model[MODEL.inertia] ** 2


@njit(cache=True, error_model="numpy")
def add_noise(model: Array, x: Array, step: float, variance: float, work: Array, P: Array) -> None:
    """Add to P (n, n) an acceleration of that variance, constant over the time step [s]; work (4, n) is overwritten."""
    factors(damping_rate(model, x, x[X.velocity]), step, work[0])
    angle, velocity = work[0, FACTORS.second], work[0, FACTORS.first]
    P[X.angle, X.angle] += variance * angle * angle
    P[X.angle, X.velocity] += variance * angle * velocity
    P[X.velocity, X.angle] += variance * angle * velocity
    P[X.velocity, X.velocity] += variance * velocity * velocity


@njit(cache=True, error_model="numpy")
def drift(x: Array, P: Array, elapsed: float, spring_change: float, motor_change: float, widths: Array) -> None:
    """Add the random walk of the parameters over `elapsed` [s] to P: of the spring law's scale, B, D and F.

    spring_change, motor_change  relative, after 1 s [1/sqrt(s)]
    widths                       (n,) prior standard deviations; a parameter as uncertain as before any data stays so
    """
    walk, own = spring_change**2 * elapsed, motor_change**2 * elapsed
    for j in range(X.inverse_inertia, X.size):
        if P[j, j] < widths[j] ** 2:
            P[j, j] += own * x[j] * x[j]
    for j in range(X.size, x.size):
        if P[j, j] >= widths[j] ** 2:
            return
    for j in range(X.size, x.size):
        for k in range(X.size, x.size):
            P[j, k] += walk * x[j] * x[k]
