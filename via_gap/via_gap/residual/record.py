"""A log of one joint as input of its equations: angles, velocities, and the commands or torques of its drives."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike
from via_core.errors import SignalError
from via_core.signals import Array, locked
from via_sim.joint.parameters import P
from via_sim.joint.torques import N_COMMANDS

from via_gap.residual.zero_order_hold import SLOTS, means_of_cells

STILL = 0.02  # [rad/s] default speed below which an axis counts as at standstill
_CACHED = 2  # means: a fit alternates between its parameters and a variation of one of them


@dataclass(frozen=True, eq=False)
class Record:
    """A log of one joint as input of its equations.

    time          (N,) [s] strictly increasing
    angle         (N, 3) [rad] link, motor 1, motor 2 as measured; NaN where not measured
    velocity      (N, 3) [rad/s] likewise, measured or estimated
    command_time  (K,) [s] strictly increasing; the first command also acts before it
    commands      (K, N_COMMANDS) as zero-order hold, columns as of the simulator
    sensed        whether the motor torques among them were measured; then errors of their sensors are undone
    still         (3,) [rad/s] speed below which each axis counts as at standstill

    Arrays are copied and locked. Raises SignalError where shapes or values do not fit.
    """

    time: Array
    angle: Array
    velocity: Array
    command_time: Array
    commands: Array
    sensed: bool = False
    still: ArrayLike = STILL
    _means: OrderedDict[bytes, tuple[Array, Array]] = field(default_factory=OrderedDict, init=False, repr=False)

    def __post_init__(self) -> None:
        still = np.broadcast_to(np.asarray(self.still, dtype=np.float64), (3,))
        object.__setattr__(self, "still", locked(still, "still"))
        count = len(self.command_time)
        shapes = {"time": (len(self),), "angle": (len(self), 3), "velocity": (len(self), 3)}
        for name, shape in {**shapes, "command_time": (count,), "commands": (count, N_COMMANDS)}.items():
            values = locked(getattr(self, name), name)
            object.__setattr__(self, name, values)
            if values.shape != shape:
                raise SignalError(f"'{name}' of a record must have shape {shape}, got {values.shape}")
            if values.ndim == 1 and (len(values) < 1 or not np.all(np.diff(values) > 0.0)):
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
        key = row[SLOTS].tobytes()
        if key not in self._means:
            made = []
            for delay in sorted({row[P.delay], 0.0}, reverse=True):
                made.append(np.empty((len(self), N_COMMANDS)))
                means_of_cells(row, self.time, self.command_time, self.commands, self.sensed, delay, made[-1])
            self._means[key] = made[0], made[-1]
        self._means.move_to_end(key)
        if len(self._means) > _CACHED:
            self._means.popitem(last=False)
        return self._means[key]
