"""Bound on the achievable error: what a flexible torque model beside a repair can still explain of the residual.

On every axis with a torque, a weighted sum of the functions of `Basis` of the measured motion acts on the repaired
plant. The weights are fitted to the fitted segments by ridge regression on the response to a pulse of torque. One
simulation per piece of a segment and axis serves all functions and all segments. The ridge is chosen on blocks left
out, by the loss of the fits. (By squares, segments with large errors would decide alone.) The torque is then simulated,
and the remaining residual is fitted again. The bound is the error of this torque on held-out segments, or that of the
named effects if that is lower.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from via_core.signals import Array, Signals
from via_sim.joint.layout import EXTERNAL, M1
from via_sim.joint.parameters import DYNAMIC, P

from via_gap.candidates.fit import Fit
from via_gap.residual.residual_model import ResidualModel
from via_gap.residual.rollout import Rollout
from via_gap.residual.segments import Segments
from via_gap.selection.basis import FINE, KNOTS, Basis, Wave, ticks_of, wave_values

PIECES = 10  # of a segment, over which a pulse of torque lasts
PULSE = 0.01  # of the typical torque: small enough to be linear
RIDGES = np.geomspace(1e-7, 1e2, 7)  # relative to the diagonal of the normal matrix
FOLDS = 4
BLOCK = 4  # segments that are left out together
ROUNDS = 3
ORDERS = range(3, 33)  # waves per turn that are searched in the residual of the other functions
WAVES = 6  # of them that are used
SHARES = (1.0, 0.5, 0.2)
ENOUGH = 0.01  # share of the loss: a round that gains less is the last


@dataclass(frozen=True, eq=False)
class Flexible:
    """A torque on every axis as a function of the motion, beside a repaired plant.

    row      (N_PARAMETERS,) of the plant
    columns  command columns to which the torques are added
    limits   (2,) [N m] of the drives, which apply to commands and not to the added torques
    weights  (columns, K) [N m]
    """

    basis: Basis
    row: Array
    columns: tuple[int, ...]
    limits: Array
    weights: Array

    @staticmethod
    def without_torque(
        problem: ResidualModel, basis: Basis, row: Array, columns: tuple[int, ...], limits: Array
    ) -> Flexible:
        """The model whose weights are zero."""
        count = basis.values(problem.views[0].segments).shape[1]
        return Flexible(basis, row, columns, limits, np.zeros((len(columns), count)))

    def functions(self, problem: ResidualModel) -> list[Array]:
        """(steps, K) of the log of each view."""
        return [self.basis.values(rollout.segments) for rollout in problem.views]

    def residual(self, problem: ResidualModel, functions: Sequence[Array]) -> Array:
        """Whitened measured minus simulated (R,) of a problem's segments."""
        parts = []
        for rollout, values in zip(_simulated(problem), functions, strict=True):
            commands = _limited(rollout.segments.commands, self.limits)
            commands[:, list(self.columns)] += self._torque(rollout.segments, values)
            parts.append(_run(rollout, self.row, commands[None])[0])
        return np.concatenate(parts)

    def driven(self, segments: Segments) -> Segments:
        """The log with the torques added to its commands, for free runs."""
        log = segments.log
        assert log.commands is not None
        sent = log.commands.resample(segments.origin + np.arange(len(segments.commands)) / segments.rate)
        torque = self._torque(segments, self.basis.values(segments))[:, 0]
        channels = {**sent.channels, "external_torque": segments.commands[:, EXTERNAL] + torque}
        units = {**sent.units, "external_torque": "N m"}
        commands = Signals(sent.time, channels, units, sent.held | {"external_torque"})
        return replace(segments, log=replace(log, commands=commands))

    def _torque(self, segments: Segments, values: Array) -> Array:
        """(T, columns) [N m] on every tick of a log."""
        return np.repeat(values @ self.weights.T, ticks_of(segments), axis=0)[: len(segments.commands)]


def flexible(fitted: ResidualModel, start: Fit) -> Flexible:
    """The flexible model beside the effects and device parameters of `start`, fitted to the segments of `fitted`."""
    row = fitted.row(start.effects, start.offsets)
    limits = row[P.torque_limit : P.torque_limit + 2].copy()
    row[P.torque_limit : P.torque_limit + 2] = np.inf
    columns = [EXTERNAL]
    columns += [M1 + i for i in range(2) if row[P.axis_kind + 1 + i] == DYNAMIC]
    segments = [rollout.segments for rollout in fitted.views]
    models = [
        Flexible.without_torque(fitted, Basis.of(segments, places=places), row, tuple(columns), limits)
        for places in (KNOTS, FINE)
    ]
    residual = models[0].residual(fitted, models[0].functions(fitted))
    pulses = [_pulses(rollout, models[0], rest) for rollout, rest in _parts(fitted, residual)]
    pull = fitted.weights(residual)
    tries = [_Folded.of(fitted, pulses, each.functions(fitted), pull, residual, each.weights) for each in models]
    model, folded = min(zip(models, tries, strict=True), key=lambda pair: pair[1].ridge[1])
    model, residual = _descended(model, residual, folded)
    waves = _waves(fitted, pulses, residual)
    richer = replace(model, basis=replace(model.basis, waves=waves))
    richer = replace(richer, weights=np.pad(model.weights, ((0, 0), (0, 2 * len(waves)))))
    without = folded.moved(residual, model.weights).ridge[1]
    folded = _Folded.of(fitted, pulses, richer.functions(fitted), pull, residual, richer.weights)
    return _descended(richer, residual, folded)[0] if folded.ridge[1] < without else model


