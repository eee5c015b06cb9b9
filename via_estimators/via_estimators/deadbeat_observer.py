"""A delayed unknown-input observer of a motor: the torque that acts on it besides its own, in finitely many steps.

Part of `unknown_input_observer`, which names the source. Over one window the input is w + v (t - middle), and the state
(theta, omega) obeys

    B omega' + D omega = tau + w + v (t - middle),   tau held over the interval that ends at its stamp

Four samples determine theta, omega, w and v whatever the initial error: as many as the model with its input has
states. A window has many more, and least squares over all of them are the deadbeat observer with the least noise. Rows
enter one by one by Givens rotations, with exact transitions on any stamps; the delay is half a window.

Several signals pass at once: the angle, the torque, and functions of time as if each of them drove the motor.
"""

from __future__ import annotations

from math import exp, expm1, sqrt

from numba import njit
from via_core.signals import Array

from via_estimators.slots import slots

STEPS = 4  # order of the model: theta, omega, w, v
OWN = 2  # signals before the functions: angle, torque
# Variance of w and v due to torque noise over that of the plain mean and slope of the torques, for a motor without
# damping, the worst case: angles weigh the torque by (1 - u^2)^2 and u (1 - u^2)^2, -1 < u < 1.
OVER_MEAN, OVER_SLOPE = 10.0 / 7.0, 70.0 / 33.0
# Of the present window: samples, time since its start [s], first angle, angle in its middle, last one, range of the
# angle; range of phi.
NOW = slots("count", "age", "first", "middle", "last", "lowest", "highest", "low", "high")


@njit(cache=True, error_model="numpy")
def size(functions: int) -> int:
    """Numbers in the state of one observer."""
    signals = OWN + functions
    return NOW.size + 2 * signals + functions + STEPS * (STEPS + signals)


@njit(cache=True, error_model="numpy")
def views(state: Array, functions: int) -> tuple[Array, Array, Array, Array]:
    """NOW, responses (2, signals) of angle and velocity, last values of the functions, triangle (4, 4 + signals)."""
    signals = OWN + functions
    last = NOW.size + 2 * signals
    triangle = last + functions
    return (
        state[: NOW.size],
        state[NOW.size : last].reshape(2, signals),
        state[last:triangle],
        state[triangle : triangle + STEPS * (STEPS + signals)].reshape(STEPS, STEPS + signals),
    )


@njit(cache=True, error_model="numpy")
def transition(damping: float, h: float) -> tuple[float, float, float, float]:
    """exp(-x), phi_1, phi_2, phi_3 for x = damping h: angles after h of a velocity, a unit force and its unit slope.

    damping  D/B [1/s]

    phi_1 = (1 - exp(-x)) / damping, phi_(k+1) = (h^k / k! - phi_k) / damping; a series where x is small.
    """
    x = damping * h
    if x > 0.1:
        one = -expm1(-x) / damping
        two = (h - one) / damping
        return exp(-x), one, two, (0.5 * h * h - two) / damping
    one = h * (1.0 - x / 2.0 * (1.0 - x / 3.0 * (1.0 - x / 4.0 * (1.0 - x / 5.0 * (1.0 - x / 6.0 * (1.0 - x / 7.0))))))
    two = h * h * (0.5 - x / 6.0 * (1.0 - x / 4.0 * (1.0 - x / 5.0 * (1.0 - x / 6.0 * (1.0 - x / 7.0)))))
    three = h**3 * (1.0 / 6.0 - x / 24.0 * (1.0 - x / 5.0 * (1.0 - x / 6.0 * (1.0 - x / 7.0 * (1.0 - x / 8.0)))))
    return exp(-x), one, two, three


@njit(cache=True, error_model="numpy")
def begin(state: Array, theta: float, phi: float, functions: Array) -> None:
    """Begin a window with the angle theta [rad], the deflection phi [rad] and the functions' values there."""
    now, response, last, triangle = views(state, functions.size)
    response[:] = 0.0
    triangle[:] = 0.0
    triangle[0, 0] = 1.0  # the first sample: its angle is that of the window's start, from which angles are counted
    last[:] = functions
    now[NOW.count], now[NOW.age] = 1.0, 0.0
    now[NOW.first] = now[NOW.middle] = now[NOW.last] = now[NOW.lowest] = now[NOW.highest] = theta
    now[NOW.low] = now[NOW.high] = phi


@njit(cache=True, error_model="numpy", forceinline=True)
def advance(
    state: Array, inertia: float, damping: float, step: float, theta: float, phi: float, torque: float,
    functions: Array, half: float, row: Array,
) -> None:  # fmt: skip
    """Add the sample that ends the step [s] to the window.

    functions  their values at the sample, linear in between
    half       samples up to the middle of the window
    row        (4 + signals,) overwritten: responses of the angle to theta = 1, omega = 1, w = 1 and v = 1 at the
               window's start, v counted from there; the angle itself, and its responses to tau and to each function
    """
    now, response, last, triangle = views(state, functions.size)
    per = 1.0 / inertia
    keep, one, two, three = transition(damping * per, step)
    for j in range(1, response.shape[1]):
        force, slope = torque, 0.0
        if j >= OWN:
            force, slope = last[j - OWN], (functions[j - OWN] - last[j - OWN]) / step
            last[j - OWN] = functions[j - OWN]
        omega = response[1, j]
        response[0, j] += one * omega + per * (two * force + three * slope)
        response[1, j] = keep * omega + per * (one * force + two * slope)
    now[NOW.age] += step
    now[NOW.count] += 1.0
    _, one, two, three = transition(damping * per, now[NOW.age])
    row[0], row[1], row[2], row[3] = 1.0, one, per * two, per * three
    row[STEPS] = theta - now[NOW.first]
    for j in range(1, response.shape[1]):
        row[STEPS + j] = response[0, j]
    _rotate(triangle, row)
    now[NOW.last] = theta
    if now[NOW.count] <= half:
        now[NOW.middle] = theta
    now[NOW.lowest], now[NOW.highest] = min(now[NOW.lowest], theta), max(now[NOW.highest], theta)
    now[NOW.low], now[NOW.high] = min(now[NOW.low], phi), max(now[NOW.high], phi)


@njit(cache=True, error_model="numpy", forceinline=True)
def _rotate(triangle: Array, row: Array) -> None:
    """Add the row to the triangle, all columns alike."""
    for j in range(STEPS):
        if row[j] == 0.0:
            continue
        per = 1.0 / sqrt(triangle[j, j] ** 2 + row[j] ** 2)
        c, s = triangle[j, j] * per, row[j] * per
        for i in range(j, row.size):
            above = triangle[j, i]
            triangle[j, i] = c * above + s * row[i]
            row[i] = c * row[i] - s * above


@njit(cache=True, error_model="numpy")
def reconstruct(triangle: Array, middle: float, found: Array) -> tuple[float, float]:
    """Inputs that would move the motor by each signal, from at least four samples; returns variances of w and v.

    triangle  (4, 4 + signals)
    middle    [s] after the window's start at which w holds
    found     (2, signals) w and v of each signal, overwritten: of the angle, B omega' + D omega; of the torque, tau

    The variances are per variance of one angle sample.
    """
    a, b, d = triangle[2, 2], triangle[2, 3], triangle[3, 3]
    for j in range(found.shape[1]):
        v = triangle[3, STEPS + j] / d
        found[1, j] = v
        found[0, j] = (triangle[2, STEPS + j] - b * v) / a + middle * v
    along = middle - b / a
    return 1.0 / (a * a) + (along / d) ** 2, 1.0 / (d * d)
