"""The parameter row: all parameters of one joint, effects included, in one flat float64 row with named slots.

The compiled kernels read this row, so K variants of a joint are a matrix (K, N_PARAMETERS). The slots of the nominal
joint are listed here; each effect declares its own, with neutral values (gain 1, no gap). An effect with neutral values
changes no bit of a simulation.

    row[P.gravity_torque] = 0.3
    row[P.viscous_friction + LINK]          # three neighbouring slots: link, motor 1, motor 2
    row[P.torque_limit + 1]                 # two neighbouring slots: motors or transmissions
    row[P.ripple_order + 3 * k + axis]      # harmonic k, from 0
"""

from __future__ import annotations

from collections import namedtuple
from typing import Any

import numpy as np
from via_core.dampers import N_DAMPER_COEFFICIENTS
from via_core.signals import Array
from via_core.spring_equations import N_COEFFICIENTS

from via_sim.catalogue import EFFECTS
from via_sim.catalogue.kinds import Slot

LINK, MOTOR_1, MOTOR_2 = range(3)  # axes
ABSENT, DYNAMIC, SERVO = range(3)  # kind of an axis: none, own dynamics, position servo
NO_DAMPER, AT_LINK, AT_TRANSMISSION = range(3)
NO_DRIVE, TORQUE_DRIVE, POSITION_DRIVE = range(3)  # drive on the link of a rigid joint


_NOMINAL = (
    Slot("axis_kind", "-", "ABSENT, DYNAMIC or SERVO: link, motor 1, motor 2", 3),
    Slot("inertia", "kg m^2", "M, B_1, B_2", 3, 1.0),
    Slot("viscous_friction", "N m s/rad", "Dq, Dth_1, Dth_2", 3),
    Slot("breakaway_friction", "N m", "dry friction at standstill: link, motor 1, motor 2", 3),
    Slot("kinetic_friction", "N m", "dry friction at speed", 3),
    Slot("bandwidth", "rad/s", "bandwidth w of the position servos: motor 1, motor 2", 2),
    Slot("torque_limit", "N m", "limit of the motor torque that the drive reports", 2, np.inf),
    Slot("gravity_torque", "N m", "g(q) = gravity_torque sin(q - gravity_angle)"),
    Slot("gravity_angle", "rad", "angle at which the link hangs at rest"),
    Slot("gravity", "m/s^2", "acceleration on a payload, with the sign of gravity_torque; 0: upright axis"),
    Slot("link_drive", "-", "NO_DRIVE, TORQUE_DRIVE (its command is the external torque) or POSITION_DRIVE"),
    Slot("drive_stiffness", "N m/rad", "kp of the position drive on the link"),
    Slot("drive_damping", "N m s/rad", "kd, of the link's speed; acts while the drive is on"),
    Slot("drive_torque_limit", "N m", "known limit of kp times the error", 1, np.inf),
    Slot("drive_limits_sum", "-", "1: kd times the speed counts for the limit as well"),
    Slot("drive_speed_limit", "rad/s", "largest speed of the acting goal", 1, np.inf),
    Slot("integral_limit", "N m", "largest torque of its integral", 1, np.inf),
    Slot("transmissions", "-", "number of springs, 0 to 2"),
    Slot("serial", "-", "1: motor 2 is the preset of spring 1; 0: each spring has its own motor"),
    Slot("spring_kind", "-", "spring law of via_core.springs", 2),
    Slot("spring", "", "coefficients of the two spring laws", 2 * N_COEFFICIENTS),
    Slot("stop", "rad", "deflection beyond which the spring law continues along its tangent", 2, np.inf),
    Slot("input_errors", "-", "1: the angle at the input of the transmission differs from that of the motor", 2),
    Slot("damper_site", "-", "NO_DAMPER, AT_LINK or AT_TRANSMISSION"),
    Slot("damper_kind", "-", "map of via_core.dampers"),
    Slot("damper", "", "coefficients of the map", N_DAMPER_COEFFICIENTS),
    Slot("delay", "s", "dead time of the command"),
    Slot("origin", "s", "age of the run at tick 0"),
    Slot("tick", "s", "period of the commands", 1, 1e-3),
    Slot("substeps", "-", "integration steps per tick", 1, 1.0),
)

SLOTS = (*_NOMINAL, *(slot for kind in EFFECTS.values() for slot in kind.slots))

_starts = np.concatenate(([0], np.cumsum([slot.size for slot in SLOTS])))
# A named tuple of ints: numba folds it into constants.
P: Any = namedtuple("Slots", [slot.name for slot in SLOTS])(*(int(start) for start in _starts[:-1]))  # type: ignore
N_PARAMETERS = int(_starts[-1])
_FIRST = {slot.name: (start, slot.size) for slot, start in zip(SLOTS, P)}


def neutral_row() -> Array:
    """A row (N_PARAMETERS,) with every slot at its neutral value."""
    return np.repeat([slot.neutral for slot in SLOTS], [slot.size for slot in SLOTS]).astype(np.float64)


class RowSpot:
    """A row at one axis (0 link, 1, 2 motors) and site, through which an effect reads and writes its slots by name."""

    def __init__(self, row: Array, axis: int, site: str) -> None:
        self.row, self.axis, self.site = row, axis, site

    def __getitem__(self, slot: str | tuple[str, int]) -> float:
        return float(self.row[self._index(slot)])

    def __setitem__(self, slot: str | tuple[str, int], value: float) -> None:
        self.row[self._index(slot)] = value

    def _index(self, slot: str | tuple[str, int]) -> int:
        name, harmonic = (slot, 0) if isinstance(slot, str) else slot
        start, size = _FIRST[name]
        if size == 1:
            return start
        return start + (self.axis - MOTOR_1 if size == 2 else 3 * harmonic + self.axis)
