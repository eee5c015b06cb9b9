"""Memory of a block of runs: named rows of one number per lane."""

from __future__ import annotations

from collections import namedtuple
from typing import Any

import numpy as np
from via_core.spring_equations import N_COEFFICIENTS

from via_sim.catalogue.sensor.encoder_eccentricity import ENCODER_HARMONICS
from via_sim.catalogue.terms import SIGNALS
from via_sim.joint.layout import N_COMMANDS
from via_sim.joint.parameters import P
from via_sim.joint.step import PER_AXIS
from via_sim.joint.terms import terms_at

# Name and number of rows. Three rows belong to link, motor 1, motor 2; two rows to the motors or transmissions.
_SIZES = {
    # at the beginning of the step: motion and torques of the elements with memory, in the order of the state; these
    # rows at the beginning of the tick; motion at the stage; velocities at the midpoint
    "start": 6, "bristle": 3, "maxwell": 2, "lagged": 3, "behind": 1, "integral": 1, "before": 16,
    "at": 6, "midpoint": 3,
    # torques at Krogstad's stages, and the weights of `kernel.weigh`
    "n": 3, "a": 3, "b": 3, "c": 3, "weight": 3 * PER_AXIS,
    # length of the step; of both pieces of a tick, where a dead time divides it: weights and the damping they are for,
    # lags left, length
    "length": 1, "piece_weight": 6 * PER_AXIS, "weighed": 2, "piece_lag_left": 6, "piece_length": 2,
    # servos: bandwidth; angle and velocity of both at the middle, then at the end of the step
    "bandwidth": 2, "servo": 8,
    # age at the beginning of the run; inputs: command row behind the dead time, its external torque before it, all
    # torque, the part that is not from the drives, drive torque before the lag
    "age": 1, "command": N_COMMANDS, "external": 1, "torque": 3, "other_torque": 3, "commanded": 3, "damping": 1,
    "spring_factor": 2,
    # modes: slip direction (0 without friction), 1 where an axis sticks, flank of the gap, slip direction of the
    # Maxwell element, 1 where the wall is touched; `joins` is 1 where the lane goes in lockstep, else -1; the margin is
    # positive while such a lane has kept its modes
    "sign": 3, "stuck": 3, "flank": 2, "slip": 2, "touch": 1, "joins": 1, "margin": 1,
    # intermediate values
    "spring_torque": 2, "geared_torque": 2,
    # position drive: commanded goal, goal that acts, 1 while the drive is on, torque without kd; goals behind the speed
    # limit and behind the lag at the beginning of the step; 1 where there is a speed limit, 1 where there is a lag;
    # parameters
    "target": 1, "acting": 1, "power": 1, "drive_torque": 1, "followed": 1, "trailing": 1, "slews": 1, "lags": 1,
    "encoder_offset": 3, "drive_stiffness": 1, "drive_damping": 1, "drive_limit": 1, "drive_brake": 1,
    "drive_gain": 1, "drive_bias": 1,
    # its command and the one before, without feedforward, and whether that was on; goal per difference of both
    "sent": 1, "sent_before": 1, "on_before": 1, "lead": 1,
    # its integral: mean over a piece of a tick, error at the beginning of the piece, largest value
    "held": 1, "first_error": 1, "integral_reach": 1, "integral_rate": 1,
    "drive_speed_limit": 1, "lag": 1, "eccentricity": 3 * ENCODER_HARMONICS,
    "eccentricity_order": 3 * ENCODER_HARMONICS, "eccentricity_phase": 3 * ENCODER_HARMONICS,
    # parameters, as in the row; an exponential spring is rise exp(growth phi) - fall exp(-growth phi); `no_gap`,
    # `no_maxwell` and `no_wall` are infinite where there is none; `lag_left` is the share of a lag left at the
    # beginning, the middle and the end of a step; `preset_offset` is added to the motor's angle in a spring law
    "inertia": 3, "viscous_friction": 3,
    "kinetic_friction": 3, "friction_excess": 3, "inverse_stribeck_velocity": 3, "friction_asymmetry": 3,
    "viscous_asymmetry": 3, "load_friction": 3, "counter_friction": 3, "load_stribeck": 3, "counter_stribeck": 3,
    "load_quadratic": 3, "inverse_load_velocity": 3, "bristle_torque": 3, "bristle_rate": 3,
    "gravity_torque": 1, "gravity_angle": 1, "spring": 2 * N_COEFFICIENTS, "preset_offset": 2, "rise": 2, "fall": 2,
    "growth": 2, "stop": 2, "spring_hardening": 2, "pretension_offset": 2, "half_gap": 2, "no_gap": 2, "no_maxwell": 2,
    "slip_torque": 2, "slip_stiffness": 2, "spring_damping": 2, "contact_angle": 1, "contact_side": 1,
    "contact_stiffness": 1, "contact_damping": 1, "no_wall": 1, "coupling": 3, "pulse_torque": 1, "pulse_start": 1,
    "pulse_stop": 1, "spring_scale": 2, "stiffness_rate": 2, "torque_limit": 2, "torque_gain": 3, "torque_bias": 3,
    "lag_left": 3,
    # of terms at the input of a transmission: error [rad] and its derivative
    "input_error": 2, "input_slope": 2,
    **{name: 3 * term.repeats for place in SIGNALS for term in terms_at(place) for name in term.slots},
}  # fmt: skip
_Rows = namedtuple("_Rows", list(_SIZES))  # type: ignore[misc]
Z: Any = _Rows(*(int(s) for s in np.cumsum((0, *list(_SIZES.values())[:-1]))))
N_ROWS = sum(_SIZES.values())
# Slot of the parameter row and row of each parameter that has the same name in both; `load_parameters` changes some.
COPIED = np.array(
    [(getattr(P, name) + i, getattr(Z, name) + i) for name in _SIZES if name in P._fields for i in range(_SIZES[name])]
)

# Arrangement of a block, and terms that some lane has; the others are skipped.
#   axes          number of axes
#   springs       number of transmissions
#   kinds         spring laws of the transmissions
#   coefficients  polynomial coefficients of the springs that are not zero
#   gravity       whether any link has gravity
#   coupled       whether the damper is at the transmission
#   friction      bit per axis with dry friction
#   falls         whether breakaway differs from kinetic friction
#   gaps          number of transmissions whose backlash is checked
#   rare          bits of the terms below, which most joints lack
Terms = namedtuple("Terms", "axes springs kinds coefficients gravity coupled friction falls gaps rare")

# First bit of each rare term: one bit per axis, transmission, or joint; of the catalogue's terms see `terms.py`.
_Rare = namedtuple(
    "_Rare", "bristle maxwell spring_damping wall lag loads position goal eccentric input hardening servo limited terms"
)
R: Any = _Rare(0, 3, 5, 6, 7, 8, 9, 10, 11, 12, 14, 15, 17, 18)
