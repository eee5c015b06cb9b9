"""A fit of effects together with the device parameters: its coordinates, derivatives and Gauss-Newton steps.

Derivatives are finite differences. Methods that need residuals ask for them (`ResidualModel.answer`), so that several
fits are simulated side by side; see refinement.py.
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
from via_gap.candidates.covariance import covariance_of, in_units, unfitted_delay_sd
from via_gap.candidates.levers import bending, bent, straightened
from via_gap.candidates.location import Location
from via_gap.candidates.scales import Scales
from via_gap.candidates.starts import size_of
from via_gap.residual.nuisance import BOUND, descend, lowest_offsets
from via_gap.residual.residual_model import Asks, ResidualModel

SPARSE = 6  # of so many neighbouring segments two are used for the first fit of the device parameters
LEAST_STEP = 0.003  # of the typical size of a parameter: least step of a finite difference
RELATIVE_STEP = 0.03  # of its value; of the depth to which a wall yields
LONG = 10.0  # [s] a parameter in seconds with a larger range is a time of the run, not a delay
OWN = 6  # rounds for the device parameters alone


Members = list[tuple[Location, list[float]]]  # locations of effects with their values or initial values


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
    def at_bound(self) -> bool:
        """Whether a nuisance parameter is as far from the device file as it may be."""
        return bool(np.any(np.abs(self.offsets) > BOUND - 1e-6))

    @property
    def locations(self) -> tuple[Location, ...]:
        return tuple(map(Location.of, self.effects))

    @property
    def members(self) -> Members:
        """The locations of the effects with their values."""
        return [(Location.of(each), list(each.parameters.values())) for each in self.effects]

    def reordered(self, order: Sequence[int]) -> Fit:
        """The same fit with its effects in another order."""
        ends = np.cumsum([0, *(len(each.parameters) for each in self.effects)])
        own = np.concatenate([np.arange(ends[number], ends[number + 1]) for number in order])
        tolerances = self.tolerances[:, own] if self.tolerances.size else self.tolerances
        effects, covariance = tuple(self.effects[number] for number in order), self.covariance[np.ix_(own, own)]
        return replace(self, effects=effects, covariance=covariance, tolerances=tolerances)


def _depths(location: Location, values: Sequence[float], scales: Scales) -> Array:
    """(p,) [rad] depth to which a wall yields to the typical torque, for its place; infinite for other parameters."""
    found = np.full(len(location.parameters), np.inf)
    if location.kind.touched:
        names = [p.name for p in location.parameters]
        found[names.index("angle")] = scales.torque[0] / max(values[names.index("stiffness")], 1e-9)
    return found


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
    places  (p,) whether it is the place of a wall: what counts is how far the wall yields, not where zero is
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
    places: Mask
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
        depths = np.concatenate([_depths(each, starts[i:], scales) for i, each in zip(first, locations)])
        places, size = np.isfinite(depths), np.minimum(size, depths)
        levers = tuple(int(i) for i, location in zip(first, locations) if location.kind.lever)
        low, high = (np.concatenate(ends) for ends in zip(*(bounds_of(each, scales) for each in locations)))
        size, low, high = (straightened(each, levers) for each in (size, low, high))
        times = np.array([p.unit == "s" and p.high > LONG for _, p in parameters], dtype=np.bool_)
        orders = [p.name.partition("_")[0] == "order" for _, p in parameters]
        fixed = np.array([is_order and float(v).is_integer() for is_order, v in zip(orders, starts)], dtype=np.bool_)
        none = np.zeros(len(problem.nuisances), dtype=np.bool_)
        takes = np.array([p.low < p.neutral < p.high for _, p in parameters], dtype=np.bool_)
        free = Axes(problem, tuple(locations), size, low / size, high / size, levers, times, places, fixed, takes, none)
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
        highest = np.full(self.count, BOUND)
        return np.append(lowest_offsets(self.problem.nuisances), self.low), np.append(highest, self.high)

    def _row(self, at: Array) -> Array | None:
        return self.problem.row_or_none(self._effects(at), at[: self.count])

    def _effects(self, at: Array) -> list[Effect | None]:
        values = iter(bent(at[self.count :] * self.size, self.levers))
        return [effect_or_none(each, [next(values) for _ in each.parameters]) for each in self.locations]

    def effects(self, at: Array) -> tuple[Effect, ...]:
        """The effects at these coordinates without invalid ones."""
        return tuple(effect for effect in self._effects(at) if effect is not None)

    def losses(self, tries: Sequence[Array]) -> Asks[tuple[Array, Array]]:
        """(K,) losses and (K, R) residuals at K coordinates; infinite where an effect is invalid."""
        rows = [self._row(at) for at in tries]
        residuals = np.full((len(tries), self.problem.size), np.inf)
        there = [row for row in rows if row is not None]
        if there:
            residuals[[row is not None for row in rows]] = yield there
        found = self.problem.loss(residuals) + np.sum(np.array(tries)[:, : self.count] ** 2, axis=1)
        return np.where(np.isfinite(residuals[:, 0]), found, np.inf), residuals

    def best(self, tries: Sequence[Array]) -> Asks[Point]:
        """The coordinates with the least loss; the first of equal ones."""
        losses, residuals = yield from self.losses(tries)
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

        1 is the mean square of noise. A prior has the widths of the ranges as standard deviations: of a mass and of its
        distance, not of their products, which would leave a mass of 1e10 kg possible where only m l^2 is known.
        """
        square = float(np.sum((self.problem.weights(here.residual) * here.residual) ** 2)) / self.problem.measured
        low, high = (bent(end * self.size, self.levers) for end in (self.low, self.high))
        widths = bending(here.at[self.count :] * self.size, self.levers) * self.size / (high - low)[:, None]
        return covariance_of(normal, widths.T @ widths, self.count) * max(square, 1.0)

    def sd(self, fit: Fit) -> Array:
        """(p,) standard deviations of a fit over the typical sizes."""
        straightens = np.linalg.inv(bending(straightened(np.array(fit.values), self.levers), self.levers))
        return np.asarray(np.sqrt(np.diag(straightens @ fit.covariance @ straightens.T)) / self.size)

    def fit(self, here: Point, covariance: Array, sd: Array) -> Fit:
        """The fit at these coordinates; covariance (p, p) and standard deviations sd (p,) over the typical sizes.

        Standard deviations of delays also include what is not known of the commands between samples, unless it was
        fitted, and those of all effects the tolerances of the nuisances that they contain.
        """
        bends = bending(here.at[self.count :] * self.size, self.levers)
        covariance = bends @ in_units(covariance, sd, self.size) @ bends.T
        covariance += np.diag(unfitted_delay_sd(self.problem, self.locations) ** 2)
        tolerances = self.contained(here.at)[self.held] * self.size @ bends.T
        covariance += tolerances.T @ tolerances
        offsets = here.at[: self.count].copy()
        return Fit(self.effects(here.at), offsets, here.loss, here.residual, covariance, tolerances)

    def nuisance_jacobian(self, here: Point) -> Asks[Array]:
        """(R, J); 0 for those that the effects contain."""
        effects, offsets = self.effects(here.at), here.at[: self.count]
        return self.free((yield from self.problem.nuisance_slopes(effects, offsets, here.residual)))

    def free(self, jacobian: Array) -> Array:
        """The derivatives (R, J) by the nuisances without those that the effects contain."""
        return np.where(self.held, 0.0, jacobian)

    def slopes(self, here: Point) -> Asks[Array]:
        """(R, p) derivatives of the residual by the effects' parameters; not finite where a step is invalid.

        0 for times and fixed parameters.
        """
        values, moves = here.at[self.count :], ~(self.times | self.fixed)
        steps = np.where(self.places, RELATIVE_STEP, np.maximum(LEAST_STEP, RELATIVE_STEP * np.abs(values)))
        steps = np.where(values + steps > self.high, -steps, steps)[moves]
        slopes = np.zeros((len(here.residual), len(values)))
        _, moved = yield from self.losses([*(here.at + np.eye(len(here.at))[self.count :][moves] * steps[:, None])])
        slopes[:, moves] = (moved - here.residual).T / steps
        return slopes

    def search_times(self, here: Point, steps: Sequence[float]) -> Asks[Point]:
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
                ((losses, _),) = near.answer([replace(self, problem=near).losses(tries)])
                if not losses.min() < losses[0]:
                    break
                at = tries[int(np.argmin(losses))]
        best = yield from self.best([at])
        return best if best.loss < here.loss else here
