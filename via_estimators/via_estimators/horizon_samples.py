"""Samples of `moving_horizon`, condensed to intervals, and the layout of its state.

A state is the header, the outputs, the times of the window, LINK of the present interval, and per transmission KEPT,
SUMS, the intervals of the horizon, the nodes that bound them, the arrival cost, the unknowns z, the triangle of their
information and their covariance.
"""

from __future__ import annotations

from math import sqrt

from numba import njit
from via_core.signals import Array

from via_estimators import horizon_problem
from via_estimators.horizon_problem import DATA, NODE, U
from via_estimators.slots import slots
from via_estimators.spring_series import power
from via_estimators.transmissions import VISITED
from via_estimators.window import HEADER

LEAST_ANGLE_NOISE = 1e-6  # [deflection scales] of collocation, where encoders are exact
# Followed by the means (n,) and the standard deviations (n,) of the prior.
P = slots(
    "length", "transmissions", "order", "even_terms", "stride", "intervals", "every", "max_gap", "torque_noise",
    "position_noise", "deflection_scale", "minimum_motion", "range_margin", "truncation", "drift", "friction_velocity",
)  # fmt: skip
# Of each transmission: range of deflection in the horizon [rad], 1 if informative, solutions so far, time of the last
# one [s], innovations and their sum of squares, intervals in the horizon, 1 if a solution is due.
KEPT = slots("moved", "moving", "solved", "time", "weight", "power", "intervals", "due", after=VISITED)
# Of each transmission, sums over the present interval: first and last theta, and the integrals of theta relative to the
# first, of the torque and of torque times time since the start; smallest and largest deflection.
SUMS = slots("first", "last", "theta", "torque", "moment", "low", "high")
# Of the joint, the present interval: samples, start [s], q at the start, and sums of time, its square, q, and both.
LINK = slots("count", "start", "q", "t", "tt", "dq", "t_dq")


@njit(cache=True, error_model="numpy")
def unknowns(par: Array) -> int:
    """Number of unknowns of a transmission, without nodes."""
    return U.size + int(par[P.order]) + int(par[P.even_terms])


@njit(cache=True, error_model="numpy")
def part_size(par: Array) -> int:
    """Numbers in the state of one transmission."""
    n, intervals = unknowns(par), int(par[P.intervals])
    size = NODE + n
    return KEPT.size + SUMS.size + intervals * DATA.size + (intervals + 1) * NODE + size * (size + 1) + n + 2 * n * n


@njit(cache=True, error_model="numpy")
def parts_at(par: Array) -> int:
    """Position of the transmissions in the state, after header, outputs, times and LINK."""
    return HEADER.size + 2 * (1 + 3 * int(par[P.transmissions])) + int(par[P.length]) + LINK.size


@njit(cache=True, error_model="numpy")
def parts(par: Array, state: Array) -> Array:
    """The view (m, ..) of the transmissions."""
    at, each = parts_at(par), part_size(par)
    return state[at : at + int(par[P.transmissions]) * each].reshape(int(par[P.transmissions]), each)


@njit(cache=True, error_model="numpy")
def views(
    par: Array, part: Array
) -> tuple[Array, Array, Array, Array, Array, Array, Array, Array]:  # fmt: skip
    """Views KEPT, SUMS, data (M, DATA.size), nodes (M + 1, 2), arrival [R | e], z (n,), root and covariance (n, n)."""
    n, intervals = unknowns(par), int(par[P.intervals])
    size = NODE + n
    data = KEPT.size + SUMS.size
    nodes = data + intervals * DATA.size
    arrival = nodes + (intervals + 1) * NODE
    z = arrival + size * (size + 1)
    root = z + n
    covariance = root + n * n
    return (
        part[: KEPT.size],
        part[KEPT.size : data],
        part[data:nodes].reshape(intervals, DATA.size),
        part[nodes:arrival].reshape(intervals + 1, NODE),
        part[arrival:z].reshape(size, size + 1),
        part[z:root],
        part[root:covariance].reshape(n, n),
        part[covariance : covariance + n * n].reshape(n, n),
    )


@njit(cache=True, error_model="numpy")
def detach(par: Array, part: Array) -> None:
    """Empty the horizon; the arrival cost keeps what the last solution says about z, and nothing about a node."""
    kept, _, _, _, arrival, z, root, _ = views(par, part)
    n = z.size
    kept[KEPT.intervals] = kept[KEPT.due] = 0.0
    arrival[:] = 0.0
    for i in range(NODE):
        arrival[i, i] = horizon_problem.LOOSE
    for i in range(n):
        for j in range(n):
            arrival[NODE + i, NODE + j] = root[i, j]
            arrival[NODE + i, NODE + n] += root[i, j] * z[j]


@njit(cache=True, error_model="numpy")
def stiffness(par: Array, z: Array, phi: float, slope: Array) -> tuple[float, float]:
    """Stiffness [N m/rad] and its derivative by phi at phi [rad]; slope (n,) = d stiffness / dz, overwritten."""
    order, share, n = int(par[P.order]), phi / par[P.deflection_scale], z.size
    total = bend = 0.0
    slope[: U.size] = 0.0
    for j in range(U.size, n):
        exponent = power(j - U.size, order)
        rise = share ** (exponent - 1) if exponent > 0 else 0.0
        a = par[P.size + j] + par[P.size + n + j] * z[j]
        slope[j] = par[P.size + n + j] * rise
        total += a * rise
        bend += a * (exponent - 1) * share ** (exponent - 2) / par[P.deflection_scale] if exponent > 1 else 0.0
    return total, bend


