"""Time step and integrator of a joint in MuJoCo, and delays and filters of its commands."""

from __future__ import annotations

from math import isfinite

from via_sim.joint.parameters import POSITION_DRIVE, P

from via_export.target import TICK, Target
from via_export.xml import Attributes

STEP = 2.5e-4  # [s] largest time step
ROUND = 0.25  # time steps by which a delay is shortened, so that rounding does not select the next sample


def integrator(target: Target) -> str:
    """Euler, with a quarter of the step, where elements have memory.

    MuJoCo updates bristles and slipping springs exactly, but once per step. The stages of RK4 use them without that:
    bristles that follow within a step are unstable there, and springs stick over a whole step.
    """
    return "Euler" if has_memory(target) else "RK4"


def has_memory(target: Target) -> bool:
    """Whether an axis has friction by LuGre's equations, or a transmission a spring that slips."""
    axes, springs = range(1 + target.device.n_motors), range(target.device.n_transmissions)
    bristles = any(target.dry(axis)[0] > target.dry(axis)[1] or target.bristle(axis)[0] > 0.0 for axis in axes)
    return bristles or any(target.row[P.hysteresis_torque + i] > 0.0 for i in springs)


def step(target: Target) -> float:
    """[s] time step: a fraction of a millisecond that resolves the joint."""
    steps = max(round(TICK / STEP), 2 * target.substeps)
    return TICK / (4 * steps if has_memory(target) else steps)


def steps_late(target: Target, h: float) -> int:
    """Time steps h [s] of an actuator's delay; one more for a goal with a speed limit, which acts a step early."""
    slews = target.row[P.link_drive] == POSITION_DRIVE and isfinite(target.row[P.drive_speed_limit])
    return round(float(target.row[P.delay]) / h) + int(slews)


def late(target: Target) -> Attributes:
    """Attributes of an actuator's delay, in time steps; its buffer is long enough for half of their length."""
    late = steps_late(target, step(target))
    return {"delay": (late - ROUND) * step(target), "nsample": float(2 * late + 2)} if late > 0 else {}


def lag_filter(target: Target) -> Attributes:
    lag = float(target.row[P.lag])
    return {"dyntype": "filterexact", "dynprm": lag, "actearly": True} if lag > 0.0 else {}
