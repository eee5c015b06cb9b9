"""Fit of a candidate's effects together with the device parameters, by Gauss-Newton with finite differences.

Steps stay inside the bounds. A line search on the simulation accepts only points with a lower loss.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from via_core.errors import ParameterError
from via_core.signals import Array, Mask
from via_sim.effects import Effect

from via_gap.candidates.bounds import bounds_of
from via_gap.candidates.containment import contained
from via_gap.candidates.covariance import covariance_of, delay_sd, in_units
from via_gap.candidates.levers import bending, bent, straightened
from via_gap.candidates.location import Location
from via_gap.candidates.scales import Scales
from via_gap.candidates.starts import size_of
from via_gap.residual.nuisance import BOUND, descend
from via_gap.residual.residual_model import ResidualModel

ROUNDS = 14
SPARSE = 6  # of so many neighbouring segments two are used for the first fit of the device parameters
LEAST_STEP = 0.003  # of the typical size of a parameter: step of a finite difference
SHARES = (1.0, 0.25)  # of a step, tried at once; damping does the rest
DONE = 2e-3  # share of the loss: after a step that gains less, the Jacobian is renewed or the fit ends
AGED = 0.3  # share of the loss at which the nuisance Jacobian was computed: below it, the Jacobian is renewed
STALE = 0.9  # the same, below which a fit does not end on this Jacobian
LONG = 10.0  # [s] a parameter in seconds with a larger range is a time of the run, not a delay
TIME_STEPS = (0.1, 0.03, 0.01, 0.003, 0.001, 0.0003, 0.0001)  # of the log's duration
LAST_STEPS = 3  # of these, once times are nearly right
MOST_DAMPED = 1.0  # of the curvature of each parameter: a step that is damped more and does not help is the last
OWN = 6  # rounds for the device parameters alone
GIVE_UP = 4.0  # times the best loss so far


@dataclass(frozen=True)
class Budget:
    """Effort of one fit.

    rounds  largest number of Gauss-Newton steps
    rival   loss of the best fit so far: a fit that stays far above it is stopped early; 0: no limit
    """

    rounds: int = ROUNDS
    rival: float = 0.0


FINISHING = Budget(rounds=6)  # from the best fit on a subset of the segments to the best fit on all


@dataclass(frozen=True, eq=False)
class Fit:
    """Effects and device parameters that minimise the loss on the training segments.

    effects     with their fitted values
    offsets     (J,) of the nuisance parameters from the device file, in standard deviations of their tolerance
    loss        loss of the residual plus squared offsets
    residual    (R,) whitened
    covariance  (p, p) of the effects' parameters in their order, in their units
    tolerances  (t, p) changes of them by one standard deviation of each device parameter that they contain, which are
                part of the covariance
    """

    effects: tuple[Effect, ...]
    offsets: Array
    loss: float
    residual: Array
    covariance: Array
    tolerances: Array = field(default_factory=lambda: np.empty((0, 0)))

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

    def reordered(self, order: Sequence[int]) -> Fit:
        """The same fit with its effects in another order."""
        ends = np.cumsum([0, *(len(each.parameters) for each in self.effects)])
        own = np.concatenate([np.arange(ends[number], ends[number + 1]) for number in order])
        tolerances = self.tolerances[:, own] if self.tolerances.size else self.tolerances
        effects, covariance = tuple(self.effects[number] for number in order), self.covariance[np.ix_(own, own)]
        return replace(self, effects=effects, covariance=covariance, tolerances=tolerances)


Members = list[tuple[Location, list[float]]]  # locations of effects with their values or initial values


def members_of(fit: Fit) -> Members:
    """The locations of a fit's effects with their values."""
    return [(p, list(e.parameters.values())) for p, e in zip(fit.locations, fit.effects, strict=True)]


def fit_on(problem: ResidualModel, fit: Fit) -> Fit:
    """The same effects and device parameters, with loss and residual on the segments of `problem`."""
    residual = problem.residual([problem.row(fit.effects, fit.offsets)])[0]
    return replace(fit, loss=float(problem.loss(residual) + fit.offsets @ fit.offsets), residual=residual)


def event_times(fit: Fit) -> tuple[float, ...]:
    """Times [s since the run began] at which effects begin or end."""
    return tuple(
        effect.parameters[p.name]
        for effect in fit.effects
        for p in Location.of(effect).parameters
        if p.unit == "s" and p.high > LONG and effect.parameters[p.name] != p.neutral
    )


