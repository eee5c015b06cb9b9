"""The second view: the missing torque of each equation along the measured motion, without simulation.

    missing = [ <torque(q, qd, commands; effects), psi> - I <q, psi''> ] / gain

for every axis whose equation the signals allow: the link, and each motor. `equation_torques` contains every
effect as in the simulator. psi modulates windows (via_core.weak_form), so that no angle is differentiated.

If measured torque does not predict the motion (a controller moves a light motor evenly; an arm is held upright),
simulated segments favour any effect that keeps the model at rest. Models are then compared by inverse dynamics alone.
Inverse dynamics has a trivial minimum too: a model in which neither drive nor inertia acts. There are two guards.
Missing torque is divided by the gain of the drive (`gain` above), and inverse dynamics is not used alone if no model
predicts the drive's torque better than its mean does (`baseline`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from via_core.devices import Device
from via_core.errors import SignalError
from via_core.signals import Array, Indices, Mask
from via_core.weak_form import window_weights
from via_sim.effects import Effect
from via_sim.joint.layout import EXTERNAL, M1, POWER
from via_sim.joint.parameters import P
from via_sim.plants import JointPlant

from via_gap.residual.equation_torques import EquationTorques, equation_torques
from via_gap.residual.record import Record
from via_gap.residual.segments import Segments
from via_gap.residual.threads import together

WINDOW = 0.06  # [s]
STRIDE = 0.5  # of a window
ORDER = 3  # of the modulating function
LONGEST = 4  # times WINDOW at most
QUIET = 0.1  # of the drive's torque: sensor noise in a window that is long enough
TAKING = np.r_[  # slots of effects that can reduce the torque of a drive
    P.torque_gain : P.torque_gain + 3,
    P.saturation : P.saturation + 3,
    P.torque_deadband : P.torque_deadband + 3,
    P.dead_zone : P.dead_zone + 3,
    P.position_deadband : P.position_deadband + 3,
    P.load_friction : P.load_velocity,
    P.lag,
]
SMALLEST = 1e-9  # [N m] of a floor
LEAST_WHOLE = 0.5  # share of the windows without a gap in their samples
LAGS = 8.0  # time constants after which a lag has passed everything
LEAST_GAIN = 0.05  # of a drive: smaller ones count as this


@dataclass(frozen=True, eq=False)
class Windows:
    """Samples of one log for the equations, shared by all selections of its segments.

    undriven the record without the commands of drives; no axis feels the drive of another
    axes     equations that the signals allow: 0 link, 1, 2 motors
    weights  (3, n) of a window: <f, psi>, <f, psi'>, <f, psi''>
    stride   ticks from one window to the next
    floor    (a,) [N m] standard deviation by sensor noise
    sensed   (a,) [N m] part of it by the noise of measured torques that drive the axis
    drive    (T, a) [N m] torque that drives each axis: of its motor, or of the springs for a link behind springs
    whole    (T - n + 1,) whether the window that begins at a tick contains no gap in the samples
    """

    record: Record
    undriven: Record
    axes: tuple[int, ...]
    weights: Array
    stride: int
    floor: Array
    sensed: Array
    drive: Array
    whole: Mask

    def floor_behind(self, lag: float) -> Array:
        """(a,) [N m] floor if a lag [s] follows the measured torques: it filters their noise as well.

        Otherwise a lag would explain the noise that it removes.
        """
        if lag <= 0.0:
            return self.floor
        weights, period = self.weights[0], self.record.time[1] - self.record.time[0]
        passes = np.exp(-period / lag * np.arange(len(weights) + int(LAGS * lag / period) + 1))
        left = np.convolve(weights, passes / passes.sum())
        share = np.sum(left**2) / np.sum(weights**2)
        return np.sqrt(self.floor**2 - (1.0 - share) * self.sensed**2)


@dataclass(frozen=True, eq=False)
class InverseDynamics:
    """Chosen segments of a log, each a row of windows for every axis."""

    segments: Segments
    chosen: Indices
    nominal: Array  # (N_PARAMETERS,)
    windows: Windows

    @cached_property
    def first(self) -> Indices:
        """(C, w) tick at which each window of each chosen segment begins."""
        span = self.windows.weights.shape[1]
        steps = np.arange(0, max(self.segments.ticks - span, 0) + 1, self.windows.stride)
        return np.minimum(self.segments.begin[self.chosen][:, None] + steps, len(self.segments.angles) - span)

    @cached_property
    def inside(self) -> Indices:
        """(n,) ticks in any window, ascending: only their torques are computed."""
        return np.unique(self.first[..., None] + np.arange(self.windows.weights.shape[1]))

    @cached_property
    def place(self) -> Indices:
        """(C, w) index of `first` in `inside`."""
        return np.searchsorted(self.inside, self.first)

    @cached_property
    def weight(self) -> Array:
        """(C, w) of each window in comparisons: 0 with a gap in its samples.

        Above 1 elsewhere in such a segment, so that its mean squares are those of its other windows.
        """
        whole = self.windows.whole[self.first]
        return whole * np.sqrt(whole.shape[1] / np.maximum(whole.sum(axis=1, keepdims=True), 1))

    @property
    def middle(self) -> Indices:
        """(C, w) tick in the middle of each window."""
        return self.first + self.windows.weights.shape[1] // 2

    def torques(self, residual: Array) -> Array:
        """Missing torque [N m] (C, a, w) of a residual (C, w a)."""
        return residual.reshape(len(self.chosen), len(self.windows.axes), -1) * self.windows.floor[:, None]

    @staticmethod
    def of(segments: Segments, chosen: Indices, span: int = 0) -> InverseDynamics:
        """Windows as `windows_of` makes them. Raises SignalError if the signals allow no equation."""
        return InverseDynamics(segments, chosen, segments.nominal, windows_of(segments, segments.nominal, span))

    @staticmethod
    def by_segment(segments: Segments, chosen: Indices) -> InverseDynamics:
        """The same with windows as long as a segment, the time scale of the simulated segments."""
        return InverseDynamics.of(segments, chosen, segments.ticks + 1)

    def part(self, which: Indices) -> InverseDynamics:
        """Some of the segments, by their indices in `chosen`."""
        return replace(self, chosen=self.chosen[which])

    @property
    def size(self) -> int:
        """Whitened values per segment."""
        return self.first.shape[1] * len(self.windows.axes)

    def residual(self, rows: Array) -> Array:
        """Missing torque in units of the floor (K, C, w a) of rows (K, N_PARAMETERS)."""
        out = np.empty((len(rows), len(self.first), self.size))

        def evaluate(k: int) -> None:
            out[k] = self._missing(rows[k])

        together(partial(evaluate, k) for k in range(len(rows)))
        return out

    def baseline(self) -> Array:
        """(C, w a) the drive's torque minus its mean, in units of the floor: the residual without a model."""
        drive = self.windows.drive[self.inside]
        parts = [self.over(drive[:, i], 0) for i in range(drive.shape[1])]
        scaled = [
            self.weight * (part - part.mean()) / floor for part, floor in zip(parts, self.windows.floor, strict=True)
        ]
        return np.concatenate(scaled, axis=1)

    def over(self, values: Array, derivative: int) -> Array:
        """Integral of values (n,) on the ticks `inside` against a derivative of psi, over each window (C, w)."""
        weights = self.windows.weights
        return sliding_window_view(values, weights.shape[1])[self.place] @ weights[derivative]

    def _missing(self, row: Array) -> Array:
        """(C, w a) in units of the floor."""
        terms = equation_torques(row, self.windows.record, self.inside)
        scales = self.windows.floor_behind(float(row[P.lag])) * self._passed(row, terms)
        parts = [self.weight * self._missing_at(terms, a) / s for a, s in zip(self.windows.axes, scales, strict=True)]
        return np.concatenate(parts, axis=1)

    def _passed(self, row: Array, terms: EquationTorques) -> Array:
        """(a,) share of the drive's torque that acts on each axis under a row: 1 unless an effect reduces it.

        With a drive that is weak, saturated, slow or balanced by load-dependent friction, little torque would be
        missing in any motion. Missing torque is therefore relative to the torque that acts.
        """
        axes, shares = self.windows.axes, np.ones(len(self.windows.axes))
        driven = [i for i, axis in enumerate(axes) if axis > 0 or self.segments.log.device.n_transmissions == 0]
        if not driven or np.array_equal(row[TAKING], self.nominal[TAKING]):
            return shares
        acting = terms.torque - equation_torques(row, self.windows.undriven, self.inside).torque
        for i in driven:
            pairs = acting[:, axes[i]], self.windows.drive[self.inside, i]
            acts, sent = (float(np.linalg.norm(self.over(each, 0))) for each in pairs)
            shares[i] = max(acts / max(sent, SMALLEST), LEAST_GAIN)
        return shares

    def _missing_at(self, terms: EquationTorques, axis: int) -> Array:
        """(C, w) [N m]; while an axis is nearly at rest, dry friction balances as much torque as it can."""
        standing, friction = terms.standing[:, axis], terms.friction[:, axis]
        acting = terms.torque[:, axis] + np.where(standing, friction, 0.0)  # only friction of slip
        missing = terms.inertia[axis] * self.over(terms.angle[:, axis], 2) - self.over(acting, 0)
        sides = (terms.backward, terms.forward)
        upwards, downwards = (self.over(np.where(standing, side[:, axis], 0.0), 0) for side in sides)
        return missing - np.clip(missing, -np.maximum(downwards, 0.0), np.maximum(upwards, 0.0))


