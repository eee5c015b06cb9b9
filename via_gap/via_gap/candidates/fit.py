"""Fit of a candidate's effects together with the device's own numbers, by Gauss-Newton with finite differences.

Steps stay inside the bounds of the effects; a line search on the true simulation accepts only what lowers the loss.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from via_core.errors import ParameterError
from via_core.signals import Array
from via_sim.effects import Effect

from via_gap.candidates.covariance import clustered_covariance, covariance_of, in_units
from via_gap.candidates.location import Location
from via_gap.candidates.scales import Scales
from via_gap.candidates.starts import size_of
from via_gap.residual.nuisance import BOUND, descend
from via_gap.residual.residual_model import STEP, ResidualModel

ROUNDS = 14
SPARSE = 6  # two of so many neighbouring segments are enough to come near the device's own numbers
LEAST_STEP = 0.003  # of the typical size of a parameter: a finite difference
TURNS = 2  # at most, of the steps to the end of a fit
FINE = 0.1  # of a step, where differences are central: what they leave out is then far below a tolerance
SHARES = (1.0, 0.25)  # of a step, tried at once; damping does the rest
DONE = 2e-3  # share of the loss: a step that gains less is the last with this Jacobian
AGED = 0.3  # share of the loss at which a Jacobian of the nuisances was made, below which it says nothing any more
STALE = 0.9  # the same, below which a fit does not end on it
LONG = 10.0  # [s] a parameter in seconds that may be longer is a time of the run, not a delay
TIME_STEPS = (0.1, 0.03, 0.01, 0.003, 0.001, 0.0003, 0.0001)  # of the log's duration
LAST_STEPS = 3  # of these, once an effect is nearly where it belongs
MOST_DAMPED = 1.0  # of the curvature of each number: a step that even then does not help is the last
WIDEST = 10.0  # times the typical size in a log: beyond it an effect is no longer one of this device
SCALED = ("N m", "N m s/rad", "N m s^2/rad^2", "kg m^2")  # units whose bounds the device sets
FINISHING = 6  # rounds from the best on a subset to the best on all
OWN = 6  # rounds of the device's own numbers
GIVE_UP = 4.0  # times the best loss so far


@dataclass(frozen=True, eq=False)
class Fit:
    """Effects and device numbers that explain the training segments best.

    effects     with their values
    deviations  (J,) of the nuisances [sd]
    loss        squared residual plus squared deviations
    residual    (R,) whitened
    covariance  (p, p) of the effects' parameters in their order, in their units
    """

    effects: tuple[Effect, ...]
    deviations: Array
    loss: float
    residual: Array
    covariance: Array

    @property
    def sd(self) -> Array:
        """(p,) standard deviations of the effects' parameters in their order."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def values(self) -> list[float]:
        """(p,) parameters of the effects in their order, in their units."""
        return [value for effect in self.effects for value in effect.parameters.values()]

    @property
    def locations(self) -> tuple[Location, ...]:
        return tuple(map(Location.of, self.effects))


Members = list[tuple[Location, list[float]]]  # and the values they have or start from


def members_of(fit: Fit) -> Members:
    """The locations of a fit's effects with their values."""
    return [(p, list(e.parameters.values())) for p, e in zip(fit.locations, fit.effects, strict=True)]


def on(problem: ResidualModel, fit: Fit) -> Fit:
    """The same effects and numbers with their residual on the segments of `problem`."""
    residual = problem.residual([problem.row(fit.effects, fit.deviations)])[0]
    loss = float(problem.loss(residual) + fit.deviations @ fit.deviations)
    return Fit(fit.effects, fit.deviations, loss, residual, fit.covariance)


def events(fit: Fit) -> tuple[float, ...]:
    """When effects begin and end [s since the run began], those that do at a time of the run."""
    return tuple(
        effect.parameters[p.name]
        for effect in fit.effects
        for p in Location.of(effect).parameters
        if p.unit == "s" and p.high > LONG and effect.parameters[p.name] != p.neutral
    )


