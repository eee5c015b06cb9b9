"""Ranges of the parameters of an effect: those of the catalogue, and what is plausible in a log."""

from __future__ import annotations

import numpy as np
from via_core.signals import Array, Mask

from via_gap.candidates.location import Location
from via_gap.candidates.scales import Scales
from via_gap.candidates.starts import size_of

WIDEST = 10.0  # times the typical size in a log: largest plausible effect
QUARTER = 0.5 * np.pi  # [rad] largest error of the direction of gravity: beyond it gravity is reversed
SCALED = ("N m", "N m s/rad", "N m s^2/rad^2", "kg m^2")  # units whose bounds depend on the device


def bounds_of(location: Location, scales: Scales) -> tuple[Array, Array]:
    """Lowest and highest value (p,) of every parameter; torques and inertias at most WIDEST times the typical size.

    That does not hold for walls: the damping of a hard one is that of a knock, not of the motion.

    Dry friction is also at most WIDEST times the largest missing torque of its axis: the larger a static friction is,
    the more errors near standstill lie below it, so that the equations alone do not limit it.
    That of the device file can be absent, but not drive the axis.

    Gravity can be absent, with the tolerance of the device file, but not reversed: that is an angle with another
    zero, or a drive that does more than its model.

    A torque ripple has at least one period within the travel of its axis: part of a period would be any function of
    the angle, such as an error of gravity.
    """
    usual = not location.kind.touched
    limited = [(p, usual and p.unit in SCALED and p.neutral == 0.0) for p in location.parameters]
    reach = np.array([WIDEST * size_of(p, location, scales) if has_limit else np.inf for p, has_limit in limited])
    if location.kind.dry:
        is_torque = np.array([p.unit == "N m" for p in location.parameters])
        reach = np.where(is_torque, np.minimum(reach, WIDEST * scales.missing[location.axis]), reach)
    low, high = np.array([(p.low, p.high) for p in location.parameters]).T
    low = np.where(absences(location), -scales.friction[location.axis], low)
    if np.isfinite(scales.gravity):
        ends = {"gravity_torque": (-scales.gravity, np.inf), "gravity_angle": (-QUARTER, QUARTER)}
        least, most = np.array([ends.get(str(p.slot), (-np.inf, np.inf)) for p in location.parameters]).T
        low, high = np.maximum(low, least), np.minimum(high, most)
    if location.kind.whole_period:
        whole = 2.0 * np.pi / max(float(scales.travel[location.axis]), 1e-9)
        is_order = np.array([p.unit == "1/rev" for p in location.parameters])
        low = np.where(is_order, np.minimum(np.maximum(low, whole), high), low)
    return np.maximum(low, -reach), np.minimum(high, reach)


def absences(location: Location) -> Mask:
    """(p,) whether the low end of a parameter is the absence of the dry friction of the device file."""
    dry = location.kind.dry
    return np.array([dry and p.low < 0.0 and p.unit == "N m" for p in location.parameters], dtype=np.bool_)