def _descended(model: Flexible, residual: Array, folded: _Folded) -> tuple[Flexible, Array]:
    """Gauss-Newton steps on the weights -> model, residual (R,). `folded` belongs to the given `residual`."""
    fitted, (ridge, _) = folded.problem, folded.ridge
    loss = float(fitted.loss(residual))
    for round_ in range(ROUNDS):
        if round_:
            folded = folded.moved(residual, model.weights)
        wanted = folded.weights(ridge).reshape(model.weights.shape)
        tries = []
        for share in SHARES:
            trial = replace(model, weights=model.weights + share * (wanted - model.weights))
            rest = trial.residual(fitted, folded.functions)
            tries.append((float(fitted.loss(rest)), trial, rest))
            if tries[-1][0] < loss:
                break
        value, trial, rest = min(tries, key=lambda each: each[0])
        if not value < loss:
            break
        gain, loss, model, residual = loss - value, value, trial, rest
        if gain < ENOUGH * loss:
            break
    return model, residual


def _simulated(problem: ResidualModel) -> list[Rollout]:
    """The views of a model, all of which must be simulations."""
    views = [rollout for rollout in problem.views if isinstance(rollout, Rollout)]
    assert len(views) == len(problem.views)
    return views


def _parts(problem: ResidualModel, residual: Array) -> Iterator[tuple[Rollout, Array]]:
    """Every view with its part (C, values) of a residual (R,)."""
    return zip(_simulated(problem), problem.by_view(residual), strict=True)


def _limited(commands: Array, limits: Array) -> Array:
    """Commands (T, N_COMMANDS) with the limits of the drives; angles of servos have none."""
    moved = commands.copy()
    moved[:, M1 : M1 + 2] = np.clip(moved[:, M1 : M1 + 2], -limits, limits)
    return moved


def _run(rollout: Rollout, row: Array, commands: Array) -> Array:
    """Residuals (n, C values) of one row under each of commands (n, T, N_COMMANDS)."""
    rows = np.repeat(row[None], len(commands), axis=0)
    rows[:, P.tick], rows[:, P.substeps] = rollout.segments.nominal[P.tick], rollout.segments.nominal[P.substeps]
    return rollout.residual(rows, commands).reshape(len(commands), -1)


