"""Which quantities of a joint the measured signals determine, and how well: Fisher information of its torque equations.

Model. In each window k an equation of `joint_equations` has the residual r_k = f_k' x - y_k. Sensor samples have
independent noise n_c of standard deviation s_c. To first order in the noise, at the true x,

    r_k = sum_c (G_c n_c)_k,    G_c = sum_j x_j df_j/dn_c - dy/dn_c,    C = sum_c s_c^2 G_c G_c'

so that torque noise enters through <n, psi>, and encoder noise through B <n, psi''> - D <n, psi'> - sigma <n, psi>: no
velocity or acceleration is computed, and the weights of overlapping windows give the exact correlation of their noise.
Equations share the noise of the angles, so they are stacked. For Gaussian noise the information about x is

    J = A' C^-1 A,       A = (f_1, f_2, ..)',

and no unbiased estimator has a covariance below J^-1 (Cramer-Rao bound; G. C. Goodwin and R. L. Payne, Dynamic System
Identification: Experiment Design and Data Analysis, 1977). Four windows per window length
contain the information up to the frequencies that a window passes.

Noise in A counts as motion: measured with A + dA, J is too large by E = E[dA' C^-1 dA], which is known. In a direction
without any motion, v' J v is chi-square distributed with N degrees of freedom and mean v' E v; its standard deviation
is (2/N)^(1/2) of that mean. For measured signals

    J = A' C^-1 A - (1 + 2 (2/N)^(1/2)) E,      negative eigenvalues set to 0,

is therefore a bound that noise alone exceeds in 2.5 % of the cases. Simulated signals without noise need none.

Equations whose right side is zero determine their unknowns up to a common factor: x itself is without information.
That holds exactly, whatever the noise and the discretisation, and is imposed on J (`_scales`).

A model that does not explain the signals has larger residuals than C. C of each equation is multiplied by the reduced
chi-square of its own fit where that exceeds 1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf, sqrt

import numpy as np
from scipy import linalg, sparse
from via_core.devices import Device
from via_core.errors import SignalError
from via_core.signals import Array

from via_estimators import window
from via_estimators.joint_equations import BEND, HELD, PSI, SLOPE, Equation, Part, Unknown, equations_of
from via_estimators.joint_record import Record

SPAN = 0.2  # [s] window
FEWEST = 20  # sampling intervals per window at least
ORDER = 5  # of the modulating function
OVERLAP = 4  # windows per window length
CHUNK = 60  # windows whose noise is treated together; that of neighbouring chunks counts as independent
DETERMINED = 1.0  # relative standard deviation below which a direction counts in the rank
NEVER = 1e-6  # eigenvalue of J for directions without information: a relative standard deviation of 1000


@dataclass(frozen=True, eq=False)
class Information:
    """Fisher information about the unknowns, in units of their sizes.

    matrix  (p, p)
    misfit  of each equation: standard deviation of its residuals over that which sensor noise explains, at least 1
    windows number of windows
    """

    unknowns: tuple[Unknown, ...]
    matrix: Array
    misfit: dict[str, float]
    windows: int

    @cached_property
    def _eigen(self) -> tuple[Array, Array]:
        values, vectors = linalg.eigh(self.matrix)
        return np.maximum(values, 0.0), vectors

    @property
    def rank(self) -> int:
        """Number of independent combinations of unknowns with a relative standard deviation below DETERMINED."""
        return int(np.sum(self._eigen[0] > DETERMINED**-2))

    @property
    def condition(self) -> float:
        """Condition number of J in units of the sizes; infinite without full rank."""
        values = self._eigen[0]
        return float(values[-1] / values[0]) if len(values) and values[0] > NEVER else inf

    @cached_property
    def covariance(self) -> Array:
        """J^-1 (p, p), in units of the sizes; directions without information have a variance of 1 / NEVER."""
        values, vectors = self._eigen
        return np.asarray((vectors / np.maximum(values, NEVER)) @ vectors.T)

    def standard_deviation(self, name: str) -> float:
        """Standard deviation of an unknown in its unit, from the signals alone."""
        at = self._at(name)
        return sqrt(self.covariance[at, at]) * self.unknowns[at].size

    def with_file(self, name: str) -> float:
        """The same if the device file's tolerances hold for all other quantities, the same spring's excepted."""
        at = self._at(name)
        own, known = self.unknowns[at], np.zeros(len(self.unknowns))
        for j, other in enumerate(self.unknowns):
            if j != at and not (own.part == other.part and own.part.startswith("spring")):
                known[j] = (other.tolerance * (abs(other.value) / other.size or 1.0)) ** -2
        extended = replace(self, matrix=self.matrix + np.diag(known))
        return sqrt(extended.covariance[at, at]) * self.unknowns[at].size

    def stiffness(self, spring: int, phi: Array) -> Array:
        """Covariance (k, k) [(N m/rad)^2] of the stiffness of spring 1 or 2 at deflections phi (k,) [rad]."""
        slope = self.stiffness_slope(spring, phi)
        return np.asarray(slope @ self.covariance @ slope.T)

    def stiffness_slope(self, spring: int, phi: Array) -> Array:
        """Derivative (k, p) of that stiffness by the unknowns in units of their sizes."""
        nodes = [(j, each) for j, each in enumerate(self.unknowns) if each.part == f"spring {spring}"]
        slope = np.zeros((len(phi), len(self.unknowns)))
        at = np.array([each.deflection for _, each in nodes if each.deflection is not None], dtype=np.float64)
        odd = len(at) == len(nodes)  # without a torque at rest the powers are even in the stiffness
        base, there = (at**2, np.asarray(phi) ** 2) if odd else (at, np.asarray(phi))
        for k, (j, unknown) in enumerate((j, each) for j, each in nodes if each.deflection is not None):
            others = np.delete(base, k)
            slope[:, j] = np.prod((there[:, None] - others) / (base[k] - others), axis=1) * unknown.size
        return slope

    def weak(self) -> list[dict[str, float]]:
        """Directions that the signals do not determine: the shares of their unknowns, the largest 1."""
        values, vectors = self._eigen
        found = []
        for column in np.flatnonzero(values <= DETERMINED**-2):
            v = vectors[:, column] / np.abs(vectors[:, column]).max()
            found.append({self.unknowns[j].name: float(v[j]) for j in np.flatnonzero(np.abs(v) > 0.1)})
        return found

    def _at(self, name: str) -> int:
        return [each.name for each in self.unknowns].index(name)


def information_of(device: Device, record: Record, noisy: bool, only: Sequence[str] = ()) -> Information:
    """Information in the samples of a record.

    noisy  whether the samples have sensor noise (a log) or not (a simulation with ideal sensors)
    only   names of the equations to use; empty: all

    Raises SignalError if no window fits, ParameterError without the link angle.
    """
    made = equations_of(device, record)
    equations = [each for each in made.equations if not only or each.name in only]
    used = {name for each in equations for name in each.unknown}
    unknowns = tuple(each for each in made.unknowns if each.name in used)
    p = len(unknowns)
    if not unknowns:
        raise SignalError(
            f"{', '.join(record.channels)}: no equation of '{device.name}' can be evaluated with these signals; "
            f"measure all motor angles, or the torque of a rigid joint's drive"
        )
    chunks = [_Chunk.of(equations, unknowns, record, starts, noisy) for starts in _windows(record.time)]
    if not chunks:
        raise SignalError(f"no window of {SPAN:g} s without gaps: {len(record.time)} samples")
    misfit = _misfit(equations, unknowns, chunks) if noisy else {each.name: 1.0 for each in equations}
    scale = np.array([misfit[each.name] for each in equations])
    matrix, excess, count = np.zeros((p, p)), np.zeros((p, p)), 0
    for chunk in chunks:
        weight = np.repeat(scale, chunk.windows)
        factor = linalg.cho_factor(chunk.covariance * np.outer(weight, weight), lower=True)
        matrix += chunk.regressors.T @ linalg.cho_solve(factor, chunk.regressors)
        count += chunk.windows
        if noisy:
            inverse = linalg.cho_solve(factor, np.eye(len(weight)))
            excess += chunk.excess(inverse)
    if noisy:
        matrix = matrix - (1.0 + 2.0 * sqrt(2.0 / max(count * len(equations), 1))) * excess
    for free in _scales(equations, unknowns):
        keep = np.eye(p) - np.outer(free, free)
        matrix = keep @ matrix @ keep
    values, vectors = linalg.eigh(0.5 * (matrix + matrix.T))
    return Information(unknowns, (vectors * np.maximum(values, 0.0)) @ vectors.T, misfit, count)


def _scales(equations: Sequence[Equation], unknowns: Sequence[Unknown]) -> list[Array]:
    """Unit vectors (p,), in units of the sizes, of unknowns that only equations without a right side contain."""
    groups: list[tuple[set[str], bool]] = []  # unknowns that equations connect, and whether all right sides are zero
    for equation in equations:
        names, free = set(equation.unknown), not any(np.any(part.values) for part in equation.known)
        for other in [each for each in groups if each[0] & names]:
            names, free = names | other[0], free and other[1]
            groups.remove(other)
        groups.append((names, free))
    found = [
        np.array([each.value / each.size if each.name in names else 0.0 for each in unknowns])
        for names, free in groups
        if free and names
    ]
    return [each / np.linalg.norm(each) for each in found]


@dataclass(frozen=True, eq=False)
class _Chunk:
    """Consecutive windows of all equations, E equations with R windows each, stacked.

    regressors  (E R, p) A in units of the sizes
    known       (E R,) y - A x of the device file
    covariance  (E R, E R) C
    gains       of each unknown and equation: noise gain in units of the noise by channel, sparse (R, samples)
    """

    windows: int
    regressors: Array
    known: Array
    covariance: Array
    gains: list[list[_Gain]]

    @classmethod
    def of(
        cls, equations: Sequence[Equation], unknowns: Sequence[Unknown], record: Record, starts: tuple[int, Array],
        noisy: bool,
    ) -> _Chunk:  # fmt: skip
        weights, first, last = _weights(record.time, *starts)
        samples, R = slice(first, last), weights[PSI].shape[0]
        regressors, known = np.zeros((len(equations) * R, len(unknowns))), np.zeros(len(equations) * R)
        total: list[_Gain] = []
        gains: list[list[_Gain]] = [[{} for _ in equations] for _ in unknowns]
        for at, equation in enumerate(equations):
            block, sums = slice(at * R, (at + 1) * R), _Sums(record.noise, samples)
            for part in equation.known:
                known[block] += part.factor * (weights[part.weights] @ part.values[samples])
                sums.add(part, -1.0)
            for j, unknown in enumerate(unknowns):
                own = _Sums(record.noise, samples)
                for part in equation.unknown.get(unknown.name, ()):
                    values = weights[part.weights] @ part.values[samples]
                    regressors[block, j] += unknown.size * part.factor * values
                    sums.add(part, unknown.value)
                    own.add(part, unknown.size)
                gains[j][at] = own.gain(weights) if noisy else {}
            total.append(sums.gain(weights))
        known -= regressors @ np.array([each.value / each.size for each in unknowns])
        covariance = np.zeros((len(known), len(known)))
        for k, one in enumerate(total):
            for m, other in enumerate(total[: k + 1]):
                for channel in one.keys() & other.keys():
                    shared = (one[channel] @ other[channel].T).toarray()
                    covariance[k * R : (k + 1) * R, m * R : (m + 1) * R] += shared
        covariance = np.tril(covariance) + np.tril(covariance, -1).T
        diagonal = np.diag(covariance)
        covariance[np.diag_indices(len(known))] += 1e-9 * diagonal + 1e-15 * diagonal.mean() + 1e-30
        return cls(R, regressors, known, covariance, gains)

    def excess(self, inverse: Array) -> Array:
        """E[dA' C^-1 dA] (p, p)."""
        p, R = len(self.gains), self.windows
        found = np.zeros((p, p))
        blocks = [(j, k, each) for j, own in enumerate(self.gains) for k, each in enumerate(own) if each]
        for i, k, one in blocks:
            for j, m, other in blocks:
                for channel in (one.keys() & other.keys()) if j <= i else ():
                    product = (one[channel] @ other[channel].T).tocoo()
                    found[i, j] += float(product.data @ inverse[k * R + product.row, m * R + product.col])
        return np.asarray(found + np.tril(found, -1).T)


_Gain = dict[str, sparse.csr_array]  # by channel, times the noise of the channel


class _Sums:
    """Sum of parts' slopes by channel and weights, so that each needs one product with the weights."""

    def __init__(self, noise: Mapping[str, float], samples: slice) -> None:
        self.noise, self.samples = noise, samples
        self.slopes: dict[str, dict[int, Array]] = {}

    def add(self, part: Part, share: float) -> None:
        for channel, slope in part.slopes.items():
            scaled = share * part.factor * self.noise.get(channel, 0.0) * slope[self.samples]
            own = self.slopes.setdefault(channel, {})
            own[part.weights] = own[part.weights] + scaled if part.weights in own else scaled

    def gain(self, weights: Sequence[sparse.csr_array]) -> _Gain:
        found: _Gain = {}
        for channel, own in self.slopes.items():
            if not any(np.any(slope) for slope in own.values()):
                continue
            data = sum(weights[w].data * slope[weights[w].indices] for w, slope in own.items())
            shape = weights[PSI]
            found[channel] = sparse.csr_array((data, shape.indices, shape.indptr), shape=shape.shape)
        return found


def _misfit(equations: Sequence[Equation], unknowns: Sequence[Unknown], chunks: Sequence[_Chunk]) -> dict[str, float]:
    """Residuals of each equation's own weighted fit over their noise; the device file is a prior of one size."""
    found: dict[str, float] = {}
    for at, equation in enumerate(equations):
        own = [j for j, each in enumerate(unknowns) if each.name in equation.unknown]
        rows_of, sides = [], []
        for chunk in chunks:
            block = slice(at * chunk.windows, (at + 1) * chunk.windows)
            factor = linalg.cholesky(chunk.covariance[block, block], lower=True)
            rows_of.append(linalg.solve_triangular(factor, chunk.regressors[block][:, own], lower=True))
            sides.append(linalg.solve_triangular(factor, chunk.known[block], lower=True))
        A, y = np.vstack(rows_of), np.concatenate(sides)
        x = np.linalg.solve(A.T @ A + np.eye(len(own)), A.T @ y)
        spare = max(len(y) - len(own), 1)
        found[equation.name] = sqrt(max(float(np.sum((y - A @ x) ** 2)) / spare, 1.0))
    return found


def _windows(time: Array) -> list[tuple[int, Array]]:
    """Length in samples and first samples of the windows of each chunk; no window contains a gap."""
    if len(time) < 3:
        return []
    period = float(np.median(np.diff(time)))
    length = max(round(SPAN / period), FEWEST) + 1
    step = max((length - 1) // OVERLAP, 1)
    breaks = np.flatnonzero(np.diff(time) > 5.5 * period) + 1
    found = []
    for low, high in zip(np.r_[0, breaks], np.r_[breaks, len(time)], strict=True):
        starts = np.arange(low, high - length + 1, step)
        found += [(length, starts[k : k + CHUNK]) for k in range(0, len(starts), CHUNK)]
    return [each for each in found if len(each[1])]


def _weights(time: Array, length: int, starts: Array) -> tuple[list[sparse.csr_array], int, int]:
    """Sparse weights (R, samples) of PSI, SLOPE, BEND and HELD, with the first and the last + 1 sample."""
    first, last = int(starts[0]), int(starts[-1]) + length
    data = np.empty((4, len(starts), length))
    psi, held = np.empty((3, length)), np.empty(length)
    for k, start in enumerate(starts):
        stamps = np.ascontiguousarray(time[start : start + length])
        window.weigh(ORDER, stamps - stamps[0], length - 1, psi, held)
        data[[PSI, SLOPE, BEND], k], data[HELD, k] = psi, held
    columns = (starts[:, None] - first + np.arange(length)).ravel()
    pointers = np.arange(len(starts) + 1) * length
    shape = (len(starts), last - first)
    return [sparse.csr_array((each.ravel(), columns, pointers), shape=shape) for each in data], first, last
