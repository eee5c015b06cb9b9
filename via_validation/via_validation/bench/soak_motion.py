"""Motion of the endurance test: a period with stops and rest, measured with noise, encoder steps, dropouts and gaps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from via_controllers.joints.multisine import Multisine
from via_core.devices import Device
from via_core.errors import ParameterError
from via_core.signals import Array, Signals
from via_estimators.contract import rows_of
from via_estimators.methods import estimator_for
from via_sim.plants import JointPlant
from via_sim.sensors import IDEAL
from via_sim.simulate import simulate

RATE = 1000.0  # [Hz]
PERIOD = 600.0  # [s] after which the motion repeats
STOPS = ((100.0, 107.0), (250.0, 310.0), (480.0, 600.0))  # [s] without motion
FADE = 1.0  # [s] of smooth transition into and out of a stop
LOST = 0.02  # share of seconds with a burst of invalid samples
BURST = 20  # samples
GAP = (0.06, 2.0)  # [s] range of the gap in every chunk; a gap of the longest length separates two periods
LOAD = 0.25  # spring torque over that at the deflection limit


@dataclass(frozen=True)
class Motion:
    """One period: rows (N, 1 + k) without noise, noise and steps of each column (k,), truth of the output (N,)."""

    rows: Array
    noise: Array
    quantum: Array
    truth: Array
    output: str


def moving(time: Array) -> Array:
    """Amplitude (N,) of the motion at `time` [s] of a period: 1 in motion, 0 in a stop, smooth in between."""
    share = np.ones(len(time))
    for begin, end in ((-1.0, 0.0), *STOPS):
        outside = np.clip(np.maximum(begin - time, time - end) / FADE, 0.0, 1.0)
        share = np.minimum(share, outside * outside * (3.0 - 2.0 * outside))
    return share


def motion_of(device: Device, method: str, period: float = PERIOD) -> Motion:
    """The joint's motion under multisine commands. Raises ParameterError for an unsupported arrangement or drive."""
    time = np.arange(round(period * RATE)) / RATE
    share = moving(time)

    def tones(mean: float, *pairs: tuple[float, float]) -> Array:
        found = Multisine(0.0, tuple(a for a, _ in pairs), tuple(f for _, f in pairs))
        return mean + share * np.array([found.at(t) for t in time])

    names = {"damping": np.full(len(time), 0.5)} if device.damper is not None else {}
    if device.drive == "servo" and device.arrangement == "serial":
        names |= {"equilibrium": tones(0.0, (0.5, 0.9), (0.3, 2.1)), "preset": tones(0.8, (0.4, 0.3))}
    elif device.arrangement == "rigid":
        names |= {"external_torque": tones(0.0, (4.0, 0.5), (2.0, 1.3))}
    elif device.drive == "torque" and device.n_transmissions == 2:
        load = LOAD * float(device.springs[0].torque(device.springs[0].max_deflection))
        first = tones(1.0, (0.5, 0.7), (0.25, 1.9))
        second = tones(1.0, (0.5, 1.1), (0.25, 2.3))
        names |= {"motor": np.column_stack([load * first, -load * second])}
    else:
        raise ParameterError(f"no motion defined for '{device.name}': {device.arrangement}, {device.drive} drive")
    commands = Signals(time, names, dict.fromkeys(names, "-"), frozenset(names))
    run = simulate(JointPlant.from_device(device), commands, period - 1.0 / RATE, RATE, sensors=IDEAL)
    estimator = estimator_for(device, method)
    output = "stiffness" if "stiffness" in estimator.outputs else "damping"
    channels = {**run.measured.channels, **{n: v for n, v in names.items() if n in ("equilibrium", "preset")}}
    rows = rows_of(Signals(run.measured.time, channels, dict.fromkeys(channels, "-")), estimator.inputs)
    noise, quantum = _sensors(device, estimator.inputs)
    return Motion(rows, noise, quantum, run.truth[output], output)


def _sensors(device: Device, inputs: Sequence[str]) -> tuple[Array, Array]:
    """Noise and steps of every column from the device file; defaults: .01 N m for torques, .01 rad/s for velocities."""
    noise, quantum = np.zeros(len(inputs)), np.zeros(len(inputs))
    for at, name in enumerate(inputs):
        if name == "q":
            quantum[at] = device.sensors.link_quantum or 0.0
        elif name.startswith("theta_velocity"):
            noise[at] = 0.01
        elif name.startswith("theta"):
            quantum[at] = device.sensors.motor_quantum or 0.0
        elif name.startswith("tau"):
            noise[at] = device.sensors.link_torque_noise or device.sensors.torque_noise or 0.01
        noise[at] = max(noise[at], quantum[at] / 2.0)
    return noise, quantum


def measured(motion: Motion, begin: int, end: int, shift: float, random: np.random.Generator) -> tuple[Array, Array]:
    """Rows and truth of samples begin..end of the period, `shift` [s] later, with noise, invalid samples and a gap."""
    rows = motion.rows[begin:end].copy()
    truth = motion.truth[begin:end]
    values = rows[:, 1:]
    values += motion.noise * random.standard_normal(values.shape)
    stepped = motion.quantum > 0.0
    values[:, stepped] = np.round(values[:, stepped] / motion.quantum[stepped]) * motion.quantum[stepped]
    for first in np.flatnonzero(random.random(len(rows) // round(RATE)) < LOST) * round(RATE):
        values[first : first + BURST, random.integers(values.shape[1])] = random.choice([np.nan, np.inf, 1e12])
    rows[:, 0] += shift
    hole = random.integers(len(rows))
    kept = np.ones(len(rows), dtype=bool)
    kept[hole : hole + round(random.uniform(*GAP) * RATE)] = False
    return rows[kept], truth[kept]