@dataclass(frozen=True, eq=False)
class MissingTorque:
    """Missing torque of the equations of a device along one log.

    axes    of the equations: 0 link, 1, 2 motors
    centre  (W,) tick in the middle of each window
    torque  (W, a) [N m]
    floor   (a,) [N m] standard deviation by sensor noise
    """

    axes: tuple[int, ...]
    centre: Indices
    torque: Array
    floor: Array


def missing_torque(segments: Segments, device: Device, effects: Sequence[Effect] = ()) -> MissingTorque | None:
    """Missing torque of every equation of `device` with effects that the signals allow; None if they allow none."""
    plant = JointPlant.from_device(device)
    row = plant.at_rate(segments.rate)
    try:
        windows = windows_of(segments, row)
    except SignalError:
        return None
    view = InverseDynamics(segments, np.arange(len(segments)), row, windows)
    full = plant.with_effects(effects).at_rate(segments.rate)
    missing = view.torques(view.residual(full[None])[0]).swapaxes(1, 2).reshape(-1, len(windows.axes))
    return MissingTorque(windows.axes, view.middle.ravel(), missing, windows.floor)


def windows_of(segments: Segments, nominal: Array, span: int = 0) -> Windows:
    """Windows of `span` ticks, or of the fewest in which sensor noise is small beside the drive's torque."""
    log, rate = segments.log, segments.rate
    axes = equations(segments, log.device)
    if not axes:
        raise SignalError(f"{log.name}: the signals allow no equation of the joint")
    angle, velocity = np.full((2, len(segments.angles), 3), np.nan)
    for i, axis in enumerate(segments.axes):
        angle[:, axis], velocity[:, axis] = segments.angles[:, i], segments.start[:, 3 + axis]
    time = np.arange(len(angle)) / rate
    sensed = bool(log.device.n_motors) and not log.motors_commanded
    record = Record(time, angle, velocity, time, segments.commands, sensed, segments.still)
    undriven = replace(record, commands=_undriven(segments.commands, log.device))
    drive = _drives(nominal, record, undriven, log.device, axes)
    slopes = _slopes(segments, axes)
    for times in range(1, LONGEST + 1):
        ticks = span or max(5, round(times * WINDOW * rate) + 1)
        if ticks > segments.ticks + 1:
            raise SignalError(f"{log.name}: segments are shorter than a window of {times * WINDOW:g} s")
        weights = window_weights(ORDER, np.arange(ticks) / rate)
        floor, of_torque = _floor(nominal, segments, slopes, axes, np.sqrt(np.sum(weights**2, axis=1)))
        if span or np.all(floor <= QUIET * drive.std(axis=0)) or 2 * ticks > segments.ticks:
            break
    whole = np.asarray(~sliding_window_view(segments.hidden, ticks).any(axis=1))
    if whole.mean() < LEAST_WHOLE:
        raise SignalError(f"{log.name}: too many samples are missing for an equation of the joint")
    return Windows(record, undriven, axes, weights, max(1, round(STRIDE * (ticks - 1))), floor, of_torque, drive, whole)


