"""The equation of all joints of an arm, and fits of numbers that all of them feel.

    tau_i - friction_i - [M(q) qdd + c(q, qd) + g(q)]_i = z_i' c_i + Y_i(q, qd, qdd) phi

    z_i   what joint i alone can lack: bias, dry and viscous friction, rotor, gain (1, sign qd_i, qd_i, qdd_i, torque)
    Y_i   torque per number of a `Shared` cause, which all joints feel
    phi   its numbers

Both sides are averaged over windows of WINDOW: the equation holds for averages as well, and noise of the accelerations
averages out. A window counts for a joint if its direction is certain in every sample, because dry friction is unknown
where a joint reverses or rests; a block without any window that counts is left out. Fits are compared by held-out
errors of blocks.

Source: W. Khalil, E. Dombre, Modeling, Identification and Control of Robots, Butterworth-Heinemann 2002, chapter 12
(linear regression of dynamic parameters, filtered and decimated).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import pinocchio
from scipy.stats import norm
from scipy.stats import t as student
from via_core.signals import Array, Signals

from via_gap.logs.log import JointLog
from via_gap.run.arm_model import Arm, body_of, smoothed_motion, under, velocity_noise
from via_gap.selection.holdout import BLOCK
from via_gap.selection.numbers import NUMBERS

WINDOW = 0.1  # [s] of the averages: longer than the smoothing of the angles, short beside a motion of the arm
DEGREE = 5  # of the polynomials that smooth the angles: bias of accelerations would remain, noise averages out
OWN, NUMBERS_OF_BODY = 5, 10  # columns of z and of Y; one column of the missing torque follows
GRAVITY = -1  # column of gravity in the blocks, after those of the bodies and of the offsets of angles
TINY = np.finfo(float).tiny  # added to errors: blocks at rest have none
_Z, _Y = slice(0, OWN), slice(OWN, OWN + NUMBERS_OF_BODY)  # the gain is the last of z


class Shared(Protocol):
    """A cause that all joints feel; `point` (p,) are its unknowns."""

    @property
    def column(self) -> int:
        """Number of its Y in the blocks: that of a body or offset, or GRAVITY."""

    def numbers(self, point: Array) -> Array:
        """phi (10,)."""

    def solved(self, root: Array, start: Array | None) -> tuple[Array, Array]:
        """Unknowns and standard deviations (p,) with the least |root (phi, -1)|, root (11, 11); start: a guess."""


@dataclass(frozen=True)
class OneUnknown:
    """A `Shared` cause that is one unknown (1,), within bounds, times a direction (10,) of phi; joint: its number."""

    column: int
    joint: int
    direction: tuple[float, ...]
    bounds: tuple[float, float]

    def numbers(self, point: Array) -> Array:
        """The unknown times the direction."""
        return np.asarray(point[0] * np.array(self.direction))

    def solved(self, root: Array, start: Array | None) -> tuple[Array, Array]:
        """Least squares within the bounds, with a prior of standard deviation one."""
        row = root[:, :-1] @ np.array(self.direction)
        precision = float(row @ row) + 1.0
        return np.clip([float(row @ root[:, -1]) / precision], *self.bounds), np.array([precision**-0.5])


@dataclass(frozen=True, eq=False)
class ArmFit:
    """A shared cause, or none, and the own errors of each joint.

    point    (p,) unknowns of the cause, with sd if all windows were independent; empty without a cause
    factors  (n, 16) of all columns: own errors, phi, -1; weight (n,) inverse variance of each joint
    """

    cause: Shared | None
    gains: bool
    point: Array
    sd: Array
    factors: Array
    weight: Array

    @property
    def column(self) -> int:
        return 0 if self.cause is None else self.cause.column

    @property
    def gain(self) -> Array:
        """(n,) share of each required torque that a wrong gain adds to the drive's torque; 0 with right gains."""
        return np.asarray(self.factors[:, OWN - 1])

    @staticmethod
    def of(train: Array, cause: Shared | None, gains: bool, start: Array | None = None) -> ArmFit:
        """The fit to blocks (B, n, columns, 16, 16)."""
        total = train[:, :, 0 if cause is None else cause.column].sum(axis=0)
        point, sd = np.zeros(0), np.zeros(0)
        numbers = np.zeros(NUMBERS_OF_BODY) if cause is None or start is None else cause.numbers(start)
        factors = _coefficients(total, numbers, gains)
        for _ in range(2):  # the second time with the weights of the first fit
            if cause is None:
                break
            weight = _weights(total, factors)
            reduced = np.einsum("i,ijk->jk", weight, np.stack([_reduced(each, gains) for each in total]))
            values, vectors = np.linalg.eigh(reduced)
            point, sd = cause.solved(np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T, start)
            start = point
            factors = _coefficients(total, cause.numbers(point), gains)
        return ArmFit(cause, gains, point, sd, factors, _weights(total, factors))

    def against(self, other: ArmFit, test: Array) -> Array:
        """(B,) log of the squared error of every held-out block over that of the other fit; weights of this one."""
        own, its = (each.squares(test) @ self.weight for each in (self, other))
        return np.log((own + TINY) / (its + TINY))

    def left(self, other: ArmFit, test: Array) -> Array:
        """(n,) of each joint, squared error over that of the other fit; geometric mean of the held-out blocks.

        Most causes change the torques of few joints; the errors of the others would hide it.
        """
        own, its = self.squares(test), other.squares(test)
        return np.exp(np.mean(np.log((own + TINY) / (its + TINY)), axis=0))

    def squares(self, test: Array) -> Array:
        """(B, n) sum of squared errors of every block and joint [N^2 m^2]."""
        return np.einsum("ij,bijk,ik->bi", self.factors, test[:, :, self.column], self.factors)

    def uncertain(self, train: Array) -> tuple[Array, Array]:
        """Standard deviations of the unknowns (p,) and of the gains (n,).

        From the scatter between blocks (jackknife), because errors within a block are not independent.
        """
        every = np.arange(len(train))
        left_out = [ArmFit.of(train[every != b], self.cause, self.gains, self.point) for b in every]
        points, gains = (np.array(each) for each in zip(*((fit.point, fit.gain) for fit in left_out), strict=True))
        point, gain = (np.sqrt((len(every) - 1) * np.var(each, axis=0)) for each in (points, gains))
        return np.asarray(np.maximum(point, self.sd)), np.asarray(gain)