def make(location: Location, values: Sequence[float]) -> Effect | None:
    """The effect, or None where these values together make none."""
    parameters = location.parameters
    inside = {p.name: float(np.clip(v, p.low, p.high)) for p, v in zip(parameters, values, strict=True)}
    if {"breakaway", "kinetic"} <= inside.keys():
        inside["breakaway"] = max(inside["breakaway"], inside["kinetic"])
    try:
        return location.effect(inside)
    except ParameterError:
        return None


def fit_device_numbers(problem: ResidualModel) -> Fit:
    """The device's own numbers alone, inside their tolerances, by the loss that held-out data are judged by."""
    few = problem.by_squares.part([np.flatnonzero(np.arange(len(view.chosen)) % SPARSE < 2) for view in problem.views])
    deviations = few[0].fit_nuisances((), np.zeros(len(problem.nuisances)))[0]
    deviations, residual, _ = problem.fit_nuisances((), deviations, OWN)
    return Fit((), deviations, float(problem.loss(residual) + deviations @ deviations), residual, np.empty((0, 0)))


def bounds_of(location: Location, scales: Scales) -> tuple[Array, Array]:
    """Lowest and highest value (p,) of every parameter: its kind's, for torques and inertias as the device has them."""
    ends = []
    for p in location.parameters:
        reach = WIDEST * size_of(p, location, scales) if p.unit in SCALED and p.neutral == 0.0 else np.inf
        ends.append((max(p.low, -reach), min(p.high, reach)))
    low, high = np.array(ends).T
    return low, high


@dataclass(frozen=True, eq=False)
class _Axes:
    """Where a fit moves: deviations of the nuisances (J,), then every parameter of the effects over its typical size.

    size   (p,) of the parameters, in their units
    low    (p,) ends of their ranges over `size`; high likewise
    times  (p,) those that are times of the run, which no slope leads to
    """

    problem: ResidualModel
    locations: tuple[Location, ...]
    size: Array
    low: Array
    high: Array
    times: NDArray[np.bool_]

    @staticmethod
    def of(problem: ResidualModel, locations: Sequence[Location], scales: Scales) -> _Axes:
        parameters = [(location, p) for location in locations for p in location.parameters]
        size = np.array([size_of(p, location, scales) for location, p in parameters])
        low, high = (np.concatenate(ends) / size for ends in zip(*(bounds_of(each, scales) for each in locations)))
        times = np.array([p.unit == "s" and p.high > LONG for _, p in parameters], dtype=np.bool_)
        return _Axes(problem, tuple(locations), size, low, high, times)

    @property
    def count(self) -> int:
        """Nuisances, J."""
        return len(self.problem.nuisances)

    def point(self, deviations: Array, values: Sequence[float]) -> Array:
        """(J + p,) of deviations and parameters in their units, which are moved into their ranges."""
        return np.append(deviations, np.clip(np.asarray(values, dtype=np.float64) / self.size, self.low, self.high))

    @property
    def box(self) -> tuple[Array, Array]:
        """(J + p,) lowest and highest point."""
        bound = np.full(self.count, BOUND)
        return np.append(-bound, self.low), np.append(bound, self.high)

    def effects(self, point: Array) -> list[Effect | None]:
        values, first, made = point[self.count :] * self.size, 0, []
        for location in self.locations:
            number = len(location.parameters)
            made.append(make(location, list(values[first : first + number])))
            first += number
        return made

    def losses(self, points: Sequence[Array]) -> tuple[Array, Array]:
        """(K,) losses and (K, R) residuals of points; infinite where there are no such effects."""
        count = self.count
        rows = [self.problem.row_or_none(self.effects(point), point[:count]) for point in points]
        residuals = np.full((len(points), self.problem.size), np.inf)
        there = [row for row in rows if row is not None]
        if there:
            residuals[[row is not None for row in rows]] = self.problem.residual(there)
        found = self.problem.loss(residuals) + np.sum(np.array(points)[:, :count] ** 2, axis=1)
        return np.where(np.isfinite(residuals[:, 0]), found, np.inf), residuals

    def slopes(self, at: Array, residual: Array) -> Array:
        """(R, p) of the residual (R,) at a point along every parameter; not finite where a step makes no effect."""
        here = at[self.count :]
        steps = np.maximum(LEAST_STEP, 0.03 * np.abs(here))
        steps = np.where(here + steps > self.high, -steps, steps)
        moved = self.losses([*(at + np.eye(len(at))[self.count :] * steps[:, None])])[1]
        return (moved - residual).T / steps


