"""Plays motor torques of a table, corrected by feedback on the motor angles if the table has their references.

    tau = tau_c(t) + K_P e + K_D ed,   e = theta_c(t) - theta

Torques hold from row to row; references are interpolated. The torques of a model alone would let the motors drift,
because nothing else returns them to their references. The difference of the motor angles at the start from the first
reference fades out, without a jump: it is multiplied by 1 - u^2 (3 - 2u), u = t / fade_in. After the last row the joint
is held at the last reference; without references torques are zero.
ed is the derivative of e behind a first-order low pass of bandwidth w_f. The reference passes the same low pass as the
measurement, so that a joint on its reference gets the torques of the table, whatever its acceleration.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import isfinite, isnan, nan

import numpy as np
from via_core.signals import Array, locked

from via_controllers.contract import Controller, JointSample, Quantity, Torques, limited, passive, require
from via_controllers.low_pass import LARGEST, low_passed


@dataclass(frozen=True)
class PlayedState:
    """State after a sample."""

    start: float  # [s] time of the first sample, NaN before it
    origin: Array  # (m,) [rad] motor angles of the first sample
    time: float  # [s] of the last sample
    error: Array  # e (m,) [rad]
    error_rate: Array  # ed (m,) [rad/s]


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
        zeros = locked(np.zeros(self.torque.shape[1]), "origin")
        return PlayedState(nan, zeros, 0.0, zeros, zeros)

    def step(self, state: PlayedState, sample: JointSample) -> tuple[PlayedState, Torques]:
        if not (isfinite(sample.time) and np.all(np.abs(sample.theta) < LARGEST)):  # the link angle is not used
            return state, passive(self.torque.shape[1])
        if isnan(state.start):
            state = replace(state, start=sample.time, origin=locked(sample.theta, "origin"), time=sample.time)
        elapsed = sample.time - state.start
        # stamps are rounded: a sample at 0.14 s is in the row of 0.14 s
        row = int(np.searchsorted(self.time - self.time[0], elapsed + 1e-9, side="right")) - 1
        if self.reference is None:
            ended = row >= len(self.time) - 1
            torque = np.zeros(self.torque.shape[1]) if ended else self.torque[row]
            return replace(state, time=sample.time), limited(torque, np.asarray(self.torque_limit))
        error = self._wanted(self.reference, row, elapsed, state.origin) - sample.theta
        rate = low_passed(state.error_rate, state.error, error, sample.time - state.time, self.velocity_bandwidth)
        after = replace(state, time=sample.time, error=locked(error, "error"), error_rate=locked(rate, "error_rate"))
        torque = self.torque[row] + self.proportional_gain * error + self.derivative_gain * rate
        return after, limited(torque, np.asarray(self.torque_limit))

    def _wanted(self, reference: Array, row: int, elapsed: float, origin: Array) -> Array:
        """theta_c (m,) [rad] in a row of the table, `elapsed` [s] after the first sample."""
        wanted = reference[row]
        if row < len(reference) - 1:
            passed = elapsed - (self.time[row] - self.time[0])
            wanted = wanted + (reference[row + 1] - wanted) * (passed / (self.time[row + 1] - self.time[row]))
        u = min(elapsed / self.fade_in, 1.0)
        return np.asarray(wanted + (1.0 - u * u * (3.0 - 2.0 * u)) * (origin - reference[0]))
