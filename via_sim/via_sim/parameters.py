"""The parameter row: everything one joint is, effects included, in one flat float64 row with named slots.

One compiled kernel reads this row, so a thousand variants of a joint are a matrix (K, N_PARAMETERS) and one call. Every
effect has its slots, and a neutral value in them (0 friction, gain 1, no gap) that leaves each bit of the result as if
the effect did not exist.

    row[P.gravity_torque] = 0.3
    row[P.viscous_friction + LINK]          # slots of the three axes stand in a row: link, motor 1, motor 2
    row[P.torque_gain + 1]                  # slots of the motors (and transmissions) likewise: first, second
    row[P.ripple_order + 3 * k + axis]      # of harmonic k, from 0
"""

from __future__ import annotations

from collections import namedtuple
from dataclasses import dataclass
from typing import Any

import numpy as np
from via_core.dampers import N_DAMPER_COEFFICIENTS
from via_core.signals import Array
from via_core.springs import N_COEFFICIENTS

LINK, MOTOR_1, MOTOR_2 = range(3)  # axes
ABSENT, DYNAMIC, SERVO = range(3)  # what moves an axis: nothing, its own dynamics, a position servo
NO_DAMPER, AT_LINK, AT_TRANSMISSION = range(3)
NO_DRIVE, TORQUE_DRIVE, POSITION_DRIVE = range(3)  # on the link: none, or of a rigid joint
RIPPLE_HARMONICS, ENCODER_HARMONICS = 8, 4  # of one axis, at most
_RIPPLE, _ENCODER = 3 * RIPPLE_HARMONICS, 3 * ENCODER_HARMONICS  # the three axes of a harmonic stand in a row


@dataclass(frozen=True)
class Slot:
    """`size` neighbouring entries of the row, all `neutral` until a device or an effect says otherwise."""

    name: str
    unit: str
    text: str
    size: int = 1
    neutral: float = 0.0