def member_slopes(problem: ResidualModel, fit: Fit, scales: Scales) -> Array:
    """(R, k) of the residual along those parameters of a fit's effects on which it depends smoothly."""
    axes = _Axes.of(problem, fit.locations, scales)
    slopes = axes.slopes(axes.point(fit.deviations, fit.values), fit.residual)
    return slopes[:, np.isfinite(slopes[0]) & np.any(slopes != 0.0, axis=0) & ~axes.times]


def _search_times(
    losses: Callable[[Sequence[Array]], tuple[Array, Array]],
    at: Array, value: float, residual: Array, which: Sequence[int], low: Array, high: Array,
    steps: Sequence[float] = TIME_STEPS,
) -> tuple[Array, float, Array]:  # fmt: skip
    """When something begins and ends: no slope says how far off it is, so it is sought by ever smaller steps."""
    for step in steps:
        for _ in range(3):
            tries = []
            for k in which:
                for sign in (-1.0, 1.0):
                    moved = at.copy()
                    moved[k] = np.clip(moved[k] + sign * step, low[k], high[k])
                    tries.append(moved)
            loss, residuals = losses(tries)
            best = int(np.argmin(loss))
            if not loss[best] < value:
                break
            at, value, residual = tries[best], float(loss[best]), residuals[best]
    return at, value, residual


def refine(
    problem: ResidualModel,
    base: Fit,
    jacobian: Array | None,
    members: Sequence[tuple[Location, Sequence[float]]],
    scales: Scales,
    rival: float = 0.0,
    rounds: int = ROUNDS,
) -> Fit | None:
    """Gauss-Newton on all effects `members` (with the values they start from) and the nuisance parameters together.

    jacobian  (R, J) of the nuisances near there; None: made here
    rival     loss of the best fit so far: one that is far above it and no longer falls is given up. None: never valid.
    """
    axes = _Axes.of(problem, [location for location, _ in members], scales)
    size, low, high, count, many = axes.size, axes.low, axes.high, axes.count, len(axes.size)
    box, effects_at, losses, times = axes.box, axes.effects, axes.losses, axes.times
    at = axes.point(base.deviations, [value for _, values in members for value in values])
    loss, residuals = losses([at])
    value, residual = float(loss[0]), residuals[0]
    if not np.isfinite(value):
        return None
    side, fresh, damping = jacobian, jacobian is None, 0.0
    if side is None:
        side = problem.nuisance_jacobian([e for e in effects_at(at) if e is not None], at[:count], residual)
    normal, since = np.eye(count + many), value if fresh else base.loss
    slopes, sloped = np.empty((problem.size, many)), np.inf
    apart = np.zeros(many, dtype=bool)
    for round_ in range(rounds):
        if times.any():  # at last by milliseconds: with each better size of what begins then it shows better when
            which = [count + int(k) for k in np.flatnonzero(times)]
            finer = TIME_STEPS if round_ < 2 else TIME_STEPS[-LAST_STEPS:]
            at, value, residual = _search_times(losses, at, value, residual, which, *box, finer)
        if value < AGED * since:
            side = problem.nuisance_jacobian([e for e in effects_at(at) if e is not None], at[:count], residual)
            fresh, since = True, value
        if value < sloped:
            slopes = axes.slopes(at, residual)
            apart = ~np.isfinite(slopes[0])  # no neighbour makes an effect: a side, or a number at its bound
            slopes[~np.isfinite(slopes)] = 0.0
            slopes[:, times] = 0.0
            sloped = value
        pull = problem.weights(residual)
        whole = np.hstack([side, slopes]) * pull[:, None]
        normal = whole.T @ whole
        normal[:count, :count] += np.eye(count)
        gradient = whole.T @ (whole @ at - pull * residual)
        held = damping * np.diag(normal)
        wanted = descend(normal + np.diag(held), gradient + held * at, at, *box)
        tries = [at + share * (wanted - at) for share in SHARES]
        loss, residuals = losses(tries)
        best = int(np.argmin(loss))
        gain = value - float(loss[best])
        if gain > 0.0:
            at, value, residual = tries[best], float(loss[best]), residuals[best]
            damping *= 0.1
        if best > 0 or gain <= 0.0:
            damping = max(10.0 * damping, 0.01)
        if round_ >= 1 and value > GIVE_UP * rival > 0.0 and gain < 0.3 * value:
            break
        if gain <= 0.0 and fresh and damping <= MOST_DAMPED:  # shorter steps along the same slopes
            continue
        if gain < DONE * value:
            effects = [effect for effect in effects_at(at) if effect is not None]
            if (fresh and value >= STALE * since) or len(effects) < len(members):
                break
            side = problem.nuisance_jacobian(effects, at[:count], residual)
            fresh, since = True, value
    effects = [effect for effect in effects_at(at) if effect is not None]
    covariance = covariance_of(normal, high - low, count) * _excess(problem, residual)
    sd = np.minimum(np.sqrt(np.diag(covariance)), high - low)
    sd = np.where(times, TIME_STEPS[-1], np.where(apart, 0.0, sd))
    return Fit(tuple(effects), at[:count].copy(), value, residual, in_units(covariance, sd, size))


