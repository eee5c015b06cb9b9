"""Closed-loop simulation of an arm with a controller, sample by sample."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Generic

import numpy as np
from via_controllers.contract import ArmController, ArmSample, State
from via_core.errors import ParameterError
from via_core.signals import Array
from via_core.vsa_arms import VsaArm
from via_sim.robots.arm import ArmState, arm_step, contact_force
from via_sim.robots.contacts import Contact

PERIOD = 1e-3  # [s] sampling period of the controller


@dataclass(frozen=True)
class Phase:
    """An interval with the same contacts at the tip."""

    duration: float  # [s]
    contacts: tuple[Contact, ...] = ()
    substeps: int = 2  # of the simulation in a sampling period; 4 or more for walls and hands


@dataclass(frozen=True)
class TorqueNoise:
    """White noise of torque sensors: standard deviation [N m] and seed."""

    sd: float
    seed: int = 1


@dataclass(frozen=True)
class ArmRun(Generic[State]):
    """N samples of an arm with n joints; torques have zero-order hold."""

    time: Array  # (N,) [s]
    q: Array  # (N, n) [rad]
    velocity: Array  # (N, n) [rad/s]
    theta: Array  # (N, n) [rad]
    motor_velocity: Array  # (N, n) [rad/s]
    torque: Array  # (N, n) [N m] of the motors
    force: Array  # (N, 3) [N] on the tip
    values: Array  # (N, k) quantities of the controller
    names: tuple[str, ...]  # of the quantities
    saturated: float  # share of samples at which a torque was clipped
    body: ArmState = field(repr=False)  # after the last sample
    state: State = field(repr=False)  # of the controller, after the last sample

    def quantity(self, name: str) -> Array:
        """(N,) the controller's quantity of this name."""
        return np.asarray(self.values[:, self.names.index(name)])

    def since(self, time: float) -> ArmRun[State]:
        """The samples from `time` [s] on."""
        first = int(np.searchsorted(self.time, time - 0.5 * PERIOD))
        parts: dict[str, Any] = {
            name: part[first:] for name, part in vars(self).items() if isinstance(part, np.ndarray)
        }
        return replace(self, **parts)


def run_arm(
    arm: VsaArm,
    controller: ArmController[State],
    start: ArmState,
    phases: Sequence[Phase],
    state: State | None = None,
    noise: TorqueNoise | None = None,
) -> ArmRun[State]:
    """Simulate the phases one after another from `start`, without delay.

    state  initial state of the controller; None: initialised by the first sample
    noise  of the torque sensors; None: the arm has no torque sensors
    """
    count = [round(phase.duration / PERIOD) for phase in phases]
    at = [phase for phase, samples in zip(phases, count, strict=True) for _ in range(samples)]
    total, n = len(at), arm.n
    states, torque = np.empty((total, 4, n)), np.empty((total, n))
    force, values = np.zeros((total, 3)), np.empty((total, len(controller.quantities)))
    body, saturated, random = start, 0, np.random.default_rng(noise.seed if noise else 0)
    measured = np.full(n, np.nan)
    for tick in range(total):
        if noise:
            measured = arm.spring_state(body.q - body.theta)[0] + random.normal(0.0, noise.sd, n)
        sample = ArmSample(tick * PERIOD, body.q, body.velocity, body.theta, body.motor_velocity, measured)
        state, out = controller.step(controller.init(sample) if state is None else state, sample)
        states[tick] = body.q, body.velocity, body.theta, body.motor_velocity
        torque[tick], values[tick] = out.torque, controller.observe(state)
        saturated += out.saturated
        contacts = at[tick].contacts
        if contacts:
            force[tick] = contact_force(arm, body.q, body.velocity, contacts)
        body = arm_step(arm, body, out.torque, PERIOD, at[tick].substeps, contacts)
    if state is None:
        raise ParameterError("the phases contain no sample")
    q, velocity, theta, motor_velocity = states.transpose(1, 0, 2)
    share, time = saturated / total, np.arange(total, dtype=float) * PERIOD
    names = tuple(quantity.name for quantity in controller.quantities)
    return ArmRun(time, q, velocity, theta, motor_velocity, torque, force, values, names, share, body, state)
