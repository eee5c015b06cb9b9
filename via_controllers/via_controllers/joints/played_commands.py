"""Plays motor torques of a table, corrected by feedback on the motor angles if the table has their references.

    tau = tau_c(t) + K_P (theta_c(t) - theta) + K_D (thd_c(t) - thd)

Torques hold from row to row; references are interpolated. The torques of a model alone would let the motors drift,
because nothing else returns them to their references. The difference of the motor angles at the start from the first
reference fades out, without a jump: it is multiplied by 1 - u^2 (3 - 2u), u = t / fade_in. After the last row the joint
is held at the last reference; without references torques are zero.
Motor velocities are derivatives of the angles behind a first-order low pass of bandwidth w_f.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import isfinite, isnan, nan

import numpy as np
from via_core.signals import Array, locked

from via_controllers.contract import Controller, JointSample, Quantity, Torques, limited, passive, require
from via_controllers.low_pass import low_passed

LARGEST = 1e6  # [rad] larger motor angles are transmission errors, which would corrupt the velocity estimate


@dataclass(frozen=True)
class PlayedState:
    """State after a sample."""

    start: float  # [s] time of the first sample, NaN before it
    origin: Array  # (m,) [rad] motor angles of the first sample
    time: float  # [s] of the last sample
    theta: Array  # (m,) [rad]
    velocity: Array  # (m,) [rad/s] low-passed


@dataclass(frozen=True, eq=False)
class PlayedCommands(Controller[PlayedState]):
    """The controller. Raises ParameterError for tables that do not fit, and for gains or limits that are not positive.

    time       (N,) [s], increasing
    torque     (N, m) [N m]
    reference  (N, m) [rad]; None: torques only
    """

    time: Array
    torque: Array
    reference: Array | None
    proportional_gain: float  # K_P [N m/rad]
    derivative_gain: float  # K_D [N m s/rad]
    velocity_bandwidth: float  # w_f [rad/s]
    torque_limit: tuple[float, ...]  # [N m]
    fade_in: float  # [s]

    def __post_init__(self) -> None:
        require(self.torque.ndim == 2 and len(self.torque) == len(self.time) > 1, "commands need two rows or more")
        require(bool(np.all(np.isfinite(self.torque))), "commands: every torque must be finite")
        require(bool(np.all(np.diff(self.time) > 0.0)), "commands: their time must increase")
        shape = self.torque.shape
        require(self.reference is None or self.reference.shape == shape, f"references must have shape {shape}")
        require(len(self.torque_limit) == shape[1], f"commands are for {shape[1]} motors, not {len(self.torque_limit)}")
        for name in ("proportional_gain", "velocity_bandwidth", "fade_in"):
            require(getattr(self, name) > 0.0, f"{name} must be > 0, got {getattr(self, name)}")
        require(min(self.torque_limit) > 0.0, f"torque_limit must be > 0, got {self.torque_limit}")
        require(self.derivative_gain >= 0.0, f"derivative_gain must be >= 0, got {self.derivative_gain}")

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        return (Quantity("time", "s"),)

    def observe(self, state: PlayedState) -> Array:
        """Time [s] since the first row; NaN before the first sample."""
        return np.array([state.time - state.start])

    def init(self) -> PlayedState:
        zeros = locked(np.zeros(self.torque.shape[1]), "theta")
        return PlayedState(nan, zeros, 0.0, zeros, zeros)

    def step(self, state: PlayedState, sample: JointSample) -> tuple[PlayedState, Torques]:
        if not (isfinite(sample.time) and np.all(np.abs(sample.theta) < LARGEST)):  # the link angle is not used
            return state, passive(self.torque.shape[1])
        if isnan(state.start):
            theta = locked(sample.theta, "origin")
            state = PlayedState(sample.time, theta, sample.time, theta, np.zeros(len(theta)))
        step = sample.time - state.time
        velocity = low_passed(state.velocity, state.theta, sample.theta, step, self.velocity_bandwidth)
        after = replace(
            state, time=sample.time, theta=locked(sample.theta, "theta"), velocity=locked(velocity, "velocity")
        )
        return after, limited(self._torque(after), np.asarray(self.torque_limit))

    def _torque(self, state: PlayedState) -> Array:
        """(m,) [N m] before the limit."""
        elapsed = state.time - state.start
        # stamps are rounded: a sample at 0.14 s is in the row of 0.14 s
        row = int(np.searchsorted(self.time - self.time[0], elapsed + 1e-9, side="right")) - 1
        ended = row >= len(self.time) - 1
        if self.reference is None:
            return np.zeros(self.torque.shape[1]) if ended else self.torque[row]
        wanted, rate = self.reference[row], np.zeros(self.torque.shape[1])
        if not ended:
            rate = (self.reference[row + 1] - wanted) / (self.time[row + 1] - self.time[row])
            wanted = wanted + rate * (elapsed - (self.time[row] - self.time[0]))
        u = min(elapsed / self.fade_in, 1.0)
        wanted = wanted + (1.0 - u * u * (3.0 - 2.0 * u)) * (state.origin - self.reference[0])
        feedback = self.proportional_gain * (wanted - state.theta) + self.derivative_gain * (rate - state.velocity)
        return self.torque[row] + feedback
