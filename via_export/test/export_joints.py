"""Devices, commands and effects with which the tests of this package compare simulators."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from via_core.devices import Device, load_device
from via_core.signals import Array, Signals
from via_export.exporting import export
from via_export.mujoco_joint import QUEUE, MujocoJoint
from via_sim.effects import Effect
from via_sim.plants import JointPlant
from via_sim.simulate import InitialConditions, command_rows, initial_state, simulate

RATE = 1000.0  # [Hz]


def wave(frequency: float, amplitude: float) -> Callable[[Array], Array]:
    return lambda t: amplitude * (np.sin(2 * np.pi * frequency * t) + 0.3 * np.sin(4.6 * np.pi * frequency * t))


def of_motors(count: int, amplitude: float) -> Callable[[Array], Array]:
    one = wave(0.9, amplitude)
    return lambda t: np.stack([one(t), -0.6 * one(t)][:count], axis=1)


# device -> commands, angles of link and motors at the start [rad]
MOTIONS: dict[str, tuple[dict[str, Callable[[Array], Array]], tuple[float, ...]]] = {
    "dfki_simple_pendulum": ({"external_torque": wave(0.9, 2.0)}, ()),
    "compact_vpda": ({"external_torque": wave(0.9, 3.0), "damping": lambda t: 0.5 + 0.4 * np.sin(5 * t)}, ()),
    "xl330": ({"equilibrium": wave(1.0, 0.8)}, ()),
    "visco_elastic_demo": ({"motor": of_motors(1, 1.0)}, ()),
    "cubic_demo": ({"motor": of_motors(2, 1.5)}, ()),
    "qbmove_a": ({"motor": of_motors(2, 1.5)}, ()),
    "dlr_bavs": ({"motor": of_motors(2, 0.5)}, ()),
    "vsa2": ({"motor": of_motors(2, 0.3)}, ()),
    "maccepavd": (
        {"equilibrium": wave(1.0, 0.5), "preset": lambda t: 0.5 + 0.3 * np.sin(3 * t),
         "damping": lambda t: 0.5 + 0.45 * np.sin(5 * t)}, (0.0, 0.0, 0.5),
    ),
    "edinburgh_vsa": ({"equilibrium": wave(1.0, 0.3), "preset": lambda t: 0.3 + 0.1 * np.sin(3 * t)}, (0.0, 0.3, -0.3)),
}  # fmt: skip


def commands_of(device: Device, seconds: float) -> Signals:
    time = np.arange(round(seconds * RATE)) / RATE
    channels = {name: np.asarray(value(time)) for name, value in MOTIONS[device.name][0].items()}
    return Signals(time, channels, dict.fromkeys(channels, ""), frozenset(channels))


def start_of(device: Device) -> Array:
    state = np.zeros(6)
    given = MOTIONS[device.name][1]
    state[: len(given)] = given
    return state


def angles_in_via_sim(device: Device, effects: Sequence[Effect], seconds: float) -> Array:
    """(N, axes) [rad] as measured."""
    plant = JointPlant.from_device(device).with_effects(effects)
    run = simulate(plant, commands_of(device, seconds), seconds, RATE, initial=InitialConditions(start_of(device)))
    q = run.measured["q"][:, None]
    return np.hstack([q, run.measured["theta"]]) if device.n_motors else q


def angles_in_mujoco(device: Device, effects: Sequence[Effect], seconds: float) -> Array:
    """(N, axes) [rad] as the sensors of the exported model measure them."""
    made = export(device, effects, "mjcf")
    model = MujocoJoint(made.text, made.target, rate=RATE)
    plant, commands = JointPlant.from_device(device).with_effects(effects), commands_of(device, seconds)
    state = initial_state(plant, RATE, start_of(device), 0)
    before = np.zeros((QUEUE, 6))
    if device.drive == "servo":
        before[:, :2] = start_of(device)[1:3]
    return model.run(model.start(state, before), command_rows(device, commands, commands.time))


def difference(one: Array, other: Array) -> float:
    """Largest over the axes: rms difference over the standard deviation of `one`."""
    scale = np.maximum(np.std(one, axis=0), 1e-9)
    return float(np.max(np.sqrt(np.mean((one - other) ** 2, axis=0)) / scale))


def device_of(name: str) -> Device:
    return load_device(name)