def _excess(problem: ResidualModel, residual: Array) -> float:
    """Mean square of a residual (R,) as it is weighted, at least that of noise."""
    return max(float(np.mean((problem.weights(residual) * residual) ** 2)), 1.0)


def converged(problem: ResidualModel, fit: Fit, scales: Scales) -> Fit:
    """A fit led to the end along what hardly changes its loss, with standard deviations that know of it.

    Without a torque on record all torques and inertias of a joint may grow together and nothing shows: only the
    tolerances of the device's numbers say how far. `refine` ends anywhere on such a line, and its one-sided differences
    bend it, so that it seems well known. Central differences keep it straight; one step with them is nearly exact,
    but from where a number of the device stands at the end of its tolerance.
    """
    axes = _Axes.of(problem, fit.locations, scales)
    count = axes.count
    at = axes.point(fit.deviations, fit.values)
    steps = FINE * np.append(
        STEP / np.array([each.tolerance for each in problem.nuisances]),
        np.maximum(LEAST_STEP, 0.03 * np.abs(at[count:])),
    )
    (value,), (residual,) = axes.losses([at])
    low, high = axes.box
    for _ in range(TURNS):  # from an end of a tolerance differences are one-sided, and such a step only comes near
        one_sided = bool(np.any(np.abs(at[:count]) >= BOUND))
        around = [np.clip(at + sign * steps, low, high) for sign in (1.0, -1.0)]
        ahead, behind = (axes.losses([*(at + np.diag(each - at))])[1] for each in around)
        slopes = ((ahead - behind) / (around[0] - around[1])[:, None]).T
        known = np.isfinite(slopes[0]) & np.append(np.full(count, True), ~axes.times)
        slopes[:, ~known] = 0.0
        pull = problem.weights(residual)
        slopes *= pull[:, None]
        normal = slopes.T @ slopes
        normal[:count, :count] += np.eye(count)
        wanted = descend(normal, slopes.T @ (slopes @ at - pull * residual), at, low, high)
        for share in (1.0, 0.5, 0.25):
            trial = at + share * (wanted - at)
            (loss,), (moved,) = axes.losses([trial])
            if loss < value:
                at, value, residual = trial, float(loss), moved
                break
        if not one_sided:
            break
    covariance = covariance_of(normal, axes.high - axes.low, count) * _excess(problem, residual)
    clustered = clustered_covariance(problem, slopes, pull * residual, normal, count)
    covariance *= np.outer(*2 * (np.sqrt(np.maximum(np.diag(clustered) / np.diag(covariance), 1.0)),))
    sd = np.where(known[count:], np.minimum(np.sqrt(np.diag(covariance)), axes.high - axes.low), fit.sd / axes.size)
    effects = tuple(effect for effect in axes.effects(at) if effect is not None)
    return Fit(effects, at[:count].copy(), float(value), residual, in_units(covariance, sd, axes.size))