@njit(cache=True, error_model="numpy")
def begin(link: Array, parts: Array, row: Array) -> None:
    """Begin an interval with the sample row (time, q, theta_1, tau_1, ..)."""
    link[:] = 0.0
    link[LINK.count], link[LINK.start], link[LINK.q] = 1.0, row[0], row[1]
    for i in range(parts.shape[0]):
        sums, theta = parts[i, KEPT.size : KEPT.size + SUMS.size], row[2 + 2 * i]
        sums[:] = 0.0
        sums[SUMS.first] = sums[SUMS.last] = theta
        sums[SUMS.low] = sums[SUMS.high] = row[1] - theta


@njit(cache=True, error_model="numpy")
def add(link: Array, parts: Array, row: Array, step: float) -> None:
    """Add the sample that ends the step [s] to the sums of the present interval."""
    t, dq = row[0] - link[LINK.start], row[1] - link[LINK.q]
    link[LINK.count] += 1.0
    link[LINK.t] += t
    link[LINK.tt] += t * t
    link[LINK.dq] += dq
    link[LINK.t_dq] += t * dq
    for i in range(parts.shape[0]):
        sums, theta, tau = parts[i, KEPT.size : KEPT.size + SUMS.size], row[2 + 2 * i], row[3 + 2 * i]
        sums[SUMS.theta] += step * (0.5 * (sums[SUMS.last] + theta) - sums[SUMS.first])
        sums[SUMS.torque] += step * tau
        sums[SUMS.moment] += step * tau * (t - 0.5 * step)
        sums[SUMS.last] = theta
        sums[SUMS.low], sums[SUMS.high] = min(sums[SUMS.low], row[1] - theta), max(sums[SUMS.high], row[1] - theta)


@njit(cache=True, error_model="numpy")
def append(par: Array, link: Array, part: Array, span: float, slope: Array) -> None:
    """Append the interval that just ended, of `span` [s], to a transmission's horizon, with a guess of its nodes."""
    kept, sums, data, nodes, _, z, _, _ = views(par, part)
    at, count = int(kept[KEPT.intervals]), link[LINK.count]
    d = data[at]
    mean_t, mean_q = link[LINK.t] / count, link[LINK.dq] / count
    rate = (link[LINK.t_dq] - count * mean_t * mean_q) / (link[LINK.tt] - count * mean_t * mean_t)
    d[DATA.span], d[DATA.impulse] = span, sums[SUMS.torque]
    d[DATA.moment] = 0.5 * span * sums[SUMS.torque] - sums[SUMS.moment]
    d[DATA.q_start] = link[LINK.q] + mean_q - rate * mean_t
    d[DATA.q_middle], d[DATA.q_end] = d[DATA.q_start] + 0.5 * rate * span, d[DATA.q_start] + rate * span
    d[DATA.theta] = sums[SUMS.first] + sums[SUMS.theta] / span
    d[DATA.low], d[DATA.high] = sums[SUMS.low], sums[SUMS.high]
    turned = (sums[SUMS.last] - sums[SUMS.first]) / span
    found = stiffness(par, z, d[DATA.q_middle] - d[DATA.theta], slope)[0]
    noise = par[P.torque_noise] ** 2 + (found * par[P.position_noise]) ** 2
    noise *= span / (count - 1.0)
    d[DATA.sd_impulse], d[DATA.sd_moment] = sqrt(noise * span), sqrt(noise * span / 12.0) * span
    least = LEAST_ANGLE_NOISE * par[P.deflection_scale]
    d[DATA.sd_theta] = sqrt((par[P.position_noise] ** 2 + least * least) / (count - 1.0))
    if at == 0:
        nodes[0, 0], nodes[0, 1] = sums[SUMS.first], turned
    nodes[at + 1, 0], nodes[at + 1, 1] = sums[SUMS.last], turned
    kept[KEPT.intervals] = at + 1.0


@njit(cache=True, error_model="numpy")
def end(par: Array, link: Array, parts: Array, span: float, slope: Array) -> bool:
    """Append the interval to every horizon; returns whether one of them is full and informative."""
    due = False
    for i in range(parts.shape[0]):
        kept, data = parts[i, : KEPT.size], views(par, parts[i])[2]
        append(par, link, parts[i], span, slope)
        if kept[KEPT.intervals] < par[P.intervals]:
            continue
        low, high = data[0, DATA.low], data[0, DATA.high]
        for k in range(1, data.shape[0]):
            low, high = min(low, data[k, DATA.low]), max(high, data[k, DATA.high])
        kept[KEPT.moved] = high - low
        kept[KEPT.moving] = kept[KEPT.due] = 1.0 if high - low >= par[P.minimum_motion] else 0.0
        if kept[KEPT.due] > 0.0:
            due = True
        else:
            detach(par, parts[i])
    return due
