"""The device as a diagnosis found it, with which later motion is compared."""

from __future__ import annotations

import numpy as np
from via_core.devices import Device
from via_sim.plants import JointPlant

from via_gap.report.report import GapReport
from via_gap.residual.residual_model import ResidualModel


def fitted_device(device: Device, report: GapReport) -> Device:
    """The device with the parameters that a diagnosis fitted inside their tolerances."""
    found = {each.name: each.offset for each in report.nuisance}
    model = ResidualModel.of_plant(JointPlant.from_device(device))
    return model.repaired(np.array([found.get(each.name, 0.0) for each in model.nuisances]))