@dataclass(frozen=True, eq=False)
class _Folded:
    """Normal equations of the weights in every fold, at one residual; the unknowns are the total weights.

    pulses, functions  of each view, see `_pulses` and `Flexible.functions`
    weight   (R,) of the residual's values, as in the robust loss of the fits
    residual (R,) of the total weights `reached` (columns, K)
    normals  (F, K, K) matrices
    pulls    (F, K) right-hand sides
    """

    problem: ResidualModel
    pulses: Sequence[Array]
    functions: Sequence[Array]
    weight: Array
    residual: Array
    reached: Array
    normals: Array
    pulls: Array

    @staticmethod
    def of(
        problem: ResidualModel, pulses: Sequence[Array], functions: Sequence[Array], weight: Array, residual: Array,
        weights: Array,
    ) -> _Folded:  # fmt: skip
        """Normal equations of each fold at the residual of a model with `weights`."""
        normals, pulls = np.zeros((FOLDS, weights.size, weights.size)), np.zeros((FOLDS, weights.size))
        made = _Folded(problem, pulses, functions, weight, residual, weights, normals, pulls)
        for fold, where, matrix in made._blocks():
            pulled = matrix * weight[where, None]
            normals[fold] += pulled.T @ pulled
            pulls[fold] -= pulled.T @ (residual[where] * weight[where])
        return replace(made, pulls=pulls + normals @ weights.reshape(-1))

    def moved(self, residual: Array, weights: Array) -> _Folded:
        """The same pulses at the residual of other weights."""
        pulls = self.normals @ weights.reshape(-1)
        for fold, where, matrix in self._blocks():
            pulls[fold] -= matrix.T @ (residual[where] * self.weight[where] ** 2)
        return replace(self, residual=residual, reached=weights, pulls=pulls)

    @cached_property
    def ridge(self) -> tuple[float, float]:
        """The ridge with the best predictions of folds left out, and their loss; to first order in the weights."""
        whole, all_pulls = self.normals.sum(axis=0), self.pulls.sum(axis=0)
        steps = np.stack(
            [
                [solved(whole - normal, all_pulls - pull, float(ridge)) for ridge in RIDGES]
                for normal, pull in zip(self.normals, self.pulls, strict=True)
            ]
        ) - self.reached.reshape(-1)
        predicted = np.repeat(self.residual[None], len(RIDGES), axis=0)
        for fold, where, matrix in self._blocks():
            predicted[:, where] += steps[fold] @ matrix.T
        losses = self.problem.loss(predicted)
        best = int(np.argmin(losses))
        return float(RIDGES[best]), float(losses[best])

    def weights(self, ridge: float) -> Array:
        """(columns K,) from all folds."""
        return solved(self.normals.sum(axis=0), self.pulls.sum(axis=0), ridge)

    def _blocks(self) -> Iterator[tuple[int, slice, Array]]:
        """Fold, place in a residual, and design matrix (r, columns K) of each block of neighbouring segments."""
        begin = 0
        for rollout, values, each in zip(_simulated(self.problem), self.functions, self.pulses, strict=True):
            for first in range(0, len(rollout.chosen), BLOCK):
                block = slice(first, first + BLOCK)
                there = each[:, :, block].transpose(0, 2, 3, 1) @ _pieces(rollout, values, block)  # (columns, C, r, K)
                matrix = there.transpose(1, 2, 0, 3).reshape(-1, there.shape[0] * there.shape[3])
                yield (first // BLOCK) % FOLDS, slice(begin, begin + len(matrix)), matrix
                begin += len(matrix)


def _pieces(rollout: Rollout, values: Array, block: slice) -> Array:
    """(C, PIECES, K) mean of functions (steps, K) over each piece of the segments of a block."""
    edges = np.linspace(0, rollout.segments.ticks, PIECES + 1).astype(int)
    ticks = rollout.segments.begin[rollout.chosen[block]][:, None] + np.arange(rollout.segments.ticks)
    sums = np.add.reduceat(values[ticks // ticks_of(rollout.segments)], edges[:-1], axis=1)
    return np.asarray(sums / np.diff(edges)[:, None])


def _waves(problem: ResidualModel, pulses: Sequence[Array], residual: Array) -> tuple[Wave, ...]:
    """The waves whose torque, each alone, explains most of the residual."""
    axes = problem.views[0].segments.axes
    every = [Wave(place, order, signed) for place in range(len(axes)) for order in ORDERS for signed in (False, True)]
    functions = [np.hstack([wave_values(rollout.segments, wave) for wave in every]) for rollout in problem.views]
    slope = np.zeros((len(pulses[0]), 2 * len(every)))
    curve = np.full_like(slope, 1e-300)
    for (rollout, rest), values, each in zip(_parts(problem, residual), functions, pulses, strict=True):
        pieces = _pieces(rollout, values, slice(None))
        along = np.einsum("apcr,cr->acp", each, rest)
        size_of = np.einsum("apcr,apcr->acp", each, each)
        slope += np.einsum("acp,cpk->ak", along, pieces)
        curve += np.einsum("acp,cpk->ak", size_of, pieces**2)
    worth = np.max((slope**2 / curve).reshape(len(slope), len(every), 2).sum(axis=2), axis=0)
    return tuple(every[k] for k in np.argsort(-worth)[:WAVES])


def solved(normal: Array, pull: Array, ridge: float) -> Array:
    """argmin w' N w - 2 p' w + ridge |D w|^2, D^2 the diagonal of N."""
    scale = np.sqrt(np.diag(normal) + 1e-12 * np.max(np.diag(normal)) + 1e-300)
    regular = normal / np.outer(scale, scale)
    regular[range(len(scale)), range(len(scale))] += ridge + 1e-12
    try:
        factor = cho_factor(regular, check_finite=False)
    except LinAlgError:  # rounding made an eigenvalue negative
        regular[range(len(scale)), range(len(scale))] += ridge - np.linalg.eigvalsh(regular)[0]
        factor = cho_factor(regular, check_finite=False)
    return np.asarray(cho_solve(factor, pull / scale, check_finite=False) / scale)


def _pulses(rollout: Rollout, model: Flexible, residual: Array) -> Array:
    """(columns, PIECES, C, values) change of a residual (C, values) by 1 N m on each axis over each piece."""
    segments, row = rollout.segments, model.row
    edges = np.linspace(0, segments.ticks, PIECES + 1).astype(int)
    piece = np.searchsorted(edges, segments.since_begin, side="right") - 1
    commands = _limited(segments.commands, model.limits)
    typical = max(float(np.std(commands[:, list(model.columns)])), 0.1 * abs(float(model.row[P.gravity_torque])), 0.1)

    found = []
    for column in model.columns:
        moved = np.repeat(commands[None], PIECES, axis=0)
        moved[:, :, column] += np.where(piece == np.arange(PIECES)[:, None], PULSE * typical, 0.0)
        change = (_run(rollout, row, moved) - residual.reshape(-1)) / (PULSE * typical)
        found.append(change.reshape(PIECES, len(rollout.chosen), -1))
    return np.stack(found)
