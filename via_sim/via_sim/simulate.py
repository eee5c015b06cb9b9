"""simulate() in one batch, Simulator step by step, simulate_many for many variants: one compiled kernel, same bits.

Time. Sample k belongs to t_k = start + k / rate. Command k is held over [t_k, t_{k+1}); it is what a controller answers
to sample k. `tau` of sample k is the torque commanded over the tick that ended at t_k (nothing later is known then),
before dead time and gain: what the drive would log.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import pairwise
from math import ceil

import numpy as np
from numpy.typing import ArrayLike
from via_core.devices import Device
from via_core.errors import ParameterError
from via_core.signals import Array, Signals

from via_sim.catalogue import MAX_DELAY
from via_sim.effects import Effect
from via_sim.kernel import run
from via_sim.lockstep.run import LANES, run_many
from via_sim.measurements import MEASURED, TRUTH
from via_sim.parameters import ABSENT, SERVO, P
from via_sim.plants import JointPlant
from via_sim.sensors import IDEAL, Sensors
from via_sim.torques import ARM, DAMPING, EXTERNAL, GOAL, HISTORY, M1, N_COMMANDS, NEIGHBOUR, POWER, QUEUED, X

MAX_SEED = 2**53 - 1


@dataclass(frozen=True)
class Simulation:
    """What the sensors saw, and what was."""

    measured: Signals
    truth: Signals


@dataclass(frozen=True)
class Simulator:
    """A joint, its sensors and a tick rate: `init` makes a state, `step` returns the next one.

    The state (n,) is one flat row that holds everything: motion, tick number, seed, queue of commands under way.
    """

    plant: JointPlant
    rate: float  # [Hz] ticks
    sensors: Sensors = IDEAL
    _row: Array = field(init=False, repr=False, compare=False)  # not locked: read-only arrays are a type of their own
    _sensor_row: Array = field(init=False, repr=False, compare=False)  # to numba, and would compile everything twice

    def __post_init__(self) -> None:
        object.__setattr__(self, "_row", self.plant.at_rate(self.rate))
        object.__setattr__(self, "_sensor_row", self.sensors.row())
        self.sensors.decimation(self.rate)

    def init(self, initial: ArrayLike | None = None, seed: int = 0) -> Array:
        """State (n,) at tick 0.

        initial  (6,) q, theta_1, theta_2 [rad] and their velocities [rad/s]; all zero if left out
        """
        return initial_state(self.plant, self.rate, initial, seed)

    def sample(self, state: Array) -> tuple[Array, Array]:
        """(measured (9,), truth (16,)) of a state, in the order of kernel.MEASURED and kernel.TRUTH."""
        return self._run(state.copy(), np.empty((0, N_COMMANDS)))

    def step(self, state: Array, command: ArrayLike) -> tuple[Array, Array, Array]:
        """(next state (n,), measured (9,), truth (16,)) after one tick under command (4,) or (N_COMMANDS,).

        command  motor 1, motor 2 [N m or rad] (of a position drive its goal [rad] and 1, or 0 to switch it off),
                 damping command [-], external torque at the link [N m], and of an arm the neighbour's angle [rad] and
                 the torque of its other joints on the link [N m]

        Raises ParameterError when the command is not finite or has another shape.
        """
        u = np.zeros((1, N_COMMANDS))
        given = np.asarray(command, dtype=np.float64)
        if given.shape not in ((NEIGHBOUR,), (N_COMMANDS,)) or not np.all(np.isfinite(given)):
            raise ParameterError(f"a command is {NEIGHBOUR} or {N_COMMANDS} finite numbers, got {command!r}")
        u[0, : len(given)] = given
        after = state.copy()
        measured, truth = self._run(after, u)
        return after, measured, truth

    def _run(self, state: Array, commands: Array) -> tuple[Array, Array]:
        measured, truth = np.empty((len(commands) + 1, len(MEASURED))), np.empty((len(commands) + 1, len(TRUTH)))
        run(self._row, self._sensor_row, state, commands, measured, truth)
        return measured[-1], truth[-1]


def initial_state(plant: JointPlant, rate: float, initial: ArrayLike | None, seed: int) -> Array:
    """State row (n,) at tick 0; what is not there yet in the queue of commands is the passive one (servos stay)."""
    if isinstance(seed, bool) or not 0 <= seed <= MAX_SEED:
        raise ParameterError(f"seed must be 0 to {MAX_SEED}, got {seed}")
    motion = np.zeros(6) if initial is None else np.asarray(initial, dtype=np.float64)
    if motion.shape != (6,) or not np.all(np.isfinite(motion)):
        raise ParameterError(f"initial must be 6 finite numbers (three angles, three velocities), got {initial!r}")
    queue = ceil(MAX_DELAY * rate) + 2
    state = np.zeros(X.queue + QUEUED * queue)
    kinds = np.tile(plant.parameters[P.axis_kind : P.axis_kind + 3], 2)
    state[:6] = np.where(kinds == ABSENT, 0.0, motion)
    state[X.seed] = seed
    state[X.history : X.queue].reshape(HISTORY, 6)[:, :3] = state[:3]  # it has stood there before
    state[X.queue :].reshape(queue, QUEUED)[:, :2] = passive_command(plant, state)[:2]
    return state


def passive_command(plant: JointPlant, state: Array) -> Array:
    """The command (N_COMMANDS,) that asks for nothing: zero torque, servos where they are, drives off, no damping."""
    servo = plant.parameters[P.axis_kind + 1 : P.axis_kind + 3] == SERVO
    row = np.zeros(N_COMMANDS)
    row[:2] = np.where(servo, state[1:3], 0.0)
    return row


def command_rows(device: Device, commands: Signals, time: Array) -> Array:
    """Commands (N, N_COMMANDS) held at `time`, from the channels a device understands.

    `motor` (N, m) torque [N m] or servo position [rad]; servo devices take `equilibrium` and `preset` [rad] instead. A
    position drive takes its goal as `equilibrium`, NaN where it is switched off; it has no preset, and one is not used.
    `damping` [-], `external_torque` [N m], `neighbour` [rad] and `arm_torque` [N m] are optional. Raises ParameterError
    on a channel that does not fit.
    """
    known = {"motor", "equilibrium", "preset", "damping", "external_torque", "neighbour", "arm_torque"}
    strangers = commands.channels.keys() - known
    if strangers:
        raise ParameterError(f"no command channel '{sorted(strangers)[0]}'; there are: {', '.join(sorted(known))}")
    held = Signals(commands.time, commands.channels, commands.units, frozenset(commands.channels))
    held = held.resample(time + 1e-9 + 4.0 * np.spacing(np.abs(time)))  # 0.02 * 7 must not come one tick after 0.14
    positioned = device.drive == "position"
    for name, values in held.channels.items():
        if positioned and (name == "preset" or (name == "equilibrium" and not np.any(np.isinf(values)))):
            continue
        if not np.all(np.isfinite(values)):
            first = int(np.flatnonzero(~np.isfinite(values.reshape(len(time), -1).sum(axis=1)))[0])
            raise ParameterError(f"command '{name}' is not finite at {time[first]:.6g} s")
    rows = np.zeros((len(time), N_COMMANDS))
    angles = {"equilibrium", "preset"} & held.channels.keys()
    if "motor" in held:
        if angles:
            raise ParameterError("commands have 'motor' and " + " and ".join(sorted(angles)) + ": one of them rules")
        motor = held["motor"].reshape(len(time), -1)
        if motor.shape[1] != device.n_motors:
            raise ParameterError(
                f"command 'motor' has {motor.shape[1]} columns, '{device.name}' {device.n_motors} motors"
            )
        rows[:, M1 : M1 + device.n_motors] = motor
    elif positioned and "equilibrium" in held:
        on = np.isfinite(held["equilibrium"])
        rows[:, GOAL], rows[:, POWER] = np.where(on, held["equilibrium"], 0.0), on
    elif angles:
        if device.drive != "servo" or device.n_motors == 0:
            raise ParameterError(f"'{device.name}' has no position servos: command 'motor' torques instead")
        if "equilibrium" not in held:
            raise ParameterError("commands have 'preset' but no 'equilibrium'")
        preset = held["preset"] if "preset" in held else np.zeros(len(time))
        rows[:, M1 : M1 + device.n_motors] = device.motor_angles(held["equilibrium"], preset)
    if "damping" in held:
        rows[:, DAMPING] = held["damping"]
    if "external_torque" in held:
        rows[:, EXTERNAL] = held["external_torque"]
    if "neighbour" in held:
        rows[:, NEIGHBOUR] = held["neighbour"]
    if "arm_torque" in held:
        rows[:, ARM] = held["arm_torque"]
    return rows


def simulate(
    plant: JointPlant,
    commands: Signals | None,
    duration: float,
    rate: float,
    effects: Sequence[Effect] = (),
    sensors: Sensors = IDEAL,
    initial: ArrayLike | None = None,
    seed: int = 0,
    start: float = 0.0,
    age: float = 0.0,
) -> Simulation:
    """A whole run in one call.

    commands  held between their samples, see `command_rows`; before their first sample the first stands. None: passive
    duration  [s] rounded to ticks; n ticks give n+1 samples
    rate      [Hz] ticks; measured has every (rate / sensors.rate)-th sample, truth all
    effects   beside those the plant already has
    initial   (6,) q, theta_1, theta_2 [rad], velocities [rad/s]
    start     [s] time of sample 0, on the commands' clock
    age       [s] of the run at sample 0, which drifts and pulses count from

    Raises ParameterError for commands, effects or numbers that do not fit, or that overflow.
    """
    if effects:
        plant = plant.with_effects((*plant.effects, *effects))
    device, row = plant.device, plant.at_rate(rate)
    row[P.origin] = age
    every = sensors.decimation(rate)
    time = _ticks(duration, rate, start)
    state = initial_state(plant, rate, initial, seed)
    if commands is None:
        rows = np.tile(passive_command(plant, state), (len(time) - 1, 1))
    else:
        rows = command_rows(device, commands, time[:-1])
    measured, truth = np.empty((len(time), len(MEASURED))), np.empty((len(time), len(TRUTH)))
    run(row, sensors.row(), state, rows, measured, truth)
    if not np.all(np.isfinite(state)):
        lost = int(np.argmax(~np.isfinite(truth[:, 0])))
        raise ParameterError(f"'{device.name}' left the range of numbers at {time[lost]:.6g} s under these commands")
    return Simulation(_measured(device, time[::every], measured[::every]), _truth(device, time, truth))


def simulate_many(
    plants: Sequence[JointPlant],
    commands: ArrayLike,
    rate: float,
    initial: ArrayLike | None = None,
    threads: int = 2,
) -> Array:
    """Motion (K, N+1, 6) of K plants under the same command rows (N, 4) or (N, N_COMMANDS); inf or NaN on overflow."""
    given = np.asarray(commands, dtype=np.float64)
    if given.ndim != 2 or given.shape[1] not in (NEIGHBOUR, N_COMMANDS) or not np.all(np.isfinite(given)):
        raise ParameterError(
            f"commands must be finite and (N, {NEIGHBOUR}) or (N, {N_COMMANDS}), got shape {given.shape}"
        )
    inputs = np.zeros((len(given), N_COMMANDS))
    inputs[:, : given.shape[1]] = given
    if not plants:
        raise ParameterError("simulate_many needs at least one plant")
    rows = np.stack([plant.at_rate(rate) for plant in plants])
    states = np.stack([initial_state(plant, rate, initial, 0) for plant in plants])
    return simulate_rows(rows, states, inputs, threads)


def simulate_rows(rows: Array, states: Array, commands: Array, threads: int = 2) -> Array:
    """Motion (K, N+1, 6), as ideal sensors read it, of K parameter rows of one joint, `threads` blocks at once.

    rows      (K, N_PARAMETERS) with tick and substeps, as of `JointPlant.at_rate`
    states    (K, n) as of `initial_state`, moved on in place
    commands  (N, 5) shared, as of `command_rows`

    For fits, which change numbers of a row and have nothing to check: see `EffectKind.write`.
    """
    out, begins = np.empty((len(rows), len(commands) + 1, 6)), np.zeros(len(rows), dtype=np.int64)
    blocks = np.linspace(0, ceil(len(rows) / LANES), max(1, min(threads, ceil(len(rows) / LANES))) + 1).astype(int)
    edges = np.minimum(blocks * LANES, len(rows))
    with ThreadPoolExecutor(len(edges) - 1) as pool:  # the kernel releases the GIL
        jobs = [
            pool.submit(run_many, rows[a:b], states[a:b], commands, begins[a:b], out[a:b]) for a, b in pairwise(edges)
        ]
        for job in jobs:
            job.result()
    return out


def _ticks(duration: float, rate: float, start: float) -> Array:
    if not (np.isfinite(duration) and duration >= 0.0):
        raise ParameterError(f"duration must be finite and >= 0 s, got {duration}")
    return start + np.arange(round(duration * rate) + 1) / rate


def _measured(device: Device, time: Array, rows: Array) -> Signals:
    motors, cut = device.n_motors, {name: i for i, name in enumerate(MEASURED)}
    channels = {"q": rows[:, cut["q"]], "q_velocity": rows[:, cut["q_velocity"]], "tau_link": rows[:, cut["tau_link"]]}
    units = {"q": "rad", "q_velocity": "rad/s", "tau_link": "N m"}
    if motors:
        for name, first, unit in (
            ("theta", "theta_1", "rad"),
            ("theta_velocity", "theta_velocity_1", "rad/s"),
            ("tau", "tau_1", "N m"),
        ):
            channels[name] = rows[:, cut[first] : cut[first] + motors]
            units[name] = unit
    return Signals(time, channels, units)


def _truth(device: Device, time: Array, rows: Array) -> Signals:
    cut = {name: i for i, name in enumerate(TRUTH)}
    scalars = {"q": "rad", "q_velocity": "rad/s", "stiffness": "N m/rad", "damping": "N m s/rad"}
    channels, units = {name: rows[:, cut[name]] for name in scalars}, dict(scalars)
    per_motor = {"theta": ("theta_1", "rad"), "theta_velocity": ("theta_velocity_1", "rad/s")}
    per_motor["motor_torque"] = ("motor_torque_1", "N m")
    per_spring = {"stiffness_each": ("stiffness_1", "N m/rad"), "deflection": ("deflection_1", "rad")}
    per_spring["transmission_torque"] = ("transmission_torque_1", "N m")
    for table, width in ((per_motor, device.n_motors), (per_spring, device.n_transmissions)):
        for name, (first, unit) in table.items():
            if width:
                channels[name], units[name] = rows[:, cut[first] : cut[first] + width], unit
    return Signals(time, channels, units)
