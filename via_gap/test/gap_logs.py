"""Logs the tests share: a motor-controlled joint that follows a multisine, with planted effects and wrong numbers."""

from collections.abc import Sequence
from functools import cache

import numpy as np
from via_core.devices import Device, load_device, parse_device
from via_core.signals import Signals
from via_gap.design.commands import following
from via_gap.logs.log import JointLog
from via_gap.residual.nuisance import nuisances
from via_sim.effects import Effect, write_effects
from via_sim.plants import JointPlant
from via_sim.sensors import Sensors
from via_sim.simulate import InitialConditions, Simulator, simulate

FLEXIBLE = """
name: joint
title: flexible test joint
source: [made for a test]
confidence: assumed
arrangement: flexible
link: {inertia: 0.02, viscous_friction: 0.02, gravity_torque: 0.4}
motors: [{inertia: 0.015, viscous_friction: 0.1, torque_limit: 8.0}]
springs: [{law: odd_polynomial, odd_coefficients: [6.0, 10.0], max_deflection: 1.5}]
sensors: {rate: 1000.0, link_quantum: 9.587e-5, motor_quantum: 9.587e-5, torque_noise: 0.002}
"""
RIGID = """
name: joint
title: rigid test joint
source: [made for a test]
confidence: assumed
arrangement: rigid
link: {inertia: 0.04, viscous_friction: 0.1, gravity_torque: 1.0}
sensors: {rate: 500.0, link_quantum: 9.587e-5}
"""
POSITIONED = """
name: joint
title: rigid test joint with a position drive
source: [made for a test]
confidence: assumed
arrangement: rigid
drive: position
link: {inertia: 0.04, viscous_friction: 0.1, gravity_torque: 1.0}
servo: {kp: 12.0, kd: 0.4, torque_limit: 4.0, delay: 0.0073}
sensors: {rate: 500.0, link_quantum: 9.587e-5}
"""
HELD = frozenset({"equilibrium", "preset", "damping"})


def flexible() -> Device:
    return parse_device(FLEXIBLE, "flexible")


def rigid() -> Device:
    return parse_device(RIGID, "rigid")


def positioned() -> Device:
    return parse_device(POSITIONED, "positioned")


def servo() -> Device:
    return load_device("maccepavd").model_copy(update={"sensors": flexible().sensors})


def wrong_plant(device: Device, effects: Sequence[Effect], rng: np.random.Generator, tolerance: float) -> JointPlant:
    """The true plant: every number of the device file off by up to `tolerance`, and the effects."""
    nominal = JointPlant.from_device(device)
    row = nominal.parameters.copy()
    for nuisance in nuisances(nominal):
        nuisance.apply(row, tolerance / nuisance.tolerance * rng.uniform(-1.0, 1.0))
    write_effects(row, device, effects)
    return JointPlant(device, row, tuple(effects))


def log_of(
    device: Device, effects: Sequence[Effect] = (), seed: int = 1, duration: float = 12.0, tolerance: float = 0.05
) -> JointLog:
    """A recorded motion of the joint; the same arguments give the same bits."""
    return _log(device.model_dump_json(), tuple(effects), seed, duration, tolerance)


class _Key(tuple):
    """Effects hold mappings, which cannot be hashed: they count by what they say."""

    def __hash__(self) -> int:
        return hash(repr(tuple(self)))


def _log(text: str, effects: tuple[Effect, ...], seed: int, duration: float, tolerance: float) -> JointLog:
    return _made(text, _Key(effects), seed, duration, tolerance)


@cache
def _made(text: str, effects: _Key, seed: int, duration: float, tolerance: float) -> JointLog:
    device = Device.model_validate_json(text)
    rng = np.random.default_rng(seed)
    plant = wrong_plant(device, effects, rng, tolerance)
    rate = device.sensors.rate
    count = round(duration * rate)
    time = np.arange(count + 1) / rate
    frequency = np.array([0.15, 0.37, 0.83, 1.7, 2.9]) * rng.uniform(0.8, 1.2, 5)
    amplitude = np.array([0.5, 0.35, 0.25, 0.12, 0.06]) * rng.uniform(0.8, 1.2, 5)
    phase = rng.uniform(0.0, 6.28, 5)
    fade = np.clip(time, 0.0, 1.0)
    wish = (fade * fade * (3.0 - 2.0 * fade)) * np.sum(
        amplitude[:, None] * np.sin(2.0 * np.pi * frequency[:, None] * time + phase[:, None]), axis=0
    )
    sensors = Sensors.of_device(device)
    if device.drive == "servo":
        every = slice(None, -1, 10)
        channels = {
            "equilibrium": wish[every],
            "preset": 0.9 + 0.3 * np.sin(0.7 * time[every]),
            "damping": 0.5 + 0.5 * np.sin(1.4 * time[every]),
        }
        commands = Signals(time[every], channels, {"equilibrium": "rad", "preset": "rad", "damping": "-"}, HELD)
        measured = simulate(plant, commands, duration, rate, sensors, InitialConditions(seed=seed)).measured
    elif not device.motors:
        commands = Signals(
            time[:-1], {"external_torque": wish[:-1]}, {"external_torque": "N m"}, frozenset({"external_torque"})
        )
        measured = simulate(plant, commands, duration, rate, sensors, InitialConditions(seed=seed)).measured
    else:
        measured, commands = controlled(plant, sensors, rate, time, wish, seed)
    seen = {name: values for name, values in measured.channels.items() if np.isfinite(values).any()}
    return JointLog(f"log {seed}", device, Signals(measured.time, seen, measured.units), commands)


