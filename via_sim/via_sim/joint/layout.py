"""Layout of the arrays of one joint: state, command, inputs of the equations, modes."""

from __future__ import annotations

from collections import namedtuple
from typing import Any

from via_sim.catalogue import EFFECTS

HISTORY = 34  # past samples in the ring buffer for late encoders

# State row: the full state of a joint at a tick; X is the first column of each part.
#   position (3) [rad], velocity (3) [rad/s]  of link, motor 1, motor 2
#   tick, seed             number of the tick, seed of the noise
#   reported_torque (2)    [N m] commanded during the last tick
#   motor_torque (2), damping, external  [N m or rad, N m s/rad, N m] that acted during the last tick
#   beside                 [N m] part of `external` that is not from the drive of a rigid joint
#   bristle (3), hysteresis (2)  [N m] torques of the elements with memory
#   lag (3)                [N m] drive torques behind the lag; of a position drive [rad] the distance of its goal
#   behind                 [rad] distance of a position drive's goal from the commanded one due to the speed limit
#   integral               [rad] of a position drive: integral of its error, times ki / kp
#   history (HISTORY, 6)   motion at past ticks, a ring buffer
#   queue (L, QUEUED)      the last L commands, a ring buffer for the dead time
State = namedtuple(
    "State",
    "position velocity tick seed reported_torque motor_torque damping external beside bristle hysteresis lag behind "
    "integral history queue",
)
X: Any = State(0, 3, 6, 7, 8, 10, 12, 13, 14, 15, 18, 20, 23, 24, 25, 25 + 6 * HISTORY)

# Command row, constant during a tick: motor 1, motor 2 [N m or rad], damping [-], external torque at the link [N m],
# angle of the neighbour joint [rad], torque of the other joints of an arm on the link [N m]. The dead time applies to
# the first QUEUED of them. A position drive has its goal [rad] and 1 (on) or 0 (off) in place of the motors.
N_COMMANDS, QUEUED = 6, 4
M1, M2, DAMPING, EXTERNAL, NEIGHBOUR, ARM = range(N_COMMANDS)
GOAL, POWER = M1, M2

# Inputs u of the equations. Columns 0 to 3 as in the command row: torque on motor 1, motor 2 [N m] (command [rad] of a
# servo), DAMPING [N m s/rad], EXTERNAL torque on the link [N m]; then
#   spring (2)          factors of the two springs [-]
#   target (3)          commands to the drives of link, motor 1, motor 2 [N m; goal of a position drive: rad]
#   beside (3)          torques on these axes that are not from drives [N m]
#   acting, on          of a position drive: goal [rad], 1 or 0
#   followed, lagged    its goal at the beginning of the step behind the speed limit and behind the lag [rad]
#   held                mean of its integral over the piece of the tick [rad]
_Inputs = namedtuple("_Inputs", "spring target beside acting on followed lagged held")
U: Any = _Inputs(4, 6, 9, 12, 13, 14, 15, 16)
N_INPUTS = 17

# Modes. Columns 0 to 2 are the axes: STUCK, SMOOTH (no dry friction) or slip direction -1, +1; then
#   flank (2), slip (2)  flank of the transmissions (0 within the gap), slip direction of their Maxwell elements (or 0)
#   touch                whether the wall is touched
#   dry (3)              whether the axes have dry friction
#   switches, lags       whether any mode can change, the drives lag
#   rare (3), paired     whether an axis has rare torques, and two of them have some between each other or with a wall
#   every                ticks between samples in the ring buffer
#   coefficients (2)     number of coefficients of the spring laws, up to the last that is not zero in a polynomial
#   late, substeps       dead time in whole ticks, integration steps per tick
#   repeats (3 each)     number of harmonics, up to the last that is not zero, of each periodic term of an axis
_Modes = namedtuple("_Modes", "flank slip touch dry switches lags rare paired every coefficients late substeps repeats")
MODE: Any = _Modes(3, 5, 7, 8, 11, 12, 13, 16, 17, 18, 20, 21, 22)
STUCK, SMOOTH = 0, 2
N_MODES = MODE.repeats + 3 * sum(term.repeats > 1 for kind in EFFECTS.values() for term in kind.terms)
