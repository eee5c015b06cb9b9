"""Base of the holding controllers: springs and dampers hold the motors of an arm or a joint at their initial angles.

tau_i = tau_0,i + K_P,i (theta_0,i - theta_i) - K_D,i thd_i
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from via_core.signals import Array

from via_controllers.contract import ArmController, ArmSample, Quantity, Torques, limited, passive


@dataclass(frozen=True)
class Held:
    """Reference, gains and limits, (n,) each."""

    theta: Array  # theta_0 [rad]
    torque: Array  # tau_0 [N m]
    proportional: Array  # K_P [N m/rad]
    derivative: Array  # K_D [N m s/rad]
    limit: Array  # of the motors [N m]


class Holding(ArmController[Held]):
    """A holding controller; `init` determines reference and gains."""

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        return ()

    def observe(self, state: Held) -> Array:
        return np.empty(0)

    def step(self, state: Held, sample: ArmSample) -> tuple[Held, Torques]:
        if not sample.valid:
            return state, passive(len(state.theta))
        torque = (
            state.torque + state.proportional * (state.theta - sample.theta) - state.derivative * sample.theta_velocity
        )
        return state, limited(torque, state.limit)
