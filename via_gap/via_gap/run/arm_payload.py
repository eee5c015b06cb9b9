"""A mass that the bodies of an arm lack, such as a payload, estimated from the missing torque of all joints together.

    tau_i - friction_i - [M(q) qdd + c(q, qd) + g(q)]_i = z_i' c_i + Y_k,i(q, qd, qdd) phi(m, p)

    z_i   what joint i alone can lack: bias, dry and viscous friction, rotor, gain (1, sign qd_i, qd_i, qdd_i, torque)
    Y_k   torque per mass, first and second moments of body k (pinocchio's regressor)
    phi   those of a point mass m at p in the frame of joint k

A payload raises the torque of every joint by about the same share. Joint by joint it is therefore taken for a wrong
gain of each drive; only together do the joints show it. Three models are compared by held-out errors of blocks: joints
with wrong gains; a payload and right gains; a payload and wrong gains. The first must be significantly worse than one
of the others; gains are wrong beside a payload only if that is significantly better, because gains can replace most of
a payload.

Both sides are averaged over windows of WINDOW: the equation holds for averages as well, and noise of the accelerations
averages out. A window counts for a joint if its direction is certain in every sample, because dry friction is unknown
where a joint reverses or rests; a block without any window that counts is left out.

Source: W. Khalil, E. Dombre, Modeling, Identification and Control of Robots, Butterworth-Heinemann 2002, chapter 12
(linear regression of dynamic parameters, filtered and decimated).
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio
from pydantic import TypeAdapter, ValidationError
from scipy.optimize import least_squares
from scipy.stats import norm
from scipy.stats import t as student
from via_core.errors import SignalError
from via_core.problems import problems
from via_core.signals import Array
from via_core.text_files import read_text

from via_gap.logs.log import JointLog
from via_gap.run.arm_model import Arm, smoothed_motion, velocity_noise
from via_gap.selection.holdout import BLOCK
from via_gap.selection.numbers import NUMBERS

WINDOW = 0.1  # [s] of the averages: longer than the smoothing of the angles, short beside a motion of the arm
DEGREE = 5  # of the polynomials that smooth the angles: bias of accelerations would remain, noise averages out
FEWEST = 4  # blocks fitted, and held out: with fewer a t test finds only what needs no test
REACH = 1.0  # [m] standard deviation of the position before anything is known: the size of an arm
_LINE = np.linspace(-REACH, REACH, 11)
GRID = np.stack(np.meshgrid(_LINE, _LINE, _LINE), axis=-1).reshape(-1, 3)  # [m] positions where fits may start
STARTS = 5  # of these, the best ones
EDGE = 1e-3  # of the mass of a body: closer to its loss the mass counts as at the end of its range
OWN, BODY = 5, 10  # columns of z and of Y; one column of the missing torque follows
_Z, _Y = slice(0, OWN), slice(OWN, OWN + BODY)  # the gain is the last of z


@dataclass(frozen=True)
class Payload:
    """A point mass in the frame of a joint.

    link          joint that moves it
    tied          joints that could move it as well: their held-out errors are not significantly larger
    mass          [kg] with mass_sd; negative: the bodies are too heavy
    position      (3,) [m] in the joint's frame with position_sd
    explained     share of the held-out squared error left by errors of single joints that it removes
    """

    link: str
    tied: tuple[str, ...]
    mass: float
    mass_sd: float
    position: tuple[float, float, float]
    position_sd: tuple[float, float, float]
    explained: float

    def text(self) -> str:
        """One sentence."""
        place = ", ".join(f"{a:z.3f} ± {b:.2g}" for a, b in zip(self.position, self.position_sd, strict=True))
        other = f" (or {', '.join(self.tied)})" if self.tied else ""
        what = "Payload" if self.mass > 0.0 else "Mass that is absent"
        return (
            f"{what} at {self.link}{other}: mass {abs(self.mass):.3g} ± {self.mass_sd:.2g} kg at ({place}) m in the "
            f"frame of this joint. It explains {100.0 * self.explained:.3g} % of the squared missing torque that "
            "errors of single joints leave. The joints are diagnosed with it."
        )


def read_payload(path: Path) -> Payload:
    """The payload in a file that `via gap diagnose --arm --json` wrote. Raises ViaError in one line."""
    try:
        return TypeAdapter(Payload).validate_json(read_text(path))
    except ValidationError as error:
        raise SignalError(f"{path}: no payload of an arm: {problems(error)}") from None


def is_payload(path: Path) -> bool:
    """Whether a JSON file holds a payload of an arm rather than a report of a joint."""
    try:
        return {"link", "mass", "position"} <= json.loads(read_text(path)).keys()
    except (ValueError, AttributeError, RecursionError):
        return False


def with_payload(arm: Arm, payload: Payload) -> Arm:
    """The arm whose bodies contain the payload. Raises SignalError if the arm has no joint of its link."""
    names = [each.name for each in arm.devices]
    if payload.link not in names:
        raise SignalError(f"'{arm.name}' has no joint '{payload.link}'; it has: {', '.join(names)}")
    model = arm.model.copy()
    body = _body_of(arm, names.index(payload.link))
    numbers = model.inertias[body].toDynamicParameters() + _point_mass(np.array([payload.mass, *payload.position]))
    model.inertias[body] = pinocchio.Inertia.FromDynamicParameters(numbers)
    return Arm(arm.name, arm.devices, model, arm.order, arm.reference)


def find_payload(
    arm: Arm, logs: Sequence[Sequence[JointLog]], holdout: Sequence[Sequence[JointLog]] = ()
) -> Payload | None:
    """The mass that explains what errors of single joints leave; None if there is none, or if it cannot be tested.

    logs, holdout: recordings of the whole arm, one log per joint each; without `holdout` every second block is held out
    """
    fitted = [each for run in logs for each in _blocks(arm, run)]
    held = [each for run in holdout for each in _blocks(arm, run)] if holdout else fitted[1::2]
    fitted = fitted if holdout else fitted[::2]
    if min(len(fitted), len(held)) < FEWEST:
        return None
    train, test = np.stack(fitted), np.stack(held)
    alone = _Fit.of(train, 0, None, gains=True)
    whole = sum(each.mass for each in arm.model.inertias)
    masses = [_Masses(arm.model.inertias[_body_of(arm, k)].mass, whole) for k in range(len(arm.devices))]
    loaded = [_Fit.of(train, k, each, gains=False) for k, each in enumerate(masses)]
    loaded = [_better(each, _Fit.of(train, each.body, masses[each.body], gains=True), test) for each in loaded]
    best = min(loaded, key=lambda fit: float(fit.against(alone, test).mean()))
    link, gain = arm.devices[best.body], best.against(alone, test)
    explained = 1.0 - float(np.exp(gain.mean()))
    sd = np.maximum(best.jackknife(train, masses[best.body]), best.sd)
    mass = float(best.point[0])
    carried = sum(arm.model.inertias[body].mass for body in arm.model.subtrees[_body_of(arm, best.body)])
    if (
        not _exceeds(-gain - NUMBERS.margin, NUMBERS.significance / len(loaded))
        or explained < NUMBERS.substantial
        or abs(mass) < link.tolerances.gravity * carried
        or abs(mass) < norm.ppf(1.0 - 0.5 * NUMBERS.significance) * sd[0]
        or mass < -(1.0 - EDGE) * masses[best.body].there
    ):
        return None
    others = [each for each in loaded if each is not best]
    tied = [each.body for each in others if not _exceeds(each.against(best, test), NUMBERS.significance)]
    names = tuple(arm.devices[k].name for k in tied)
    (x, y, z), (x_sd, y_sd, z_sd) = map(float, best.point[1:]), map(float, sd[1:])
    return Payload(link.name, names, mass, float(sd[0]), (x, y, z), (x_sd, y_sd, z_sd), explained)


@dataclass(frozen=True)
class _Masses:
    """What a mass at a body can be before anything is known.

    there  [kg] of the body itself, which is all that can be absent
    sd     [kg] standard deviation: the mass of the arm
    """

    there: float
    sd: float


@dataclass(frozen=True, eq=False)
class _Fit:
    """A point mass at a body, or none, and the own errors of each joint.

    point    (4,) [kg, m] mass and position, with sd if all windows were independent; zero without a mass
    factors  (n, 16) of all columns: own errors, body parameters, -1; weight (n,) inverse variance of each joint
    """

    body: int
    gains: bool
    point: Array
    sd: Array
    factors: Array
    weight: Array

    @staticmethod
    def of(train: Array, body: int, mass: _Masses | None, gains: bool, start: Array | None = None) -> _Fit:
        """The fit to blocks (B, n, bodies, 16, 16); without `mass` there is none, without `start` all are tried."""
        total = train[:, :, body].sum(axis=0)
        point, sd = np.zeros(4) if start is None else start, np.zeros(4)
        factors = _coefficients(total, _point_mass(point), gains)
        for _ in range(2):  # the second time with the weights of the first fit
            if mass is None:
                break
            weight = _weights(total, factors)
            reduced = np.einsum("i,ijk->jk", weight, np.stack([_reduced(each, gains) for each in total]))
            values, vectors = np.linalg.eigh(reduced)
            root = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
            starts = [point] if np.any(point) else _starts(root, mass)
            least = [-mass.there, *3 * [-np.inf]]
            fits = [
                least_squares(_error, each, args=(root, mass.sd), bounds=(least, np.inf), x_scale=[1.0, 0.1, 0.1, 0.1])
                for each in starts
            ]
            found = min(fits, key=lambda fit: float(fit.cost))
            point, sd = found.x, np.sqrt(np.diag(np.linalg.pinv(found.jac.T @ found.jac, hermitian=True)))
            factors = _coefficients(total, _point_mass(point), gains)
        return _Fit(body, gains, point, sd, factors, _weights(total, factors))

    def against(self, other: _Fit, test: Array) -> Array:
        """(B,) log of the squared error of every held-out block over that of the other fit; weights of this one."""
        own, its = (_losses(test[:, :, each.body], each.factors, self.weight) for each in (self, other))
        tiny = np.finfo(float).tiny  # blocks at rest have no error
        return np.asarray(np.log((own + tiny) / (its + tiny)))

    def jackknife(self, train: Array, mass: _Masses) -> Array:
        """(4,) standard deviations from the scatter between blocks, within which errors are not independent."""
        every = np.arange(len(train))
        left_out = [_Fit.of(train[every != b], self.body, mass, self.gains, self.point).point for b in every]
        return np.sqrt((len(every) - 1) * np.var(left_out, axis=0))


def _better(right: _Fit, wrong: _Fit, test: Array) -> _Fit:
    """The payload with right gains, or with wrong gains if that is significantly better."""
    return wrong if _exceeds(right.against(wrong, test) - NUMBERS.margin, NUMBERS.significance) else right


def _exceeds(differences: Array, significance: float) -> bool:
    """Whether the mean of differences (B,) between blocks is above zero: one-sided t test."""
    error = float(np.std(differences, ddof=1)) / np.sqrt(len(differences))
    return bool(np.mean(differences) > student.ppf(1.0 - significance, len(differences) - 1) * error)


def _starts(root: Array, mass: _Masses) -> list[Array]:
    """The STARTS positions of GRID with the least error, each with its best mass: the error has several minima."""
    columns = root[:, :-1] @ np.array([_point_mass(np.array([1.0, *place])) for place in GRID]).T
    weight = np.sum(columns**2, axis=0) + mass.sd**-2
    best = np.maximum(columns.T @ root[:, -1] / weight, -mass.there)
    error = np.sum((columns * best - root[:, -1:]) ** 2, axis=0) + (best / mass.sd) ** 2
    error += np.sum(GRID**2, axis=1) / REACH**2
    return [np.array([best[i], *GRID[i]]) for i in np.argsort(error)[:STARTS]]


def _error(point: Array, root: Array, mass: float) -> Array:
    """Whitened error of a point mass, and its distance from none at the joint."""
    return np.concatenate([root @ np.append(_point_mass(point), -1.0), [point[0] / mass], point[1:] / REACH])


def _point_mass(point: Array) -> Array:
    """Mass, first and second moments (10,) of a mass at a position, (4,) [kg, m], in pinocchio's order."""
    m, x, y, z = point
    return m * np.array([1.0, x, y, z, y * y + z * z, -x * y, x * x + z * z, -x * z, -y * z, x * x + y * y])


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


