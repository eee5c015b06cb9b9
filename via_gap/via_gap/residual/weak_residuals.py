"""Missing torque of each equation of a device along a whole log, for the location of the gap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from via_core.devices import Device
from via_core.errors import SignalError
from via_core.signals import Array
from via_sim.plants import JointPlant

from via_gap.residual.inverse_dynamics import InverseDynamics, windows_of
from via_gap.residual.segments import Segments


@dataclass(frozen=True, eq=False)
class Residual:
    """One equation over the windows of one log.

    axis    0 link, 1, 2 motors
    centre  (W,) tick in the middle of each window
    torque  (W,) [N m] missing in the model
    floor   (W,) [N m] standard deviation by sensor noise
    """

    axis: int
    centre: NDArray[np.intp]
    torque: Array
    floor: Array

    @property
    def name(self) -> str:
        return "link" if self.axis == 0 else f"motor {self.axis}"


def weak_residuals(segments: Segments, device: Device) -> tuple[Residual, ...]:
    """Residuals of every equation of `device` that the signals allow to evaluate, maybe none."""
    row = JointPlant.from_device(device).at_rate(segments.rate)
    try:
        windows = windows_of(segments, row)
    except SignalError:
        return ()
    view = InverseDynamics(segments, np.arange(len(segments)), row, windows)
    missing, centre = view.torques(view.residual(row[None])[0]), view.middle.ravel()
    return tuple(
        Residual(axis, centre, missing[:, i].ravel(), np.full(len(centre), windows.floor[i]))
        for i, axis in enumerate(windows.axes)
    )
