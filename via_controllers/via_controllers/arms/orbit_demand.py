"""What a modal limit cycle asks of motors and springs, as a share of their limits, and the largest possible level.

    qdd of `modal_limit_cycle`, integrated from z_k = A at rest, gives q and the torque tau of the links
    tau_e = -tau,   theta = q - phi(tau_e),   motor torque B thdd + D thd - tau_e

Derivatives of theta are differences over the last of PERIODS periods.
Source: inverse dynamics of flexible joints, (9), (10) and (105) of the document.
"""

from __future__ import annotations

from dataclasses import replace
from math import inf, isfinite, pi, sqrt
from typing import NamedTuple

import numpy as np
from via_core.errors import ParameterError
from via_core.signals import Array

from via_controllers.arms.modal_limit_cycle import ModalLimitCycle
from via_controllers.contract import rounded_down

PERIODS, STEPS = 3, 200  # simulated, and steps in each
SMALLEST, HALVINGS = 1e-3, 12  # [rad] of the joint that moves most, at the least level; steps of the bisection


class Demand(NamedTuple):
    """The limit that comes nearest."""

    limit: str  # e.g. 'torque limit of elbow'
    share: float  # [-] of it that is needed; above 1 the motors cannot follow


def require_possible(cycle: ModalLimitCycle) -> None:
    """Raise ParameterError with the largest level if motors or springs cannot give that of the cycle."""
    limit, share = demand_of(cycle)
    if share > 1.0:
        largest = largest_level(cycle)
        remedy = f"largest level: {rounded_down(largest)}" if largest else "choose another mode or equilibrium"
        needed = f"{share:.3g} times the {limit}" if isfinite(share) else f"more than the {limit}"
        raise ParameterError(f"level {cycle.level:g} of mode {cycle.mode + 1} needs {needed}; {remedy}")


def demand_of(cycle: ModalLimitCycle) -> Demand:
    """The demand of the cycle at its level."""
    arm = cycle.arm
    try:
        q, torque, step = _orbit(cycle)
        deflection = np.array([arm.deflection(-each) for each in torque])
    except (ParameterError, ArithmeticError, ValueError, np.linalg.LinAlgError):  # the orbit leaves all bounds
        return Demand("range of the springs", inf)
    speed = np.gradient(q - deflection, step, axis=0)
    motor = arm.motor_inertia * np.gradient(speed, step, axis=0) + arm.motor_friction * speed + torque
    period = slice(-STEPS - 2, -2)  # differences at the ends are of first order
    swings = {
        "torque limit": (motor, arm.torque_limit),
        "speed limit": (speed, arm.speed_limit),
        "max_deflection": (deflection, arm.deflection_limit),
    }
    found = []
    for name, (values, limit) in swings.items():
        shares = np.abs(values[period]).max(axis=0) / limit
        shares[np.isnan(shares)] = inf
        found.append(Demand(f"{name} of {arm.joints[int(shares.argmax())]}", float(shares.max())))
    return max(found, key=lambda each: each.share)


def largest_level(cycle: ModalLimitCycle) -> float:
    """The largest level [kg m^2] below that of the cycle that the motors can give, by bisection; 0: none found."""
    shape = cycle.init(cycle.equilibrium).W[:, cycle.mode]
    low, high = 0.5 * (SMALLEST / float(np.abs(shape).max())) ** 2, cycle.level
    if demand_of(replace(cycle, level=low)).share > 1.0:
        return 0.0
    for _ in range(HALVINGS):
        middle = sqrt(low * high)
        possible = demand_of(replace(cycle, level=middle)).share <= 1.0
        low, high = (middle, high) if possible else (low, middle)
    return low


def _orbit(cycle: ModalLimitCycle) -> tuple[Array, Array, float]:
    """Link angles (N, n) [rad], torques (N, n) [N m] on the links, and the time step [s]."""
    basis = cycle.init(cycle.equilibrium)
    step = 2.0 * pi / sqrt(float(basis.eigenvalues[cycle.mode])) / STEPS
    x = np.array([cycle.equilibrium + basis.W[:, cycle.mode] * cycle.amplitude, np.zeros(cycle.arm.n)])
    rows = []

    def rates(x: Array) -> Array:
        return np.array([x[1], cycle.at(basis, x[0], x[1]).acceleration])

    for _ in range(PERIODS * STEPS):
        now = cycle.at(basis, x[0], x[1])
        basis = now.basis
        rows.append((x[0], now.torque))
        k1 = np.array([x[1], now.acceleration])
        k2 = rates(x + 0.5 * step * k1)
        k3 = rates(x + 0.5 * step * k2)
        k4 = rates(x + step * k3)
        x = x + step / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
    q, torque = (np.array(each) for each in zip(*rows, strict=True))
    return q, torque, step