def _losses(grams: Array, factors: Array, weight: Array) -> Array:
    """(B,) mean whitened squared error of every block, from (B, n, 16, 16)."""
    squares = np.einsum("ij,bijk,ik->bi", factors, grams, factors)
    return squares @ weight / grams[:, :, 0, 0].sum(axis=1)


def _body_of(arm: Arm, joint: int) -> int:
    """Number in the model of the body that a joint of the arm moves."""
    return next(i for i, each in enumerate(arm.model.joints) if i and each.idx_v == arm.order[joint])


def _blocks(arm: Arm, run: Sequence[JointLog]) -> list[Array]:
    """Gram matrices (n, bodies, 16, 16) of the windows of each block of a recording; empty without any torque."""
    time = run[0].measured.time
    torques = [log.torque for log in run]
    if all(each is None for each in torques):
        return []
    drive = np.stack([np.full(len(time), np.nan) if each is None else each[:, 0] for each in torques], axis=1)
    angle = np.stack([log.measured["q"] for log in run], axis=1)
    q, v, a = smoothed_motion(time, angle, DEGREE)
    certain = norm.ppf(1.0 - 0.5 * NUMBERS.significance) * velocity_noise(time, angle, q, DEGREE)
    drive = np.where(np.abs(v) > certain, drive, np.nan)
    length = max(round(WINDOW / float(np.median(np.diff(time)))), 1)
    count = len(time) // length
    per_block = max(round(BLOCK / WINDOW), 1)
    rows = _rows(arm, drive, (q, v, a), length, count)
    made = (_grams(rows[:, first : first + per_block]) for first in range(0, count - per_block + 1, per_block))
    return [each for each in made if each[:, 0, 0, 0].any()]


