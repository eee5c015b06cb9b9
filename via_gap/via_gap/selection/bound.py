"""The ceiling: what a flexible model of everything a repair leaves would still close.

Beside the repaired plant acts a torque on every axis that has a torque, a weighted sum of the functions of `Basis` of
the measured motion. The weights come from the shots that are fitted, by ridge regression on what a pulse of torque does
to a shot (one simulation per piece of a shot and axis serves every function and all shots at once), with the ridge
chosen on blocks left out; the torque is then simulated, and the rest fitted again. What it leaves of shots that were
not fitted is the ceiling, or what the named effects leave where that is less.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import eigh
from via_core.signals import Array, Signals
from via_sim.parameters import DYNAMIC, P
from via_sim.torques import EXTERNAL, M1

from via_gap.candidates.fit import Fit
from via_gap.residual.errors import Errors
from via_gap.residual.residual_model import Problem
from via_gap.residual.rollout import Bench
from via_gap.residual.segments import Shots
from via_gap.selection.basis import Basis, Wave, ticks_of, wave_values

PIECES = 10  # of a shot, over which a pulse of torque lasts
PULSE = 0.01  # of the typical torque: small enough to be linear
RIDGES = np.geomspace(1e-7, 1e-1, 5)  # of the mean squared size of a function's effect
FOLDS = 4
BLOCK = 4  # shots that are left out together
ROUNDS = 3
ORDERS = range(3, 33)  # waves per turn that are looked for in what the rest leaves
WAVES = 6  # of them that are taken
SHARES = (1.0, 0.5, 0.2)
ENOUGH = 0.01  # share of the loss: a round that gains less is the last


@dataclass(frozen=True, eq=False)
class Flexible:
    """A torque on every axis as a function of the motion, beside a repaired plant.

    row      (N_PARAMETERS,) of the plant
    columns  commands by which the torques enter
    limits   (2,) [N m] of the drives, which act on what is commanded and not on the torques here
    weights  (columns, K) [N m]
    """

    basis: Basis
    row: Array
    columns: tuple[int, ...]
    limits: Array
    weights: Array

    def functions(self, problem: Problem) -> list[Array]:
        """(steps, K) of the log of each bench."""
        return [self.basis.values(bench.shots) for bench in problem.benches]

    def residual(self, problem: Problem, functions: Sequence[Array]) -> Array:
        """Whitened measured minus simulated (R,) of a problem's shots."""
        parts = []
        for bench, values in zip(_simulated(problem), functions, strict=True):
            commands = _limited(bench.shots.commands, self.limits)
            commands[:, list(self.columns)] += self._torque(bench.shots, values)
            parts.append(_run(bench, self.row, commands[None])[0])
        return np.concatenate(parts)

    def driven(self, shots: Shots) -> Shots:
        """The log as if the torques had been commanded, for runs from beginning to end."""
        log = shots.log
        assert log.commands is not None
        held = log.commands.resample(shots.origin + np.arange(len(shots.commands)) / shots.rate)
        torque = self._torque(shots, self.basis.values(shots))[:, 0]
        channels = {**held.channels, "external_torque": shots.commands[:, EXTERNAL] + torque}
        units = {**held.units, "external_torque": "N m"}
        commands = Signals(held.time, channels, units, held.held | {"external_torque"})
        return replace(shots, log=replace(log, commands=commands))

    def _torque(self, shots: Shots, values: Array) -> Array:
        """(T, columns) [N m] on every tick of a log."""
        return np.repeat(values @ self.weights.T, ticks_of(shots), axis=0)[: len(shots.commands)]


def flexible(fitted: Problem, start: Fit) -> Flexible:
    """The flexible model beside the effects and numbers of `start`, fitted to the shots of `fitted`."""
    row = fitted.row(start.effects, start.deviations)
    limits = row[P.torque_limit : P.torque_limit + 2].copy()
    row[P.torque_limit : P.torque_limit + 2] = np.inf
    columns = [EXTERNAL]
    columns += [M1 + i for i in range(2) if row[P.axis_kind + 1 + i] == DYNAMIC]
    basis = Basis.of([bench.shots for bench in fitted.benches])
    model = Flexible(basis, row, tuple(columns), limits, np.empty((len(columns), 0)))
    functions = model.functions(fitted)
    model = replace(model, weights=np.zeros((len(columns), functions[0].shape[1])))
    residual = model.residual(fitted, functions)
    pulses = _all_pulses(fitted, model, residual)
    folded = _Folded.of(fitted, pulses, functions, residual, model.weights)
    model, residual = _descended(fitted, model, functions, pulses, residual, folded)
    waves = _waves(fitted, pulses, residual)
    richer = replace(model, basis=replace(basis, waves=waves))
    richer = replace(richer, weights=np.pad(model.weights, ((0, 0), (0, 2 * len(waves)))))
    more = richer.functions(fitted)
    without = folded.moved(fitted, pulses, functions, residual, model.weights).ridge()[1]
    folded = _Folded.of(fitted, pulses, more, residual, richer.weights)
    if folded.ridge()[1] < without:
        model, _ = _descended(fitted, richer, more, pulses, residual, folded)
    return model