SLOTS = (
    Slot("axis_kind", "-", "ABSENT, DYNAMIC or SERVO: link, motor 1, motor 2", 3),
    Slot("inertia", "kg m^2", "M, B_1, B_2", 3, 1.0),
    Slot("viscous_friction", "N m s/rad", "Dq, Dth_1, Dth_2", 3),
    Slot("viscous_asymmetry", "N m s/rad", "half of what the friction has more forwards than backwards", 3),
    Slot("quadratic_drag", "N m s^2/rad^2", "times v |v|", 3),
    Slot("breakaway_friction", "N m", "dry friction at standstill: link, motor 1, motor 2", 3),
    Slot("kinetic_friction", "N m", "dry friction at speed", 3),
    Slot("friction_asymmetry", "N m", "half of what dry friction has more forwards than backwards", 3),
    Slot("stribeck_velocity", "rad/s", "speed at which 1/e of the excess of breakaway over kinetic is left", 3, 1.0),
    Slot("load_friction", "-", "dry friction per torque that the axis carries, its load: see friction.py", 3),
    Slot("both_sides", "-", "1: any of the next four is not zero", 3),
    Slot("counter_friction", "-", "dry friction per counter torque", 3),
    Slot("load_stribeck", "-", "what standstill adds per load", 3),
    Slot("counter_stribeck", "-", "what standstill adds per counter torque", 3),
    Slot("load_quadratic", "1/(N m)", "what standstill adds per square of the smaller of both, where they oppose", 3),
    Slot("load_velocity", "rad/s", "speed at which 1/e of what standstill adds is left", 3, 1.0),
    Slot("bristle_torque", "N m", "of Dahl's bristle once it slides", 3),
    Slot("bristle_stiffness", "N m/rad", "of Dahl's bristle at rest", 3, 1.0),
    Slot("bandwidth", "rad/s", "w of the position servos: motor 1, motor 2", 2),
    Slot("torque_limit", "N m", "saturation of the motor torque that the drive knows of", 2, np.inf),
    Slot("saturation", "N m, rad/s", "limit nobody knows of: of drive torques, of the speed of servos", 3, np.inf),
    Slot("lag", "s", "time constant of first order between command and torque; a servo's 2/w grows by it"),
    Slot("torque_gain", "-", "torque per torque commanded: of a rigid joint's drive, motor 1, motor 2", 3, 1.0),
    Slot("torque_bias", "N m", "torque that nobody commanded: likewise", 3),
    Slot("ripple_amplitude", "N m", "torque over the angle of the axis: likewise, for each harmonic", _RIPPLE),
    Slot("ripple_order", "-", "periods per turn", _RIPPLE, 1.0),
    Slot("ripple_phase", "rad", "at angle zero", _RIPPLE),
    Slot("gravity_torque", "N m", "g(q) = gravity_torque sin(q - gravity_angle)"),
    Slot("gravity_angle", "rad", "where the link hangs at rest"),
    Slot("gravity", "m/s^2", "that acts on a payload, with the sign of gravity_torque; 0: the axis is upright"),
    Slot("coupling", "N m/rad", "torque per angle of the neighbour: on the link, between it and motor 1, motor 2", 3),
    Slot("contact_stiffness", "N m/rad", "of a wall; 0: there is none"),
    Slot("contact_damping", "N m s/rad", "of the wall; it never pulls"),
    Slot("contact_angle", "rad", "where the wall stands"),
    Slot("contact_side", "-", "1: beyond its angle, -1: before it", 1, 1.0),
    Slot("pulse_torque", "N m", "on the link, from pulse_start until pulse_stop"),
    Slot("pulse_start", "s", "age of the run"),
    Slot("pulse_stop", "s", "age of the run"),
    Slot("link_drive", "-", "NO_DRIVE, TORQUE_DRIVE (its command is the external torque) or POSITION_DRIVE"),
    Slot("drive_stiffness", "N m/rad", "kp of the position drive on the link"),
    Slot("drive_damping", "N m s/rad", "kd, of the link's speed; acts while the drive is on"),
    Slot("drive_torque_limit", "N m", "of kp times the error, which the drive knows of", 1, np.inf),
    Slot("drive_speed_limit", "rad/s", "at which the goal that acts follows the one commanded, at most", 1, np.inf),
    Slot("transmissions", "-", "number of springs, 0 to 2"),
    Slot("serial", "-", "1: motor 2 is the preset of spring 1; 0: each spring has its own motor"),
    Slot("spring_kind", "-", "law of via_core.springs", 2),
    Slot("spring", "", "coefficient rows of the two laws", 2 * N_COEFFICIENTS),
    Slot("stop", "rad", "deflection from which the law continues along its tangent", 2, np.inf),
    Slot("spring_scale", "-", "torque per torque of the law", 2, 1.0),
    Slot("spring_hardening", "1/rad^2", "share of the law's torque added per squared deflection", 2),
    Slot("stiffness_rate", "1/s", "share of the spring's torque added per age of the run", 2),
    Slot("pretension_offset", "rad", "added to the motor angle that pretensions the spring", 2),
    Slot("backlash", "rad", "width of the torque-free gap in the transmission", 2),
    Slot("hysteresis_torque", "N m", "at which the Maxwell element beside the spring slips", 2),
    Slot("hysteresis_stiffness", "N m/rad", "of the Maxwell element", 2, 1.0),
    Slot("spring_damping", "N m s/rad", "of the speed of deflection", 2),
    Slot("damper_site", "-", "NO_DAMPER, AT_LINK or AT_TRANSMISSION"),
    Slot("damper_kind", "-", "map of via_core.dampers"),
    Slot("damper", "", "coefficient row of the map", N_DAMPER_COEFFICIENTS),
    Slot("delay", "s", "dead time of the command"),
    Slot("encoder_offset", "rad", "read too much: link, motor 1, motor 2", 3),
    Slot("encoder_harmonics", "-", "of the encoder's periodic error: up to the last amplitude that is not zero", 3),
    Slot("eccentricity", "rad", "amplitude of the encoder's periodic error: link, motors, for each harmonic", _ENCODER),
    Slot("eccentricity_order", "-", "periods per turn", _ENCODER, 1.0),
    Slot("eccentricity_phase", "rad", "at angle zero", _ENCODER),
    Slot("encoder_quantum", "rad", "least step of the reading", 3),
    Slot("skew", "s", "by which the reading is late", 3),
    Slot("sensed_gain", "-", "reading per torque: at the link, motor 1, motor 2", 3, 1.0),
    Slot("sensed_bias", "N m", "read too much: likewise", 3),
    Slot("origin", "s", "age of the run at tick 0"),
    Slot("tick", "s", "period over which a command is held", 1, 1e-3),
    Slot("substeps", "-", "integration steps per tick", 1, 1.0),
)

_starts = np.concatenate(([0], np.cumsum([slot.size for slot in SLOTS])))
# A named tuple of ints: numba folds it into constants.
P: Any = namedtuple("Slots", [slot.name for slot in SLOTS])(*(int(start) for start in _starts[:-1]))  # type: ignore
N_PARAMETERS = int(_starts[-1])


def neutral_row() -> Array:
    """A row (N_PARAMETERS,) with every slot at its neutral value."""
    return np.repeat([slot.neutral for slot in SLOTS], [slot.size for slot in SLOTS]).astype(np.float64)
