"""Bounds of estimates, of steps between samples and of deflections that follow from the device file.

A range of deflection that the file states too small makes no equation wrong: the spring law is estimated wherever the
joint moves. So the bounds hold for all deflections seen, by the spring law of the file, and `exceeded_text` names the
range.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from via_core.devices import Device
from via_core.modulated_rows import DAMPER_FACTOR, Samples, device_factor
from via_core.motor_stops import PRESLIDING
from via_core.signals import Array

FURTHEST, FASTEST = 1.0, 1e3  # [rad], [rad/s]: an angle that steps further is a measurement fault
STRONGEST = 10.0  # [-] largest step of a torque, over the largest torque of motor and spring


def steps_of(device: Device, inputs: tuple[str, ...]) -> tuple[Array, Array]:
    """Largest step (1 + k,) of every column between two samples, and what it grows by per second; inf: any."""
    springs = [abs(float(spring.torque(spring.max_deflection))) for spring in device.springs]
    limits = [getattr(motor, "torque_limit", None) or 0.0 for motor in device.motors]
    largest, step, rate = max([0.0, *springs, *limits]), [np.inf], [0.0]
    for name in inputs:
        angle = name == "q" or (name.startswith("theta_") and name[6:].isdigit())
        torque = name.startswith("tau") and largest > 0.0
        step.append(FURTHEST if angle else STRONGEST * largest if torque else np.inf)
        rate.append(FASTEST if angle else 0.0)
    return np.array(step), np.array(rate)


def deflections_of(device: Device, samples: Samples) -> Array:
    """Largest deflection (m,) [rad] of each transmission that lasts for three samples, so that no wild one counts."""
    phi = np.abs(samples.q[:, None] - samples.theta[:, : device.n_transmissions])
    phi = phi[np.isfinite(phi).all(axis=1)]
    return np.min([phi[:-2], phi[1:-1], phi[2:]], axis=0).max(axis=0, initial=0.0)


def exceeded(device: Device, seen: Array) -> NDArray[np.bool_]:
    """Whether the deflections seen (m,) [rad] are beyond those of the file by more than a stop yields."""
    step = (device.sensors.link_quantum or 0.0) + (device.sensors.motor_quantum or 0.0)
    limits = np.array([spring.max_deflection for spring in device.springs])
    count = min(len(limits), len(seen))
    return np.asarray(seen[:count] > limits[:count] + PRESLIDING + step)


def exceeded_text(device: Device, seen: Array) -> str:
    """The remedy for deflections seen (m,) [rad] that the file excludes, '' without one."""
    for i in np.flatnonzero(exceeded(device, seen)):
        return (
            f"deflection q - theta_{i + 1} reached {seen[i]:.3g} rad, beyond the max_deflection of "
            f"{device.springs[i].max_deflection:.3g} rad in the device file: correct it, or units and zeros of angles"
        )
    return ""


def bounds_of(device: Device, outputs: tuple[str, ...], seen: Array) -> tuple[Array, Array]:
    """Smallest and largest plausible outputs (k,) at deflections up to those of the file or seen (m,) [rad]."""
    given = device.tolerances
    late = max(1.0 / device.sensors.rate, given.torque_timing)
    factor, motor = device_factor(given.spring), device_factor(given.motor_inertia)
    stiffest = []
    for spring, far in zip(device.springs, seen, strict=False):
        reach = max(spring.max_deflection, far)
        phi = np.linspace(-reach, reach, 129)
        steepest = factor * float(np.max(spring.stiffness(phi, 0.0)))
        steepest = steepest if np.isfinite(steepest) else np.inf  # the spring law of the file may end before
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
    return np.nan_to_num(low), np.nan_to_num(high)  # without a bound the largest number: those of a state are finite