def effect_or_none(location: Location, values: Sequence[float]) -> Effect | None:
    """The effect with its values moved into their ranges; None if the values contradict one another."""
    parameters = location.parameters
    inside = {p.name: float(np.clip(v, p.low, p.high)) for p, v in zip(parameters, values, strict=True)}
    if {"breakaway", "kinetic"} <= inside.keys():
        inside["breakaway"] = max(inside["breakaway"], inside["kinetic"])
    try:
        return location.effect(inside)
    except ParameterError:
        return None


def fit_device_parameters(problem: ResidualModel) -> Fit:
    """The device parameters alone, fitted inside their tolerances with the loss of `problem`."""
    few = problem.by_squares.part([np.flatnonzero(np.arange(len(view.chosen)) % SPARSE < 2) for view in problem.views])
    offsets = few[0].fit_nuisances((), np.zeros(len(problem.nuisances)))[0]
    offsets, residual = problem.fit_nuisances((), offsets, OWN)
    return Fit((), offsets, float(problem.loss(residual) + offsets @ offsets), residual, np.empty((0, 0)))


@dataclass(frozen=True, eq=False)
class Point:
    """Coordinates (J + p,) of a fit, see `Axes`, with their loss and residual (R,)."""

    at: Array
    loss: float
    residual: Array


