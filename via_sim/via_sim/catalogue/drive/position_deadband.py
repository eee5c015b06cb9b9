"""A position drive that does not correct small errors, as those of hobby servos.

Its torque jumps at the edge of the band, which the integrator notices at its next step, as a real drive does at its
next sample: the error is about 2 % of the width.
"""

from __future__ import annotations

from via_sim.catalogue.kinds import EffectKind, EffectParameter, Slot
from via_sim.catalogue.starts import Typical, thresholds
from via_sim.catalogue.terms import Term


def _corrected(position_deadband: float, error: float) -> float:
    return error * (abs(error) >= position_deadband)


def _largest_error(here: Typical) -> float:
    """Error [rad] at the largest torque of the drive."""
    assert here.device.servo is not None
    return here.peak / here.device.servo.kp


KIND = EffectKind(
    name="position_deadband",
    text="a position drive without torque while the error between goal and measured angle is smaller than a width",
    term="kp e for |e| >= width, else 0; e the error of the goal",
    confused_with="coulomb_friction, stribeck_friction: also resist a moving link; encoder_quantisation: in the log",
    sites=("motor",),
    parameters=(
        EffectParameter("width", "rad", 0.0, 3.2, 0.0, "smallest error that is corrected", slot="position_deadband"),
    ),
    slots=(Slot("position_deadband", "rad", "errors of a position drive below it are not corrected", 3),),
    terms=(Term("error", _corrected),),
    starts=thresholds("width", _largest_error),
    of_drive=True,
    of_goal=True,
)
