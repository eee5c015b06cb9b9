"""Section 7 by direct collocation: the problem of `program` solved by an independent method.

On each of N intervals the control is constant and the state is a polynomial of degree `degree` that satisfies the
joint's equations at Radau points. IPOPT maximises the link velocity at the end. The method uses neither an exact
discretisation nor linearity.
"""

from __future__ import annotations

from typing import Any

import casadi
import numpy as np
from via_controllers.contract import require
from via_core.errors import ViaError

from via_validation.switching.motor_models import DrivenJoint, Optimum


def largest_velocity(driven: DrivenJoint, horizon: float, intervals: int = 200, degree: int = 3) -> Optimum:
    """The optimum at t_f = `horizon` [s]; raises ViaError if IPOPT does not converge."""
    require(horizon > 0.0, f"a horizon must be > 0 s, got {horizon}")
    A, b = driven.system
    n, h = len(b), horizon / intervals
    points = casadi.collocation_points(degree, "radau")
    slopes, ends, _ = casadi.collocation_coeff(points)
    x = casadi.MX.sym("x", n)
    inner = casadi.MX.sym("inner", n, degree)
    u = casadi.MX.sym("u")
    # Each interval: its polynomial satisfies the equations at the points and ends where the next one begins.
    rates = casadi.horzcat(x, inner) @ slopes
    defects = h * (casadi.DM(A) @ inner + casadi.repmat(casadi.DM(b) * u, 1, degree)) - rates
    interval = casadi.Function("interval", [x, inner, u], [casadi.vec(defects), casadi.horzcat(x, inner) @ ends])

    states = casadi.MX.sym("X", n, intervals + 1)
    inners = casadi.MX.sym("Z", n, degree * intervals)
    controls = casadi.MX.sym("U", 1, intervals)
    defect, end = interval.map(intervals)(states[:, :-1], inners, controls)
    unknown = casadi.veccat(states, inners, controls)
    equal = casadi.vertcat(casadi.vec(defect), casadi.vec(end - states[:, 1:]), states[:, 0])
    largest = np.full(n, np.inf)
    if n == 3:
        largest[2] = driven.velocity_limit
    high = np.concatenate(
        [np.tile(largest, intervals + 1), np.tile(largest, degree * intervals), np.full(intervals, driven.limit)]
    )
    problem: dict[str, Any] = {"x": unknown, "f": -states[1, -1], "g": equal}
    quiet: dict[str, Any] = {"ipopt.print_level": 0, "ipopt.sb": "yes", "print_time": False, "ipopt.tol": 1e-9}
    solver = casadi.nlpsol("fastest", "ipopt", problem, quiet)
    found = solver(x0=0.0, lbx=-high, ubx=high, lbg=0.0, ubg=0.0)
    if not solver.stats()["success"]:
        raise ViaError(f"no optimum over {horizon:g} s: IPOPT returned {solver.stats()['return_status']}")
    solution = np.asarray(found["x"]).ravel()
    state = solution[: n * (intervals + 1)].reshape(intervals + 1, n)
    return Optimum(
        np.linspace(0.0, horizon, intervals + 1), solution[-intervals:], state, float(state[-1, 1])
    )  # fmt: skip
