"""What `modulated_torque` takes from a device file beside `transmissions`: window, damping of a transmission."""

from __future__ import annotations

from math import sqrt
from typing import Any

from via_core.devices import Device

from via_estimators.transmissions import driving_motors_of

SHORTEST, FEWEST, MOST = 0.1, 20, 400  # [s], and in intervals: windows from a device file
ENERGY = 1.98, 3010.0  # c_0 and c_2 of w_55
RELAXATION = 0.01  # [s] standard deviation of damping over stiffness of a spring: rubber has some milliseconds


def loss_of(device: Device, stiffness: float) -> dict[str, float]:
    """Prior of the damping of a transmission: that of its damper, or of a spring of `stiffness` [N m/rad]."""
    of_spring = RELAXATION * stiffness
    if device.damper is None or device.damper.site != "transmission":
        return {"loss_deviation": of_spring}
    least, most = (float(device.damping_of(u)) for u in (0.0, 1.0))
    return {"loss_prior": 0.5 * (least + most), "loss_deviation": max(most, of_spring)}


def window_for(known: dict[str, Any], device: Device) -> int:
    """Sampling intervals of the shortest window in which torque noise exceeds that of the encoders five times.

    A longer window delays the estimate and hides motion, a shorter one adds encoder noise through psi''. The variances
    are proportional to c_0 torque_noise^2 / T and c_2 (B position_noise)^2 / T^5, c_i = T^(2i+1) <psi^(i), psi^(i)>.
    """
    heaviest = max(motor.inertia for motor in driving_motors_of(device))
    balance = heaviest * known["position_noise"] / known["torque_noise"]
    span = max(SHORTEST, sqrt(balance) * (5.0 * ENERGY[1] / ENERGY[0]) ** 0.25)
    return int(min(max(round(span * device.sensors.rate), FEWEST), MOST))