def _descended(
    fitted: Problem, model: Flexible, functions: Sequence[Array], pulses: Sequence[Array], residual: Array,
    folded: _Folded,
) -> tuple[Flexible, Array]:  # fmt: skip
    """Weights fitted to what is left and simulated, a few times -> model, residual (R,). `folded` at that residual."""
    ridge, _ = folded.ridge()
    loss = float(residual @ residual)
    for round_ in range(ROUNDS):
        if round_:
            folded = folded.moved(fitted, pulses, functions, residual, model.weights)
        wanted = folded.weights(ridge).reshape(model.weights.shape)
        tries = []
        for share in SHARES:
            trial = replace(model, weights=model.weights + share * (wanted - model.weights))
            rest = trial.residual(fitted, functions)
            tries.append((float(rest @ rest), trial, rest))
            if tries[-1][0] < loss:
                break
        value, trial, rest = min(tries, key=lambda each: each[0])
        if not value < loss:
            break
        gain, loss, model, residual = loss - value, value, trial, rest
        if gain < ENOUGH * loss:
            break
    return model, residual


def lower(first: Errors, second: Errors) -> Array:
    """(n,) gap of each signal: the lesser of two, never less than what the sensors leave."""
    return np.maximum(np.minimum(first.signals, second.signals), first.floors)


def _simulated(problem: Problem) -> list[Bench]:
    """The benches of a problem; all run, for a torque can be added only to what is run."""
    benches = [bench for bench in problem.benches if isinstance(bench, Bench)]
    assert len(benches) == len(problem.benches)
    return benches


def _limited(commands: Array, limits: Array) -> Array:
    """Commands (T, N_COMMANDS) as the drives pass them on; angles of servos have no limit."""
    moved = commands.copy()
    moved[:, M1 : M1 + 2] = np.clip(moved[:, M1 : M1 + 2], -limits, limits)
    return moved


def _run(bench: Bench, row: Array, commands: Array) -> Array:
    """Residuals (n, C values) of one row under each of commands (n, T, N_COMMANDS)."""
    rows = np.repeat(row[None], len(commands), axis=0)
    rows[:, P.tick], rows[:, P.substeps] = bench.nominal[P.tick], bench.nominal[P.substeps]
    return bench.residual(rows, commands).reshape(len(commands), -1)


@dataclass(frozen=True, eq=False)
class _Folded:
    """Normal equations of every fold: normals (F, K, K), and what the residual at hand says, pulls (F, K).

    others  (F,) all folds but one together, taken apart once for every ridge and every residual
    """

    normals: Array
    pulls: Array
    others: tuple[_Curves, ...]

    @staticmethod
    def of(
        problem: Problem, pulses: Sequence[Array], functions: Sequence[Array], residual: Array, weights: Array
    ) -> _Folded:
        """At a residual that already has a torque of `weights` in it: the pull is that of the total."""
        normals, pulls = np.zeros((FOLDS, weights.size, weights.size)), np.zeros((FOLDS, weights.size))
        for fold, matrix, rest in _blocks(problem, pulses, functions, residual):
            normals[fold] += matrix.T @ matrix
            pulls[fold] -= matrix.T @ rest
        whole = normals.sum(axis=0)
        others = tuple(_Curves.of(whole - normal) for normal in normals)
        return _Folded(normals, pulls + normals @ weights.reshape(-1), others)

    def moved(
        self, problem: Problem, pulses: Sequence[Array], functions: Sequence[Array], residual: Array, weights: Array
    ) -> _Folded:
        """The same pulses at another residual."""
        pulls = self.normals @ weights.reshape(-1)
        for fold, matrix, rest in _blocks(problem, pulses, functions, residual):
            pulls[fold] -= matrix.T @ rest
        return replace(self, pulls=pulls)

    def ridge(self) -> tuple[float, float]:
        """The one of RIDGES with which folds left out are predicted best, and the loss of them, up to a constant."""
        losses = np.zeros(len(RIDGES))
        for normal, pull, rest in zip(self.normals, self.pulls, self.others, strict=True):
            said = self.pulls.sum(axis=0) - pull
            for k, ridge in enumerate(RIDGES):
                w = rest.solved(said, float(ridge))
                losses[k] += w @ normal @ w - 2.0 * w @ pull
        best = int(np.argmin(losses))
        return float(RIDGES[best]), float(losses[best])

    def weights(self, ridge: float) -> Array:
        """(columns K,) from all folds."""
        return solved(self.normals.sum(axis=0), self.pulls.sum(axis=0), ridge)