@dataclass(frozen=True, eq=False)
class Axes:
    """Coordinates of a fit: offsets of the nuisances (J,), then every effect parameter over its typical size (p,).

    size   (p,) typical sizes of the parameters, in their units
    low    (p,) ends of their ranges over `size`; high likewise
    levers  index of each mass whose distance from the axis is the next parameter, see levers.py
    times  (p,) whether a parameter is a time of the run, for which the gradient is useless
    fixed  (p,) whether a parameter keeps its initial value: an order of whole periods per turn
    takes  (p,) whether a parameter can take up an error of either sign of a nuisance
    held   (J,) whether the effects contain a nuisance, which then stays at 0
    """

    problem: ResidualModel
    locations: tuple[Location, ...]
    size: Array
    low: Array
    high: Array
    levers: tuple[int, ...]
    times: Mask
    fixed: Mask
    takes: Mask
    held: Mask

    @staticmethod
    def of(
        problem: ResidualModel,
        members: Sequence[tuple[Location, Sequence[float]]],
        scales: Scales,
        fitted: bool = False,
    ) -> Axes:
        """If `fitted`, a parameter takes up errors wherever it is further from both ends of its range than these."""
        locations, starts = [location for location, _ in members], [value for _, values in members for value in values]
        parameters = [(location, p) for location in locations for p in location.parameters]
        size = np.array([size_of(p, location, scales) for location, p in parameters])
        first = np.cumsum([0, *(len(location.parameters) for location in locations)])
        levers = tuple(int(i) for i, location in zip(first, locations) if location.kind.lever)
        low, high = (np.concatenate(ends) for ends in zip(*(bounds_of(each, scales) for each in locations)))
        size, low, high = (straightened(each, levers) for each in (size, low, high))
        times = np.array([p.unit == "s" and p.high > LONG for _, p in parameters], dtype=np.bool_)
        orders = [p.name.partition("_")[0] == "order" for _, p in parameters]
        fixed = np.array([is_order and float(v).is_integer() for is_order, v in zip(orders, starts)], dtype=np.bool_)
        none = np.zeros(len(problem.nuisances), dtype=np.bool_)
        takes = np.array([p.low < p.neutral < p.high for _, p in parameters], dtype=np.bool_)
        free = Axes(problem, tuple(locations), size, low / size, high / size, levers, times, fixed, takes, none)
        begin = free.coordinates(np.zeros(len(none)), starts)
        if fitted:
            reach = BOUND * np.abs(replace(free, takes=np.ones_like(takes)).contained(begin)).max(axis=0, initial=0.0)
            takes |= (begin[len(none) :] - reach > free.low) & (begin[len(none) :] + reach < free.high)
        free = replace(free, takes=takes)
        return replace(free, held=np.any(free.contained(begin) != 0.0, axis=1))

    @property
    def count(self) -> int:
        """Number of nuisances, J."""
        return len(self.problem.nuisances)

    def coordinates(self, offsets: Array, values: Sequence[float]) -> Array:
        """(J + p,) from offsets and parameter values in their units, which are moved into their ranges.

        The effects take up the offsets of the nuisances that they contain, so that the equations stay the same.
        """
        at = np.append(offsets, straightened(np.asarray(values, dtype=np.float64), self.levers) / self.size)
        if np.any(at[: self.count][self.held]):
            at[self.count :] += np.where(self.held, offsets, 0.0) @ self.contained(at)
            at[: self.count][self.held] = 0.0
        return np.clip(at, *self.box)

    def contained(self, at: Array) -> Array:
        """(J, p) changes of the effects' parameters that equal one standard deviation of each contained nuisance."""
        return contained(self._row, np.append(np.zeros(self.count), at[self.count :]), self.takes)

    @property
    def box(self) -> tuple[Array, Array]:
        """(J + p,) lowest and highest coordinates."""
        bound = np.full(self.count, BOUND)
        return np.append(-bound, self.low), np.append(bound, self.high)

    def _row(self, at: Array) -> Array | None:
        return self.problem.row_or_none(self._effects(at), at[: self.count])

    def _effects(self, at: Array) -> list[Effect | None]:
        values = iter(bent(at[self.count :] * self.size, self.levers))
        return [effect_or_none(each, [next(values) for _ in each.parameters]) for each in self.locations]

    def effects(self, at: Array) -> tuple[Effect, ...]:
        """The effects at these coordinates without invalid ones."""
        return tuple(effect for effect in self._effects(at) if effect is not None)

    def losses(self, tries: Sequence[Array]) -> tuple[Array, Array]:
        """(K,) losses and (K, R) residuals at K coordinates; infinite where an effect is invalid."""
        rows = [self._row(at) for at in tries]
        residuals = np.full((len(tries), self.problem.size), np.inf)
        there = [row for row in rows if row is not None]
        if there:
            residuals[[row is not None for row in rows]] = self.problem.residual(there)
        found = self.problem.loss(residuals) + np.sum(np.array(tries)[:, : self.count] ** 2, axis=1)
        return np.where(np.isfinite(residuals[:, 0]), found, np.inf), residuals

    def best(self, tries: Sequence[Array]) -> Point:
        """The coordinates with the least loss; the first of equal ones."""
        losses, residuals = self.losses(tries)
        k = int(np.argmin(losses))
        return Point(tries[k], float(losses[k]), residuals[k])

    def step(self, here: Point, slopes: Array, damping: float = 0.0) -> tuple[Array, Array]:
        """Weighted normal matrix (J + p, J + p), and the coordinates with the least linear prediction of the loss.

        slopes  (R, J + p) derivatives of the residual; damping is relative to the curvature of each coordinate
        """
        pull = self.problem.weights(here.residual)
        slopes = slopes * pull[:, None]
        normal = slopes.T @ slopes
        normal[: self.count, : self.count] += np.eye(self.count)
        gradient = slopes.T @ (slopes @ here.at - pull * here.residual)
        damped = damping * np.diag(normal)
        return normal, descend(normal + np.diag(damped), gradient + damped * here.at, here.at, *self.box)

    def covariance(self, here: Point, normal: Array) -> Array:
        """(p, p) of the parameters over their typical sizes, for the mean weighted square of the residual, if above 1.

        1 is the mean square of noise.
        """
        square = float(np.mean((self.problem.weights(here.residual) * here.residual) ** 2))
        return covariance_of(normal, self.high - self.low, self.count) * max(square, 1.0)

    def sd(self, fit: Fit) -> Array:
        """(p,) standard deviations of a fit over the typical sizes."""
        straightens = np.linalg.inv(bending(straightened(np.array(fit.values), self.levers), self.levers))
        return np.asarray(np.sqrt(np.diag(straightens @ fit.covariance @ straightens.T)) / self.size)

    def fit(self, here: Point, covariance: Array, sd: Array) -> Fit:
        """The fit at these coordinates; covariance (p, p) and standard deviations sd (p,) over the typical sizes.

        Standard deviations of delays also include what is not known of the commands between samples, and those of all
        effects the tolerances of the nuisances that they contain.
        """
        bends = bending(here.at[self.count :] * self.size, self.levers)
        covariance = bends @ in_units(covariance, sd, self.size) @ bends.T
        covariance += np.diag(delay_sd(self.problem, self.locations) ** 2)
        tolerances = self.contained(here.at)[self.held] * self.size @ bends.T
        covariance += tolerances.T @ tolerances
        offsets = here.at[: self.count].copy()
        return Fit(self.effects(here.at), offsets, here.loss, here.residual, covariance, tolerances)

    def nuisance_jacobian(self, here: Point) -> Array:
        """(R, J); 0 for those that the effects contain."""
        return self.free(self.problem.nuisance_jacobian(self.effects(here.at), here.at[: self.count], here.residual))

    def free(self, jacobian: Array) -> Array:
        """The derivatives (R, J) by the nuisances without those that the effects contain."""
        return np.where(self.held, 0.0, jacobian)

    def slopes(self, here: Point) -> Array:
        """(R, p) derivatives of the residual by the effects' parameters; not finite where a step is invalid.

        0 for times and fixed parameters.
        """
        values, moves = here.at[self.count :], ~(self.times | self.fixed)
        steps = np.maximum(LEAST_STEP, 0.03 * np.abs(values))
        steps = np.where(values + steps > self.high, -steps, steps)[moves]
        slopes = np.zeros((len(here.residual), len(values)))
        moved = self.losses([*(here.at + np.eye(len(here.at))[self.count :][moves] * steps[:, None])])[1]
        slopes[:, moves] = (moved - here.residual).T / steps
        return slopes

    def search_times(self, here: Point, steps: Sequence[float]) -> Point:
        """Beginnings and ends of effects by steps of decreasing size, because no gradient leads to them.

        A moved time changes only the segments between its old and its new value: only these are simulated.
        """
        at, along = here.at, np.eye(len(here.at))[self.count :][self.times]
        for step in steps:
            for _ in range(3):
                tries = [at, *(np.clip(at + move, *self.box) for unit in along for move in (-step * unit, step * unit))]
                moved = np.array(tries)[:, self.count :][:, self.times] * self.size[self.times]
                near, _ = self.problem.part(self.problem.touched(np.stack([moved.min(axis=0), moved.max(axis=0)])))
                if not near.views:
                    break
                losses, _ = replace(self, problem=near).losses(tries)
                if not losses.min() < losses[0]:
                    break
                at = tries[int(np.argmin(losses))]
        best = self.best([at])
        return best if best.loss < here.loss else here


