"""The hopper as a `Body` for the simulator node: it is dropped at the start and cannot be pushed or held."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Self

import numpy as np
from via_core.errors import ParameterError
from via_core.hopper import JOINTS, Hopper
from via_core.signals import Array

from via_sim.robots.bodies import Body, BodyMeasurement
from via_sim.robots.hopper import HopperPlant, HopperState


@dataclass(frozen=True, eq=False)
class HopperBody(Body[HopperState]):
    """A hopper that starts `drop` [m] above ground with relaxed springs, its legs crouched by `crouch` [rad]."""

    hopper: Hopper
    crouch: float
    drop: float
    _plant: HopperPlant = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_plant", HopperPlant(self.hopper))

    @property
    def name(self) -> str:
        return "hopper"

    @property
    def joints(self) -> tuple[str, ...]:
        return JOINTS

    def init(self) -> HopperState:
        motors = self.hopper.crouched(self.crouch)
        return self._plant.start(motors, motors, self.drop)

    def step(self, state: HopperState, torque: Array, period: float) -> HopperState:
        return self._plant.step(state, torque, period)

    def limited(self, state: HopperState, torque: Array) -> Array:
        return np.clip(torque, -self.hopper.torque_limit, self.hopper.torque_limit)

    def stopped(self, state: HopperState) -> HopperState:
        return self.init()

    def measure(self, state: HopperState) -> BodyMeasurement:
        spring_torque, _, _ = self.hopper.spring_state(state.q - state.theta)
        return BodyMeasurement(state.q, state.velocity, state.theta, state.motor_velocity, spring_torque)

    def contact_force(self, state: HopperState) -> Array:
        return np.array([0.0, 0.0, state.force.sum()])

    def base(self, state: HopperState) -> Array | None:
        x, z, pitch = state.trunk
        return np.array([x, 0.0, z, 0.0, np.sin(0.5 * pitch), 0.0, np.cos(0.5 * pitch)])

    def pushed(self, state: HopperState, impulse: Array, deflection: Array) -> HopperState:
        raise ParameterError("the hopper cannot be pushed; it starts by falling")

    def held(self, state: HopperState) -> Self:
        raise ParameterError("the hopper cannot be held: it has no end effector")

    def released(self) -> Self:
        return self
