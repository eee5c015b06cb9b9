"""The least-squares problem of `moving_horizon`: residuals of one horizon, Gauss-Newton steps, and the arrival cost.

Sources: C. V. Rao, J. B. Rawlings, D. Q. Mayne, Constrained state estimation for nonlinear discrete-time systems,
IEEE Transactions on Automatic Control 48(2), 2003 (arrival cost); P. Kuehl, M. Diehl, T. Kraus, J. P. Schloeder,
H. G. Bock, A real-time algorithm for moving horizon state and parameter estimation, Computers & Chemical Engineering
35(1), 2011 (multiple shooting, a fixed number of Gauss-Newton steps, arrival cost by QR). Transcription: collocation by
cubic Hermite polynomials (Hermite-Simpson) in the integral form of the motor equation.

Nodes x_k = (theta_k, omega_k) bound intervals of span T. The motor equation B omega' + D omega + F s(omega) - tau_e =
tau + noise is multiplied by 1 and by T/2 - t and integrated over an interval. Both equations are exact but for
Simpson's rule, and their noise is independent, with variance S T and S T^3 / 12 for torque noise of density S:

    r_1 = (B d_omega + D d_theta + F T (omega_0 + omega_1) / (h_0 + h_1) - T <tau_e> - integral tau) / sd_1
    r_2 = (B (d_theta - T (omega_0 + omega_1)/2) + T^2/12 (D (omega_0 - omega_1) + F (s_0 - s_1) - tau_e0 + tau_e1)
           - integral (T/2 - t) tau) / sd_2
    r_3 = (mean of the measured theta - (theta_0 + theta_1)/2 - T (omega_0 - omega_1)/12) / sd_3

h = sqrt(omega^2 + v^2), and s = omega / h is the smoothed sign; its mean over an interval with linear omega is the
quotient in r_1. Where the motor may stick or turn back, friction is noise (`weighed`). The spring torque is tau_e =
sum_p a_p f_p(q - theta) as in `modulated_torque`.
The unknowns are the nodes and p = (B, D, F, a..), with p = mean + width z.

An arrival cost |R (x_0, z) - e|^2, R triangular, is the array [R | e]. A Gauss-Newton step eliminates the nodes one by
one by rotations (`sweep`), which takes [R | e] to the next node, and then substitutes backwards; the triangle that
remains is the marginal information of z. Intervals that leave the horizon pass the same sweep. CasADi generates
residuals and Jacobians; it is loaded when the first problem is solved.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from via_core.signals import Array

from via_estimators import qr
from via_estimators.slots import slots
from via_estimators.spring_series import power

# Measurements of an interval: span [s], impulse of the torque [N m s] and its moment about the middle [N m s^2], line
# through q at start, middle and end [rad], mean of theta [rad], standard deviations of r_1, r_2, r_3, and the smallest
# and largest deflection [rad].
DATA = slots(
    "span", "impulse", "moment", "q_start", "q_middle", "q_end", "theta", "sd_impulse", "sd_moment", "sd_theta",
    "low", "high",
)  # fmt: skip
U = slots("inertia", "damping", "friction")  # unknowns, followed by the coefficients of the spring law
NODE = 2  # numbers of a node: theta, omega
EQUATIONS = 3  # per interval
LOOSE = 1e-6  # information [1/rad, s/rad] of a node before any data


class Model(NamedTuple):
    """Constants of one transmission: odd and even terms, scale [rad], velocity of the smoothed sign [rad/s], prior."""

    order: int
    even_terms: int
    scale: float
    smoothing: float
    mean: Array  # (n,)
    width: Array  # (n,)


class Solution(NamedTuple):
    """Nodes (M + 1, 2), z (n,), triangle (n, n) of the information of z; sum of squares, residuals, Jacobians there."""

    nodes: Array
    z: Array
    root: Array
    cost: float
    residual: Array  # (M, 3)
    jacobian: Array  # (M, 3, 4 + n)


@lru_cache(maxsize=32)
def _functions(order: int, even_terms: int, intervals: int) -> Any:
    """CasADi function of nodes (2, M) at start and end, p (n, M), data (DATA.size, M), scale and smoothing (2, M).

    Returns the residuals (3, M) and their Jacobians (3, M (4 + n)).
    """
    import casadi

    n = U.size + order + even_terms
    start, end, p = casadi.SX.sym("start", NODE), casadi.SX.sym("end", NODE), casadi.SX.sym("p", n)
    d, constants = casadi.SX.sym("d", DATA.size), casadi.SX.sym("c", 2)
    scale, span = constants[0], d[DATA.span]

    def spring(phi: Any) -> Any:
        torque = 0.0
        for term in range(order + even_terms):
            exponent = power(term, order)
            torque += p[U.size + term] * scale * (phi / scale) ** exponent / max(exponent, 1)
        return torque

    risen, slowed = end[0] - start[0], start[1] - end[1]
    middle = 0.5 * (start[0] + end[0]) + span * slowed / 8.0
    first, half, last = (
        spring(q - theta)
        for q, theta in ((d[DATA.q_start], start[0]), (d[DATA.q_middle], middle), (d[DATA.q_end], end[0]))
    )
    speeds = [casadi.sqrt(omega**2 + constants[1] ** 2) for omega in (start[1], end[1])]
    impulse = p[U.damping] * risen - p[U.inertia] * slowed - span / 6.0 * (first + 4.0 * half + last)
    impulse += p[U.friction] * span * (start[1] + end[1]) / (speeds[0] + speeds[1]) - d[DATA.impulse]
    moment = p[U.damping] * slowed + p[U.friction] * (start[1] / speeds[0] - end[1] / speeds[1]) - first + last
    moment = span**2 / 12.0 * moment + p[U.inertia] * (risen - 0.5 * span * (start[1] + end[1])) - d[DATA.moment]
    miss = d[DATA.theta] - 0.5 * (start[0] + end[0]) - span * slowed / 12.0
    residual = casadi.vertcat(impulse / d[DATA.sd_impulse], moment / d[DATA.sd_moment], miss / d[DATA.sd_theta])
    jacobian = casadi.jacobian(residual, casadi.vertcat(start, end, p))
    each = casadi.Function("interval", [start, end, p, d, constants], [residual, casadi.densify(jacobian)])
    return each.map(intervals)


def weighed(model: Model, nodes: Array, z: Array, data: Array) -> Array:
    """Intervals data (M, DATA.size) with friction of unknown direction added to the noise of the torque.

    The mean of the smoothed sign over an interval is m; a friction that opposes another motion differs by F (1 - m^2).
    """
    omega, friction = nodes[:, 1], (model.mean + model.width * z)[U.friction]
    speed = np.hypot(omega, model.smoothing)
    mean = (omega[:-1] + omega[1:]) / (speed[:-1] + speed[1:])
    unknown, span = friction * (1.0 - mean**2), data[:, DATA.span]
    found = data.copy()
    found[:, DATA.sd_impulse] = np.hypot(data[:, DATA.sd_impulse], unknown * span)
    found[:, DATA.sd_moment] = np.hypot(data[:, DATA.sd_moment], 0.25 * unknown * span**2)
    return found


def linearise(model: Model, nodes: Array, z: Array, data: Array) -> tuple[Array, Array]:
    """Residuals (M, 3) and Jacobians (M, 3, 4 + n) by the two nodes and z, of intervals data (M, DATA.size)."""
    intervals, n = len(data), len(z)
    p = np.repeat((model.mean + model.width * z)[:, None], intervals, axis=1)
    constants = np.repeat([[model.scale], [model.smoothing]], intervals, axis=1)
    function = _functions(model.order, model.even_terms, intervals)
    residual, flat = function(nodes[:-1].T, nodes[1:].T, p, data.T, constants)
    jacobian = flat.full().reshape(EQUATIONS, intervals, 2 * NODE + n).transpose(1, 0, 2)
    jacobian[:, :, 2 * NODE :] *= model.width
    return np.ascontiguousarray(residual.full().T), np.ascontiguousarray(jacobian)


@njit(cache=True, error_model="numpy")
def sweep(
    arrival: Array, residual: Array, jacobian: Array, nodes: Array, z: Array, factors: Array
) -> float:  # fmt: skip
    """Eliminate one node after the other, by rotations; returns the sum of squares of one innovation per interval.

    arrival   [R | e] of the first node and z, R triangular; overwritten by that of the last node
    residual  (M, 3) and jacobian (M, 3, 4 + n), linearised at nodes (M + 1, 2) and z (n,)
    factors   (M, 2, 4 + n + 1) rows of the eliminated nodes: the node, the next one, z, right side; overwritten
    """
    size, squares = arrival.shape[0], 0.0
    R, right, row = np.empty((NODE + size, NODE + size)), np.empty(NODE + size), np.empty(NODE + size)
    for k in range(residual.shape[0]):
        R[:] = 0.0
        right[:] = 0.0
        for i in range(size):
            to = i if i < NODE else i + NODE
            right[to] = arrival[i, size]
            for j in range(i, size):
                R[to, j if j < NODE else j + NODE] = arrival[i, j]
        for e in range(EQUATIONS):
            y = -residual[k, e]
            for j in range(row.size):
                row[j] = jacobian[k, e, j]
                at = nodes[k + j // NODE, j % NODE] if j < 2 * NODE else z[j - 2 * NODE]
                y += row[j] * at
            squares += qr.rotate_in(R, right, row, y, 0) ** 2
        factors[k, :, :-1] = R[:NODE]
        factors[k, :, -1] = right[:NODE]
        arrival[:, :size] = R[NODE:, NODE:]
        arrival[:, size] = right[NODE:]
    return squares


@njit(cache=True, error_model="numpy")
def trace_back(arrival: Array, factors: Array, nodes: Array, z: Array) -> None:
    """Overwrite nodes (M + 1, 2) and z (n,) with the solution that `sweep` has prepared."""
    size, last = arrival.shape[0], factors.shape[0]
    x = np.empty(size)
    qr.solve_triangular(arrival[:, :size].copy(), arrival[:, size].copy(), x)
    z[:] = x[NODE:]
    nodes[last] = x[:NODE]
    for k in range(last - 1, -1, -1):
        for i in range(NODE - 1, -1, -1):
            total = factors[k, i, 2 * NODE + z.size]
            for j in range(i + 1, NODE):
                total -= factors[k, i, j] * nodes[k, j]
            for j in range(NODE):
                total -= factors[k, i, NODE + j] * nodes[k + 1, j]
            for j in range(z.size):
                total -= factors[k, i, 2 * NODE + j] * z[j]
            nodes[k, i] = total / factors[k, i, i]


def _cost(arrival: Array, residual: Array, nodes: Array, z: Array) -> float:
    """Sum of squares of the arrival cost and of the residuals."""
    first = arrival[:, :-1] @ np.concatenate([nodes[0], z]) - arrival[:, -1]
    return float(first @ first + np.sum(residual**2))


def free(z: Array, root: Array) -> Array:
    """The arrival cost [R | e] of a node of which nothing is known, and of z with the information root' root."""
    n = len(z)
    arrival = np.zeros((NODE + n, NODE + n + 1))
    arrival[[0, 1], [0, 1]] = LOOSE
    arrival[NODE:, NODE:-1], arrival[NODE:, -1] = root, root @ z
    return arrival


