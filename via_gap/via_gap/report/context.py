"""Parts of a report about recordings and device: noise, held-out data, fitted parameters, what logs cannot show."""

from __future__ import annotations

from collections.abc import Sequence

from via_core.signals import Array, Indices

from via_gap.candidates.location import missing_effects
from via_gap.logs.log import JointLog
from via_gap.report.report import LogInterval, Noise, NuisanceValue
from via_gap.report.simulated_intervals import runs
from via_gap.residual.nuisance import BOUND
from via_gap.residual.recordings import Recordings, follows
from via_gap.residual.residual_model import ResidualModel
from via_gap.residual.segments import Segments
from via_gap.selection.reliability import shipped


def holdout_names(recordings: Recordings) -> tuple[str, ...]:
    """Names of the held-out logs, or that blocks of the same logs were held out."""
    return recordings.holdout or ("blocks of the same logs",)


def channel_noise(recordings: Recordings) -> tuple[Noise, ...]:
    """Declared and estimated noise of every channel of every log that was used."""
    return tuple(
        Noise(
            log=log, channel=name, unit="N m" if name.startswith("tau") else "rad", declared=noise.declared.get(name),
            estimated=each.sd, jitter=each.jitter,
        )
        for log, noise in recordings.noise.items()
        for name, each in noise.channels.items()
    )  # fmt: skip


def not_evaluated(log: JointLog) -> tuple[str, ...]:
    """What this log cannot show, one sentence each."""
    said = []
    unseen = [i + 1 for i, seen in enumerate(log.motors_seen) if not seen]
    if unseen:
        which = " and ".join(f"motor {i}" for i in unseen)
        said.append(f"the angle of {which} was not measured: only the simulated link angle can be compared")
    if log.device.drive == "torque" and not log.torque_seen and log.device.n_motors:
        said.append("no motor torque was measured: commands are used instead, the torque sensor cannot be evaluated")
    if log.device.drive == "servo":
        said.append("motors are position servos: their torques and friction are not in the model")
    if not shipped().cases:
        said.append("probabilities are not calibrated in this version: only their order is valid")
    return (*said, *missing_effects(log.device, log))


def fitted_parameters(problem: ResidualModel, offsets: Array) -> tuple[NuisanceValue, ...]:
    """The device parameters as filed and as fitted; offsets (J,) in standard deviations of their tolerance."""
    return tuple(
        NuisanceValue(
            name=n.name, unit=n.unit, filed=n.value, fitted=n.value * (1.0 + n.tolerance * float(d)),
            offset=float(d), at_bound=bool(abs(d) > BOUND - 1e-6),
            low=n.value - BOUND * n.tolerance * abs(n.value), high=n.value + BOUND * n.tolerance * abs(n.value),
        )
        for n, d in zip(problem.nuisances, offsets, strict=True)
        if n.start == 0.0
    )  # fmt: skip


def held_out_intervals(segments: Sequence[Segments], held: Sequence[Indices]) -> tuple[LogInterval, ...]:
    """Time intervals of the segments `held` (indices, one array per log), neighbours joined."""
    found = []
    for each, which in zip(segments, held, strict=True):
        begins = each.time - each.log.measured.time[0]
        for run in runs(which):
            first, last = which[run[0]], which[run[-1]]
            end = begins[last] + each.ticks / each.rate
            if last == len(each) - 1 and follows(each.log.device):
                end = each.log.duration  # a free run includes the samples after the last segment
            found.append(LogInterval(log=each.log.name, begin=float(begins[first]), end=float(end)))
    return tuple(found)
