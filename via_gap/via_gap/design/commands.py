"""Commands that take a joint through a motion, and what its sensors would record under them."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, inf

import numpy as np
from via_core.command_files import COMMAND_UNITS
from via_core.device_parts import TorqueMotor
from via_core.devices import Device
from via_core.errors import ParameterError
from via_core.signals import Array, Signals
from via_sim.joint.layout import EXTERNAL, M1
from via_sim.plants import JointPlant
from via_sim.sensors import Sensors
from via_sim.simulate import InitialConditions, Simulator, simulate

from via_gap.design.motions import DURATION, REST, Motion
from via_gap.logs.log import JointLog

RATE = 1000.0  # [Hz] least rate of commands
RANGE = 0.6  # [rad] largest motor angle from rest
SWING = 1.4  # times RANGE: how far the link may move
DEFLECTED = 0.8  # of the largest deflection
BANDWIDTH = 12.0  # [rad/s] of the position loop that makes torques from references


def rate_of(device: Device) -> float:
    """[Hz] of commands: at least RATE, a whole multiple of the sensors' rate."""
    return device.sensors.rate * ceil(RATE / device.sensors.rate - 1e-9)


def commands_of(plant: JointPlant, motion: Motion, size: float) -> tuple[Signals, Array]:
    """Commands that take a plant through a motion of `size` [rad], and its initial state (6,) at rest."""
    device, rate = plant.device, rate_of(plant.device)
    time = np.arange(round(DURATION * rate)) / rate
    equilibrium, load = size * motion.reference(time), motion.load(time)
    start = np.zeros(6)
    if device.drive == "servo":
        preset = 0.6 + 0.4 * load
        start[1 : 1 + device.n_motors] = device.motor_angles(equilibrium[0], preset[0])
        channels = {"equilibrium": equilibrium, "preset": preset, "damping": np.zeros(len(time))}
        return Signals(time, channels, COMMAND_UNITS, frozenset(channels)), start
    if device.drive == "position":
        return Signals(time, {"equilibrium": equilibrium}, COMMAND_UNITS, frozenset({"equilibrium"})), start
    preset = np.zeros(len(time))
    if device.arrangement == "antagonistic":
        raised = np.clip(time / REST, 0.0, 1.0)
        preset = raised * (0.25 + 0.15 * load) * device.springs[0].max_deflection
    wanted = device.motor_angles(equilibrium, preset) if device.n_motors else equilibrium[:, None]
    torque = following(plant, wanted, equilibrium, start, rate)
    channels = {"motor": torque} if device.n_motors else {"external_torque": torque[:, 0]}
    return Signals(time, channels, COMMAND_UNITS, frozenset(channels)), start


def following(plant: JointPlant, wanted: Array, equilibrium: Array, start: Array, rate: float) -> Array:
    """Torques (N, m) [N m] with which a position loop moves motors (or a rigid link) along `wanted` (N, m) [rad]."""
    device = plant.device
    driven = max(device.n_motors, 1)
    forward = -device.torque_each(equilibrium, wanted) if device.n_transmissions == driven else np.zeros_like(wanted)
    rates = np.gradient(wanted, 1.0 / rate, axis=0)
    motors = device.torque_motors
    carried = np.array([m.inertia + device.link.inertia / driven for m in motors] or [device.link.inertia])
    viscous = np.array([m.viscous_friction for m in motors] or [device.link.viscous_friction])
    limit = np.array([m.torque_limit or inf for m in motors] or [inf])
    proportional = carried * BANDWIDTH**2
    derivative = np.maximum(1.2 * carried * BANDWIDTH - viscous, 0.2 * carried * BANDWIDTH)
    first, column = (1, M1) if motors else (0, EXTERNAL)
    simulator = Simulator(plant, rate)
    state, command = simulator.init(start), np.zeros(4)
    torque = np.empty_like(wanted)
    for k in range(len(wanted)):
        angle, speed = state[first : first + driven], state[3 + first : 3 + first + driven]
        wish = forward[k] + proportional * (wanted[k] - angle) + derivative * (rates[k] - speed)
        torque[k] = np.clip(wish, -limit, limit)
        command[column : column + driven] = torque[k]
        state, _, _ = simulator.step(state, command)
    return torque


def angles_under(plant: JointPlant, commands: Signals) -> Array | None:
    """Motor angles (N, m) [rad] of a plant at rest under torque commands; None without motors that take torques.

    A player follows them by feedback (`via_controllers.joints.played_commands`): torques alone let motors drift.
    """
    if "motor" not in commands:
        return None
    rate = rate_of(plant.device)
    run = simulate(plant, commands, len(commands) / rate, rate, Sensors.of_device(plant.device))
    return np.asarray(run.truth.resample(commands.time)["theta"])


def recorded(plant: JointPlant, commands: Signals, start: Array, seed: int) -> JointLog | None:
    """What the device's sensors would record of a plant under these commands; None if it diverges."""
    device = plant.device
    sensors = Sensors.of_device(device)
    try:
        run = simulate(plant, commands, DURATION, rate_of(device), sensors, InitialConditions(start, seed=seed))
    except ParameterError:
        return None
    seen = {name: values for name, values in run.measured.channels.items() if np.isfinite(values).any()}
    return JointLog("proposed", device, Signals(run.measured.time, seen, run.measured.units), commands)


def all_within_limits(
    plants: Sequence[JointPlant], commands: Signals, start: Array, size: float
) -> list[JointLog] | None:
    """What the sensors would record of each plant, see `recorded`; None unless all keep within limits."""
    logs: list[JointLog] = []
    for seed, plant in enumerate(plants):
        log = recorded(plant, commands, start, seed)
        if log is None or not within_limits(log, size):
            return None
        logs.append(log)
    return logs


def within_limits(log: JointLog, size: float) -> bool:
    """Whether a recorded motion of `size` [rad] keeps within the device's limits and stays near rest."""
    device, measured = log.device, log.measured
    most = SWING * max(size, 0.5 * RANGE)
    if np.max(np.abs(measured["q"] - np.median(measured["q"]))) > most + abs(device.link.gravity_angle):
        return False
    if device.n_motors == 0:
        return True
    theta = measured["theta"]
    apart = max(1, round(0.01 * len(theta) / DURATION))  # samples: over one, encoder steps look like speeds
    speed = np.abs(theta[apart:] - theta[:-apart]).max(axis=0) / (apart * np.median(np.diff(measured.time)))
    for i, motor in enumerate(device.motors):
        fastest = motor.speed_limit if isinstance(motor, TorqueMotor) else device.observed.servo_speed_limit
        if fastest is not None and speed[i] > fastest:
            return False
    return all(
        bool(np.max(np.abs(measured["q"] - theta[:, i])) <= DEFLECTED * spring.max_deflection)
        for i, spring in enumerate(device.springs)
    )
