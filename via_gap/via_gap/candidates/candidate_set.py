"""All candidate causes of an experiment, and the sites at which the equations show the gap."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from via_core.devices import Device
from via_core.signals import Indices

from via_gap.candidates.fit import Fit
from via_gap.candidates.intervals import best_interval
from via_gap.candidates.localisation import SiteShare, localise
from via_gap.candidates.location import Location, locations
from via_gap.candidates.scales import Scales, scales_of
from via_gap.candidates.starts import starts
from via_gap.residual.inverse_dynamics import InverseDynamics, MissingTorque, missing_torque
from via_gap.residual.residual_model import ResidualModel
from via_gap.residual.segments import Segments


@dataclass(frozen=True, eq=False)
class CandidateSet:
    """Candidates of one experiment.

    locations  every effect at every location
    scales     typical sizes in these logs
    numbers    the device with fitted parameters
    missing    missing torque of its equations in each log; None if no equation can be evaluated
    shares     share of each site in it
    equations  inverse dynamics of the fitted segments in short windows; None if no equation can be evaluated
    """

    locations: tuple[Location, ...]
    scales: Scales
    numbers: Device
    missing: tuple[MissingTorque | None, ...]
    shares: tuple[SiteShare, ...]
    equations: ResidualModel | None

    @staticmethod
    def of(segments: Sequence[Segments], train: Sequence[Indices], base: Fit, fitted: ResidualModel) -> CandidateSet:
        """base: fit of the device parameters to the segments `train` (one array per log) of the model `fitted`."""
        numbers = fitted.repaired(base.offsets)
        missing = tuple(missing_torque(each, numbers) for each in segments)
        shares = localise(segments, missing, numbers)
        seen = [i for i, which in enumerate(train) if len(which)]
        scales = scales_of([segments[i] for i in seen], [missing[i] for i in seen])
        found = locations(fitted.device, segments[0].log)
        kept = tuple(location for location in found if len(segments) == 1 or not location.kind.one_run)
        begins = np.concatenate([segments[i].time[train[i]] - segments[i].log.measured.time[0] for i in seen])
        for each in kept:
            if each.kind.one_run:
                small = starts(each, scales, fitted.device)[0].directions[0]
                always = each.effect({p.name: p.neutral if p.unit == "s" else small[p.name] for p in each.parameters})
                scales = replace(scales, busy=best_interval(fitted, base, always, begins))
        equations = ResidualModel.of(segments, train, InverseDynamics.of) if all(missing) else None
        return CandidateSet(kept, scales, numbers, missing, shares, equations)
