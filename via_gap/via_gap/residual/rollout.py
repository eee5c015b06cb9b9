"""Segments simulated from their measured states, and the whitened error of the simulation.

At the start of a segment, angles and velocities of the measured axes are reset, and so are the torques of bristles and
slipping springs (memory.py). Only the lag of a drive continues from the segment before: neighbouring segments of a row
with a lag are one run, segments of other rows are separate runs. The states of motors without an encoder are simulated
along the measured motion from the beginning of the log (unseen.py).

The measured start of a segment is uncertain. To first order, a wrong start adds correlated noise to the segment. The
errors are whitened by its covariance,

    e' (1 + A S A')^-1 e = |w|^2,   w = e - U (1 - 1 / sqrt(1 + s^2)) U' e,   U s V' = A S^1/2

with the error e in units of the noise, A the sensitivities to the start by finite differences, S the variances of the
start. An unknown start would be projected out, an exact one has no effect. Missing commands (command_gaps.py) and the
noise of measured torques that drive the simulation (torque_noise.py) add columns to A in the same way.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice
from math import ceil

import numpy as np
from via_core.signals import Array, Indices, Mask
from via_sim.catalogue.drive.actuator_delay import MAX_DELAY
from via_sim.joint.layout import QUEUED, X
from via_sim.joint.parameters import DYNAMIC, SERVO, P
from via_sim.lockstep.pack import LANES

from via_gap.residual.legs import Leg, Runs, divided, runs_of, simulate
from via_gap.residual.likely_starts import STEP, likely_start, likely_starts
from via_gap.residual.memory import (
    HELD,
    DriveGoals,
    torques_along,
    with_drive_memory,
    with_late_goal,
    write_goals,
    write_history,
)
from via_gap.residual.segments import START, Segments, binned
from via_gap.residual.torque_noise import command_pulses
from via_gap.residual.true_starts import Starts, correct, without_parts
from via_gap.residual.unseen import UnseenMotors

UNIT = np.eye(6)  # rows: one entry of a start each
NEGLIGIBLE = 0.1  # of the noise: errors by start, gaps and torque noise that change a residual by less than .5 %
LEAD = 0.06  # [s] longer than any lag between channels


@dataclass(frozen=True, eq=False)
class _Inputs:
    """What a simulation of K rows starts from and is driven by.

    rows      (K, N_PARAMETERS)
    commands  (1 or K, T, N_COMMANDS) of all rows, or of each
    memory    (K, C, HELD) torques of elements with memory at the starts, unless `states` contain them
    goals     (K, n, 3) of `Rollout._goals`; None: goals have no memory
    states    (1 or K, C, S) states at the starts; None: they continue, or commands are not those of the log
    offset    (K, C, 6) added to the starts
    lasting   (K,) whether the state of a row continues from segment to segment
    """

    rows: Array
    commands: Array
    memory: Array | None
    goals: Array | None
    states: Array | None
    offset: Array | None
    lasting: Mask


@dataclass(frozen=True, eq=False)
class Rollout:
    """Chosen segments of a log, ready to be simulated with any parameter row.

    chosen       indices of segments, ascending
    basis        orthonormal (C, b a, k): errors of each segment by a wrong start, in units of the noise
    shrink       (C, k) fraction of a residual along each of them that is attributed to the start
    motor_start  (6,) [rad], [rad/s] added to the state of motors without an encoder when the log begins
    shift        (C, 6) [rad], [rad/s] added to the measured start of each segment
    back         (C, b a) change of its error, to first order, on the way back to the measured start
    """

    segments: Segments
    chosen: Indices
    basis: Array
    shrink: Array
    lead: int  # ticks that are simulated before the first segment of a chain
    motor_start: Array
    shift: Array
    back: Array

    @staticmethod
    def of(segments: Segments, chosen: Indices) -> Rollout:
        made = Rollout._plain(segments, chosen)._whitened(segments.nominal, command_pulses(segments))
        if segments.rests or not made._unseen:
            return made
        return made._with_estimated_start()._whitened(segments.nominal, command_pulses(segments))

    @staticmethod
    def by_starts(segments: Segments, chosen: Indices) -> Rollout:
        """The same with fewer runs: noise of torques and gaps in the commands count as errors."""
        return Rollout._plain(segments, chosen)._whitened(segments.nominal, ())

    @staticmethod
    def _plain(segments: Segments, chosen: Indices) -> Rollout:
        n, size = len(chosen), segments.measured.shape[1] * len(segments.axes)
        starts = np.zeros(6), np.zeros((n, 6)), np.zeros((n, size))
        return Rollout(segments, chosen, np.empty(0), np.empty(0), segments.ticks, *starts)

    def at_likely_starts(self, row: Array) -> Rollout:
        """The same, linearised about the most likely start of each segment under a row (N_PARAMETERS,)."""
        row, steps = row.copy(), self._start_steps()
        row[[P.tick, P.substeps]] = self.segments.nominal[[P.tick, P.substeps]]

        measured = replace(self, shift=np.zeros_like(self.shift))  # one object: states of unseen motors are found once

        def errors(amounts: Array) -> Array:
            return measured._errors(measured.motion(row[None], amounts @ steps))[0]

        amounts, slopes = likely_starts(errors, len(self.chosen), len(steps))
        moved = replace(self, shift=amounts @ steps)._whitened(row, command_pulses(self.segments), STEP)
        return replace(moved, back=-np.einsum("crk,ck->cr", slopes, amounts))

    def part(self, which: Indices) -> Rollout:
        """Some of the segments, by their indices into `chosen`; with all axes measured, a short lead is enough."""
        lead = min(round(LEAD * self.segments.rate), self.segments.ticks) if self._all_seen else self.lead
        own = {name: getattr(self, name)[which] for name in ("chosen", "basis", "shrink", "shift", "back")}
        return replace(self, lead=lead, **own)

    @property
    def _known(self) -> list[int]:
        """Entries of a state that are measured: angles, then velocities."""
        return [*self.segments.axes, *(3 + axis for axis in self.segments.axes)]

    @property
    def _all_seen(self) -> bool:
        """Whether every motor has an encoder."""
        return all(self.segments.log.motors_seen)

    @property
    def size(self) -> int:
        """Whitened values per segment."""
        return self.segments.measured.shape[1] * len(self.segments.axes)

    def motion(
        self, rows: Array, offset: Array | None = None, commands: Array | None = None, begun: Array | None = None
    ) -> Array:
        """Angles as compared (K, C, b, a) [rad] of rows (K, N_PARAMETERS).

        offset    (6,) is added to every start, (C, 6) to that of each segment, (K, 1 or C, 6) also of each row
        commands  (K, T, N_COMMANDS) of each row, instead of the log's
        begun     (K, 6) added to the state of motors without an encoder of each row when the log begins

        Each segment with each row is a run, or each chain of neighbours if the state of the row continues; runs of
        similar length are simulated in lockstep.
        """
        out, runs = self._prepared(rows, offset, commands, begun)
        simulate(runs)
        return out

    def _prepared(
        self, rows: Array, offset: Array | None, commands: Array | None, begun: Array | None
    ) -> tuple[Array, list[Runs]]:
        """Memory for the angles of `motion`, and the runs that write it."""
        out = np.empty((len(rows), len(self.chosen), *self.segments.measured.shape[1:]))
        lasting = with_drive_memory(rows) & self._all_seen
        chains, runs = runs_of(self.segments.begin[self.chosen], self.segments.ticks, lasting)
        memory = goals = states = None
        sent = self.segments.commands[None] if commands is None else commands
        if self._all_seen:
            memory = torques_along(rows, self.segments.start[:, :3], self.segments.begin[self.chosen])
            goals = self._goals.states(rows, commands) if with_late_goal(rows).any() else None
            states = None if commands is not None or lasting.any() else self._begun[None]
        else:
            states = self._states_of_unseen(rows, commands, begun)
        aside = None if offset is None else np.broadcast_to(offset, (len(rows), len(self.chosen), 6))
        inputs = _Inputs(rows, sent, memory, goals, states, aside, lasting)
        kind = tuple(map(float, self.segments.nominal[[P.tick, P.substeps]]))
        return out, [Runs(self._legs(inputs, chains, piece, out), len(piece), kind) for piece in divided(runs)]

    def starts(self, row: Array) -> Starts:
        """Where each segment begins with a row (N_PARAMETERS,)."""
        segments, begin = self.segments, self.segments.begin[self.chosen]
        motion = self._starts(np.repeat(row[None], len(begin), axis=0), begin)
        if not self._all_seen:
            return Starts(begin, self._unseen_motors.states(row[None])[0], motion, None)
        ticks = np.maximum(begin - min(round(LEAD * segments.rate), segments.ticks), 0)
        states = self._initial(ticks, segments.commands, np.zeros(len(ticks), dtype=np.intp))
        goals = replace(self._goals, ticks=ticks).states(row[None])[0]
        write_goals(np.repeat(row[None], len(ticks), axis=0), goals, states)
        return Starts(ticks, states, motion, torques_along(row[None], segments.start[:, :3], begin)[0])

    def _states_of_unseen(self, rows: Array, commands: Array | None, begun: Array | None = None) -> Array:
        """(K, C, S) states of rows at the beginning of each chosen segment, where a motor has no encoder."""
        if commands is None:
            return self._unseen_motors.states(rows, begun)
        starts = self._at_rest(commands.reshape(-1, commands.shape[2]), np.arange(len(rows)) * commands.shape[1])
        return self._unseen_motors.integrated(rows, starts, commands)

    @cached_property
    def _unseen_motors(self) -> UnseenMotors:
        segments = self.segments
        start = self._at_rest(segments.commands, np.zeros(1, dtype=np.intp))
        begins = segments.begin[self.chosen]
        return UnseenMotors(segments.start, np.array(segments.axes), begins, segments.commands[None], start)

    def _at_rest(self, sent: Array, under: Indices) -> Array:
        """State rows at tick 0."""
        states = self._initial(np.zeros(len(under), dtype=np.intp), sent, under)
        states[:, :6] += self.motor_start
        return states

    @property
    def _unseen(self) -> list[int]:
        """Motors without an encoder whose state is integrated."""
        kinds = self.segments.nominal[P.axis_kind :]
        return [axis for axis in (1, 2) if axis not in self.segments.axes and kinds[axis] == DYNAMIC]

    def _start_sd(self) -> Array:
        """(k, 6) prior standard deviations of the angle of each unseen motor when the log begins, and of its velocity.

        Nothing is known but that a motor moves about as much as the link. It may move while the link still rests.
        """
        travel, speed = np.nanstd(self.segments.start[:, [0, 3]], axis=0)
        return np.array([size * UNIT[at + k] for at, size in ((0, travel), (3, speed)) for k in self._unseen])

    def _with_estimated_start(self) -> Rollout:
        """The same with the most likely start of the unseen motors, from the errors of all segments."""
        sizes = self._start_sd()

        def errors(amounts: Array) -> Array:
            rows = np.repeat(self.segments.nominal[None], len(amounts), axis=0)
            return self.whitened(self.motion(rows, begun=amounts @ sizes))

        return replace(self, motor_start=likely_start(errors, len(sizes)) @ sizes)

    def _legs(self, inputs: _Inputs, chains: Indices, runs: Indices, out: Array) -> Iterator[Leg]:
        """Legs of `runs` (n, 2), pairs of row and chain, longest chains first; writes angles into `out`."""
        rows, drive = inputs.rows, inputs.commands
        segments, known, axes = self.segments, self._known, list(self.segments.axes)
        first, count = chains[runs[:, 1]].T
        begin, lasting = segments.begin[self.chosen[first]], inputs.lasting[runs[:, 0]]
        warm = np.where(lasting, np.maximum(begin - self.lead, 0), begin)
        sent = drive.reshape(-1, drive.shape[2])
        under = runs[:, 0] % len(drive) * drive.shape[1]  # row of `sent` at which the commands of each run begin
        if inputs.states is None:
            states = self._initial(warm, sent, under)
            if inputs.goals is not None:
                at = np.searchsorted(self._goals.ticks, warm)
                write_goals(rows[runs[:, 0]], inputs.goals[runs[:, 0], at], states)
            ahead = np.flatnonzero(lasting & (self.chosen[first] > 0))
            if ahead.size:
                begun = Leg(rows[runs[ahead, 0]], states[ahead], sent, under[ahead] + warm[ahead], self.lead)
                yield begun
                states[ahead] = begun.states
        else:
            states = inputs.states[runs[:, 0] % len(inputs.states), first]
        for j in range(int(count.max())):
            left = int(np.sum(count > j))  # shorter chains have ended
            here, run, state = first[:left] + j, rows[runs[:left, 0]], states[:left]
            begin = segments.begin[self.chosen[here]]
            state[:, known] = self._starts(run, begin)[:, known]
            if inputs.goals is not None:
                state[:, X.integral] = inputs.goals[runs[:left, 0], np.searchsorted(self._goals.ticks, begin), 2]
            if inputs.memory is not None:
                state[:, X.bristle : X.bristle + HELD] = inputs.memory[runs[:left, 0], here]
            state[:, :6] += self.shift[here]
            if inputs.offset is not None:
                state[:, :6] += inputs.offset[runs[:left, 0], here]
            write_history(run, begin, state, segments.rate, known, self._starts)
            leg = Leg(run, state, sent, under[:left] + begin, segments.ticks, last=j + 1 == count.max())
            yield leg
            out[runs[:left, 0], here] = binned(leg.moved[:, :, axes], segments.every, segments.averaged)

    @cached_property
    def _begun(self) -> Array:
        """(C, .) state rows at the beginning of each segment under the commands of the log, see `_initial`."""
        ticks = self.segments.begin[self.chosen]
        return self._initial(ticks, self.segments.commands, np.zeros(len(ticks), dtype=np.intp))

    def _initial(self, ticks: Indices, sent: Array, under: Indices) -> Array:
        """State rows (n, .) at ticks: measured axes, unmeasured motors at their command, queues of delayed commands."""
        segments, kinds = self.segments, self.segments.nominal[P.axis_kind :]
        length = ceil(MAX_DELAY * segments.rate) + 3
        states = np.zeros((len(ticks), X.queue + QUEUED * length))
        states[:, X.tick] = ticks
        known = np.isfinite(segments.rest)
        queue = states[:, X.queue :].reshape(len(ticks), length, QUEUED)
        each = np.arange(len(ticks))
        before = ticks[:, None] - np.arange(1, length + 1)
        queue[each[:, None], before % length] = sent[under[:, None] + np.maximum(before, 0), :QUEUED]
        early, back = np.nonzero(before < 0)
        for axis in (1, 2):  # before the log began, servos were at rest
            if known[axis] and kinds[axis] == SERVO:
                queue[early, before[early, back] % length, axis - 1] = segments.rest[axis]
        for axis in range(3):
            if axis not in segments.axes:
                if kinds[axis] == SERVO:
                    states[:, axis] = sent[under + ticks, axis - 1]
                elif kinds[axis] == DYNAMIC:
                    states[:, axis] = segments.start[ticks, 0]
                if known[axis]:
                    states[ticks == 0, axis] = segments.rest[axis]
        states[:, self._known] = segments.start[ticks][:, self._known]
        history = states[:, X.history : X.queue].reshape(len(ticks), -1, 6)
        history[:, :, :3] = states[:, None, :3]
        return states

    @cached_property
    def _goals(self) -> DriveGoals:
        """Goals of position drives under the commands of the log, where chains are warmed up and segments begin."""
        begin = self.segments.begin[self.chosen]
        ticks = np.union1d(begin, np.maximum(begin - self.lead, 0))
        return DriveGoals(self.segments.commands, self.segments.start[:, 0], ticks)

    def _starts(self, rows: Array, ticks: Indices) -> Array:
        """True angles and velocities (n, 6) at ticks: the measured ones without the encoder errors of each row."""
        found = self.segments.start[ticks]
        correct(rows, self.segments.start, ticks, np.array(self.segments.axes), self.segments.rate, found)
        return found

    def _unseen_noise(self) -> dict[int, Array]:
        """[rad], [rad/s] standard deviation (2,) of the start of each motor without an encoder.

        Noise of the measured axes excites the motor behind its spring. It is found by a run along a motion with as much
        noise again; as for measured axes, the bias of smoothing is included (`START`).
        """
        if not self._unseen:
            return {}
        segments, motors = self.segments, self._unseen_motors
        noisy = replace(motors, measured=segments.start + segments.smoothed_noise(np.random.default_rng(0)))
        moved = noisy.integrated(segments.nominal[None])[0] - motors.integrated(segments.nominal[None])[0]
        sizes = START * np.sqrt(np.mean(np.nan_to_num(moved[:, :6]) ** 2, axis=0))
        least = segments.start_noise[0]  # a motor is known from the link, at best as well as the link itself
        return {axis: np.maximum(sizes[[axis, 3 + axis]], least) for axis in self._unseen}

    def _start_steps(self) -> Array:
        """(k, 6) one standard deviation of the angle and of the velocity of each axis with an uncertain start."""
        known = dict(zip(self.segments.axes, self.segments.start_noise, strict=True)) | self._unseen_noise()
        return np.array([size * UNIT[axis + at] for axis, noise in known.items() for at, size in zip((0, 3), noise)])

    def _whitened(self, row: Array, pulses: Iterable[Array], step: float = 1.0) -> Rollout:
        """The same with `basis` and `shrink`, from runs of a row that start `step` standard deviations aside."""
        aside = np.vstack([np.zeros((1, 6)), step * self._start_steps()])
        sizes, rows = self._start_sd(), np.repeat(row[None], max(LANES, len(aside)), axis=0)
        plain, *moved = self.motion(rows[: len(aside)], aside[:, None])
        changes = [(each - plain) / step for each in moved]
        each_pulse = iter(pulses)
        while some := list(islice(each_pulse, LANES)):
            commands = self.segments.commands + np.stack(some)
            changes += [*(self.motion(rows[: len(some)], commands=commands) - plain)]
        if len(sizes):
            changes += [*((self.motion(rows[: len(sizes)], begun=STEP * sizes) - plain) / STEP)]
        columns = np.stack(changes, axis=-1)
        columns = columns * (self.segments.weight[self.chosen] / self.segments.noise)[..., None]
        flat = columns.reshape(len(self.chosen), self.size, len(changes))
        basis, singular, _ = np.linalg.svd(np.clip(np.nan_to_num(flat), -1e9, 1e9), full_matrices=False)
        kept = int(np.max(np.sum(singular > NEGLIGIBLE, axis=1), initial=1))
        return replace(self, basis=basis[..., :kept], shrink=1.0 - 1.0 / np.sqrt(1.0 + singular[:, :kept] ** 2))

    def residual(self, rows: Array, commands: Array | None = None) -> Array:
        """Whitened measured minus simulated (K, C, b a), commands as in `motion`; overflow gives a huge value."""
        return self.whitened(self.motion(rows, commands=commands))

    def whitened(self, motion: Array) -> Array:
        """Whitened measured minus simulated (K, C, b a) of angles as compared, motion (K, C, b, a) [rad]."""
        return without_parts(self._errors(motion) + self.back, self.basis, self.shrink)

    def _errors(self, motion: Array) -> Array:
        """Measured minus simulated (K, C, b a) in units of the noise; overflow gives a huge value."""
        scale = self.segments.weight[self.chosen] / self.segments.noise
        error = (self.segments.measured[self.chosen] - motion) * scale
        flat = error.reshape(len(motion), len(self.chosen), self.size)
        return np.clip(np.nan_to_num(flat, nan=1e8, posinf=1e8, neginf=-1e8), -1e8, 1e8)

    def baseline(self) -> Array:
        """(C, b a) whitened error of a prediction without a model: constant velocity from each measured start."""
        segments = self.segments
        ticks = np.arange(segments.ticks + 1) / segments.rate
        start = segments.start[segments.begin[self.chosen]]
        axes = list(segments.axes)
        line = start[:, None, axes] + ticks[None, :, None] * start[:, None, [3 + axis for axis in axes]]
        error = segments.measured[self.chosen] - binned(line, segments.every, segments.averaged)
        scaled = error * segments.weight[self.chosen] / segments.noise
        return without_parts(scaled.reshape(1, len(self.chosen), self.size), self.basis, self.shrink)[0]


def residuals(rollouts: Sequence[Rollout], rows: Sequence[Array]) -> list[Array]:
    """`Rollout.residual` of each of several logs with its own rows (K, N_PARAMETERS), simulated side by side."""
    prepared = [each._prepared(own, None, None, None) for each, own in zip(rollouts, rows, strict=True)]
    simulate([run for _, runs in prepared for run in runs])
    return [each.whitened(out) for each, (out, _) in zip(rollouts, prepared, strict=True)]
