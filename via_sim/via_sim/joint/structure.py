"""Structure of a joint, for which kernels are compiled: what is absent costs nothing.

A part of a `Structure` is True or None. numba compiles a function for each combination of argument types, None is a
type, and LLVM drops all code behind `if has.gravity is not None` where gravity is None. A joint with nothing but
springs, dampers, gravity and torque drives is smooth; it gets a short kernel of its own structure, which numba compiles
at its first use and caches. All other joints share one kernel with all parts.
"""

from __future__ import annotations

from collections import namedtuple
from typing import Any

import numpy as np
from via_core.signals import Array
from via_core.spring_equations import N_COEFFICIENTS, ODD_POLYNOMIAL

from via_sim.joint.parameters import NO_DAMPER, POSITION_DRIVE, SERVO, SLOTS, P, neutral_row

# rest            events, memory, servos, dead time, and all that the other parts do not stand for
# noise           of the sensors, and quantisation
# gravity         of the link
# damper          at link or transmission
# spring, second  first and second transmission
# curves          springs that are not polynomials
# adjusted        springs with a factor or an offset of their pretension
# polynomials     coefficients of two polynomial springs; their number is a part of the type. Unused with `curves`
# stops           deflections [rad] beyond which the springs continue along their tangents. Unused with the `rest`
Structure = namedtuple("Structure", "rest noise gravity damper spring second curves adjusted polynomials stops")
EVERYTHING = Structure(True, True, True, True, True, True, True, True, ((0.0,), (0.0,)), (0.0, 0.0))

# Slots that short kernels read. Where any other slot is not neutral, a joint has the `rest`.
_SHORT = frozenset(
    {"axis_kind", "inertia", "viscous_friction", "torque_limit", "gravity_torque", "gravity_angle", "gravity"}
    | {"link_drive", "transmissions", "serial", "spring_kind", "spring", "stop", "pretension_offset", "spring_scale"}
    | {"damper_site", "damper_kind", "damper", "origin", "tick", "substeps", "torque_gain", "torque_bias"}
    | {"sensed_gain", "sensed_bias", "encoder_offset", "encoder_quantum"}
)
_NEUTRAL = neutral_row()
_REST = np.repeat([slot.name not in _SHORT for slot in SLOTS], [slot.size for slot in SLOTS])
_LENGTHS = (1, 2, 4, N_COEFFICIENTS)  # of polynomials: few, because a kernel is compiled for each


def structure_of(p: Array, s: Array) -> Any:
    """The structure of the joint with parameter row p (N_PARAMETERS,) and sensor row s (7,)."""
    if not is_smooth(p):
        return EVERYTHING
    scales, offsets = p[P.spring_scale : P.spring_scale + 2], p[P.pretension_offset : P.pretension_offset + 2]
    curves = np.any(p[P.spring_kind : P.spring_kind + 2] != ODD_POLYNOMIAL)
    return Structure(
        rest=None,
        noise=_part(np.any(s != 0.0) or np.any(p[P.encoder_quantum : P.encoder_quantum + 3] != 0.0)),
        gravity=_part(p[P.gravity_torque] != 0.0),
        damper=_part(p[P.damper_site] != NO_DAMPER),
        spring=_part(p[P.transmissions] > 0),
        second=_part(p[P.transmissions] > 1),
        curves=_part(curves),
        adjusted=_part(np.any(scales != 1.0) or np.any(offsets != 0.0)),
        polynomials=EVERYTHING.polynomials if curves else _polynomials(p),
        stops=(float(p[P.stop]), float(p[P.stop + 1])),
    )


def _part(there: object) -> bool | None:
    return True if there else None


def _polynomials(p: Array) -> tuple[tuple[float, ...], ...]:
    """Coefficients of both springs, as many as the longer one needs."""
    springs = p[P.spring : P.spring + 2 * N_COEFFICIENTS].reshape(2, N_COEFFICIENTS)
    last = int(np.max(np.flatnonzero(np.any(springs != 0.0, axis=0)), initial=0))
    length = next(each for each in _LENGTHS if each > last)
    return tuple(tuple(each[:length].tolist()) for each in springs)


def is_smooth(p: Array) -> bool:
    """Whether a joint has nothing of what `rest` stands for."""
    kinds = p[P.axis_kind : P.axis_kind + 3]
    motors = np.count_nonzero(kinds[1:])
    regular = p[P.link_drive] != POSITION_DRIVE and not np.any(kinds == SERVO) and motors == p[P.transmissions]
    return bool(regular and np.array_equal(p[_REST], _NEUTRAL[_REST]))
