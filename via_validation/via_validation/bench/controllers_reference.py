"""Modal limit cycle on flexible joints in plain numpy, as a reference for the compiled controller.

Rigid bodies and springs are those of the arm; modal quantities are computed by numpy and scipy on small arrays. The
equations, the order of the modes and the result are the same (`controllers` checks it). Crossings of eigenvalues and
the start from rest are not implemented: it is evaluated on the cycle only.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import eigh
from via_controllers.arms.modal_limit_cycle import ModalLimitCycle
from via_controllers.arms.modal_limit_cycle_vsa import VsaModalLimitCycle
from via_controllers.contract import ArmSample
from via_core.signals import Array


def link_torque(cycle: ModalLimitCycle, near: Array, q: Array, velocity: Array) -> tuple[Array, Array]:
    """Torque on the links (n,) [N m] and W (n, n) at `q`, `velocity`; `near` is W of the previous sample."""
    arm, k = cycle.arm, cycle.mode
    M, slopes = arm.inertia(q), arm.inertia_slopes(q)
    values, vectors = eigh(cycle.stiffness, M)
    product = vectors.T @ M @ near
    order = np.argmax(np.abs(product), axis=0)
    W = vectors[:, order] * np.sign(product[order, np.arange(arm.n)])
    values = values[order]
    gap = values[:, None] - values[None, :]
    np.fill_diagonal(gap, 1.0)
    share = values[None, :] / gap
    np.fill_diagonal(share, -0.5)

    def turning(along: Array) -> Array:
        return (W.T @ along @ W) * share

    Mdot = np.tensordot(velocity, slopes, axes=1)
    N = W.T @ Mdot @ W
    A, rates = N * share, -values * np.diag(N)
    gap_rate = rates[:, None] - rates[None, :]
    share_rate = (rates[None, :] * gap - values[None, :] * gap_rate) / gap**2
    np.fill_diagonal(share_rate, 0.0)
    Nd = A.T @ N + N @ A + W.T @ arm.inertia_second(q, velocity) @ W
    second = A @ A + Nd * share + N * share_rate
    z = W.T @ M @ (q - cycle.equilibrium)
    zd = W.T @ M @ velocity - A @ z
    zdd = -2.0 * cycle.damping_ratio * np.sqrt(values) * zd - values * z
    H = 0.5 * (zd[k] ** 2 / values[k] + z[k] ** 2)
    pull = cycle.gain * (H - cycle.level)
    zdd[k] = -values[k] * z[k] + values[k] * (-pull * zd[k] + rates[k] / (2.0 * values[k] ** 2) * zd[k])
    drift = W @ (second @ z + 2.0 * A @ zd)
    loop = np.eye(arm.n) - np.column_stack([W @ turning(slope) @ z for slope in slopes])
    return arm.link_torque(q, velocity, np.linalg.solve(loop, drift + W @ zdd)), W


def step(controller: VsaModalLimitCycle, near: Array, sample: ArmSample) -> tuple[Array, Array]:
    """Motor torques (n,) [N m] before limits, and W."""
    cycle, s = controller.cycle, controller.difference_step
    q, v = sample.q, sample.q_velocity
    torque, W = link_torque(cycle, near, q, v)
    seen = controller.tracking.observed(sample)
    a, jerk = seen.acceleration, controller.link_jerk(sample, seen)
    behind, ahead = (
        link_torque(cycle, W, q + t * (v + t * (a / 2.0 + t * jerk / 6.0)), v + t * (a + t * jerk / 2.0))[0]
        for t in (-s, s)
    )
    wanted, rate, second = -torque, -(ahead - behind) / (2.0 * s), -(ahead - 2.0 * torque + behind) / s**2
    omega, arm = controller.bandwidth, cycle.arm
    demanded = second + 2.0 * omega * (rate - seen.rate) + omega**2 * (wanted - seen.torque)
    phi_rate = v - sample.theta_velocity
    motor = a - (demanded - seen.stiffness_slope * phi_rate**2) / seen.stiffness
    return arm.motor_inertia * motor + arm.motor_friction * sample.theta_velocity - wanted, W
