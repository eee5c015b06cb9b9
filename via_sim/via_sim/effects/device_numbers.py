"""Names of the numbers of a device file, and their slots in the parameter row.

A diagnosis varies them within their tolerance. The entry `device_numbers` of an effects file stores the factors that
were fitted together with the effects.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite, tanh

import numpy as np
from via_core.errors import ParameterError
from via_core.signals import Array
from via_core.spring_equations import EXPONENTIAL, N_COEFFICIENTS, ODD_POLYNOMIAL, SINH

from via_sim.catalogue.kinds import EffectKind, EffectParameter
from via_sim.joint.parameters import DYNAMIC, NO_DAMPER, POSITION_DRIVE, SERVO, TORQUE_DRIVE, P

AXES = ("link", "motor 1", "motor 2")
NAMES = (
    *(f"{axis} {what}" for axis in AXES for what in ("inertia", "viscous friction", "dry friction")),
    *(f"{axis} bandwidth" for axis in AXES[1:]),
    *(f"spring {i} {what}" for i in (1, 2) for what in ("torque", "shape")),
    "gravity torque",
    "torque scale",
    "damper",
    "servo kp",
    "servo kd",
    "servo torque limit",
)
DEVICE_NUMBERS = EffectKind(
    name="device_numbers",
    text="factors on numbers of the device file, fitted with the effects and written before them",
    term="factor times the number",
    confused_with="",
    sites=("device",),
    parameters=(),
    optional=tuple(EffectParameter(name, "-", 0.1, 10.0, 1.0, "factor") for name in NAMES),
)


@dataclass(frozen=True)
class DeviceNumber:
    """One number; a factor on it multiplies `slots` of the row. The value of a spring or damper characteristic is 1.

    lever  relative change of the spring's torque, at most, per relative change of the number; 1 for other numbers
    """

    name: str  # one of NAMES
    unit: str
    value: float
    slots: tuple[int, ...]
    lever: float


def numbers_of(row: Array) -> tuple[DeviceNumber, ...]:
    """All numbers of a device's row (N_PARAMETERS,)."""
    found = []

    def add(name: str, unit: str, value: float, *slots: int, lever: float = 1.0) -> None:
        found.append(DeviceNumber(name, unit, float(value), slots, lever))

    for axis, name in enumerate(AXES):
        if row[P.axis_kind + axis] == DYNAMIC:
            add(f"{name} inertia", "kg m^2", row[P.inertia + axis], P.inertia + axis)
            add(f"{name} viscous friction", "N m s/rad", row[P.viscous_friction + axis], P.viscous_friction + axis)
            dry = (P.breakaway_friction + axis, P.kinetic_friction + axis)
            add(f"{name} dry friction", "N m", row[dry[0]], *dry)
        if row[P.axis_kind + axis] == SERVO:
            add(f"{name} bandwidth", "rad/s", row[P.bandwidth + axis - 1], P.bandwidth + axis - 1)
    for i in range(int(row[P.transmissions])):
        start = P.spring + i * N_COEFFICIENTS
        add(f"spring {i + 1} torque", "-", 1.0, *_proportional(row, i))
        shape = f"spring {i + 1} shape"  # the stiffening beside the torque
        higher = np.flatnonzero(row[start + 1 : start + N_COEFFICIENTS])
        if row[P.spring_kind + i] == ODD_POLYNOMIAL and row[start] != 0.0 and higher.size:
            add(shape, "-", 1.0, *(int(start + 1 + k) for k in higher))
        if row[P.spring_kind + i] == SINH:
            furthest = float(row[start + 1] * row[P.stop + i])
            add(shape, "-", 1.0, start + 1, lever=furthest / tanh(furthest))
    add("gravity torque", "N m", row[P.gravity_torque], P.gravity_torque)
    drives = [0] if row[P.link_drive] == TORQUE_DRIVE else []
    drives += [axis for axis in (1, 2) if row[P.axis_kind + axis] == DYNAMIC]
    if drives:
        add("torque scale", "-", row[P.torque_gain + drives[0]], *(P.torque_gain + axis for axis in drives))
    if row[P.damper_site] != NO_DAMPER:
        add("damper", "-", 1.0, P.damper, P.damper + 1)
    if row[P.link_drive] == POSITION_DRIVE:
        add("servo kp", "N m/rad", row[P.drive_stiffness], P.drive_stiffness)
        add("servo kd", "N m s/rad", row[P.drive_damping], P.drive_damping)
        if isfinite(row[P.drive_torque_limit]):
            add("servo torque limit", "N m", row[P.drive_torque_limit], P.drive_torque_limit)
    return tuple(found)


def _proportional(row: Array, i: int) -> range:
    """Slots to which the torque of the spring at transmission `i`, from 0, is proportional."""
    start = P.spring + i * N_COEFFICIENTS
    return range(start, start + {ODD_POLYNOMIAL: N_COEFFICIENTS, EXPONENTIAL: 2}.get(int(row[P.spring_kind + i]), 1))


def with_spring_scales(row: Array) -> Array:
    """A row with the same equations in which the scale of each spring is multiplied into its coefficients."""
    made = row.copy()
    for i in range(int(row[P.transmissions])):
        made[list(_proportional(row, i))] *= row[P.spring_scale + i]
        made[P.spring_scale + i] = 1.0
    return made


def write_numbers(row: Array, factors: Mapping[str, float]) -> None:
    """Multiply numbers of a row in place. Raises ParameterError for a number that the joint lacks."""
    slots = {number.name: number.slots for number in numbers_of(row)}
    for name, factor in factors.items():
        if name not in slots:
            raise ParameterError(f"'{name}' is not a number of this joint; choose from {', '.join(slots)}")
        row[list(slots[name])] *= factor
