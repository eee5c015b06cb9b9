"""Comparison of a short interval of a log with the nominal model: size of the gap, and the site where it lies.

It uses the equations of the diagnosis without its fits, so that two seconds of data take some milliseconds. The device
may have parameters that a diagnosis fitted; then only what exceeds their tolerance remains.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from via_core.devices import Device
from via_core.signals import Signals
from via_sim.effects import Effect
from via_sim.plants import JointPlant

from via_gap.candidates.localisation import SiteShare, localise
from via_gap.logs.log import JointLog, believed
from via_gap.logs.noise import LogNoise, log_noise
from via_gap.residual.errors import segment_errors
from via_gap.residual.inverse_dynamics import MissingTorque, missing_torque
from via_gap.residual.residual_model import ResidualModel
from via_gap.residual.rollout import Rollout
from via_gap.residual.segments import Segments, cut_with_noise

STILL = 1e-3  # [rad] travel of the link below which nothing can be compared


@dataclass(frozen=True)
class Comparison:
    """An interval of a log against a model."""

    window: float  # [s] length of the interval
    error: float  # [rad] root mean square of simulated minus measured link angle, in short segments
    normalised_error: float  # [-] error over the standard deviation of the measured link angle
    residual_ratio: float  # [-] rms residual of the equations over what the sensors explain; 1: no gap; NaN: none
    sites: tuple[SiteShare, ...]  # where the residual lies, largest share first
    moves: bool  # whether the link moved enough for a comparison
    levels: tuple[float, ...]  # of the residual beside known effects, a segment with motion each (`run.change`)


class Comparator:
    """Compares one joint again and again.

    Estimating the noise takes a hundred times as long as the rest. It is done once at rest and once in motion.
    """

    def __init__(self) -> None:
        self._noise: LogNoise | None = None
        self._known: tuple[bool, tuple[bool, ...]] = (False, ())  # whether the joint moved; which motors were measured

    def compare(self, log: JointLog, device: Device, effects: Sequence[Effect] = ()) -> Comparison:
        """The comparison of a log with a device and its known effects; see the function `compare`."""
        (log,) = believed([log])
        known = (_moves(log) or self._known[0], log.motors_seen)
        if self._noise is None or known != self._known:
            self._noise, self._known = log_noise(log), known
        return compare(log, device, self._noise, effects)


def compare(
    log: JointLog, device: Device, noise: LogNoise | None = None, effects: Sequence[Effect] = ()
) -> Comparison:  # fmt: skip
    """The log against `device`; `noise` of its channels is estimated unless it is given.

    effects  known ones: `levels` are those of the residual beside them, all else is compared with the device alone

    Raises SignalError for a log without commands to simulate with, or one that is too short.
    """
    (log,) = believed([log])
    segments = cut_with_noise(log, noise or log_noise(log))
    known = segments.valid if segments.valid.any() else np.ones(len(segments), dtype=np.bool_)
    problem = ResidualModel.of([segments], [np.flatnonzero(known)], Rollout.by_starts)
    errors = segment_errors(problem, problem.residual([JointPlant.from_device(device).parameters])[0])
    missing = missing_torque(segments, device)
    ratio = float("nan") if missing is None else float(np.sqrt(np.mean((missing.torque / missing.floor) ** 2)))
    return Comparison(
        window=log.duration,
        error=float(np.sqrt(np.mean(errors.squares[:, 0]))),
        normalised_error=float(errors.signals[0]),
        residual_ratio=ratio,
        sites=localise([segments], [missing], device),
        moves=_moves(log),
        levels=_levels(segments, missing_torque(segments, device, effects) if effects else missing),
    )


def _levels(segments: Segments, missing: MissingTorque | None) -> tuple[float, ...]:
    """(n,) logarithm of the mean squared residual, over its noise, of each segment in which the link moves."""
    if missing is None:
        return ()
    squares = np.mean(((missing.torque / missing.floor) ** 2).reshape(len(segments), -1), axis=1)
    moved = np.ptp(segments.measured[:, :, 0], axis=1) > STILL
    return tuple(np.log(squares[moved & (squares > 0.0)]).tolist())


def _moves(log: JointLog) -> bool:
    return bool(np.nanmax(log.measured["q"]) - np.nanmin(log.measured["q"]) > STILL)


def warm_up(device: Device) -> None:
    """Compare an artificial motion, which loads the compiled kernels before the first real comparison."""
    time = np.arange(1000) / device.sensors.rate
    wave = 0.1 * np.sin(12.0 * time)
    motors = np.repeat(wave[:, None], device.n_motors, axis=1)
    channels = {"q": wave, "theta": motors} if device.n_motors else {"q": wave}
    held = {"motor": motors} if device.n_motors else {"damping": np.zeros(len(time))}
    commands = Signals(time, held, {"motor": "", "damping": "-"}, frozenset(held))
    compare(JointLog("warm-up", device, Signals(time, channels, {"q": "rad", "theta": "rad"}), commands), device)