def _grams(rows: Array) -> Array:
    """(n, bodies, 16, 16) from rows (n, windows, bodies, 16); those with NaN do not count."""
    usable = np.isfinite(rows).all(axis=-1, keepdims=True)
    kept = np.where(usable, rows, 0.0)
    return np.einsum("iwkp,iwkq->ikpq", kept, kept)


def _rows(arm: Arm, drive: Array, motion: tuple[Array, Array, Array], length: int, count: int) -> Array:
    """Averages (n, windows, bodies, 16) of all columns; NaN where a joint reverses or its torque `drive` is NaN."""
    q, v, a = motion
    n, used = q.shape[1], length * count
    model, data = arm.model, arm.model.createData()
    bodies = [BODY * (_body_of(arm, k) - 1) for k in range(n)]
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
    out = np.empty((n, count, n, OWN + BODY + 1))
    out[..., _Z], out[..., -1] = own[:, :, None], mean(missing)[:, :, None]
    velocity, acceleration = np.zeros(model.nv), np.zeros(model.nv)
    for w in range(count):
        total = np.zeros((model.nv, BODY * (model.njoints - 1)))
        for k in range(w * length, (w + 1) * length):
            velocity[arm.order], acceleration[arm.order] = v[k], a[k]
            total += pinocchio.computeJointTorqueRegressor(model, data, arm.configuration(q[k]), velocity, acceleration)
        for k, column in enumerate(bodies):
            out[:, w, k, _Y] = total[arm.order, column : column + BODY] / length
    out[~steady] = np.nan
    return out
