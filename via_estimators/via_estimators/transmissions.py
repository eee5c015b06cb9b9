"""What estimators of the motors' torque equation share: what a device tells them, their columns, and their door.

Such an estimator takes q, then theta_i and tau_i of each transmission i, and gives the joint's stiffness, then that of
each transmission. Which equation it makes of them, and how it is solved, is its own file's.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

from numba import njit
from via_core.device_parts import TorqueMotor
from via_core.devices import Device
from via_core.errors import ParameterError
from via_core.signals import Array

from via_estimators import window


def motors_of(device: Device) -> tuple[TorqueMotor, ...]:
    """The motors behind a device's transmissions; raises ParameterError unless each is driven by torque."""
    motors = tuple(motor for motor in device.motors if isinstance(motor, TorqueMotor))
    if not device.n_transmissions or len(motors) < device.n_transmissions:
        raise ParameterError(f"'{device.name}' has no torque-driven transmission; its torque equation is not known")
    return motors


def known_of(device: Device) -> dict[str, Any]:
    """Parameters that a device file tells whatever is made of the equation: counts, scales, and the sensors' noise."""
    law, sensors = device.spring_laws[0], device.sensors
    stop = law.max_deflection
    quantum = max(sensors.link_quantum or 0.0, sensors.motor_quantum or 0.0)
    return {
        "transmissions": device.n_transmissions,
        "deflection_scale": stop,
        "torque_noise": sensors.torque_noise or 1e-3 * float(law.torque(stop)),
        "position_noise": quantum / sqrt(12.0),
        "minimum_motion": max(0.001 * stop, 4.0 * quantum),
    }


def inputs_of(transmissions: int) -> tuple[str, ...]:
    """Columns of a sample after its time."""
    return ("q", *(f"{name}_{i}" for i in range(1, transmissions + 1) for name in ("theta", "tau")))


def outputs_of(transmissions: int, *each: str) -> tuple[str, ...]:
    """Columns of an estimate: the joint's stiffness, each transmission's, and `each` once per transmission."""
    return ("stiffness", *(f"{name}_{i}" for name in ("stiffness", *each) for i in range(1, transmissions + 1)))


@njit(cache=True, error_model="numpy")
def enter(state: Array, times: Array, row: Array, transmissions: int, furthest: float, max_gap: float) -> int:
    """`window.admit` for row (time, q, theta_1, tau_1, ..), which also refuses a deflection beyond `furthest` [rad]."""
    for i in range(transmissions):
        if abs(row[1] - row[2 + 2 * i]) > furthest:
            return window.refuse(state)
    return window.admit(state, times, row, 2 + 2 * transmissions, max_gap)
