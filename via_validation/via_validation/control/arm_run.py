"""A law on a simulated arm, sample by sample: what sensors would have said, what the law commanded and told."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Generic

import numpy as np
from via_controllers.contract import ArmController, ArmSample, State
from via_core.errors import ParameterError
from via_core.signals import Array
from via_core.vsa_arms import VsaArm
from via_sim.arm import ArmState, arm_step, contact_force
from via_sim.contacts import Contact

PERIOD = 1e-3  # [s] of the law


@dataclass(frozen=True)
class Phase:
    """A stretch of time in which the same things touch the tip."""

    duration: float  # [s]
    contacts: tuple[Contact, ...] = ()


@dataclass(frozen=True)
class ArmRun(Generic[State]):
    """N samples of an arm of n joints; torques are held from one sample to the next."""

    time: Array  # (N,) [s]
    q: Array  # (N, n) [rad]
    velocity: Array  # (N, n) [rad/s]
    theta: Array  # (N, n) [rad]
    motor_velocity: Array  # (N, n) [rad/s]
    torque: Array  # (N, n) [N m] of the motors
    force: Array  # (N, 3) [N] on the tip
    told: Array  # (N, k) the law's quantities
    names: tuple[str, ...]  # of the quantities
    saturated: float  # share of samples at which a torque was cut
    body: ArmState = field(repr=False)  # after the last sample
    state: State = field(repr=False)  # the law's, after the last sample

    def quantity(self, name: str) -> Array:
        """(N,) what the law told under this name."""
        return np.asarray(self.told[:, self.names.index(name)])

    def since(self, time: float) -> ArmRun[State]:
        """The samples from `time` [s] on."""
        first = int(np.searchsorted(self.time, time - 0.5 * PERIOD))
        parts: dict[str, Any] = {
            name: part[first:] for name, part in vars(self).items() if isinstance(part, np.ndarray)
        }
        return replace(self, **parts)


def run_arm(
    arm: VsaArm,
    law: ArmController[State],
    start: ArmState,
    phases: Sequence[Phase],
    substeps: int = 2,
    state: State | None = None,
    torque_noise: float = 0.0,
    seed: int = 1,
) -> ArmRun[State]:
    """The phases one after another, from `start`, without delay.

    substeps      of the simulation in a millisecond, 4 or more for walls and hands
    state         the law's, to go on from; None: what it makes of the first sample
    torque_noise  [N m] standard deviation of torque sensors; 0: there are none
    """
    count = [round(phase.duration / PERIOD) for phase in phases]
    contacts = [phase.contacts for phase, samples in zip(phases, count, strict=True) for _ in range(samples)]
    total, n, free = len(contacts), arm.n, np.zeros(arm.n)
    states, torque = np.empty((total, 4, n)), np.empty((total, n))
    force, told = np.zeros((total, 3)), np.empty((total, len(law.quantities)))
    body, saturated, random = start, 0, np.random.default_rng(seed)
    measured = np.full(n, np.nan)
    for tick in range(total):
        if torque_noise:
            measured = arm.spring_state(body.q - body.theta)[0] + random.normal(0.0, torque_noise, n)
        sample = ArmSample(tick * PERIOD, body.q, body.velocity, body.theta, body.motor_velocity, measured)
        state, out = law.step(law.init(sample) if state is None else state, sample)
        states[tick] = body.q, body.velocity, body.theta, body.motor_velocity
        torque[tick], told[tick] = out.torque, law.told(state)
        saturated += out.saturated
        if contacts[tick]:
            force[tick] = contact_force(arm, body.q, body.velocity, contacts[tick])
        body = arm_step(arm, body, out.torque, free, PERIOD, substeps, contacts[tick])
    if state is None:
        raise ParameterError("phases hold no sample")
    q, velocity, theta, motor_velocity = states.transpose(1, 0, 2)
    share, time = saturated / total, np.arange(total, dtype=float) * PERIOD
    names = tuple(quantity.name for quantity in law.quantities)
    return ArmRun(time, q, velocity, theta, motor_velocity, torque, force, told, names, share, body, state)
