"""Bounds beyond which an estimate cannot come from a device near its file."""

from __future__ import annotations

import numpy as np
from via_core.devices import Device
from via_core.modulated_rows import DAMPER_FACTOR, device_factor
from via_core.signals import Array


def bounds_of(device: Device, outputs: tuple[str, ...]) -> tuple[Array, Array]:
    """Smallest and largest plausible outputs (k,)."""
    given = device.tolerances
    late = max(1.0 / device.sensors.rate, given.torque_timing)
    factor, motor = device_factor(given.spring), device_factor(given.motor_inertia)
    stiffest = []
    for spring in device.springs:
        phi = np.linspace(-spring.max_deflection, spring.max_deflection, 129)
        steepest = factor * float(np.max(spring.stiffness(phi, 0.0)))
        adjustable = not np.array_equal(spring.stiffness(phi, 0.0), spring.stiffness(phi, 1.0))
        stiffest.append(np.inf if adjustable else steepest)  # a preset has no stated limit
    low, high = np.zeros(len(outputs)), np.full(len(outputs), np.inf)
    for at, name in enumerate(outputs):
        kind, _, number = name.rpartition("_")
        if name == "gain":
            low[at], high[at] = 1.0 / factor, factor
        elif name == "damping" and device.drive == "torque" and device.arrangement == "rigid":
            high[at] = DAMPER_FACTOR * (device.link.viscous_friction + float(device.damping_of(1.0)))
        elif name == "stiffness" and device.drive == "torque":
            high[at] = sum(stiffest)
        elif kind == "stiffness" and device.drive == "torque":
            high[at] = stiffest[int(number) - 1]
        elif kind == "motor_inertia":
            inertia = getattr(device.motors[int(number) - 1], "inertia", np.inf)
            low[at], high[at] = inertia / motor, inertia * motor
        elif kind == "motor_damping" and device.drive == "torque" and stiffest:
            low[at] = -stiffest[int(number) - 1] * late  # q that is d late takes k d q' from a spring's torque
    return low, high