def controlled(plant: JointPlant, sensors: Sensors, rate: float, time: np.ndarray, wish: np.ndarray, seed: int):
    """One torque-driven motor under a position controller that sees what the encoder reads."""
    simulator = Simulator(plant, rate, sensors)
    state = simulator.init(seed=seed)
    rows = np.empty((len(time), 9))
    torque = np.zeros(len(time) - 1)
    rows[0] = simulator.sample(state)[0]
    speed = 0.0
    for k in range(len(time) - 1):
        if k:
            speed += 0.25 * ((rows[k, 1] - rows[k - 1, 1]) * rate - speed)
        torque[k] = np.clip(-0.4 * speed - 8.0 * (rows[k, 1] - wish[k]), -8.0, 8.0)
        command = np.zeros(4)
        command[0] = torque[k]
        state, rows[k + 1], _ = simulator.step(state, command)
    measured = Signals(
        time, {"q": rows[:, 0], "theta": rows[:, 1:2], "tau": rows[:, 3:4]}, {"q": "rad", "theta": "rad", "tau": "N m"}
    )
    return measured, Signals(time[:-1], {"motor": torque[:, None]}, {"motor": "N m"}, frozenset({"motor"}))


def antagonistic_log(effects: Sequence[Effect] = (), duration: float = 6.0, seed: int = 3) -> JointLog:
    """Two motors of an antagonistic joint under a position loop, with a moving equilibrium and preset."""
    device = load_device("cubic_aa_vsa")
    plant, rate = JointPlant.from_device(device).with_effects(effects), device.sensors.rate
    time = np.arange(round(duration * rate)) / rate
    fade = np.clip(time, 0.0, 1.0)
    equilibrium = fade**2 * sum(a * np.sin(w * time) for a, w in ((0.3, 1.1), (0.2, 4.3), (0.05, 17.0)))
    preset = 0.15 * fade * device.springs[0].max_deflection * (2.0 + np.sin(0.9 * time))
    torque = following(plant, device.motor_angles(equilibrium, preset), equilibrium, np.zeros(6), rate)
    commands = Signals(time, {"motor": torque}, {"motor": "N m"}, frozenset({"motor"}))
    measured = simulate(
        plant, commands, duration, rate, Sensors.of_device(device), InitialConditions(seed=seed)
    ).measured
    seen = [name for name, values in measured.channels.items() if np.isfinite(values).any()]
    return JointLog(f"log {seed}", device, measured.select(seen), commands)


def even_log(effects: Sequence[Effect] = (), speed: float = 0.3, duration: float = 10.0, seed: int = 4) -> JointLog:
    """A balanced rigid joint under velocity control that turns evenly, first forwards, then backwards."""
    device = rigid()
    device = device.model_copy(update={"link": device.link.model_copy(update={"gravity_torque": 0.0})})
    rate = device.sensors.rate
    simulator = Simulator(JointPlant.from_device(device).with_effects(effects), rate, Sensors.of_device(device))
    state, count = simulator.init(seed=seed), round(duration * rate)
    angle, torque = np.empty(count + 1), np.zeros(count)
    angle[0] = simulator.sample(state)[0][0]
    seen = integral = 0.0
    for k in range(count):
        wanted = speed * min(k / rate, 1.0) * (1.0 if k < count // 2 else -1.0)
        if k:
            seen += 0.3 * ((angle[k] - angle[k - 1]) * rate - seen)
        integral += (wanted - seen) / rate
        torque[k] = 0.6 * (wanted - seen) + 6.0 * integral
        state, row, _ = simulator.step(state, np.array([0.0, 0.0, 0.0, torque[k]]))
        angle[k + 1] = row[0]
    time, sent = np.arange(count + 1) / rate, {"external_torque": torque}
    commands = Signals(time[:-1], sent, {"external_torque": "N m"}, frozenset(sent))
    return JointLog("even", device, Signals(time, {"q": angle}, {"q": "rad"}), commands)
