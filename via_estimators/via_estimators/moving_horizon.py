"""Stiffness by moving-horizon estimation: least squares over the last samples, with the older ones as arrival cost.

Sources: Rao, Rawlings, Mayne 2003, and Kuehl et al. 2011, cited in full in `horizon_problem`, which states the problem.
Per motor of a joint, the unknowns are angle and velocity at the nodes of the horizon, inertia, damping, dry friction
and the coefficients of the spring law, in the basis of `modulated_torque`. Samples are condensed to one interval of
`stride` samples: span, exact integrals of the torque, which a sample holds over the interval that ends at its stamp,
mean of the motor's angle, and a line through the link's angle. When the horizon is full, `iterations` Gauss-Newton
steps solve the problem, and the oldest `every` intervals enter the arrival cost.

Unknowns may change: between two solutions the scale of the spring law, inertia, damping and friction each walk at
random by `drift`. After a gap or a standstill the information of the last solution is kept, that of the angles is not.

Noise of a torque sample includes that of the link's angle through the stiffness, and where the motor may stick, its
friction. The noise level is estimated from the innovations of the intervals that leave; with it, standard deviations
follow from the Hessian of the Gauss-Newton method. They also include the declared uncertainty of the torque's scale and
the truncation of the basis, as in `modulated_torque`. Not included: the torque's delay, correlated encoder noise, and
the curvature that a Gauss-Newton Hessian omits.

The kernel is compiled, but for the solutions: CasADi evaluates residuals and Jacobians.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import exp, sqrt

import numpy as np
from numba import njit
from via_core.devices import Device
from via_core.errors import ParameterError
from via_core.signals import Array
from via_core.status import BAD_SAMPLE

from via_estimators import horizon_problem, transmissions, window
from via_estimators import horizon_samples as horizon
from via_estimators.contract import Estimator, Kernel, Parameters, expect, parameter
from via_estimators.horizon_problem import DATA, U
from via_estimators.horizon_samples import KEPT, LINK, P
from via_estimators.slots import row_of
from via_estimators.spring_series import MOST_TERMS, power, tail, terms_for
from via_estimators.transmissions import JOINT, VISITED
from via_estimators.window import HEADER

FURTHEST = 10.0  # [deflection scales] larger deflections are bad samples
NOISE_MEMORY = 10.0  # [s] over which the noise level is averaged
KNOWN = 20.0  # innovations that the declared noise level counts for
WIDEST = 1.0  # variance that drift adds to a relative scale at most


@dataclass(frozen=True)
class MovingHorizonParameters(Parameters):
    """Parameters of `MovingHorizon`; the prior is so wide that data soon replace it."""

    transmissions: int = parameter(2, "number of motors with a transmission each", "-", 1, 2)
    window: int = parameter(400, "sampling intervals in the horizon", "-", 20, 4000)
    stride: int = parameter(10, "sampling intervals between two nodes", "-", 2, 100)
    every: int = parameter(5, "nodes between two solutions", "-", 1, 50)
    iterations: int = parameter(2, "Gauss-Newton steps per solution", "-", 1, 10)
    order: int = parameter(3, "odd terms of the spring law", "-", 1, MOST_TERMS)
    even_terms: int = parameter(0, "even terms in addition, the constant first", "-", 0, MOST_TERMS)
    truncation: float = parameter(1.0, "truncation error over the last term; 0: the basis is exact", "-", 0.0, 10.0)
    drift: float = parameter(0.005, "relative random walk of every unknown", "1/sqrt(s)", 0.0, 10.0)
    friction_velocity: float = parameter(0.02, "velocity scale of the smoothed dry friction", "rad/s", 1e-6, 10.0)
    max_gap: float = parameter(0.05, "longest step between samples that keeps the horizon", "s", 1e-4, 10.0)
    deflection_scale: float = parameter(1.0, "deflection at which all terms have equal weight", "rad", 1e-3, 10.0)
    stiffness_prior: float = parameter(0.0, "stiffness per transmission before any data", "N m/rad", 0.0, 1e9)
    stiffness_deviation: float = parameter(300.0, "standard deviation of the prior stiffness", "N m/rad", 1e-6, 1e9)
    inertia_prior: float = parameter(0.01, "motor inertia before any data", "kg m^2", 1e-9, 1e3)
    inertia_deviation: float = parameter(0.1, "standard deviation of the prior inertia", "kg m^2", 1e-9, 1e3)
    damping_prior: float = parameter(0.0, "motor damping before any data", "N m s/rad", 0.0, 1e4)
    damping_deviation: float = parameter(10.0, "standard deviation of the prior damping", "N m s/rad", 1e-9, 1e4)
    friction_prior: float = parameter(0.0, "dry friction of a motor before any data", "N m", 0.0, 1e6)
    friction_deviation: float = parameter(1.0, "standard deviation of the prior dry friction", "N m", 1e-9, 1e6)
    constant_deviation: float = parameter(300.0, "standard deviation of the constant before any data", "N m", 1e-9, 1e9)
    torque_noise: float = parameter(0.1, "expected standard deviation of torque noise", "N m", 1e-9, 1e9)
    position_noise: float = parameter(3e-5, "standard deviation of one angle sample", "rad", 0.0, 0.1)
    minimum_motion: float = parameter(0.01, "least range of deflection in an informative horizon", "rad", 0.0, 1.0)
    range_margin: float = parameter(0.02, "margin beyond the visited range, relative to it", "-", 0.0, 1.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.window < self.stride * (self.every + 1):
            raise ParameterError(
                f"window must hold more than `every` = {self.every} intervals of {self.stride} samples: {self.window}"
            )


@dataclass(frozen=True)
class MovingHorizon(Estimator):
    """Stiffness of one or two transmissions from motor torques and angles on both sides."""

    parameters: MovingHorizonParameters = MovingHorizonParameters()

    @classmethod
    def from_device(cls, device: Device) -> MovingHorizon:
        """Scales and priors of the order of magnitude that the device file states."""
        known = transmissions.priors_of(device) | transmissions.known_of(device) | transmissions.torques_of(device)
        order, even = terms_for(device.springs)
        return cls(MovingHorizonParameters(**known, order=order, even_terms=even))

    def with_parameters(self, parameters: Parameters) -> MovingHorizon:
        return replace(self, parameters=expect(parameters, MovingHorizonParameters))

    @cached_property
    def inputs(self) -> tuple[str, ...]:
        return transmissions.inputs_of(self.parameters.transmissions)

    @cached_property
    def outputs(self) -> tuple[str, ...]:
        return transmissions.outputs_of(self.parameters.transmissions, "motor_inertia", "motor_damping")

    @cached_property
    def model(self) -> horizon_problem.Model:
        """The constants of a transmission."""
        own = self.parameters
        n = U.size + own.order + own.even_terms
        mean, width = np.zeros(n), np.full(n, own.stiffness_deviation)
        mean[: U.size + 1] = own.inertia_prior, own.damping_prior, own.friction_prior, own.stiffness_prior
        width[: U.size] = own.inertia_deviation, own.damping_deviation, own.friction_deviation
        if own.even_terms > 0:
            width[U.size + own.order] = own.constant_deviation / own.deflection_scale
        return horizon_problem.Model(
            own.order, own.even_terms, own.deflection_scale, own.friction_velocity, mean, width
        )  # fmt: skip

    @cached_property
    def _constants(self) -> Array:
        """Parameter row of the kernel; writable, since a locked array compiles again."""
        own = self.parameters
        row = row_of(P, own, length=own.window + 1, intervals=own.window // own.stride)
        return np.concatenate([row, self.model.mean, self.model.width])

    def init(self) -> Array:
        par, k = self._constants, len(self.outputs)
        state = np.zeros(horizon.parts_at(par) + self.parameters.transmissions * horizon.part_size(par))
        window.start(state)
        state[HEADER.size : HEADER.size + 2 * k] = transmissions.prior_outputs(self.parameters, "inertia", "damping")
        for part in horizon.parts(par, state):
            kept, _, _, _, arrival, _, root, covariance = horizon.views(par, part)
            kept[[KEPT.weight, KEPT.power]] = KNOWN
            np.fill_diagonal(root, 1.0)
            np.fill_diagonal(covariance, 1.0)
            arrival[:] = horizon_problem.free(np.zeros(len(root)), root)
        state.flags.writeable = False
        return state

    def load(self) -> None:
        super().load()
        state = self.init().copy()
        par = self._constants
        _, _, data, nodes, arrival, z, _, _ = horizon.views(par, horizon.parts(par, state)[0])
        data[:] = 1.0
        solution = horizon_problem.solve(self.model, arrival, (nodes, z), data, self.parameters.iterations)
        if solution is not None:
            horizon_problem.leave(arrival, solution, self.parameters.every)

    def condition(self, state: Array) -> float:
        par = self._constants
        return float(max(np.linalg.cond(horizon.views(par, part)[6]) for part in horizon.parts(par, state)))

    @property
    def _advance(self) -> Kernel:
        return self._take

    def _take(self, state: Array, rows: Array, out: Array) -> int:
        """The kernel: rows up to the next solution at a time."""
        par, at, entered = self._constants, 0, False
        while at < len(rows):
            at = _fold(par, state, rows, out, at, entered)
            entered = at < len(rows)
            if entered:
                for part in horizon.parts(par, state):
                    if part[KEPT.due] > 0.0:
                        self._solve(part, state[HEADER.last])
        return int(out[-1, 1])

    def _solve(self, part: Array, now: float) -> None:
        """Solve the problem of one transmission, whose horizon is full, and move the horizon on by `every` nodes."""
        par, own, model = self._constants, self.parameters, self.model
        kept, _, data, nodes, arrival, z, root, covariance = horizon.views(par, part)
        kept[KEPT.due] = 0.0
        with np.errstate(all="ignore"):
            noisy = horizon_problem.weighed(model, nodes, z, data)
            solution = horizon_problem.solve(model, arrival, (nodes, z), noisy, own.iterations)
            if solution is None:
                horizon.detach(par, part)
                return
            after, innovations = horizon_problem.leave(arrival, solution, own.every)
            inverse = np.linalg.inv(solution.root)
            elapsed = float(data[: own.every, DATA.span].sum())
            after = horizon_problem.walk(after, self._directions(solution.z), min(own.drift**2 * elapsed, WIDEST))
            keep = exp(-elapsed / NOISE_MEMORY)
            weight = KNOWN + keep * (kept[KEPT.weight] - KNOWN) + own.every
            power = KNOWN + keep * (kept[KEPT.power] - KNOWN) + innovations
            found = max(power / weight, 0.0) * inverse @ inverse.T
        if not (np.isfinite(after).all() and np.isfinite(found).all()):
            horizon.detach(par, part)
            return
        kept[KEPT.weight], kept[KEPT.power] = weight, power
        kept[KEPT.solved] += 1.0
        kept[KEPT.time] = now
        z[:], root[:], covariance[:], arrival[:] = solution.z, solution.root, found, after
        for angle in data[:, DATA.q_middle] - data[:, DATA.theta]:
            transmissions.visit(kept, angle if own.even_terms > 1 else abs(angle))
        kept[VISITED.high] = max(kept[VISITED.high], 0.0)
        data[: -own.every] = data[own.every :].copy()
        nodes[: len(nodes) - own.every] = solution.nodes[own.every :]
        kept[KEPT.intervals] -= own.every

    def _directions(self, z: Array) -> Array:
        """Directions (n, 4) of z in which the unknowns walk, per relative change: each of the motor, the spring law."""
        relative = self.model.mean / self.model.width + z
        directions = np.zeros((len(z), U.size + 1))
        directions[range(U.size), range(U.size)] = relative[: U.size]
        directions[U.size :, U.size] = relative[U.size :]
        return directions


@njit(cache=True, error_model="numpy")
def _truncation(par: Array, kept: Array, z: Array, covariance: Array) -> float:
    """Variance of stiffness [(N m/rad)^2] due to the terms left out: the last term of either parity, less its noise."""
    order, even, n = int(par[P.order]), int(par[P.even_terms]), z.size
    far = max(abs(kept[VISITED.low]), abs(kept[VISITED.high])) / par[P.deflection_scale]
    total = 0.0
    for parity in range(2 if even > 1 else 1):
        term = order - 1 + parity * even
        j = U.size + term
        width = par[P.size + n + j]
        share, variance = par[P.size + j] + width * z[j], width * width * covariance[j, j]
        total += tail(power(term, order) - 1, far, share, variance)
    return par[P.truncation] ** 2 * total


@njit(cache=True, error_model="numpy")
def _report(par: Array, now: float, phi: float, part: Array, i: int, value: Array, sd: Array, joint: Array,
            slope: Array) -> None:  # fmt: skip
    """Write the outputs of transmission i at the deflection phi [rad] and add it to the joint."""
    kept, _, _, _, _, z, _, covariance = horizon.views(par, part)
    m, n, warming = int(par[P.transmissions]), z.size, kept[KEPT.solved] == 0.0
    stiffness, bend = horizon.stiffness(par, z, phi, slope)
    factor = 0.0
    if not warming:
        factor = min(par[P.drift] ** 2 * max(now - kept[KEPT.time], 0.0), WIDEST)
    uncertain = factor * stiffness**2 + 2.0 * (bend * par[P.position_noise]) ** 2
    uncertain += _truncation(par, kept, z, covariance)
    for j in range(n):
        for o in range(n):
            uncertain += slope[j] * covariance[j, o] * slope[o]
    learning = warming or kept[KEPT.moving] > 0.0
    transmissions.update(value, sd, 1 + i, stiffness, sqrt(max(uncertain, 0.0)), learning)
    for at, j in ((1 + m + i, U.inertia), (1 + 2 * m + i, U.damping)):
        found, width = par[P.size + j] + par[P.size + n + j] * z[j], par[P.size + n + j]
        transmissions.update(value, sd, at, found, width * sqrt(max(covariance[j, j], 0.0)), learning)
    transmissions.add(joint, stiffness, sd[1 + i], bend, par[P.position_noise] ** 2, 0.0)
    reached = phi if par[P.even_terms] > 1.0 else abs(phi)
    joint[JOINT.motion] = min(joint[JOINT.motion], kept[KEPT.moved])
    inside = transmissions.inside(kept, reached, par[P.range_margin])
    transmissions.grade(joint, warming, kept[KEPT.moving] > 0.0, inside)


@njit(cache=True, error_model="numpy")
def _fold(par: Array, state: Array, rows: Array, out: Array, at: int, entered: bool) -> int:
    """Take rows from number `at`, up to the first at which a solution is due, not yet answered; returns its number.

    entered  the row `at` has been taken and only has to be answered
    """
    m = int(par[P.transmissions])
    value, sd = window.outputs(state, 1 + 3 * m)
    times_at = HEADER.size + 2 * value.size
    times = state[times_at : times_at + int(par[P.length])]
    link, parts = state[horizon.parts_at(par) - LINK.size : horizon.parts_at(par)], horizon.parts(par, state)
    joint, slope = np.empty(JOINT.size), np.empty(horizon.unknowns(par))
    for k in range(at, rows.shape[0]):
        if not entered:
            before = state[HEADER.last]
            kind = transmissions.enter(state, times, rows[k], 2, FURTHEST * par[P.deflection_scale], par[P.max_gap])
            if kind == window.SKIPPED:
                window.answer(state, BAD_SAMPLE, out[k])
                continue
            if kind == window.RESTARTED:
                for i in range(m):
                    parts[i, KEPT.moved] = parts[i, KEPT.moving] = 0.0
                    horizon.detach(par, parts[i])
                horizon.begin(link, parts, rows[k])
            else:
                horizon.add(link, parts, rows[k], rows[k, 0] - before)
                if link[LINK.count] > par[P.stride]:
                    due = horizon.end(par, link, parts, rows[k, 0] - link[LINK.start], slope)
                    horizon.begin(link, parts, rows[k])
                    if due:
                        return k
        entered = False
        transmissions.begin(joint)
        for i in range(m):
            _report(par, rows[k, 0], rows[k, 1] - rows[k, 2 + 2 * i], parts[i], i, value, sd, joint, slope)
        transmissions.finish(joint, state, value, sd, out[k])
    return rows.shape[0]
