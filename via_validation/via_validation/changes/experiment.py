"""Joints whose springs or damper follow a schedule, and their measured signals, the same for every method.

Springs: motors under position control along the multisines of `via compare`, whose angles are scaled to the joint. The
torques of a noise-free run are replayed for every seed. Sensors and dry friction are those of LEVEL.

Dampers: the damping command follows the schedule. The link of compact_vpda is moved by a torque, as in Section 5 of the
research document; the servo of maccepavd swings its link, with the dead time that its device file states.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from via_controllers.contract import JointSample
from via_controllers.joints.motor_position import MotorPositionControl
from via_controllers.joints.multisine import Multisine
from via_core.devices import Device
from via_core.errors import ParameterError
from via_core.signals import Array, Signals
from via_sim.effects import Effect
from via_sim.plants import JointPlant
from via_sim.sensors import IDEAL, Sensors
from via_sim.simulate import InitialConditions, simulate

from via_validation.changes.schedules import Schedule
from via_validation.changes.springs import changing_springs, signals_of, true_stiffness
from via_validation.compare import experiment
from via_validation.compare.experiment import LEVELS, seen_by_estimators

DEVICES = ("cubic_demo", "qbmove_a", "qbmove_b", "qbmove_alterego", "dlr_bavs", "compact_vpda", "maccepavd")
LEVEL = LEVELS[1]
QBMOVE_STOP = 0.8  # [rad] to which the multisines of `via compare` belong
WIDEST = 1.5  # largest factor on them: cubic_demo's motors have no more torque
HIGHEST = 1.55  # largest factor of a schedule, with a margin, which the damper must reach
TONES = ((1.5, 0.5, 0.0), (0.4, 1.3, 1.0))  # [rad/s], [Hz], [rad] of the link of a damped joint
SWING = ((0.35, 1.1), (0.2, 2.3))  # [rad], [Hz] of a servo's equilibrium
PRESET = ((0.3, 0.0), (0.2, 0.3))  # [rad], [Hz] of its preset, a cosine


@dataclass(frozen=True)
class Recording:
    """A motion under a schedule.

    output     what changes: 'stiffness' or 'damping'
    time       (n,) [s]
    truth      (n,) of the output
    unchanged  (n,) of the output on the same motion without the schedule
    measured   measured signals for a seed
    """

    output: str
    time: Array
    truth: Array
    unchanged: Array
    measured: Callable[[int], Signals]


def changing_output(device: Device) -> str:
    """'stiffness' or 'damping'. Raises ParameterError for a device without two driven springs and without damper."""
    if device.arrangement == "antagonistic" and device.drive == "torque":
        return "stiffness"
    if device.damper is not None and (device.arrangement, device.drive) in (("rigid", "torque"), ("serial", "servo")):
        return "damping"
    raise ParameterError(f"'{device.name}' has neither a damper nor two springs with torque-driven motors")


def description_for_estimators(device: Device) -> Device:
    """The device file with the sensors of LEVEL; that of a damped joint has its own sensors."""
    return seen_by_estimators(device, LEVEL) if changing_output(device) == "stiffness" else device


def recording(device: Device, schedule: Schedule, duration: float) -> Recording:
    """The joint's motion under the schedule; `duration` [s]."""
    if changing_output(device) == "stiffness":
        return _with_springs(device, schedule, duration)
    return _damped_link(device, schedule, duration) if device.n_motors == 0 else _servo(device, schedule, duration)


def _with_springs(device: Device, schedule: Schedule, duration: float) -> Recording:
    time = np.arange(round(duration * experiment.RATE)) / experiment.RATE
    plant, factor = JointPlant.from_device(device), schedule.factor(time)
    controller, torques = _controller(device), np.zeros((len(time), 2))
    memory = controller.init()

    def control(k: int, measured: Array) -> Array:
        nonlocal memory
        memory, answer = controller.step(memory, JointSample(time[k], float(measured[0]), measured[1:3]))
        torques[k] = answer.torque
        return torques[k]

    _, truth = changing_springs(plant, factor, control, IDEAL)

    def measured(seed: int) -> Signals:
        rows, _ = changing_springs(plant, factor, lambda k, _: torques[k], LEVEL.sensors, seed)
        return signals_of(time, rows)

    stiffness = true_stiffness(truth)
    return Recording("stiffness", time, stiffness, stiffness / factor, measured)


