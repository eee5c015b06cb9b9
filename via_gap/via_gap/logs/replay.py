"""Simulation of a log's commands on the nominal model, and its error: the gap before any diagnosis.

The gap of a signal is its NRMSE: RMS error of the simulated signal over the standard deviation of the measured one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, nan, sqrt

import numpy as np
from via_core.devices import Device
from via_core.errors import SignalError
from via_core.metrics import nrmse
from via_core.signals import Array, Signals
from via_sim.effects import Effect
from via_sim.joint.encoders import true_angle
from via_sim.plants import JointPlant
from via_sim.simulate import InitialConditions, simulate

from via_gap.logs.start import FIRST, motion_at_start

TICK_RATE = 1000.0  # [Hz] of the simulation; commands of logs change on whole milliseconds
AHEAD = 1e-3  # [s] over which a velocity is freed of the encoder errors that depend on the angle


@dataclass(frozen=True)
class Gap:
    """A log beside its simulation."""

    time: Array  # (N,) [s] stamps of the measured samples
    measured: Array  # (N,) [rad] link angle
    simulated: Array  # (N,) [rad]
    nrmse: float  # [-]


def simulated_log(device: Device, measured: Signals, commands: Signals, effects: Sequence[Effect] = ()) -> Signals:
    """Signals of the device's model under the commands of a log, on a grid that covers `measured`.

    Angles are those of encoders without noise or steps, but with the encoder errors of the effects, as in the log.

    measured  `q` (N,) and, if the device has motors, `theta` (N, m); the run begins with the motion of the first
              samples, and with a motor that is not measured at rest at its first command
    commands  with zero-order hold; before the first one, its value applies

    Raises SignalError for a log without samples or without a finite link angle at its start.
    """
    plant = JointPlant.from_device(device).with_effects(effects)
    start, duration, motion = begin_of(device, measured, commands, plant.parameters)
    run = simulate(plant, commands, duration, TICK_RATE, initial=InitialConditions(motion, time=start))
    read = {name: run.measured[name] for name in ("q", "theta") if name in run.measured}
    return Signals(run.truth.time, {**run.truth.channels, **read}, run.truth.units)


def begin_of(device: Device, measured: Signals, commands: Signals, row: Array) -> tuple[float, float, Array]:
    """First time [s], duration [s] and motion (6,) of the simulation of a log; row (N_PARAMETERS,) has encoder errors.

    Raises SignalError as `simulated_log`.
    """
    if len(measured) == 0 or len(commands) == 0:
        raise SignalError("the log has no samples to simulate" if len(measured) == 0 else "the log has no commands")
    origin = float(commands.time[0])
    early = ceil(max(origin - float(measured.time[0]), 0.0) * TICK_RATE) / TICK_RATE
    start = origin - early if early else float(measured.time[0])
    duration = ceil((float(measured.time[-1]) - start) * TICK_RATE) / TICK_RATE
    return start, duration, _initial(device, measured, commands, row)


def gap_to(simulated: Signals, measured: Signals) -> Gap:
    """The gap of the link angle `q` between a simulation and a log, at the log's own stamps."""
    seen = np.isfinite(measured["q"])
    time, q = measured.time[seen], measured["q"][seen]
    angle = np.interp(time, simulated.time, simulated["q"])
    return Gap(time, q, angle, nrmse(q, angle))


def pooled(gaps: Sequence[Gap]) -> float:
    """One NRMSE [-] over several logs: all squared errors over all squared differences from each log's own mean.

    Large motions have more weight than in the mean of the logs' NRMSE. Raises SignalError if there is no log.
    """
    if not gaps:
        raise SignalError("no log to pool")
    error = sum(float(np.sum((gap.simulated - gap.measured) ** 2)) for gap in gaps)
    total = sum(float(np.sum((gap.measured - np.mean(gap.measured)) ** 2)) for gap in gaps)
    return sqrt(error / total)


def _initial(device: Device, measured: Signals, commands: Signals, row: Array) -> Array:
    """(6,) q, theta_1, theta_2 [rad] and velocities, without the encoder errors of `row` (N_PARAMETERS,)."""
    state = np.zeros(6)
    state[0], state[3] = _first(measured, "q", row, 0)
    if np.isnan(state[0]):
        raise SignalError(f"no finite link angle among the first {FIRST} samples of the log")
    commanded = np.full(device.n_motors, np.nan)
    if "equilibrium" in commands and device.n_motors:
        preset = commands["preset"][0] if "preset" in commands else 0.0
        commanded = device.motor_angles(commands["equilibrium"][0], preset)
    for motor in range(device.n_motors):
        angle, velocity = _first(measured, "theta", row, 1 + motor)
        state[1 + motor], state[4 + motor] = (angle, velocity) if np.isfinite(angle) else (commanded[motor], 0.0)
        if np.isnan(state[1 + motor]):
            raise SignalError(f"motor {motor + 1} is neither measured nor commanded at the start of the log")
    return state


def _first(measured: Signals, name: str, row: Array, axis: int) -> tuple[float, float]:
    """True angle [rad] and velocity [rad/s] of an axis at the first sample; NaN if it is not measured there."""
    if name not in measured:
        return nan, nan
    values = measured[name] if axis == 0 else measured[name][:, axis - 1]
    angle, velocity = motion_at_start(measured.time, values)
    begin, after = (float(true_angle(row, axis, each)) for each in (angle, angle + velocity * AHEAD))
    return begin, (after - begin) / AHEAD
