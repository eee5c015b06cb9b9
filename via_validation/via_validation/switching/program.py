"""Section 7 as a linear program: the largest link velocity over piecewise constant controls.

Between nodes the joint's response to a constant control is exact (matrix exponential). The program

    max nu_N   over u_k, x_k   with x_{k+1} = F_k x_k + f_k u_k, x_0 = 0, |u_k| <= limit, |mu_k| <= v

makes one error: a switch cannot happen within a step. Steps at which the control jumps are halved and the program is
solved again, until the switch is accurate enough. It checks the closed form and uses nothing of it.
The motor's velocity is limited at the nodes; between them a torque drive may exceed it by the square of a step.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm
from scipy.optimize import linprog
from scipy.sparse import coo_array
from via_controllers.contract import require
from via_core.errors import ViaError
from via_core.signals import Array

from via_validation.switching.motor_models import DrivenJoint, Optimum

JUMP = 0.1  # change of control between steps, over the largest control, that counts as a switch


def largest_velocity(driven: DrivenJoint, horizon: float, steps: int = 100, finest: float = 1e-4) -> Optimum:
    """The optimum at t_f = `horizon` [s], starting with `steps` equal steps; raises ViaError if HiGHS finds none.

    finest   steps at a switch are halved down to this share of the horizon: the error of the switch; the error of the
             velocity is about its square
    """
    require(horizon > 0.0, f"a horizon must be > 0 s, got {horizon}")
    found = _solve(driven, np.linspace(0.0, horizon, steps + 1))
    while len(halved := _halved(found, finest * horizon)) > len(found.time):
        found = _solve(driven, halved)
    return found


def _halved(found: Optimum, finest: float) -> Array:
    """The nodes, with one more in the middle of every step longer than `finest` at which the control jumps."""
    jumps = np.abs(np.diff(found.control)) > JUMP * np.abs(found.control).max()
    touched = np.append(jumps, False) | np.insert(jumps, 0, False)
    middles = 0.5 * (found.time[:-1] + found.time[1:])[touched & (np.diff(found.time) > finest)]
    return np.sort(np.concatenate([found.time, middles]))


def _solve(driven: DrivenJoint, time: Array) -> Optimum:
    A, b = driven.system
    n, N = len(b), len(time) - 1
    steps = np.diff(time)
    # exp([[A, b], [0, 0]] h) contains F and f; equal steps share it.
    discrete: dict[float, Array] = {}
    rows, columns, values = [], [], []
    states = N + np.arange(n * N).reshape(N, n)  # indices of x_1 .. x_N among the variables, after u
    for k, h in enumerate(steps):
        key = float(np.round(h, 15))
        if key not in discrete:
            discrete[key] = expm(np.block([[A, b[:, None]], [np.zeros((1, n + 1))]]) * h)[:n]
        line = n * k + np.arange(n)
        rows += [*line, *line]
        columns += [*states[k], *([k] * n)]
        values += [*np.ones(n), *(-discrete[key][:, n])]
        if k:
            rows += list(np.repeat(line, n))
            columns += list(np.tile(states[k - 1], n))
            values += list(-discrete[key][:, :n].ravel())
    equal = coo_array((values, (rows, columns)), shape=(n * N, N + n * N)).tocsr()
    low = np.full(N + n * N, -np.inf)
    low[:N] = -driven.limit
    if n == 3:
        low[states[:, 2]] = -driven.velocity_limit
    cost = np.zeros(N + n * N)
    cost[states[-1, 1]] = -1.0
    result = linprog(cost, A_eq=equal, b_eq=np.zeros(n * N), bounds=np.column_stack([low, -low]), method="highs")
    if result.status != 0:
        raise ViaError(f"no optimum over {time[-1]:g} s: {result.message}")
    state = np.vstack([np.zeros(n), result.x[N:].reshape(N, n)])
    return Optimum(time, result.x[:N], state, float(state[-1, 1]))
