"""Typical magnitudes of a joint's motion without effects; effects are drawn relative to them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from via_core.devices import Device
from via_core.signals import Array

from via_validation.sealed.stepping import Run


@dataclass(frozen=True)
class Scene:
    """A true joint and typical magnitudes of its motion."""

    device: Device
    duration: float  # [s]
    torque: Array  # (1+m,) [N m] RMS on link and motors; 0 for servos
    highest: Array  # (1+m,) [N m] largest
    speed: Array  # (1+m,) [rad/s] RMS
    deflection: Array  # (transmissions,) [rad] RMS about zero
    load: Array  # (transmissions,) [N m] RMS torque
    angles: tuple[float, float]  # [rad] range of the link: 5 and 95 %


def scene_of(device: Device, run: Run) -> Scene:
    torques = device.torque_each(run.angle[:, 0], run.angle[:, 1:])
    deflection = run.angle[:, :1] - run.angle[:, 1 : 1 + device.n_transmissions]
    link = torques.sum(axis=1)
    commanded = run.mean if device.drive == "torque" else np.zeros_like(run.mean)
    if not device.motors:  # its drive counts as motor 1, which moves with the link
        link = run.mean[:, 0]
    low, high = np.quantile(run.angle[:, 0], [0.05, 0.95])
    return Scene(
        device,
        float(run.time[-1]),
        np.concatenate([[_rms(link)], _rms(commanded)]),
        np.concatenate([[np.max(np.abs(link))], np.max(np.abs(commanded), axis=0)]),
        _rms(run.speed if device.motors else np.hstack([run.speed, run.speed])),
        _rms(deflection),
        _rms(torques),
        (float(low), float(high)),
    )


def _rms(values: Array) -> Array:
    return np.asarray(np.sqrt(np.mean(np.square(values), axis=0)))
