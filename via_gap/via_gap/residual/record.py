"""A log of one joint as input of its equations: angles, velocities, and the commands or torques of its drives.

Commands act as zero-order hold. Every sample gets their mean over its cell, from halfway before it to halfway after it.
In a trapezoid rule over samples a torque under zero-order hold has the weight of this mean: (u_n + u_{n-1})/2 where
commands change on samples, and correct to second order for any dead time, command rate and jitter.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, field
from threading import Lock

import numpy as np
from via_core.dampers import N_DAMPER_COEFFICIENTS, damper_value
from via_core.errors import SignalError
from via_core.signals import Array, locked
from via_sim.joint.compiled import bare, compiled
from via_sim.joint.layout import DAMPING, EXTERNAL, GOAL, N_COMMANDS, NEIGHBOUR, POWER
from via_sim.joint.parameters import DYNAMIC, NO_DAMPER, POSITION_DRIVE, TORQUE_DRIVE, P
from via_sim.joint.terms import saturated, terms_at

from via_gap.residual.threads import THREADS

_CACHED = 2 * THREADS  # means: a fit alternates between its parameters and a variation of one of them
_COMMAND_SLOTS = [getattr(P, slot) + axis for term in terms_at("command") for slot in term.slots for axis in range(3)]
_SLOTS = np.r_[  # of a row: all that means of commands depend on
    P.axis_kind : P.axis_kind + 3, P.torque_limit : P.torque_limit + 2, P.link_drive, _COMMAND_SLOTS,
    P.delay, P.damper_site, P.damper_kind, P.damper : P.damper + N_DAMPER_COEFFICIENTS,
    P.sensed_gain : P.sensed_gain + 3, P.sensed_bias : P.sensed_bias + 3,
]  # fmt: skip


@dataclass(frozen=True, eq=False)
class Record:
    """A log of one joint as input of its equations.

    time          (N,) [s] strictly increasing
    angle         (N, 3) [rad] link, motor 1, motor 2 as measured; NaN where not measured
    velocity      (N, 3) [rad/s] likewise, measured or estimated
    command_time  (K,) [s] strictly increasing; the first command also acts before it
    commands      (K, N_COMMANDS) as zero-order hold, columns as of the simulator
    sensed        whether the motor torques among them were measured; then errors of their sensors are undone
    still         (3,) [rad/s] speed up to which an axis may be at rest, by the uncertainty of `velocity`

    Arrays are copied and locked. Raises SignalError where shapes or values do not fit.
    """

    time: Array
    angle: Array
    velocity: Array
    command_time: Array
    commands: Array
    sensed: bool = False
    still: Array = field(default_factory=lambda: np.zeros(3))
    _means: OrderedDict[bytes, tuple[Array, Array]] = field(default_factory=OrderedDict, init=False, repr=False)
    _lock: Lock = field(default_factory=Lock, init=False, repr=False)

    def __post_init__(self) -> None:
        count = len(self.command_time)
        shapes = {"time": (len(self),), "angle": (len(self), 3), "velocity": (len(self), 3)}
        for name, shape in {**shapes, "command_time": (count,), "commands": (count, N_COMMANDS), "still": (3,)}.items():
            values = locked(getattr(self, name), name)
            object.__setattr__(self, name, values)
            if values.shape != shape:
                raise SignalError(f"'{name}' of a record must have shape {shape}, got {values.shape}")
            if name.endswith("time") and (len(values) < 1 or not np.all(np.diff(values) > 0.0)):
                raise SignalError(f"'{name}' of a record must increase and have at least one entry")
        if not np.all(np.isfinite(self.commands)):
            raise SignalError("commands of a record must be finite")

    def __len__(self) -> int:
        return len(self.time)

    def means(self, row: Array) -> tuple[Array, Array]:
        """Mean commands (N, N_COMMANDS) under a parameter row (N_PARAMETERS,): after its dead time, and without it.

        They take as long as all other terms of the equations, and most rows of a fit have the same ones. Therefore the
        last results are cached.
        """
        key = row[_SLOTS].tobytes()
        found = self._means.get(key)
        if found is None:
            made = []
            for delay in sorted({row[P.delay], 0.0}, reverse=True):
                made.append(np.empty((len(self), N_COMMANDS)))
                _means_of_cells(row, self.time, self.command_time, self.commands, self.sensed, delay, made[-1])
            found = made[0], made[-1]
        with self._lock:  # rows are evaluated on several threads
            self._means[key] = found
            self._means.move_to_end(key)
            if len(self._means) > _CACHED:
                self._means.popitem(last=False)
        return found


@compiled
def _means_of_cells(
    p: Array, time: Array, command_time: Array, commands: Array, sensed: bool, delay: float, out: Array
) -> None:
    """Means over the cells of all samples under a dead time of `delay` [s] into out (N, N_COMMANDS)."""
    last, k = time.size - 1, 0
    for n in range(time.size):
        begin, end = 0.5 * (time[max(n - 1, 0)] + time[n]), 0.5 * (time[n] + time[min(n + 1, last)])
        k = _mean(p, command_time, commands, sensed, k, begin - delay, end - delay, out[n])


@bare
def _driving(p: Array, commands: Array, k: int, column: int, sensed: bool) -> float:
    """Output of the drive under command k: torque [N m], angle [rad] or damping [N m s/rad]."""
    value = commands[k, column]
    if column == DAMPING:
        if p[P.damper_site] == NO_DAMPER:
            return 0.0
        return damper_value(int(p[P.damper_kind]), p[P.damper : P.damper + 3], value)
    if column == EXTERNAL:
        return saturated(p, 0, value) if p[P.link_drive] == TORQUE_DRIVE else value
    if column == GOAL and p[P.link_drive] == POSITION_DRIVE:
        return value * commands[k, POWER]  # zero while off: `_mean_goal` divides by the share of time on
    if column >= NEIGHBOUR or p[P.axis_kind + 1 + column] != DYNAMIC:
        return value
    if sensed:
        value = (value - p[P.sensed_bias + 1 + column]) / p[P.sensed_gain + 1 + column]
    limit = p[P.torque_limit + column]
    return saturated(p, 1 + column, min(max(value, -limit), limit))


@bare
def _mean(
    p: Array, times: Array, commands: Array, sensed: bool, k: int, a: float, b: float, out: Array
) -> int:  # fmt: skip
    """Means over [a, b] [s] into out (N_COMMANDS,); k is a command at or before a, the result one at or before b."""
    last = times.size - 1
    while k < last and times[k + 1] <= a:
        k += 1
    for column in range(out.size):
        out[column] = 0.0
    width = b - a
    while True:
        end = b if k == last else min(times[k + 1], b)
        share = 1.0 if width <= 0.0 else (end - a) / width
        for column in range(out.size):
            out[column] += share * _driving(p, commands, k, column, sensed)
        if k == last or times[k + 1] >= b:
            return k
        a = end
        k += 1
