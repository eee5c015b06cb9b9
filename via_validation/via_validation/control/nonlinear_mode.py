"""Nonlinear normal modes of an arm with its motors held: free motions in which all joints move in unison.

Without friction such a motion starts from rest, comes to rest at the other end of its path half a period later, and
returns on the same path. Its start q (n,) and its period T solve the n + 1 equations

    qd(T / 2) = 0,   |q(T / 2) - q(0)| = swing

For small swings it is a mode of (K + dg, M). From there the swing is increased in steps, each solved from the previous
one. The path is curved; its direction is the first principal component of q - q_0.
Source: Section 6.2 of the document and its [42], according to which the controller finds these motions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import root
from via_bringup.demo.reference import linear_modes
from via_core.errors import ParameterError
from via_core.signals import Array
from via_core.vsa_arms import VsaArm

RAISES = 4  # equal increases of the swing
STEPS = 120  # of the integration in half a period
REST = 1e-6  # [-] largest speed at the turning point over the speed on the way


@dataclass(frozen=True)
class NonlinearMode:
    """A nonlinear normal mode of one amplitude."""

    start: Array  # q (n,) [rad] at rest
    frequency: float  # [Hz]
    direction: Array  # (n,) [-] of unit length
    path: Array  # (STEPS + 1, n) q [rad] over half a period


def nonlinear_mode(arm: VsaArm, motors: Array, mode: int, swing: float) -> NonlinearMode:
    """The nonlinear mode that grows out of linear mode `mode`, 1 the softest, without friction.

    motors  (n,) [rad] angles at which they are held
    swing   > 0 [rad] distance between the ends of the path

    Raises ParameterError if the equations have no solution near the one for a smaller swing.
    """
    linear = linear_modes(arm, motors)
    pace = 2.0 * np.pi * float(linear.frequencies[mode - 1])
    found = np.append(0.5 * linear.directions[:, mode - 1], 2.0 * np.pi / pace)  # (q - q_0, T) of a swing of 1
    left = np.inf
    for now in swing * np.arange(1, RAISES + 1) / RAISES:

        def off(x: Array, now: float = now) -> Array:
            path, velocity = _half(arm, motors, linear.rest + now * x[:-1], x[-1])
            return np.append(velocity / (pace * now), np.linalg.norm(path[-1] - path[0]) / now - 1.0)

        found = root(off, found, tol=1e-10).x
        left = float(np.abs(off(found)).max())
    if not left < REST:
        raise ParameterError(
            f"mode {mode}: no nonlinear mode of {swing:g} rad found, residual {left:.1g}; try a smaller swing"
        )
    start = linear.rest + swing * found[:-1]
    path, _ = _half(arm, motors, start, float(found[-1]))
    motion = path - linear.rest
    return NonlinearMode(start, 1.0 / float(found[-1]), np.linalg.eigh(motion.T @ motion)[1][:, -1], path)


def _half(arm: VsaArm, motors: Array, start: Array, period: float) -> tuple[Array, Array]:
    """q (STEPS + 1, n) over half a period from rest at `start`, and qd (n,) at its end; classical Runge-Kutta."""

    def pulled(q: Array, v: Array) -> Array:
        # link_acceleration subtracts friction; add it back.
        return arm.link_acceleration(q, v, arm.link_friction * v - arm.spring_state(q - motors)[0])

    h, v = 0.5 * period / STEPS, np.zeros(arm.n)
    path = np.empty((STEPS + 1, arm.n))
    path[0] = q = start
    for i in range(STEPS):
        a1 = pulled(q, v)
        a2 = pulled(q + 0.5 * h * v, v + 0.5 * h * a1)
        a3 = pulled(q + 0.5 * h * v + 0.25 * h * h * a1, v + 0.5 * h * a2)
        a4 = pulled(q + h * v + 0.5 * h * h * a2, v + h * a3)
        q, v = q + h * v + h * h / 6.0 * (a1 + a2 + a3), v + h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
        path[i + 1] = q
    return path, v
