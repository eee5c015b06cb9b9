"""Motor torques commanded from outside, for example by a controller of ros2_control.

    tau = tau_c(t),   0 once the command is older than `timeout`

The age of a command is measured in the time of samples, from the last sample before its arrival. The clocks of sender
and samples may therefore differ.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import nan

import numpy as np
from via_core.errors import ParameterError
from via_core.signals import Array, locked

from via_controllers.contract import (
    Controller,
    JointSample,
    Quantity,
    Torques,
    limited,
    passive,
    require,
    require_positive,
)


@dataclass(frozen=True)
class CommandedTorqueState:
    """State after a sample; both times are NaN before their first value."""

    time: float  # [s] of the last sample
    commanded: float  # [s] of the last sample before the command
    torque: Array  # (m,) [N m] of the command


@dataclass(frozen=True)
class CommandedTorque(Controller[CommandedTorqueState]):
    """The controller. Raises ParameterError for limits or a timeout that are not positive."""

    torque_limit: tuple[float, ...]  # (m,) [N m]
    timeout: float = 0.02  # [s]

    def __post_init__(self) -> None:
        require_positive(self, "timeout")
        require(min(self.torque_limit) > 0.0, f"torque_limit must be > 0, got {self.torque_limit}")

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        torques = (Quantity(f"commanded_{i}", "N m") for i in range(1, 1 + len(self.torque_limit)))
        return (*torques, Quantity("age", "s"))

    def observe(self, state: CommandedTorqueState) -> Array:
        """The last command and its age, NaN without one."""
        return np.append(state.torque, state.time - state.commanded)

    def init(self) -> CommandedTorqueState:
        return CommandedTorqueState(nan, nan, locked(np.full(len(self.torque_limit), nan), "torque"))

    def with_torque(self, state: CommandedTorqueState, torque: Array) -> CommandedTorqueState:
        """`state` with this command (m,) [N m]. Raises ParameterError unless it holds m finite numbers."""
        motors = len(self.torque_limit)
        if torque.shape != (motors,) or not np.isfinite(torque).all():
            raise ParameterError(f"a command must hold {motors} finite torques, got {torque.tolist()}")
        return replace(state, commanded=state.time, torque=locked(torque, "torque"))

    def step(self, state: CommandedTorqueState, sample: JointSample) -> tuple[CommandedTorqueState, Torques]:
        if not sample.valid:
            return state, passive(len(self.torque_limit))
        state = replace(state, time=sample.time)
        if not 0.0 <= state.time - state.commanded <= self.timeout:
            return state, passive(len(self.torque_limit))
        return state, limited(state.torque, np.array(self.torque_limit))