def explains(share: float) -> str:
    """Two sentences about the share [-] of its squared missing torque that a cause explains at a joint."""
    return (
        f"This explains {100.0 * share:.3g} % of the squared missing torque that errors of single joints leave, at the "
        "joint where it explains most. The joints are diagnosed with it."
    )


def offset_column(joints: int, joint: int) -> tuple[int, int]:
    """Column of the torque per offset [N m/rad] of a joint's angle in the blocks, and its place in phi."""
    group, slot = divmod(joint, NUMBERS_OF_BODY)
    return joints + group, slot


def exceeds(differences: Array, significance: float) -> bool:
    """Whether the mean of differences (B,) between blocks is above zero: one-sided t test."""
    error = float(np.std(differences, ddof=1)) / np.sqrt(len(differences))
    return bool(np.mean(differences) > student.ppf(1.0 - significance, len(differences) - 1) * error)


def _reduced(gram: Array, gains: bool) -> Array:
    """Gram matrix (11, 11) of body and missing torque without what a joint alone explains, from (16, 16)."""
    rest, own = slice(OWN, None), slice(0, OWN if gains else OWN - 1)
    return gram[rest, rest] - gram[rest, own] @ np.linalg.pinv(gram[own, own], hermitian=True) @ gram[own, rest]


def _coefficients(total: Array, phi: Array, gains: bool) -> Array:
    """(n, 16) factors of all columns for body parameters phi (10,): own errors of each joint, phi, -1."""
    own = slice(0, OWN if gains else OWN - 1)
    factors = np.concatenate([np.zeros(OWN), phi, [-1.0]]) * np.ones((len(total), 1))
    for row, gram in zip(factors, total, strict=True):
        row[own] = np.linalg.pinv(gram[own, own], hermitian=True) @ (gram[own, -1] - gram[own, _Y] @ phi)
    return factors


def _weights(total: Array, factors: Array) -> Array:
    """(n,) inverse variance of each joint's error; 0 for a joint without windows."""
    squares = np.einsum("ij,ijk,ik->i", factors, total, factors)
    return np.divide(total[:, 0, 0], squares, out=np.zeros(len(squares)), where=squares > 0.0)


