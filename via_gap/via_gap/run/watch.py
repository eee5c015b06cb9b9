"""What a short stretch of a log says at once: how far the nominal model is off, and at which place of the joint.

The same equations as the diagnosis, none of its fits: a stretch of two seconds takes some milliseconds. The device may
be one whose numbers a diagnosis has tuned; then only what is beyond its tolerance is left.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from via_core.devices import Device
from via_core.signals import Signals
from via_sim.plants import JointPlant

from via_gap.candidates.localisation import SiteShare, localise
from via_gap.logs.log import JointLog, believed
from via_gap.logs.noise import LogNoise, log_noise
from via_gap.logs.quality import Quality
from via_gap.report.report import GapReport
from via_gap.residual.equations import weak_residuals
from via_gap.residual.errors import segment_errors
from via_gap.residual.nuisance import nuisances
from via_gap.residual.repaired_device import repaired_device
from via_gap.residual.residual_model import ResidualModel
from via_gap.residual.segments import cut_log

STILL = 1e-3  # [rad] a link that moves less than this tells nothing


@dataclass(frozen=True)
class Look:
    """A stretch of a log against a model.

    window            [s] of the stretch
    error             [rad] root mean square of simulated minus measured link angle, in short runs from measured states
    normalised_error  [-] error over the standard deviation of the measured link angle
    residual_ratio    [-] what the equations leave over what the sensors explain, root mean square; 1: no gap;
                      NaN where no equation can be looked at
    sites             where that lies, largest share first
    moves             whether the link moved enough for all this to mean anything
    """

    window: float
    error: float
    normalised_error: float
    residual_ratio: float
    sites: tuple[SiteShare, ...]
    moves: bool


class Watch:
    """Looks at one joint again and again.

    To estimate the noise takes a hundred times as long as the rest: it is done once at rest and once in motion.
    """

    def __init__(self) -> None:
        self._noise: LogNoise | None = None
        self._made: tuple[bool, tuple[bool, ...]] = (False, ())  # whether the joint moved, and which motors were seen

    def look(self, log: JointLog, device: Device) -> Look:
        """See `look`."""
        (log,) = believed([log])
        made = (_moves(log) or self._made[0], log.motors_seen)
        if self._noise is None or made != self._made:
            self._noise, self._made = log_noise(log), made
        return look(log, device, self._noise)


def _moves(log: JointLog) -> bool:
    return bool(np.nanmax(log.measured["q"]) - np.nanmin(log.measured["q"]) > STILL)


def look(log: JointLog, device: Device, noise: LogNoise | None = None) -> Look:
    """The log against `device`, with the noise of its channels where that is known.

    Raises SignalError where it has no drive to simulate with, or is too short.
    """
    (log,) = believed([log])
    whole = (float(log.measured.time[0]), float(log.measured.time[-1]))
    segments = cut_log(log, quality=Quality((), (whole,), noise or log_noise(log)))
    problem = ResidualModel.of([segments], [np.arange(len(segments))])
    errors = segment_errors(problem, problem.residual([JointPlant.from_device(device).parameters])[0])
    residuals = weak_residuals(segments, device)
    whitened = [(each.torque / each.floor) ** 2 for each in residuals]
    return Look(
        window=log.duration,
        error=float(np.sqrt(np.mean(errors.squares[:, 0]))),
        normalised_error=float(errors.signals[0]),
        residual_ratio=float(np.sqrt(np.mean(whitened))) if whitened else float("nan"),
        sites=localise([segments], [residuals], device) if residuals else (),
        moves=_moves(log),
    )


def tuned(device: Device, report: GapReport) -> Device:
    """The device with its numbers moved inside their tolerance to where a diagnosis found them."""
    found = {each.name: each.deviations for each in report.nuisance}
    moved = nuisances(JointPlant.from_device(device))
    return repaired_device(device, moved, np.array([found.get(each.name, 0.0) for each in moved]))


def rehearse(device: Device) -> None:
    """Look at a made-up motion, which loads the compiled kernels before anybody waits for them."""
    time = np.arange(1000) / device.sensors.rate
    wave = 0.1 * np.sin(12.0 * time)
    motors = np.repeat(wave[:, None], device.n_motors, axis=1)
    channels = {"q": wave, "theta": motors} if device.n_motors else {"q": wave}
    held = {"motor": motors} if device.n_motors else {"damping": np.zeros(len(time))}
    commands = Signals(time, held, {"motor": "", "damping": "-"}, frozenset(held))
    look(JointLog("rehearsal", device, Signals(time, channels, {"q": "rad", "theta": "rad"}), commands), device)