def _blocks(
    problem: Problem, pulses: Sequence[Array], functions: Sequence[Array], residual: Array
) -> Iterator[tuple[int, Array, Array]]:
    """Fold, what the functions do (r, columns K) and the residual (r,) of each block of neighbouring shots."""
    begin = 0
    for bench, values, each in zip(_simulated(problem), functions, pulses, strict=True):
        size = len(bench.chosen) * bench.size
        rest = residual[begin : begin + size].reshape(len(bench.chosen), -1)
        begin += size
        for first in range(0, len(bench.chosen), BLOCK):
            block = slice(first, first + BLOCK)
            there = each[:, :, block].transpose(0, 2, 3, 1) @ _pieces(bench, values, block)  # (columns, C, values, K)
            count = there.shape[0] * there.shape[3]
            matrix = there.transpose(1, 2, 0, 3).reshape(-1, count)
            yield (first // BLOCK) % FOLDS, matrix, rest[block].reshape(-1)


def _pieces(bench: Bench, values: Array, block: slice) -> Array:
    """(C, PIECES, K) mean of functions (steps, K) over each piece of the shots of a block."""
    edges = np.linspace(0, bench.shots.ticks, PIECES + 1).astype(int)
    ticks = bench.shots.begin[bench.chosen[block]][:, None] + np.arange(bench.shots.ticks)
    sums = np.add.reduceat(values[ticks // ticks_of(bench.shots)], edges[:-1], axis=1)
    return np.asarray(sums / np.diff(edges)[:, None])


def _waves(problem: Problem, pulses: Sequence[Array], residual: Array) -> tuple[Wave, ...]:
    """Of all waves those of which a torque would close most, each alone."""
    axes = problem.benches[0].shots.axes
    every = [Wave(place, order, signed) for place in range(len(axes)) for order in ORDERS for signed in (False, True)]
    functions = [np.hstack([wave_values(bench.shots, wave) for wave in every]) for bench in problem.benches]
    slope = np.zeros((len(pulses[0]), 2 * len(every)))
    curve, begin = np.full_like(slope, 1e-300), 0
    for bench, values, each in zip(_simulated(problem), functions, pulses, strict=True):
        size = len(bench.chosen) * bench.size
        rest = residual[begin : begin + size].reshape(len(bench.chosen), -1)
        begin += size
        pieces = _pieces(bench, values, slice(None))
        along = np.einsum("apcr,cr->acp", each, rest)
        size_of = np.einsum("apcr,apcr->acp", each, each)
        slope += np.einsum("acp,cpk->ak", along, pieces)
        curve += np.einsum("acp,cpk->ak", size_of, pieces**2)
    worth = np.max((slope**2 / curve).reshape(len(slope), len(every), 2).sum(axis=2), axis=0)
    return tuple(every[k] for k in np.argsort(-worth)[:WAVES])


@dataclass(frozen=True, eq=False)
class _Curves:
    """A normal matrix over its scale (K,), taken apart: curvatures (K,) along its axes (K, K)."""

    scale: Array
    curves: Array
    axes: Array

    @staticmethod
    def of(normal: Array) -> _Curves:
        scale = np.sqrt(np.diag(normal) + 1e-12 * np.max(np.diag(normal)) + 1e-300)
        # Of functions that the log hardly tells apart rounding makes curvatures below zero, which no factor would take.
        curves, axes = eigh(normal / np.outer(scale, scale))
        return _Curves(scale, np.maximum(curves, 0.0), axes)

    def solved(self, pull: Array, ridge: float) -> Array:
        """See `solved`."""
        return np.asarray(self.axes @ ((pull / self.scale @ self.axes) / (self.curves + ridge)) / self.scale)


def solved(normal: Array, pull: Array, ridge: float) -> Array:
    """argmin w' N w - 2 p' w + ridge |D w|^2, D^2 the diagonal of N."""
    return _Curves.of(normal).solved(pull, ridge)


def _all_pulses(problem: Problem, model: Flexible, residual: Array) -> list[Array]:
    """Of every bench, see `_pulses`."""
    found, begin = [], 0
    for bench in _simulated(problem):
        size = len(bench.chosen) * bench.size
        found.append(_pulses(bench, model, residual[begin : begin + size]))
        begin += size
    return found


def _pulses(bench: Bench, model: Flexible, residual: Array) -> Array:
    """(columns, PIECES, C, values) change of each shot's residual by a torque of 1 N m on each axis over each piece.

    A change does not depend on a fraction of a tick of dead time, with which runs cannot go in lockstep.
    """
    shots, row = bench.shots, model.row
    whole = round(row[P.delay] * shots.rate) / shots.rate
    if abs(row[P.delay] - whole) > 1e-9:
        row = row.copy()
        row[P.delay] = whole
        residual = _run(bench, row, _limited(shots.commands, model.limits)[None])[0]
    edges = np.linspace(0, shots.ticks, PIECES + 1).astype(int)
    piece = np.searchsorted(edges, np.arange(len(shots.commands)) % shots.ticks, side="right") - 1
    commands = _limited(shots.commands, model.limits)
    typical = max(float(np.std(commands[:, list(model.columns)])), 0.1 * abs(float(model.row[P.gravity_torque])), 0.1)

    found = []
    for column in model.columns:
        moved = np.repeat(commands[None], PIECES, axis=0)
        moved[:, :, column] += np.where(piece == np.arange(PIECES)[:, None], PULSE * typical, 0.0)
        change = (_run(bench, row, moved) - residual) / (PULSE * typical)
        found.append(change.reshape(PIECES, len(bench.chosen), -1))
    return np.stack(found)
