"""All candidate causes of an experiment, and the sites at which the equations show the gap."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from via_core.devices import Device

from via_gap.candidates.fit import Fit
from via_gap.candidates.localisation import SiteShare, localise
from via_gap.candidates.location import Location, locations
from via_gap.candidates.scales import Scales, scales_of
from via_gap.residual.inverse_dynamics import InverseDynamics
from via_gap.residual.repaired_device import repaired_device
from via_gap.residual.residual_model import ResidualModel
from via_gap.residual.segments import Indices, Segments
from via_gap.residual.weak_residuals import Residual, weak_residuals

ONE_RUN = ("external_torque",)  # acts at one time of one run, so it cannot be the common cause in several logs


@dataclass(frozen=True, eq=False)
class CandidateSet:
    """Candidates of one experiment.

    locations  every effect at every location
    scales     typical sizes in these logs
    numbers    the device with fitted parameters
    residuals  weak-form residuals of its equations, one tuple per log
    shares     share of each site in these residuals
    equations  inverse dynamics of the fitted segments in short windows; None if no equation can be evaluated
    """

    locations: tuple[Location, ...]
    scales: Scales
    numbers: Device
    residuals: tuple[tuple[Residual, ...], ...]
    shares: tuple[SiteShare, ...]
    equations: ResidualModel | None

    @staticmethod
    def of(segments: Sequence[Segments], train: Sequence[Indices], base: Fit, fitted: ResidualModel) -> CandidateSet:
        """base: fit of the device parameters to the segments `train` (one array per log) of the model `fitted`."""
        numbers = repaired_device(fitted.device, fitted.nuisances, base.offsets)
        residuals = tuple(weak_residuals(each, numbers) for each in segments)
        shares = localise(segments, residuals, numbers) if all(residuals) else ()
        seen = [i for i, which in enumerate(train) if len(which)]
        begins = [segments[i].time[train[i]] - segments[i].log.measured.time[0] for i in seen]
        scales = scales_of(
            [segments[i] for i in seen], [residuals[i] for i in seen], np.concatenate(begins),
            fitted.per_segment(base.residual),
        )  # fmt: skip
        excluded = ONE_RUN if len(segments) > 1 else ()
        found = locations(fitted.device, segments[0].log)
        kept = tuple(location for location in found if location.name not in excluded)
        equations = ResidualModel.of(segments, train, InverseDynamics.of) if all(residuals) else None
        return CandidateSet(kept, scales, numbers, residuals, shares, equations)
