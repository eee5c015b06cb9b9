"""Closed loop of an arm whose plant differs from the controller's model, with delay, rate, noise, friction, estimators.

The controller runs under its supervisor, as in its node, with the limits of its model. Samples come at `rate` and their
command acts `delay` later; in between the last one acts. Efforts are the mean torques over the interval that ends at
the sample, as a drive reports them. Encoders are rounded to `encoder` and velocities are differences of rounded angles
behind a low pass; without an encoder all values are exact.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from math import tanh
from typing import Any

import numpy as np
from via_controllers.arms.adaptive_limit_cycle import AdaptiveLimitCycle, AdaptiveSwing
from via_controllers.contract import ArmController, ArmSample
from via_controllers.low_pass import low_passed
from via_controllers.robot import ControlledArm
from via_core.devices import load_device
from via_core.signals import Array
from via_core.status import Status
from via_core.vsa_arms import VsaArm
from via_estimators.contract import Live
from via_estimators.methods import estimator_for
from via_estimators.payload import Payload
from via_sim.robots.arm import ArmState, limited_torque

SUBSTEP = 5e-4  # [s] of the simulation
STICTION = 0.01  # [rad/s] velocity over which dry friction turns around
VELOCITY_BANDWIDTH = 600.0  # [rad/s] of the low pass of differenced angles


@dataclass(frozen=True)
class ModelError:
    """What the controller's model does not contain."""

    payload: float = 0.0  # [kg] at the tip
    spring_scale: float = 1.0  # spring torques over the file's [-]
    link_friction: float = 0.0  # [N m s/rad] viscous, every link
    dry_friction: float = 0.0  # [N m] of every motor
    delay: float = 0.0  # [s] from sample to torque, a multiple of SUBSTEP
    rate: float = 1000.0  # [Hz] of samples
    encoder: float = 0.0  # [rad] step of all encoders; 0: exact angles and velocities
    stated_delay: float = 0.0  # [s] parameter `delay` of the controller

    def plant(self, arm: VsaArm) -> VsaArm:
        """The real arm, without dry friction."""
        return arm.corrected(self.payload, np.full(arm.n, self.spring_scale), self.link_friction)


class Estimators:
    """Payload and stiffness estimators of an arm, in process; `inform` passes their results to the controller."""

    def __init__(self, arm: VsaArm, name: str) -> None:
        self.payload = Live(Payload(arm))
        self.joints = [Live(estimator_for(load_device(f"{name}:{joint}"))) for joint in arm.joints]

    def inform(
        self, controller: AdaptiveLimitCycle, sample: ArmSample, effort: Array, state: AdaptiveSwing
    ) -> AdaptiveSwing:
        """The controller's state with the estimates at `sample`, `effort` (n,) [N m] of the motors up to it."""
        time, n = sample.time, len(self.joints)
        row = np.concatenate([[time], sample.q, sample.theta, effort])
        status = Status(self.payload.take(row[None]))
        state = controller.with_payload(state, time, status, *self.payload.numbers.reshape(2, -1).copy())
        for i in range(n):
            joint = self.joints[i]
            status = Status(joint.take(np.array([[time, sample.q[i], sample.theta[i], effort[i]]])))
            value, sd = float(joint.value[0]), float(joint.standard_deviation[0])
            state = controller.with_stiffness(state, i, time, status, value, sd)
        return state


@dataclass(frozen=True)
class ErrorRun:
    """N samples of the real arm; `finished` is False if a spring came to its stop or the supervisor stopped the motors.

    Both end the run.
    """

    time: Array  # (N,) [s]
    q: Array  # (N, n) [rad]
    velocity: Array  # (N, n) [rad/s]
    values: Array  # (N, k) quantities of the controller
    names: tuple[str, ...]
    finished: bool

    def quantity(self, name: str) -> Array:
        """(N,) the controller's quantity of this name."""
        return np.asarray(self.values[:, self.names.index(name)])


def run_with_error(
    model: VsaArm, controller: ArmController[Any], start: ArmState, error: ModelError, duration: float,
    estimators: Estimators | None = None,
) -> ErrorRun:  # fmt: skip
    """Simulate `controller`, made for `model`, on the arm with `error` from `start`; estimators inform it if given."""
    supervisor = ControlledArm.with_holding(model, controller, error.stated_delay).supervisor
    plant, n = error.plant(model), model.n
    per, late = round(1.0 / (error.rate * SUBSTEP)), round(error.delay / SUBSTEP)
    x = np.array([start.q, start.velocity, start.theta, start.motor_velocity])
    unknown, zero = np.full(n, np.nan), np.zeros(n)
    hold, measured, state = -model.spring_state(x[0] - x[2])[0], _Measured(error), supervisor.init()
    waiting: list[tuple[int, Array]] = []
    effort, rows = hold.copy(), []
    for tick in range(round(duration * error.rate)):
        time = tick / error.rate
        q, v, theta, w = measured.at(x, 1.0 / error.rate)
        sample = ArmSample(time, q, v, theta, w, unknown)
        state, out = supervisor.step(state, sample, active=True)
        if estimators is not None and isinstance(controller, AdaptiveLimitCycle):  # of this sample, for the next one
            state = supervisor.updated(state, partial(estimators.inform, controller, sample, effort))
        rows.append(np.concatenate([[time], x[0], x[1], supervisor.observe(state)]))
        waiting.append((tick * per + late, out.torque))
        effort = np.zeros(n)
        for k in range(per):
            while waiting and waiting[0][0] <= tick * per + k:
                hold = waiting.pop(0)[1]
            applied = limited_torque(plant, x[3], hold)
            x = _stepped(plant, x, applied, error.dry_friction, zero)
            effort += applied / per
        if out.fault or not (np.abs(x[0] - x[2]) <= model.deflection_limit).all():
            break
    found = np.array(rows)
    names = tuple(each.name for each in controller.quantities)
    finished = len(found) == round(duration * error.rate) and not out.fault
    split = np.split(found, [1, 1 + n, 1 + 2 * n], axis=1)
    return ErrorRun(split[0][:, 0], split[1], split[2], split[3], names, finished)


def _stepped(plant: VsaArm, x: Array, torque: Array, dry: float, no_load: Array) -> Array:
    """State (4, n) one SUBSTEP later: Runge-Kutta of fourth order under constant torque and dry friction."""

    def rate(x: Array) -> Array:
        friction = dry * np.array([tanh(w / STICTION) for w in x[3]]) if dry else 0.0
        return plant.rates(x, torque - friction, no_load)

    h = SUBSTEP
    k1 = rate(x)
    k2 = rate(x + 0.5 * h * k1)
    k3 = rate(x + 0.5 * h * k2)
    k4 = rate(x + h * k3)
    return np.asarray(x + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4))


class _Measured:
    """Measurements of the state (4, n), rounded by encoders."""

    def __init__(self, error: ModelError) -> None:
        self.step = error.encoder
        self.before: Array | None = None
        self.velocity = np.zeros((2, 0))

    def at(self, x: Array, passed: float) -> Array:
        """(4, n) at the true state `x`, `passed` [s] after the last call."""
        if not self.step:
            return x.copy()
        angles = self.step * np.round(x[[0, 2]] / self.step)
        if self.before is None:
            self.velocity = x[[1, 3]].copy()
        else:
            self.velocity = low_passed(self.velocity, self.before, angles, passed, VELOCITY_BANDWIDTH)
        self.before = angles
        return np.array([angles[0], self.velocity[0], angles[1], self.velocity[1]])
