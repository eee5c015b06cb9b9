"""What an encoder reads of an angle, but for noise, steps and lateness."""

from __future__ import annotations

from math import cos, sin

from via_core.signals import Array

from via_sim.compiled import bare
from via_sim.parameters import P


@bare
def read_motion(p: Array, axis: int, angle: float, velocity: float) -> tuple[float, float]:
    """What the encoder of an axis reads, and the speed of that reading, but for noise and steps [rad, rad/s]."""
    swing, turned = p[P.eccentricity + axis], angle + p[P.eccentricity_phase + axis]
    if swing != 0.0:
        angle += swing * sin(turned)
        velocity += swing * cos(turned) * velocity
    return angle + p[P.encoder_offset + axis], velocity
