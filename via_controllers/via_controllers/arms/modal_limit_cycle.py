"""Limit cycle of an arm on one mode, with the other modes damped: eqs. (81)-(104), for a rigid arm.

In modal coordinates of M(q) and a constant K_d the desired closed loop is, mode by mode,

    i != k   zdd_i + 2 xi sqrt(lambda_i) zd_i + lambda_i z_i = 0                                      (93), D_d by (86)
    i == k   zdd_k + lambda_k z_k = u_k,   H = zd_k^2 / (2 lambda_k) + z_k^2 / 2                      (99), (100)
             u_k = lambda_k (-k_V (H - H_d) zd_k + lambdad_k / (2 lambda_k^2) zd_k)                   (102) corrected
             Hd = -k_V (H - H_d) zd_k^2,   V = (H - H_d)^2 / 2                                        (103), (104)

(102) is printed with zd_k^2 in its last term, which does not cancel the term of (101): H then oscillates by a tenth of
H_d and more. The torque is that of (82), (90) and (91). Its gamma contains Wdd and with it the acceleration that the
torque causes. Solving for the acceleration first removes this loop, A_k = W^-1 dW/dq_k:

    (I - W [A_1 z ... A_n z]) qdd = (Wdd z at qdd = 0) + 2 Wdot zd + W zdd,   tau = M qdd + C qd + g

z = 0 is an unstable equilibrium: the motion starts with a push, or with `self_start`, which adds lambda_k s to u_k
while H is well below H_d. The time to converge without it follows from (103): zd_k^2 averages lambda_k H over a cycle,
so that with h = H / H_d

    hd = k_V lambda_k H_d h (1 - h),   1 / h(t) - 1 = (1 / h(0) - 1) exp(-k_V lambda_k H_d t)

**Far from the cycle**, after a fall or a throw, motors cannot give these torques, and the arm would swing at their
limits for good. Where k_V (H - H_d) sqrt(lambda_k) exceeds 2, mode k is damped critically, u_k = -2 sqrt(lambda_k)
zd_k; and lambda_i z_i is multiplied by the largest r <= 1 with |r K_d (q - q_d)| within STRENGTH of what the springs
hold.
Source: the document's Section 6.1; it has neither `self_start` nor the case far from the cycle.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from math import sqrt
from typing import NamedTuple

import numpy as np
from numba import njit
from via_core.signals import Array, locked
from via_core.vsa_arms import VsaArm, inertia_of

from via_controllers.arms import self_start
from via_controllers.arms.modal_transform import (
    ModalBasis,
    basis_near,
    first_basis,
    next_basis,
    rates_along,
    second_along,
)
from via_controllers.contract import require, require_positive

WALK = 0.02  # [rad] step between configurations along which modes are tracked
CRITICAL = 2.0  # damping over sqrt(lambda) that is critical
STRENGTH = 0.5  # of the stops of the springs; the other half is for gravity and motion


class ModalMotion(NamedTuple):
    """Modal state and desired torque at one time."""

    basis: ModalBasis
    z: Array  # (n,) modal coordinates [sqrt(kg m^2) rad]
    z_velocity: Array  # (n,)
    eigenvalue_rates: Array  # (n,) lambdad [1/s^3]
    H: float  # of mode k, (100)
    V: float  # (104)
    acceleration: Array  # desired qdd (n,) [rad/s^2]
    torque: Array  # (n,) [N m] on the links
    direction: float  # p of `self_start` [-]
    turning: float  # pd [1/s]
    push: float  # s [sqrt(kg m^2) rad]


@dataclass(frozen=True, eq=False)
class ModalLimitCycle:
    """The controller. Raises ParameterError for values outside the stated ranges."""

    arm: VsaArm
    equilibrium: Array  # q_d (n,) [rad]
    stiffness: Array  # K_d (n, n) [N m/rad], symmetric and positive definite
    mode: int  # k, 0 is the softest at the equilibrium
    damping_ratio: float  # xi > 0 of the other modes
    gain: float  # k_V > 0 [s/(kg m^2)]
    level: float  # H_d > 0 [kg m^2]: half the squared amplitude of z_k
    start: float = self_start.START  # a of `self_start`, 0 to 1 [-]; 0: the arm stays at rest at z = 0
    _strength: Array = field(init=False, repr=False)  # (n,) [N m] of the springs at STRENGTH of their stops

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
        require_positive(self, "damping_ratio", "gain", "level")
        require(0.0 <= self.start <= 1.0, f"start must lie in 0 to 1, got {self.start}")
        object.__setattr__(self, "_strength", locked(self.arm.spring_strength(STRENGTH), "strength"))

    @cached_property
    def amplitude(self) -> float:
        """A [sqrt(kg m^2) rad] of z_k on the cycle."""
        return sqrt(2.0 * self.level)

    def init(self, q: Array) -> ModalBasis:
        """The basis at `q` (n,) [rad], with modes in the order of the equilibrium."""
        distance = q - self.equilibrium
        basis = first_basis(self.arm.inertia(self.equilibrium), self.stiffness)
        for share in np.linspace(0.0, 1.0, 2 + int(np.abs(distance).max() / WALK))[1:]:
            basis = next_basis(basis, self.arm.inertia(self.equilibrium + share * distance), self.stiffness)
        return basis

    def at(self, near: ModalBasis, q: Array, velocity: Array, direction: float = 0.0) -> ModalMotion:
        """The desired motion at `q`, `velocity` (n,) [rad, rad/s].

        near       the basis just before
        direction  p of `self_start` now; `turning` of the result is its rate; 0: without `self_start`
        """
        arm, k = self.arm, self.mode
        modal = _modal(near.W, *arm.inertia_terms(q, velocity), self.stiffness, self.equilibrium, q, velocity)
        value, z, speed = float(modal.values[k]), float(modal.z[k]), float(modal.zd[k])
        H = 0.5 * (speed**2 / value + z**2)
        pull = self.gain * (H - self.level)
        far = pull * sqrt(value) > CRITICAL
        u = -CRITICAL * sqrt(value) * speed if far else orbit_input(value, float(modal.rates[k]), pull, speed)
        A, w = self.amplitude, sqrt(value)
        s = A * self_start.push(self.start, direction, H / self.level)
        if s != 0.0:
            u += value * s
        turning = self_start.turning(self.start, direction, z / A, speed / (w * A), w)
        returned = _returned(self.stiffness, self.equilibrium, q, self._strength)
        acceleration = _accelerated(modal, k, self.damping_ratio, u, returned)
        torque = arm.link_torque(q, velocity, acceleration)
        V = 0.5 * (H - self.level) ** 2
        return ModalMotion(
            ModalBasis(modal.W, modal.values), modal.z, modal.zd, modal.rates, H, V, acceleration, torque, direction,
            turning, s,
        )  # fmt: skip


def orbit_input(eigenvalue: float, rate: float, pull: float, z_velocity: float) -> float:
    """u_k of (102) corrected; `pull` = k_V (H - H_d) [1/s]."""
    return eigenvalue * (-pull * z_velocity + rate / (2.0 * eigenvalue**2) * z_velocity)


class _Modal(NamedTuple):
    """Modal quantities of a motion of n joints."""

    W: Array  # (n, n), modes in the order of the basis before
    values: Array  # lambda (n,)
    z: Array  # (n,)
    zd: Array  # (n,)
    rates: Array  # lambdad (n,)
    drift: Array  # (n,) W (W^-1 Wdd z + 2 A zd) at qdd = 0
    loop: Array  # (n, n) I - W [A_1 z ... A_n z]


@njit(cache=True, error_model="numpy")
def _modal(near: Array, terms: Array, h: float, K: Array, equilibrium: Array, q: Array, velocity: Array) -> _Modal:
    """Modal quantities; `near` is W just before, `terms` and `h` are those of `VsaArm.inertia_terms`."""
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
    return _Modal(W, values, z, zd, rates, drift, loop)


@njit(cache=True, error_model="numpy")
def _returned(K: Array, equilibrium: Array, q: Array, strength: Array) -> float:
    """Share r of the torques that return the links to their equilibrium."""
    share = 1.0
    for i in range(len(q)):
        wanted = 0.0
        for j in range(len(q)):
            wanted += K[i, j] * (q[j] - equilibrium[j])
        share = min(share, strength[i] / max(abs(wanted), strength[i]))
    return share


@njit(cache=True, error_model="numpy")
def _accelerated(modal: _Modal, k: int, damping_ratio: float, u: float, returned: float) -> Array:
    """qdd (n,) that results in (93) and, with u_k = u, in (99); `returned` as of `_returned`."""
    zdd = -2.0 * damping_ratio * np.sqrt(modal.values) * modal.zd - returned * modal.values * modal.z
    zdd[k] = u - returned * modal.values[k] * modal.z[k]
    return np.linalg.solve(modal.loop, modal.drift + modal.W @ zdd)  # type: ignore[return-value]