def equations(segments: Segments, device: Device) -> tuple[int, ...]:
    """Axes whose equation the signals allow: the link requires all motor angles, a motor its own and the link angle."""
    seen = segments.log.motors_seen
    link = (0,) if all(seen) else ()
    if device.drive == "servo":
        return link
    return (*link, *(1 + i for i, each in enumerate(seen) if each))


def _drives(
    nominal: Array, record: Record, undriven: Record, device: Device, axes: tuple[int, ...]
) -> Array:  # fmt: skip
    """(T, a) [N m] torque that drives each axis: of its drive, or of the springs for a link behind springs."""
    terms = equation_torques(nominal, record)
    torques = terms.torque - equation_torques(nominal, undriven).torque
    if device.n_transmissions:
        torques[:, 0] = np.nansum(terms.transmission, axis=1)
    return torques[:, list(axes)]


def _undriven(commands: Array, device: Device) -> Array:
    """The commands (T, N_COMMANDS) without those of the drives."""
    without = commands.copy()
    without[:, [M1 + i for i in range(device.n_motors)] or (POWER if device.drive == "position" else EXTERNAL)] = 0.0
    return without


def _slopes(segments: Segments, axes: tuple[int, ...]) -> Array:
    """(a, 3) [N m/rad] root mean square change of the torque on an axis by each angle, through the springs."""
    device = segments.log.device
    slopes = np.zeros((len(axes), 3))
    if not device.n_transmissions:
        return slopes
    theta = np.zeros((len(segments.angles), device.n_motors))
    for i, axis in enumerate(segments.axes[1:], start=1):
        theta[:, axis - 1] = segments.angles[:, i]
    stiffness = np.sqrt(np.mean(device.stiffness_each(segments.angles[:, 0], theta) ** 2, axis=0))
    for k, axis in enumerate(axes):
        if axis == 0:
            slopes[k, 0], slopes[k, 1 : 1 + len(stiffness)] = stiffness.sum(), stiffness
        elif axis <= len(stiffness):
            slopes[k, [0, axis]] = stiffness[axis - 1]
    return slopes


def _floor(
    nominal: Array, segments: Segments, slopes: Array, axes: tuple[int, ...], sizes: Array
) -> tuple[Array, Array]:
    """(a,) [N m] standard deviation of a window by sensor noise alone, and the part of it by measured torques.

    sizes  (3,) root sums of squared weights
    """
    noise = np.zeros(3)
    noise[list(segments.axes)] = np.sqrt(segments.ticks_per_sample) * segments.sample_noise
    each = list(axes)
    inertial = nominal[P.inertia :][each] * sizes[2]
    viscous = nominal[P.viscous_friction :][each] * sizes[1]  # dominates for a light motor with much damping
    own = (inertial**2 + viscous**2) * noise[each] ** 2  # psi' and psi'' are orthogonal
    driven = segments.torque_density[[M1 + axis - 1 if axis else EXTERNAL for axis in each]] * segments.rate
    sensed = np.sqrt(driven) * sizes[0]
    springs = slopes**2 @ noise**2 * sizes[0] ** 2
    return np.sqrt(own + springs + sensed**2 + SMALLEST**2), sensed
