"""Parts shared by the stiffness estimators that use the torque equation of the motors.

Such an estimator reads q, then theta_i and tau_i of each transmission i, and returns the stiffness of the joint, then
that of each transmission. Each module forms and solves its own equation from these signals.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np
from numba import njit
from via_core.device_parts import TorqueMotor
from via_core.devices import Device
from via_core.errors import ParameterError
from via_core.signals import Array
from via_core.status import NOT_EXCITED, OK, OUTSIDE_RANGE, WARMING_UP

from via_estimators import window
from via_estimators.slots import row_of, slots

TYPICAL = 0.05  # of the spring's largest torque: friction, or a constant torque
VISITED = slots("low", "high", "any")  # smallest and largest deflection visited [rad], 1 if there is any
# Sums over the transmissions of a joint; worst status and smallest range of motion of them.
JOINT = slots("stiffness", "variance", "slope", "common", "status", "motion")


def motors_of(device: Device) -> tuple[TorqueMotor, ...]:
    """The motors of a device's transmissions; raises ParameterError unless all are torque-driven."""
    motors = tuple(motor for motor in device.motors if isinstance(motor, TorqueMotor))
    if not device.n_transmissions or len(motors) < device.n_transmissions:
        raise ParameterError(f"'{device.name}' has no torque-driven transmission; its torque equation is not known")
    return motors


def driving_motors_of(device: Device) -> tuple[TorqueMotor, ...]:
    """Those of `motors_of` that load a spring: not the one that sets the preset of a serial joint."""
    return motors_of(device)[: device.n_transmissions]


def given_motors_of(device: Device, inertia: float, damping: float) -> dict[str, Any]:
    """Inertia and damping of each motor for methods that do not estimate them; standard deviations over them."""
    known: dict[str, Any] = {}
    for suffix, motor in zip(("", "_2"), driving_motors_of(device), strict=False):
        known |= {f"inertia{suffix}": motor.inertia, f"inertia_tolerance{suffix}": inertia * motor.inertia}
        friction = motor.viscous_friction
        known |= {f"damping{suffix}": friction, f"damping_tolerance{suffix}": damping * friction}
    return known


def known_of(device: Device) -> dict[str, Any]:
    """Parameters that every form of the equation takes from a device file: counts, scales and sensor noise.

    One number serves all transmissions and must not depend on their order: the largest scale, the least motion.
    """
    springs, sensors = device.springs, device.sensors
    stops = [spring.max_deflection for spring in springs]
    quantum = max(sensors.link_quantum or 0.0, sensors.motor_quantum or 0.0)
    strongest = max(float(spring.torque(spring.max_deflection)) for spring in springs)
    return {
        "transmissions": device.n_transmissions,
        "deflection_scale": max(stops),
        "torque_noise": sensors.torque_noise or 1e-3 * strongest,
        "position_noise": quantum / sqrt(12.0),
        "minimum_motion": max(0.001 * min(stops), 4.0 * quantum),
    }


def encoders_of(device: Device) -> dict[str, Any]:
    """Quantum and white noise [rad] of the encoders, parameters of the Kalman filters of the angles."""
    quantum = max(device.sensors.link_quantum or 0.0, device.sensors.motor_quantum or 0.0)
    return {"quantum": quantum, "position_noise": max(0.1 * quantum, 1e-9)}


def priors_of(device: Device) -> dict[str, Any]:
    """Prior means and standard deviations of stiffness, motor inertia and damping: the device file's orders of size.

    One prior serves all transmissions: the mean of their numbers, with a standard deviation of the largest.
    """
    motors = driving_motors_of(device)
    stiffness = [spring.stiffness(np.linspace(0.0, spring.max_deflection, 65)) for spring in device.springs]
    inertia, damping = [motor.inertia for motor in motors], [motor.viscous_friction for motor in motors]
    return {
        "stiffness_prior": float(np.mean(stiffness)),
        "stiffness_deviation": 3.0 * float(np.max(stiffness)),
        "inertia_prior": float(np.mean(inertia)),
        "inertia_deviation": max(inertia),
        "damping_prior": float(np.mean(damping)),
        "damping_deviation": max(*damping, 1e-6),
    }


def torques_of(device: Device) -> dict[str, Any]:
    """Priors [N m] of the torques beside a spring law that is 0 in the middle: dry friction, and a constant.

    Either may be some percent of the largest torque of a spring, whatever the device file says: the constant is due to
    the zeros of two encoders and of the torque, and to the spring law.
    """
    friction = [motor.coulomb_friction for motor in driving_motors_of(device)]
    typical = TYPICAL * max(abs(float(spring.torque(spring.max_deflection))) for spring in device.springs)
    return {
        "friction_prior": float(np.mean(friction)),
        "friction_deviation": max(*friction, typical),
        "constant_deviation": max(*(abs(float(spring.torque(0.0))) for spring in device.springs), typical),
    }


def inputs_of(transmissions: int) -> tuple[str, ...]:
    """Columns of a sample after its time."""
    return ("q", *(f"{name}_{i}" for i in range(1, transmissions + 1) for name in ("theta", "tau")))


def outputs_of(transmissions: int, *each: str) -> tuple[str, ...]:
    """Columns of an estimate: stiffness of the joint and of each transmission, then `each` once per transmission."""
    return ("stiffness", *(f"{name}_{i}" for name in ("stiffness", *each) for i in range(1, transmissions + 1)))


