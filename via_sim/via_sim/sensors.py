"""Sensors of a device: quantisation, noise, sample rate. Unmeasured quantities are NaN, never zero.

Noise is a pure function of (seed, tick, channel): steps, batches and any order of evaluation give the same bits.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite, nan

import numpy as np
from via_core.devices import Device
from via_core.errors import ParameterError
from via_core.signals import Array

from via_sim.joint.measurements import S


@dataclass(frozen=True)
class Sensors:
    """Parameters of the sensors; zero noise and zero quantum are ideal, None means there is no such sensor."""

    link_quantum: float = 0.0  # [rad] encoder step
    motor_quantum: float = 0.0  # [rad]
    link_noise: float = 0.0  # [rad] standard deviation, before the quantiser
    motor_noise: float = 0.0  # [rad]
    velocity_noise: float | None = None  # [rad/s]
    torque_noise: float = 0.0  # [N m] motor torque
    link_torque_noise: float | None = None  # [N m] spring torque at the link; of a rigid joint the dissipated torque
    rate: float | None = None  # [Hz] of the samples; None means every tick

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if value is not None and not (isfinite(value) and value >= 0.0):
                raise ParameterError(f"{name} must be finite and >= 0, got {value}")
        if self.rate == 0.0:
            raise ParameterError("rate must be > 0 Hz, got 0")

    @staticmethod
    def of_device(device: Device) -> Sensors:
        """Sensors of a device file; the rate is left at None because the file's rate is the tick rate."""
        given = device.sensors
        return Sensors(
            link_quantum=given.link_quantum or 0.0,
            motor_quantum=given.motor_quantum or 0.0,
            torque_noise=given.torque_noise,
            link_torque_noise=given.link_torque_noise,
        )

    def row(self) -> Array:
        """Sensor row (7,) of the compiled kernel."""
        return np.array([nan if (value := getattr(self, name)) is None else value for name in S._fields])

    def decimation(self, tick_rate: float) -> int:
        """Ticks per sample. Raises ParameterError unless the sensor's rate divides the tick rate [Hz]."""
        if self.rate is None:
            return 1
        ticks = round(tick_rate / self.rate)
        if ticks < 1 or abs(tick_rate / self.rate - ticks) > 1e-6:
            raise ParameterError(f"sensor rate {self.rate} Hz must divide the tick rate {tick_rate} Hz")
        return ticks


IDEAL = Sensors(velocity_noise=0.0, link_torque_noise=0.0)
