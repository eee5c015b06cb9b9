"""The parameter row: all parameters of one joint, effects included, in one flat float64 row with named slots.

The compiled kernels read this row, so K variants of a joint are a matrix (K, N_PARAMETERS). Each effect has its own
slots with neutral values (friction 0, gain 1, no gap); an effect with neutral values changes no bit of a simulation.

    row[P.gravity_torque] = 0.3
    row[P.viscous_friction + LINK]          # three neighbouring slots: link, motor 1, motor 2
    row[P.torque_limit + 1]                 # two neighbouring slots: motors or transmissions
    row[P.ripple_order + 3 * k + axis]      # harmonic k, from 0
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
ABSENT, DYNAMIC, SERVO = range(3)  # kind of an axis: none, own dynamics, position servo
NO_DAMPER, AT_LINK, AT_TRANSMISSION = range(3)
NO_DRIVE, TORQUE_DRIVE, POSITION_DRIVE = range(3)  # drive on the link of a rigid joint
RIPPLE_HARMONICS, ENCODER_HARMONICS = 8, 4  # largest numbers per axis
_RIPPLE, _ENCODER = 3 * RIPPLE_HARMONICS, 3 * ENCODER_HARMONICS  # three axes per harmonic


@dataclass(frozen=True)
class Slot:
    """`size` neighbouring entries of the row with default value `neutral`."""

    name: str
    unit: str
    text: str
    size: int = 1
    neutral: float = 0.0


SLOTS = (
    Slot("axis_kind", "-", "ABSENT, DYNAMIC or SERVO: link, motor 1, motor 2", 3),
    Slot("inertia", "kg m^2", "M, B_1, B_2", 3, 1.0),
    Slot("viscous_friction", "N m s/rad", "Dq, Dth_1, Dth_2", 3),
    Slot("viscous_asymmetry", "N m s/rad", "half the difference of forward and backward friction", 3),
    Slot("quadratic_drag", "N m s^2/rad^2", "times v |v|", 3),
    Slot("breakaway_friction", "N m", "dry friction at standstill: link, motor 1, motor 2", 3),
    Slot("kinetic_friction", "N m", "dry friction at speed", 3),
    Slot("friction_asymmetry", "N m", "half the difference of forward and backward dry friction", 3),
    Slot("stribeck_velocity", "rad/s", "speed at which the excess of breakaway over kinetic has fallen to 1/e", 3, 1.0),
    Slot("load_friction", "-", "dry friction per load torque, see friction.py", 3),
    Slot("both_sides", "-", "1: any of the next four is nonzero", 3),
    Slot("counter_friction", "-", "dry friction per counter torque", 3),
    Slot("load_stribeck", "-", "increase at standstill per load", 3),
    Slot("counter_stribeck", "-", "increase at standstill per counter torque", 3),
    Slot("load_quadratic", "1/(N m)", "increase at standstill per square of the smaller torque, if opposed", 3),
    Slot("load_velocity", "rad/s", "speed at which the increase at standstill has fallen to 1/e", 3, 1.0),
    Slot("bristle_torque", "N m", "friction of Dahl's bristle when sliding", 3),
    Slot("bristle_stiffness", "N m/rad", "stiffness of Dahl's bristle at rest", 3, 1.0),
    Slot("bandwidth", "rad/s", "bandwidth w of the position servos: motor 1, motor 2", 2),
    Slot("torque_limit", "N m", "limit of the motor torque that the drive reports", 2, np.inf),
    Slot("saturation", "N m, rad/s", "unknown limit of drive torque, of a servo its speed", 3, np.inf),
    Slot("lag", "s", "first-order time constant between command and torque; added to 2/w of a servo"),
    Slot("torque_gain", "-", "torque per commanded torque: drive of a rigid joint, motor 1, motor 2", 3, 1.0),
    Slot("torque_bias", "N m", "torque without a command: likewise", 3),
    Slot("ripple_amplitude", "N m", "amplitude of the torque ripple: likewise, for each harmonic", _RIPPLE),
    Slot("ripple_order", "-", "periods per turn", _RIPPLE, 1.0),
    Slot("ripple_phase", "rad", "at angle zero", _RIPPLE),
    Slot("gravity_torque", "N m", "g(q) = gravity_torque sin(q - gravity_angle)"),
    Slot("gravity_angle", "rad", "angle at which the link hangs at rest"),
    Slot("gravity", "m/s^2", "acceleration on a payload, with the sign of gravity_torque; 0: upright axis"),
    Slot("coupling", "N m/rad", "torque per angle of the neighbour: on the link; between link and motor 1, motor 2", 3),
    Slot("contact_stiffness", "N m/rad", "of a wall; 0: no wall"),
    Slot("contact_damping", "N m s/rad", "of the wall; it never pulls"),
    Slot("contact_angle", "rad", "of the wall"),
    Slot("contact_side", "-", "1: wall at larger angles, -1: at smaller ones", 1, 1.0),
    Slot("pulse_torque", "N m", "on the link, from pulse_start until pulse_stop"),
    Slot("pulse_start", "s", "age of the run"),
    Slot("pulse_stop", "s", "age of the run"),
    Slot("link_drive", "-", "NO_DRIVE, TORQUE_DRIVE (its command is the external torque) or POSITION_DRIVE"),
    Slot("drive_stiffness", "N m/rad", "kp of the position drive on the link"),
    Slot("drive_damping", "N m s/rad", "kd, of the link's speed; acts while the drive is on"),
    Slot("drive_torque_limit", "N m", "known limit of kp times the error", 1, np.inf),
    Slot("drive_speed_limit", "rad/s", "largest speed of the acting goal", 1, np.inf),
    Slot("transmissions", "-", "number of springs, 0 to 2"),
    Slot("serial", "-", "1: motor 2 is the preset of spring 1; 0: each spring has its own motor"),
    Slot("spring_kind", "-", "spring law of via_core.springs", 2),
    Slot("spring", "", "coefficients of the two spring laws", 2 * N_COEFFICIENTS),
    Slot("stop", "rad", "deflection beyond which the spring law continues along its tangent", 2, np.inf),
    Slot("spring_scale", "-", "torque relative to the spring law", 2, 1.0),
    Slot("spring_hardening", "1/rad^2", "relative increase of torque per squared deflection", 2),
    Slot("stiffness_rate", "1/s", "relative increase of torque per time", 2),
    Slot("pretension_offset", "rad", "added to the motor angle that pretensions the spring", 2),
    Slot("backlash", "rad", "width of the torque-free gap in the transmission", 2),
    Slot("hysteresis_torque", "N m", "at which the Maxwell element parallel to the spring slips", 2),
    Slot("hysteresis_stiffness", "N m/rad", "of the Maxwell element", 2, 1.0),
    Slot("spring_damping", "N m s/rad", "damping of the rate of deflection", 2),
    Slot("damper_site", "-", "NO_DAMPER, AT_LINK or AT_TRANSMISSION"),
    Slot("damper_kind", "-", "map of via_core.dampers"),
    Slot("damper", "", "coefficients of the map", N_DAMPER_COEFFICIENTS),
    Slot("delay", "s", "dead time of the command"),
    Slot("encoder_offset", "rad", "added to the measurement: link, motor 1, motor 2", 3),
    Slot("encoder_harmonics", "-", "number of harmonics of the encoder error, up to the last nonzero amplitude", 3),
    Slot("eccentricity", "rad", "amplitude of the encoder error: link, motors, for each harmonic", _ENCODER),
    Slot("eccentricity_order", "-", "periods per turn", _ENCODER, 1.0),
    Slot("eccentricity_phase", "rad", "at angle zero", _ENCODER),
    Slot("encoder_quantum", "rad", "resolution of the measurement", 3),
    Slot("skew", "s", "delay of the measurement", 3),
    Slot("sensed_gain", "-", "measured torque per torque: link, motor 1, motor 2", 3, 1.0),
    Slot("sensed_bias", "N m", "added to the measurement: likewise", 3),
    Slot("origin", "s", "age of the run at tick 0"),
    Slot("tick", "s", "period of the commands", 1, 1e-3),
    Slot("substeps", "-", "integration steps per tick", 1, 1.0),
)

_starts = np.concatenate(([0], np.cumsum([slot.size for slot in SLOTS])))
# A named tuple of ints: numba folds it into constants.
P: Any = namedtuple("Slots", [slot.name for slot in SLOTS])(*(int(start) for start in _starts[:-1]))  # type: ignore
N_PARAMETERS = int(_starts[-1])
PER_MOTOR = frozenset(int(start) for start, slot in zip(_starts, SLOTS) if slot.size == 2)  # without one for the link


def neutral_row() -> Array:
    """A row (N_PARAMETERS,) with every slot at its neutral value."""
    return np.repeat([slot.neutral for slot in SLOTS], [slot.size for slot in SLOTS]).astype(np.float64)
