"""A limit cycle on one mode of an arm, the other modes damped out: eqs. (81)-(104), for a rigid arm.

In modal coordinates of M(q) and a constant K_d the closed loop is to be, mode by mode,

    i != k   zdd_i + 2 xi sqrt(lambda_i) zd_i + lambda_i z_i = 0                                      (93), D_d by (86)
    i == k   zdd_k + lambda_k z_k = u_k,   H = zd_k^2 / (2 lambda_k) + z_k^2 / 2                      (99), (100)
             u_k = lambda_k (-k_V (H - H_d) zd_k + lambdad_k / (2 lambda_k^2) zd_k)                   (102) corrected
             Hd = -k_V (H - H_d) zd_k^2,   V = (H - H_d)^2 / 2                                        (103), (104)

(102) is printed with zd_k^2 in its last term, which does not cancel (101)'s: H then swings by a tenth of H_d and more.
The torque is that of (82), (90) and (91). Its gamma holds Wdd and with it the acceleration that the torque is to bring
about; this loop is closed by solving for the acceleration first, A_k = W^-1 dW/dq_k:

    (I - W [A_1 z ... A_n z]) qdd = (Wdd z at qdd = 0) + 2 Wdot zd + W zdd,   tau = M qdd + C qd + g

z = 0 is an equilibrium, if an unstable one: somebody must push, or `self_start` does, which adds lambda_k s to u_k
while H is well below H_d. How long the way is without follows from (103): over a cycle zd_k^2 is lambda_k H on average,
so that with h = H / H_d

    hd = k_V lambda_k H_d h (1 - h),   1 / h(t) - 1 = (1 / h(0) - 1) exp(-k_V lambda_k H_d t)
Source: the document's Section 6.1; it has no `self_start`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import exp, sqrt
from typing import NamedTuple

import numpy as np
from numba import njit
from via_core.signals import Array, locked
from via_core.vsa_arms import VsaArm, inertia_of

from via_controllers import self_start
from via_controllers.contract import require
from via_controllers.modal_transform import ModalBasis, basis_near, first_basis, next_basis, rates_along, second_along

WALK = 0.02  # [rad] between configurations on the way along which modes get their names


class ModalMotion(NamedTuple):
    """What the law saw and wants at one instant."""

    basis: ModalBasis
    z: Array  # (n,) modal coordinates [sqrt(kg m^2) rad]
    z_velocity: Array  # (n,)
    eigenvalue_rates: Array  # (n,) lambdad [1/s^3]
    H: float  # of mode k, (100)
    V: float  # (104)
    acceleration: Array  # qdd (n,) [rad/s^2] that it brings about
    torque: Array  # (n,) [N m] on the links
    direction: float  # p of `self_start` [-]
    turning: float  # pd [1/s]
    push: float  # s [sqrt(kg m^2) rad]


@dataclass(frozen=True, eq=False)
class ModalLimitCycle:
    """The law of this file. Raises ParameterError for parameters outside of what is said here."""

    arm: VsaArm
    equilibrium: Array  # q_d (n,) [rad]
    stiffness: Array  # K_d (n, n) [N m/rad], symmetric and positive definite
    mode: int  # k, 0 the softest at the equilibrium
    damping_ratio: float  # xi > 0 of the other modes
    gain: float  # k_V > 0 [s/(kg m^2)]
    level: float  # H_d > 0 [kg m^2]: half the squared amplitude of z_k
    start: float = self_start.START  # a of `self_start`, 0 to 1 [-]; 0: at rest at z = 0 it stays at rest

    def __post_init__(self) -> None:
        n = self.arm.n
        for name, shape in (("equilibrium", (n,)), ("stiffness", (n, n))):
            values = locked(getattr(self, name), name)
            require(values.shape == shape and bool(np.isfinite(values).all()), f"{name} must be finite {shape}")
            object.__setattr__(self, name, values)
        K = self.stiffness
        definite = np.array_equal(K, K.T) and np.linalg.eigvalsh(K).min() > 0.0
        require(definite, "stiffness must be symmetric and positive definite")
        require(0 <= self.mode < n, f"mode must be 0 to {n - 1}, got {self.mode}")
        for name in ("damping_ratio", "gain", "level"):
            value = getattr(self, name)
            require(np.isfinite(value) and value > 0.0, f"{name} must be > 0, got {value}")
        require(0.0 <= self.start <= 1.0, f"start must lie in 0 to 1, got {self.start}")

    @cached_property
    def amplitude(self) -> float:
        """A [sqrt(kg m^2) rad] of z_k on the cycle."""
        return sqrt(2.0 * self.level)

    def init(self, q: Array) -> ModalBasis:
        """The basis at `q` (n,) [rad], whose modes have the order that they have at the equilibrium."""
        way = q - self.equilibrium
        basis = first_basis(self.arm.inertia(self.equilibrium), self.stiffness)
        for share in np.linspace(0.0, 1.0, 2 + int(np.abs(way).max() / WALK))[1:]:
            basis = next_basis(basis, self.arm.inertia(self.equilibrium + share * way), self.stiffness)
        return basis

    def at(self, near: ModalBasis, q: Array, velocity: Array, direction: float = 0.0) -> ModalMotion:
        """What the law wants at `q`, `velocity` (n,) [rad, rad/s].

        near       the basis of the instant before
        direction  p of `self_start` at this instant; it turns at the rate that is answered; 0: the law without it
        """
        arm, k = self.arm, self.mode
        W, values, z, zd, rates, drift, loop = _modal(
            near.W, *arm.inertia_terms(q, velocity), self.stiffness, self.equilibrium, q, velocity
        )
        value, speed = float(values[k]), float(zd[k])
        H = 0.5 * (speed**2 / value + float(z[k]) ** 2)
        u = orbit_input(value, float(rates[k]), self.gain * (H - self.level), speed)
        A, w = self.amplitude, sqrt(value)
        s = A * self_start.push(self.start, direction, H / self.level)
        if s != 0.0:
            u += value * s
        turning = self_start.turning(self.start, direction, float(z[k]) / A, speed / (w * A), w)
        acceleration = _accelerated(W, values, z, zd, drift, loop, k, self.damping_ratio, u)
        torque = arm.link_torque(q, velocity, acceleration)
        V = 0.5 * (H - self.level) ** 2
        return ModalMotion(ModalBasis(W, values), z, zd, rates, H, V, acceleration, torque, direction, turning, s)


def approach(share: float, gain: float, level: float, eigenvalue: float, time: float) -> float:
    """h = H / H_d [-], averaged over a cycle, `time` [s] after it was `share` > 0 (head of this file)."""
    return 1.0 / (1.0 + (1.0 / share - 1.0) * exp(-gain * eigenvalue * level * time))


def least_share(after: float, gain: float, level: float, eigenvalue: float, time: float) -> float:
    """The least h(0) [-] from which h is `after` within `time` [s]: `approach` backwards in time."""
    return approach(after, gain, level, eigenvalue, -time)


def orbit_input(eigenvalue: float, rate: float, pull: float, z_velocity: float) -> float:
    """u_k of (102) corrected; `pull` = k_V (H - H_d) [1/s]."""
    return eigenvalue * (-pull * z_velocity + rate / (2.0 * eigenvalue**2) * z_velocity)


@njit(cache=True, error_model="numpy")
def _modal(
    near: Array, terms: Array, h: float, K: Array, equilibrium: Array, q: Array, velocity: Array
) -> tuple[Array, Array, Array, Array, Array, Array, Array]:
    """W (n, n) named as in `near` and lambda, z, zd and lambdad (n,); W (W^-1 Wdd z + 2 A zd) at qdd = 0 (n,); and
    I - W [A_1 z ... A_n z] (n, n). `terms` and `h` as of `VsaArm.inertia_terms`."""
    M, slopes, Mdd = inertia_of(terms, h)
    W, values = basis_near(near, M, K)
    n = len(values)
    Mdot = np.zeros((n, n))
    for k in range(n):
        Mdot += slopes[k] * velocity[k]
    A, rates = rates_along(W, values, Mdot)
    inverse = W.T @ M
    z = inverse @ (q - equilibrium)
    zd = inverse @ velocity - A @ z
    drift = W @ (second_along(W, values, Mdot, Mdd) @ z + 2.0 * (A @ zd))
    loop = np.eye(n)
    for k in range(n):
        loop[:, k] -= W @ (rates_along(W, values, slopes[k])[0] @ z)
    return W, values, z, zd, rates, drift, loop


@njit(cache=True, error_model="numpy")
def _accelerated(
    W: Array, values: Array, z: Array, zd: Array, drift: Array, loop: Array, k: int, damping_ratio: float, u: float
) -> Array:
    """qdd (n,) that brings (93) and, with u_k, (99) about."""
    zdd = -2.0 * damping_ratio * np.sqrt(values) * zd - values * z
    zdd[k] = u - values[k] * z[k]
    return np.linalg.solve(loop, drift + W @ zdd)  # type: ignore[return-value]
