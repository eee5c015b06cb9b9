"""Section 7 as a linear program: the largest link velocity over controls that are held from node to node.

Between nodes the joint's answer to a held control is exact (matrix exponential), so that the program

    max nu_N   over u_k, x_k   with x_{k+1} = F_k x_k + f_k u_k, x_0 = 0, |u_k| <= limit, |mu_k| <= v

is wrong in one thing: a switch cannot happen within a step. Steps at which the control jumps are halved and the program
is solved again, until the switch is known well enough. Nothing of the closed form is used: this checks it.
The motor's velocity is limited at the nodes, between which a torque drive may exceed it by the square of a step.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm
from scipy.optimize import linprog
from scipy.sparse import coo_array
from via_core.errors import ViaError
from via_core.signals import Array

from via_controllers.contract import require
from via_controllers.motor_models import DrivenJoint, Optimum

JUMP = 0.1  # of the largest control: a change of control from step to step that is a switch, or the way to one


def largest_velocity(driven: DrivenJoint, horizon: float, steps: int = 100, finest: float = 1e-4) -> Optimum:
    """The fastest link at t_f = `horizon` [s], beginning with `steps` equal steps; ViaError where HiGHS finds nothing.

    finest   share of the horizon below which a step beside a switch is not halved any more: the switch is known to it,
             the velocity to about its square
    """
    require(horizon > 0.0, f"a horizon must be > 0 s, got {horizon}")
    found = _solve(driven, np.linspace(0.0, horizon, steps + 1))
    while len(halved := _halved(found, finest * horizon)) > len(found.time):
        found = _solve(driven, halved)
    return found


def _halved(found: Optimum, finest: float) -> Array:
    """The nodes, with one more in the middle of every step longer than `finest` beside which the control jumps."""
    jumps = np.abs(np.diff(found.control)) > JUMP * np.abs(found.control).max()
    touched = np.append(jumps, False) | np.insert(jumps, 0, False)
    middles = 0.5 * (found.time[:-1] + found.time[1:])[touched & (np.diff(found.time) > finest)]
    return np.sort(np.concatenate([found.time, middles]))


def _solve(driven: DrivenJoint, time: Array) -> Optimum:
    A, b = driven.system
    n, N = len(b), len(time) - 1
    steps = np.diff(time)
    # exp([[A, b], [0, 0]] h) holds F and f at once; equal steps share it.
    held: dict[float, Array] = {}
    rows, columns, values = [], [], []
    states = N + np.arange(n * N).reshape(N, n)  # where x_1 .. x_N stand among the variables, after u
    for k, h in enumerate(steps):
        key = float(np.round(h, 15))
        if key not in held:
            held[key] = expm(np.block([[A, b[:, None]], [np.zeros((1, n + 1))]]) * h)[:n]
        line = n * k + np.arange(n)
        rows += [*line, *line]
        columns += [*states[k], *([k] * n)]
        values += [*np.ones(n), *(-held[key][:, n])]
        if k:
            rows += list(np.repeat(line, n))
            columns += list(np.tile(states[k - 1], n))
            values += list(-held[key][:, :n].ravel())
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