def _controller(device: Device) -> MotorPositionControl:
    """The position control of `via compare`, along its multisines scaled to the stop of the joint's springs."""
    scale = min(device.springs[0].max_deflection / QBMOVE_STOP, WIDEST)

    def scaled(tones: Multisine) -> Multisine:
        return replace(tones, mean=scale * tones.mean, amplitudes=tuple(scale * each for each in tones.amplitudes))

    return experiment.position_control(device, scaled(experiment.EQUILIBRIUM), scaled(experiment.PRESET))


def _damping(device: Device) -> tuple[float, Callable[[Array], Array]]:
    """Damping [N m s/rad] at factor 1, and the damper command [-] for a damping (n,)."""
    command = np.linspace(0.0, 1.0, 1001)
    values = device.damping_of(command)
    friction = device.link.viscous_friction if device.n_motors else 0.0  # a torque sensor at the damper has no friction
    return (friction + float(values[-1])) / HIGHEST, lambda damping: np.interp(damping - friction, values, command)


def _damped_link(device: Device, schedule: Schedule, duration: float) -> Recording:
    rate = device.sensors.rate
    time = np.arange(round(duration * rate)) / rate
    base, command = _damping(device)
    damping = base * schedule.factor(time)
    velocity, acceleration = np.zeros(len(time)), np.zeros(len(time))
    for size, frequency, phase in TONES:
        w = 2.0 * np.pi * frequency
        velocity += size * np.sin(w * time + phase)
        acceleration += size * w * np.cos(w * time + phase)
    torque = device.link.inertia * acceleration + (damping + device.link.viscous_friction) * velocity
    torque *= np.clip(time / 0.3, 0.0, 1.0)
    channels = {"external_torque": torque, "damping": command(damping)}
    commands = Signals(time, channels, {"external_torque": "N m", "damping": "-"}, frozenset(channels))
    plant, sensors = JointPlant.from_device(device), Sensors.of_device(device)

    def measured(seed: int) -> Signals:
        initial = InitialConditions(seed=seed)
        return simulate(plant, commands, (len(time) - 1) / rate, rate, sensors, initial).measured

    return Recording("damping", time, damping, np.full(len(time), base), measured)


def _servo(device: Device, schedule: Schedule, duration: float) -> Recording:
    rate, late = device.sensors.rate, device.observed.servo_dead_time
    time = np.arange(round(duration * rate)) / rate
    base, command = _damping(device)
    plant = JointPlant.from_device(device).with_effects([Effect("actuator_delay", "command", {"delay": late})])
    channels = {
        "equilibrium": np.sum([size * np.sin(2.0 * np.pi * f * time) for size, f in SWING], axis=0),
        "preset": np.sum([size * np.cos(2.0 * np.pi * f * time) for size, f in PRESET], axis=0),
    }
    # The damper acts on time: its command is given earlier by the dead time.
    given = {**channels, "damping": command(base * schedule.factor(time + late))}
    commands = Signals(time, given, {"equilibrium": "rad", "preset": "rad", "damping": "-"}, frozenset(given))
    sensors = Sensors.of_device(device)

    def measured(seed: int) -> Signals:
        found = simulate(plant, commands, (len(time) - 1) / rate, rate, sensors, InitialConditions(seed=seed)).measured
        units = {**found.units, "equilibrium": "rad", "preset": "rad"}
        return Signals(found.time, {**found.channels, **channels}, units, frozenset(channels))

    return Recording("damping", time, base * schedule.factor(time), np.full(len(time), base), measured)
