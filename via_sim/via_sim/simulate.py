"""Simulation of one joint: `simulate` runs a batch, `Simulator` single steps, both on one kernel with equal bits.

`via_sim.lockstep` runs many variants of a joint at once and differs by rounding.

Sample k belongs to the time t_k = start + k / rate. Command k acts during [t_k, t_{k+1}) as a zero-order hold; it is
the controller's answer to sample k. `tau` of sample k is the torque commanded during the tick that ended at t_k, before
dead time and gain, as a drive would log it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import ceil
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import ArrayLike
from via_core.devices import Device
from via_core.errors import ParameterError
from via_core.limits import LIMITS
from via_core.signals import Array, Signals

from via_sim.catalogue.drive.actuator_delay import MAX_DELAY
from via_sim.joint.encoders import read_motion
from via_sim.joint.kernel import run, run_in
from via_sim.joint.layout import ARM, DAMPING, EXTERNAL, GOAL, HISTORY, M1, N_COMMANDS, NEIGHBOUR, POWER, QUEUED, X
from via_sim.joint.measurements import MEASURED, TRUTH
from via_sim.joint.parameters import ABSENT, SERVO, P
from via_sim.joint.position_drive import integral_at_start
from via_sim.joint.structure import structure_of
from via_sim.plants import JointPlant
from via_sim.sensors import IDEAL, Sensors

MAX_SEED = 2**53 - 1

# Channels of a run: first column, unit, and of what there is one column each (empty: one column).
_MEASURED = {
    "q": (MEASURED.q, "rad", ""),
    "q_velocity": (MEASURED.q_velocity, "rad/s", ""),
    "tau_link": (MEASURED.tau_link, "N m", ""),
    "theta": (MEASURED.theta_1, "rad", "motor"),
    "theta_velocity": (MEASURED.theta_velocity_1, "rad/s", "motor"),
    "tau": (MEASURED.tau_1, "N m", "motor"),
}
_TRUTH = {
    "q": (TRUTH.q, "rad", ""),
    "q_velocity": (TRUTH.q_velocity, "rad/s", ""),
    "stiffness": (TRUTH.stiffness, "N m/rad", ""),
    "damping": (TRUTH.damping, "N m s/rad", ""),
    "theta": (TRUTH.theta_1, "rad", "motor"),
    "theta_velocity": (TRUTH.theta_velocity_1, "rad/s", "motor"),
    "motor_torque": (TRUTH.motor_torque_1, "N m", "motor"),
    "stiffness_each": (TRUTH.stiffness_1, "N m/rad", "spring"),
    "deflection": (TRUTH.deflection_1, "rad", "spring"),
    "transmission_torque": (TRUTH.transmission_torque_1, "N m", "spring"),
}


@dataclass(frozen=True)
class InitialConditions:
    """Conditions at sample 0 of a run."""

    motion: ArrayLike | None = None  # (6,) q, theta_1, theta_2 [rad] and their velocities [rad/s]; None: all zero
    seed: int = 0  # of the sensor noise
    time: float = 0.0  # [s] of sample 0, on the clock of the commands
    age: float = 0.0  # [s] of the joint, from which drifts and pulses count


AT_REST = InitialConditions()


@dataclass(frozen=True)
class Simulation:
    """Measured signals of one run, and the true ones."""

    measured: Signals
    truth: Signals


@dataclass(frozen=True)
class Simulator:
    """A joint, its sensors and a tick rate; `init` returns a state, `step` the next one.

    The state (n,) is one flat row: motion, tick number, seed, queue of commands within the dead time.
    """

    plant: JointPlant
    rate: float  # [Hz] ticks
    sensors: Sensors = IDEAL
    _row: Array = field(init=False, repr=False, compare=False)  # writable: numba would compile all
    _sensor_row: Array = field(init=False, repr=False, compare=False)  # kernels again for read-only arrays
    _structure: Any = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_row", self.plant.at_rate(self.rate))
        object.__setattr__(self, "_sensor_row", self.sensors.row())
        object.__setattr__(self, "_structure", structure_of(self._row, self._sensor_row))
        self.sensors.decimation(self.rate)

    def init(self, initial: ArrayLike | None = None, seed: int = 0) -> Array:
        """State (n,) at tick 0.

        initial  (6,) q, theta_1, theta_2 [rad] and their velocities [rad/s]; None: all zero
        """
        return initial_state(self.plant, self.rate, initial, seed)

    def sample(self, state: Array) -> tuple[Array, Array]:
        """(measured (9,), truth (16,)) of a state, with columns `measurements.MEASURED` and `measurements.TRUTH`."""
        return self._run(state.copy(), np.empty((0, N_COMMANDS)))

    def step(self, state: Array, command: ArrayLike) -> tuple[Array, Array, Array]:
        """(next state (n,), measured (9,), truth (16,)) after one tick.

        command  (4,) motor 1, motor 2 [N m; rad for servos], damping command [-], external torque at the link [N m], or
                 (N_COMMANDS,) with the neighbour's angle [rad] and the torque of the other joints of an arm on the link
                 [N m]; a position drive takes its goal [rad] and 1 (on) or 0 (off) in place of the motors

        Raises ParameterError for a command that is not finite or has another shape.
        """
        u = np.zeros((1, N_COMMANDS))
        given = np.asarray(command, dtype=np.float64)
        if given.shape not in ((NEIGHBOUR,), (N_COMMANDS,)) or not finite(given):
            raise ParameterError(f"a command is {NEIGHBOUR} or {N_COMMANDS} finite numbers, got {command!r}")
        u[0, : len(given)] = given
        after = state.copy()
        measured, truth = self._run(after, u)
        return after, measured, truth

    def _run(self, state: Array, commands: Array) -> tuple[Array, Array]:
        measured, truth = np.empty((len(commands) + 1, len(MEASURED))), np.empty((len(commands) + 1, len(TRUTH)))
        run_in(self._row, self._structure, self._sensor_row, state, commands, measured, truth)
        return measured[-1], truth[-1]


@njit(cache=True, error_model="numpy")
def finite(values: Array) -> bool:
    """Whether all values (n,) are finite; much faster than numpy for a few."""
    return bool(np.isfinite(values).all())


def initial_state(plant: JointPlant, rate: float, initial: ArrayLike | None, seed: int) -> Array:
    """State row (n,) at tick 0; its queue holds passive commands."""
    if isinstance(seed, bool) or not 0 <= seed <= MAX_SEED:
        raise ParameterError(f"seed must be 0 to {MAX_SEED}, got {seed}")
    motion = np.zeros(6) if initial is None else np.asarray(initial, dtype=np.float64)
    if motion.shape != (6,) or not np.all(np.isfinite(motion)):
        raise ParameterError(f"initial must be 6 finite numbers (three angles, three velocities), got {initial!r}")
    queue = ceil(MAX_DELAY * rate) + 3
    state = np.zeros(X.queue + QUEUED * queue)
    kinds = np.tile(plant.parameters[P.axis_kind : P.axis_kind + 3], 2)
    state[:6] = np.where(kinds == ABSENT, 0.0, motion)
    state[X.seed] = seed
    state[X.integral] = integral_at_start(plant.parameters)
    state[X.history : X.queue].reshape(HISTORY, 6)[:, :3] = state[:3]  # at rest before tick 0
    before = state[X.queue :].reshape(queue, QUEUED)
    before[:, :2] = passive_command(plant, state)[:2]
    if state[X.integral] != 0.0:  # the drive was on, and held the link
        before[:, POWER], before[:, GOAL] = 1.0, read_motion(plant.parameters, 0, state[0], 0.0)[0]
    return state


def passive_command(plant: JointPlant, state: Array) -> Array:
    """The passive command (N_COMMANDS,): zero torque, servos at their present angle, drives off, no damping."""
    servo = plant.parameters[P.axis_kind + 1 : P.axis_kind + 3] == SERVO
    row = np.zeros(N_COMMANDS)
    row[:2] = np.where(servo, state[1:3], 0.0)
    return row


def command_rows(device: Device, commands: Signals, time: Array) -> Array:
    """Commands (N, N_COMMANDS) at `time` by zero-order hold of these channels, all optional:

    motor                torque [N m] or servo position [rad], one column per motor
    equilibrium, preset  [rad] of servo devices, in place of `motor`; a position drive takes its goal as `equilibrium`,
                         NaN to switch it off, and ignores `preset`
    damping              [-]
    external_torque      [N m] at the link
    neighbour            [rad] angle of the neighbour joint
    arm_torque           [N m] of the other joints of an arm on the link

    Raises ParameterError for any other channel, or for one that does not fit the device.
    """
    known = {"motor", "equilibrium", "preset", "damping", "external_torque", "neighbour", "arm_torque"}
    unknown = commands.channels.keys() - known
    if unknown:
        raise ParameterError(f"no command channel '{sorted(unknown)[0]}'; choose from {', '.join(sorted(known))}")
    hold = Signals(commands.time, commands.channels, commands.units, frozenset(commands.channels))
    # rounding: 0.02 * 7 must not act one tick after 0.14
    hold = hold.resample(time + 1e-9 + 4.0 * np.spacing(np.abs(time)))
    positioned = device.drive == "position"
    for name, values in hold.channels.items():
        if positioned and (name == "preset" or (name == "equilibrium" and not np.any(np.isinf(values)))):
            continue
        if not np.all(np.isfinite(values)):
            first = int(np.flatnonzero(~np.isfinite(values.reshape(len(time), -1).sum(axis=1)))[0])
            raise ParameterError(f"command '{name}' is not finite at {time[first]:.6g} s")
    rows = np.zeros((len(time), N_COMMANDS))
    angles = {"equilibrium", "preset"} & hold.channels.keys()
    if "motor" in hold:
        if angles:
            raise ParameterError(
                f"commands have both 'motor' and {' and '.join(sorted(angles))}: give only one of them"
            )
        motor = hold["motor"].reshape(len(time), -1)
        if motor.shape[1] != device.n_motors:
            raise ParameterError(
                f"command 'motor' has {motor.shape[1]} columns, '{device.name}' {device.n_motors} motors"
            )
        rows[:, M1 : M1 + device.n_motors] = motor
    elif positioned and "equilibrium" in hold:
        on = np.isfinite(hold["equilibrium"])
        rows[:, GOAL], rows[:, POWER] = np.where(on, hold["equilibrium"], 0.0), on
    elif angles:
        if device.drive != "servo" or device.n_motors == 0:
            raise ParameterError(f"'{device.name}' has no position servos: command 'motor' torques instead")
        if "equilibrium" not in hold:
            raise ParameterError("commands have 'preset' but no 'equilibrium'")
        preset = hold["preset"] if "preset" in hold else np.zeros(len(time))
        rows[:, M1 : M1 + device.n_motors] = device.motor_angles(hold["equilibrium"], preset)
    others = {"damping": DAMPING, "external_torque": EXTERNAL, "neighbour": NEIGHBOUR, "arm_torque": ARM}
    for name in others.keys() & hold.channels.keys():
        rows[:, others[name]] = hold[name]
    return rows


def simulate(
    plant: JointPlant,
    commands: Signals | None,
    duration: float,
    rate: float,
    sensors: Sensors = IDEAL,
    initial: InitialConditions = AT_REST,
) -> Simulation:
    """Measured and true signals of a whole run.

    commands  see `command_rows`; the first command also acts before its time. None: passive
    duration  [s] rounded to ticks; n ticks give n+1 samples
    rate      [Hz] of ticks; `truth` has every tick, `measured` every (rate / sensors.rate)-th

    Raises ParameterError for commands or numbers that do not fit, and where the motion overflows.
    """
    device, row = plant.device, plant.at_rate(rate)
    row[P.origin] = initial.age
    every = sensors.decimation(rate)
    if not (np.isfinite(duration) and duration >= 0.0):
        raise ParameterError(f"duration must be finite and >= 0 s, got {duration}")
    if duration * rate > LIMITS.samples:
        raise ParameterError(f"{duration:g} s at {rate:g} Hz are more than {LIMITS.samples} samples")
    time = initial.time + np.arange(round(duration * rate) + 1) / rate
    state = initial_state(plant, rate, initial.motion, initial.seed)
    if commands is None:
        rows = np.tile(passive_command(plant, state), (len(time) - 1, 1))
    else:
        rows = command_rows(device, commands, time[:-1])
    measured, truth = np.empty((len(time), len(MEASURED))), np.empty((len(time), len(TRUTH)))
    run(row, sensors.row(), state, rows, measured, truth)
    if not np.all(np.isfinite(state)):
        lost = int(np.argmax(~np.isfinite(truth[:, 0])))
        raise ParameterError(f"'{device.name}' overflows at {time[lost]:.6g} s under these commands")
    return Simulation(
        _signals(device, time[::every], measured[::every], _MEASURED), _signals(device, time, truth, _TRUTH)
    )


def _signals(device: Device, time: Array, rows: Array, channels: dict[str, tuple[int, str, str]]) -> Signals:
    """Signals of recorded rows; `channels` holds the first column, the unit, and of what each has one column."""
    widths = {"motor": device.n_motors, "spring": device.n_transmissions}
    found: dict[str, Array] = {}
    for name, (first, _, each) in channels.items():
        if not each:
            found[name] = rows[:, first]
        elif widths[each]:
            found[name] = rows[:, first : first + widths[each]]
    return Signals(time, found, {name: channels[name][1] for name in found})