def solve(model: Model, arrival: Array, start: tuple[Array, Array], data: Array, iterations: int) -> Solution | None:
    """Gauss-Newton steps from `start` (nodes, z); None if the sum of squares has not decreased or is not finite."""
    nodes, z = start[0].copy(), start[1].copy()
    residual, jacobian = linearise(model, nodes, z, data)
    before = _cost(arrival, residual, nodes, z)
    last, factors = arrival, np.empty((len(data), NODE, 2 * NODE + len(z) + 1))
    for _ in range(iterations):
        last = arrival.copy()
        sweep(last, residual, jacobian, nodes, z, factors)
        trace_back(last, factors, nodes, z)
        residual, jacobian = linearise(model, nodes, z, data)
    cost = _cost(arrival, residual, nodes, z)
    if not (cost <= before * (1.0 + 1e-9) and np.isfinite(z).all()):
        return None
    return Solution(nodes, z, last[NODE:, NODE:-1], cost, residual, jacobian)


def leave(arrival: Array, solution: Solution, count: int) -> tuple[Array, float]:
    """The arrival cost after the first `count` intervals have left, and the sum of squares of as many innovations.

    With linear equations and Gaussian noise this is the Kalman filter in square-root information form.
    """
    after, factors = arrival.copy(), np.empty((count, NODE, 2 * NODE + len(solution.z) + 1))
    residual, jacobian = solution.residual[:count], solution.jacobian[:count]
    return after, sweep(after, residual, jacobian, solution.nodes, solution.z, factors)


def walk(arrival: Array, directions: Array, variance: float) -> Array:
    """The arrival cost after z has moved along each of the directions (n, k) by a random step of that variance."""
    if variance <= 0.0:
        return arrival
    k, size = directions.shape[1], len(arrival)
    rows = np.zeros((k + size, k + size + 1))
    rows[:k, :k] = np.eye(k) / np.sqrt(variance)
    rows[k:, :k], rows[k:, k:] = -arrival[:, NODE:-1] @ directions, arrival
    return np.asarray(np.linalg.qr(rows, mode="r"))[k:, k:]