def prior_rows(parameters: Any, coefficients: int) -> tuple[Array, Array]:
    """Prior means and standard deviations (2 + coefficients,) of inertia, damping and the spring law's coefficients."""
    mean, width = np.zeros(2 + coefficients), np.full(2 + coefficients, parameters.stiffness_deviation)
    mean[:3] = parameters.inertia_prior, parameters.damping_prior, parameters.stiffness_prior
    width[:2] = parameters.inertia_deviation, parameters.damping_deviation
    return mean, width


def prior_outputs(parameters: Any, *names: str) -> Array:
    """Values and standard deviations (2 k,) before any data, of stiffness and `names`, in the order of `outputs_of`."""
    m = parameters.transmissions
    each = [name for name in ("stiffness", *names) for _ in range(m)]
    means = [getattr(parameters, f"{name}_prior") for name in each]
    widths = [getattr(parameters, f"{name}_deviation") for name in each]
    return np.array([m * means[0], *means, sqrt(m) * widths[0], *widths])


def of_each_motor(table: Any, parameters: Any, **given: float) -> list[Array]:
    """`row_of` for every motor: its inertia and damping [SI] with their standard deviations, where these are given."""
    names = ("inertia", "inertia_tolerance", "damping", "damping_tolerance")
    each = [{name: getattr(parameters, name + suffix) for name in names} for suffix in ("", "_2")]
    return [row_of(table, parameters, **given, **own) for own in each[: parameters.transmissions]]


@njit(cache=True, error_model="numpy", forceinline=True)
def enter(state: Array, times: Array, row: Array, columns: int, furthest: float, max_gap: float) -> int:
    """`window.admit` for row (time, q, theta_1, .., theta_2, ..); also refuses deflections beyond `furthest` [rad].

    columns  of a sample per transmission, theta_i first
    """
    for at in range(2, row.size, columns):
        if abs(row[1] - row[at]) > furthest:
            return window.refuse(state)
    return window.admit(state, times, row, row.size, max_gap)


@njit(cache=True, error_model="numpy", forceinline=True)
def visit(visited: Array, phi: float) -> None:
    """Extend the range of deflections visited."""
    visited[VISITED.low] = min(visited[VISITED.low], phi) if visited[VISITED.any] > 0.0 else phi
    visited[VISITED.high] = max(visited[VISITED.high], phi) if visited[VISITED.any] > 0.0 else phi
    visited[VISITED.any] = 1.0


@njit(cache=True, error_model="numpy", forceinline=True)
def inside(visited: Array, phi: float, margin: float) -> bool:
    """Whether phi lies in the range visited, widened by the share `margin` of it."""
    room = margin * (visited[VISITED.high] - visited[VISITED.low])
    return visited[VISITED.low] - room <= phi <= visited[VISITED.high] + room


@njit(cache=True, error_model="numpy", forceinline=True)
def begin(joint: Array) -> None:
    """Overwrite the sums JOINT of the last sample."""
    joint[:] = 0.0
    joint[JOINT.status], joint[JOINT.motion] = OK, np.inf


@njit(cache=True, error_model="numpy", forceinline=True)
def update(value: Array, sd: Array, at: int, new_value: float, new_sd: float, learning: bool) -> None:
    """Write output `at`.

    While nothing is learnt, forgetting replaces data by the pull towards the last estimate, which contains no new
    information: the standard deviation must not fall then.
    """
    value[at], sd[at] = new_value, max(new_sd, (0.0 if learning else 1.0) * sd[at])


@njit(cache=True, error_model="numpy", forceinline=True)
def add(joint: Array, stiffness: float, sd: float, slope: float, q_variance: float, common: float) -> None:
    """Add one transmission's stiffness [N m/rad] to the joint's; the transmissions share the noise of q.

    slope       d stiffness / d phi [N m/rad^2]
    q_variance  [rad^2]
    common      part of sd whose cause may be the same in all transmissions: these parts add without squares
    """
    joint[JOINT.stiffness] += stiffness
    joint[JOINT.variance] += sd**2 + 2.0 * (joint[JOINT.slope] * slope * q_variance + joint[JOINT.common] * common)
    joint[JOINT.slope] += slope
    joint[JOINT.common] += common


@njit(cache=True, error_model="numpy", forceinline=True)
def grade(joint: Array, warming: bool, moving: bool, visited: bool) -> None:
    """Lower the joint's status to that of one transmission, if that is worse."""
    if warming:
        joint[JOINT.status] = WARMING_UP
    elif joint[JOINT.status] != WARMING_UP and not moving:
        joint[JOINT.status] = NOT_EXCITED
    elif joint[JOINT.status] == OK and not visited:
        joint[JOINT.status] = OUTSIDE_RANGE


@njit(cache=True, error_model="numpy", forceinline=True)
def finish(joint: Array, state: Array, value: Array, sd: Array, out: Array) -> None:
    """Write the joint's stiffness, motion and status into the state and the output row."""
    value[0], sd[0] = joint[JOINT.stiffness], sqrt(max(joint[JOINT.variance], 0.0))
    state[window.HEADER.motion], state[window.HEADER.status] = joint[JOINT.motion], joint[JOINT.status]
    window.answer(state, int(joint[JOINT.status]), out)
