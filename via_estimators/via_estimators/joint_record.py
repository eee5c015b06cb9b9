"""Samples, commands and sensor noise of one joint, as the equations of `joint_equations` read them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from via_core.devices import Device
from via_core.signals import Array, Signals

CHANNELS = ("q", "theta", "tau", "tau_link", "q_velocity", "theta_velocity")


@dataclass(frozen=True)
class Record:
    """Samples of a joint without gaps in the channels present.

    time      (N,) [s]
    channels  q, theta_1, tau_1, tau_link, q_velocity, theta_velocity_1 ..: (N,) each; missing ones are not measured
    commands  at the samples: damping [-], goal [rad] (NaN: off), servo_1 .. [rad]
    noise     standard deviation of one sample of each channel
    """

    time: Array
    channels: Mapping[str, Array]
    commands: Mapping[str, Array]
    noise: Mapping[str, float]

    def with_channels(self, names: tuple[str, ...]) -> Record:
        """The record with these channels only, numbered ones by their common name."""
        kept = {name: values for name, values in self.channels.items() if name.rstrip("_12") in names}
        return Record(self.time, kept, self.commands, self.noise)


def columns_of(signals: Signals, device: Device) -> dict[str, Array]:
    """(N,) arrays of the channels a record may have; those of motors are numbered."""
    found: dict[str, Array] = {}
    for name in CHANNELS:
        if name not in signals:
            continue
        values = signals[name]
        if values.ndim == 1:
            found[name] = values
        else:
            found |= {f"{name}_{i + 1}": values[:, i] for i in range(min(values.shape[1], device.n_drives))}
    return found


def commands_of(commands: Signals | None, device: Device, time: Array) -> dict[str, Array]:
    """Commands at the samples, as a record holds them; those not recorded are missing."""
    if commands is None:
        return {}
    held = Signals(commands.time, commands.channels, commands.units, frozenset(commands.channels)).resample(time)
    found = {"damping": held["damping"]} if "damping" in held else {}
    if "equilibrium" in held and device.drive == "position" and device.servo is not None:
        late = np.searchsorted(time, time - device.servo.delay, side="left").clip(0, len(time) - 1)
        found["goal"] = device.servo.led(held["equilibrium"], time)[late]
    if "equilibrium" in held and device.drive == "servo":
        preset = held["preset"] if "preset" in held else np.zeros(len(time))
        late = np.searchsorted(time, time - device.observed.servo_dead_time, side="left").clip(0, len(time) - 1)
        angles = device.motor_angles(held["equilibrium"], preset)[late]
        found |= {f"servo_{i + 1}": angles[:, i] for i in range(device.n_motors)}
    return found
