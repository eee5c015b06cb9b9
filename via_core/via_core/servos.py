"""Position servo: the motor angle follows its command as a critically damped second-order lag.

    x'' = w^2 (u - x) - 2 w x'

For a constant command u the error e = x - u obeys e'' + 2 w e' + w^2 e = 0, with solution e(t) = (a + b t) exp(-w t),
a = e(0), b = e'(0) + w e(0). `servo_step` evaluates it: exact and stable for any dt.
Source: servo model of the MACCEPA-VD robot, w = 25 rad/s.
"""

from math import exp, isfinite

from numba import njit


@njit(cache=True, error_model="numpy", inline="always")
def servo_step(x: float, v: float, u: float, w: float, dt: float) -> tuple[float, float]:
    """Angle [rad] and velocity [rad/s] after dt [s], for bandwidth w [rad/s] and constant command u [rad]."""
    decay = exp(-w * dt)
    e = x - u
    b = v + w * e
    return u + (e + b * dt) * decay, (v - w * b * dt) * decay


@njit(cache=True, error_model="numpy", inline="always")
def servo_acceleration(x: float, v: float, u: float, w: float) -> float:
    """x'' [rad/s^2] of the servo, as the right-hand side of an integrator."""
    return w * w * (u - x) - 2.0 * w * v


@njit(cache=True, error_model="numpy", inline="always")
def limited_step(x: float, v: float, u: float, w: float, limit: float, dt: float) -> tuple[float, float]:
    """`servo_step` of a servo whose speed is at most `limit` [rad/s]; a command u that is not finite leaves it at x."""
    new, speed = servo_step(x, v, u if isfinite(u) else x, w, dt)
    reach = limit * dt
    return x + min(max(new - x, -reach), reach), min(max(speed, -limit), limit)