def blocks(arm: Arm, run: Sequence[JointLog]) -> list[Array]:
    """Gram matrices (n, columns, 16, 16) of the windows of each block: bodies, offsets of angles, gravity."""
    time = run[0].measured.time
    angle = np.stack([log.measured["q"] for log in run], axis=1)
    q, v, a = smoothed_motion(time, angle, DEGREE)
    drive = np.stack([_drive_torque(log, q[:, i], v[:, i]) for i, log in enumerate(run)], axis=1)
    certain = norm.ppf(1.0 - 0.5 * NUMBERS.significance) * velocity_noise(time, angle, q, DEGREE)
    drive = np.where(np.abs(v) > certain, drive, np.nan)
    length = max(round(WINDOW / float(np.median(np.diff(time)))), 1)
    count = len(time) // length
    per_block = max(round(BLOCK / WINDOW), 1)
    rows = _rows(arm, drive, (q, v, a), length, count)
    made = (_grams(rows[:, first : first + per_block]) for first in range(0, count - per_block + 1, per_block))
    return [each for each in made if each[:, 0, 0, 0].any()]


def _drive_torque(log: JointLog, angle: Array, velocity: Array) -> Array:
    """Torque (N,) [N m] of a drive: recorded, or by the equation of a position drive; NaN where neither is known.

    With integral action it depends on the time before the recording.
    """
    servo, sent = log.device.servo, log.commands
    if log.torque is not None:
        return np.asarray(log.torque[:, 0])
    if servo is None or servo.ki > 0.0 or sent is None or "equilibrium" not in sent:
        return np.full(len(angle), np.nan)
    led = Signals(sent.time, {"goal": servo.led(sent["equilibrium"], sent.time)}, {"goal": "rad"}, frozenset({"goal"}))
    goal = led.resample(log.measured.time - servo.delay)["goal"]
    return servo.torque(goal - angle, velocity)


def _grams(rows: Array) -> Array:
    """(n, columns, 16, 16) from rows (n, windows, columns, 16); those with NaN do not count."""
    usable = np.isfinite(rows).all(axis=-1, keepdims=True)
    kept = np.where(usable, rows, 0.0)
    return np.einsum("iwkp,iwkq->ikpq", kept, kept)


def _rows(arm: Arm, drive: Array, motion: tuple[Array, Array, Array], length: int, count: int) -> Array:
    """Averages (n, windows, columns, 16); NaN where a joint reverses or its torque `drive` is NaN."""
    q, v, a = motion
    n, used = q.shape[1], length * count
    model, data = arm.model, arm.model.createData()
    lifted = None if arm.lift is None else arm.lift.createData()
    bodies = [NUMBERS_OF_BODY * (body_of(arm, k) - 1) for k in range(n)]
    links = [each.link for each in arm.devices]
    viscous, dry = (
        np.array([getattr(each, name) for each in links]) for name in ("viscous_friction", "coulomb_friction")
    )
    required = arm.torques(q[:used], v[:used], a[:used])
    missing = drive[:used] - required - viscous * v[:used] - dry * np.sign(v[:used])

    def mean(values: Array) -> Array:
        return values[:used].reshape(count, length, n).mean(axis=1).T

    signs = np.sign(mean(np.sign(v)))
    steady = np.abs(mean(np.sign(v))) == 1.0
    own = np.stack([np.ones((n, count)), signs, mean(v), mean(a), mean(required)], axis=-1)
    offsets = [offset_column(n, k) for k in range(n)]
    out = np.zeros((n, count, offsets[-1][0] + 2, OWN + NUMBERS_OF_BODY + 1))
    out[..., _Z], out[..., -1] = own[:, :, None], mean(missing)[:, :, None]
    velocity, acceleration = np.zeros(model.nv), np.zeros(model.nv)
    for w in range(count):
        total, stiffness = np.zeros((model.nv, NUMBERS_OF_BODY * (model.njoints - 1))), np.zeros((model.nv, model.nv))
        for k in range(w * length, (w + 1) * length):
            velocity[arm.order], acceleration[arm.order] = v[k], a[k]
            state = arm.configuration(q[k]), velocity, acceleration
            total += pinocchio.computeJointTorqueRegressor(model, data, *state)
            stiffness += pinocchio.computeRNEADerivatives(model, data, *state)[0]
            if lifted is not None:
                stiffness -= pinocchio.computeGeneralizedGravityDerivatives(arm.lift, lifted, state[0])
        for k, column in enumerate(bodies):
            out[:, w, k, _Y] = total[arm.order, column : column + NUMBERS_OF_BODY] / length
        for k, (group, slot) in enumerate(offsets):
            out[:, w, group, OWN + slot] = -stiffness[arm.order, arm.order[k]] / length
    still = np.zeros(q[:used].shape)
    for axis, along in enumerate(np.eye(3)):
        out[:, :, GRAVITY, OWN + axis] = mean(under(arm, along).torques(q[:used], still, still))
    out[~steady] = np.nan
    return out
