"""A law of an arm in closed loop with the simulated arm: a sample each millisecond, torques held until the next."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Generic

import numpy as np
from via_controllers.contract import ArmController, ArmSample, State
from via_core.signals import Array
from via_core.vsa_arms import VsaArm
from via_sim.arm import ArmState, arm_step, contact_force
from via_sim.contacts import Contact

PERIOD = 1e-3  # [s]
Contacts = Callable[[float, ArmState], Sequence[Contact]]  # what is met at a time [s], in a state


def free(time: float, state: ArmState) -> Sequence[Contact]:
    """Nothing is met."""
    return ()


@dataclass(frozen=True)
class ArmCourse(Generic[State]):
    """What a run was like at its N samples, n joints; `body` and `state` are those of the sample that would be next."""

    time: Array  # (N,) [s]
    q: Array  # (N, n) [rad], truth as all that follows
    velocity: Array  # (N, n) [rad/s]
    theta: Array  # (N, n) [rad]
    motor_velocity: Array  # (N, n) [rad/s]
    torque: Array  # (N, n) [N m] commanded
    force: Array  # (N, 3) [N] of contacts on the tip
    told: Array  # (N, k) the law's quantities
    names: tuple[str, ...]  # of them
    saturated: bool  # some motor was asked for more than its limit, at some time
    body: ArmState = field(repr=False)
    state: State = field(repr=False)

    def quantity(self, name: str) -> Array:
        """(N,) what the law told under this name."""
        return np.asarray(self.told[:, self.names.index(name)])


@dataclass(frozen=True, eq=False)
class ArmLoop(Generic[State]):
    """An arm and its law."""

    arm: VsaArm
    law: ArmController[State]
    torque_noise: float = 0.0  # [N m] standard deviation of the torque sensors; 0: there are none
    substeps: int = 2  # of the simulation in a period; contacts want 4

    def sample(self, body: ArmState, time: float, random: np.random.Generator) -> ArmSample:
        """What the sensors say of `body`."""
        told = np.full(self.arm.n, np.nan)
        if self.torque_noise:
            told = self.arm.spring_state(body.q - body.theta)[0] + random.normal(0.0, self.torque_noise, self.arm.n)
        return ArmSample(time, body.q, body.velocity, body.theta, body.motor_velocity, told)

    def run(
        self,
        body: ArmState,
        duration: float,
        contacts: Contacts = free,
        state: State | None = None,
        begin: float = 0.0,
        seed: int = 1,
    ) -> ArmCourse[State]:
        """The course from `body` over `duration` [s]; `state` is the law's, None: what it makes of the first sample."""
        random, law, still = np.random.default_rng(seed), self.law, np.zeros(self.arm.n)
        rows, told, torques, forces, saturated = [], [], [], [], False
        ticks = round(duration / PERIOD)
        for tick in range(ticks):
            time = begin + tick * PERIOD
            sample = self.sample(body, time, random)
            state, out = law.step(law.init(sample) if state is None else state, sample)
            met = contacts(time, body)
            rows.append((body.q, body.velocity, body.theta, body.motor_velocity))
            told.append(law.told(state))
            torques.append(out.torque)
            forces.append(contact_force(self.arm, body.q, body.velocity, met) if met else np.zeros(3))
            saturated |= out.saturated
            body = arm_step(self.arm, body, out.torque, still, PERIOD, self.substeps, met)
        assert state is not None  # a run has samples
        q, velocity, theta, motor_velocity = np.moveaxis(np.array(rows), 1, 0)
        names = tuple(quantity.name for quantity in law.quantities)
        stamps = begin + PERIOD * np.arange(float(ticks))
        return ArmCourse(
            stamps, q, velocity, theta, motor_velocity, np.array(torques), np.array(forces),
            np.array(told), names, saturated, body, state,
        )  # fmt: skip