def member_slopes(problem: ResidualModel, fit: Fit, scales: Scales) -> Array:
    """(R, k) derivatives of the residual by those effect parameters of a fit on which it depends smoothly."""
    axes = Axes.of(problem, members_of(fit), scales)
    slopes = axes.slopes(Point(axes.coordinates(fit.offsets, fit.values), fit.loss, fit.residual))
    return slopes[:, np.isfinite(slopes[0]) & np.any(slopes != 0.0, axis=0)]


def refine(
    problem: ResidualModel,
    base: Fit,
    members: Sequence[tuple[Location, Sequence[float]]],
    scales: Scales,
    budget: Budget = Budget(),
    jacobian: Array | None = None,
) -> Fit | None:
    """Gauss-Newton fit of the effects `members` (with initial values) and the nuisance parameters together.

    base      fit whose offsets are the initial ones
    jacobian  (R, J) of the nuisances at `base`; None: computed here

    None if the initial values are not valid together.
    """
    axes = Axes.of(problem, members, scales)
    many = len(axes.size)
    here = axes.best([axes.coordinates(base.offsets, [value for _, values in members for value in values])])
    if not np.isfinite(here.loss):
        return None
    fresh, damping = jacobian is None, 0.0
    side = axes.nuisance_jacobian(here) if jacobian is None else axes.free(jacobian)
    normal, since = np.eye(axes.count + many), here.loss if fresh else base.loss
    slopes, sloped = np.empty((problem.size, many)), np.inf
    apart = np.zeros(many, dtype=bool)
    for round_ in range(budget.rounds):
        if axes.times.any():  # small steps in later rounds: times improve with the sizes of their effects
            here = axes.search_times(here, TIME_STEPS if round_ < 2 else TIME_STEPS[-LAST_STEPS:])
        if here.loss < AGED * since:
            side, fresh, since = axes.nuisance_jacobian(here), True, here.loss
        if here.loss < sloped:
            slopes = axes.slopes(here)
            apart = ~np.isfinite(slopes[0])  # no valid neighbour: a side, or a parameter at its bound
            slopes[~np.isfinite(slopes)] = 0.0
            sloped = here.loss
        normal, wanted = axes.step(here, np.hstack([side, slopes]), damping)
        tries = [here.at + share * (wanted - here.at) for share in SHARES]
        best = axes.best(tries)
        gain = here.loss - best.loss
        if gain > 0.0:
            here = best
            damping *= 0.1
        if best.at is not tries[0] or gain <= 0.0:
            damping = max(10.0 * damping, 0.01)
        if round_ >= 1 and here.loss > GIVE_UP * budget.rival > 0.0 and gain < 0.3 * here.loss:
            break
        if gain <= 0.0 and fresh and damping <= MOST_DAMPED:  # try a shorter step with the same derivatives
            continue
        if gain < DONE * here.loss:
            if (fresh and here.loss >= STALE * since) or len(axes.effects(here.at)) < len(members):
                break
            side, fresh, since = axes.nuisance_jacobian(here), True, here.loss
    covariance = axes.covariance(here, normal)
    sd = np.minimum(np.sqrt(np.diag(covariance)), axes.high - axes.low)
    return axes.fit(here, covariance, np.where(axes.times, TIME_STEPS[-1], np.where(apart | axes.fixed, 0.0, sd)))
