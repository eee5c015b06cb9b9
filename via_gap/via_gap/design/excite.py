"""The shortest motion that determines stiffness or damping to a wanted standard deviation, within the device's limits.

Sources: finite Fourier series as excitation, J. Swevers et al., Optimal robot excitation and identification, IEEE
Transactions on Robotics and Automation 13 (1997); the information matrix as the object of design, G. C. Goodwin and
R. L. Payne, Dynamic System Identification: Experiment Design and Data Analysis (1977).

Motors follow theta = (x + s, x - s) (one motor: theta = x) with

    x(t) = f(t) sum_k (a_k sin k w t + b_k cos k w t),   s(t) = f(t) (s_0 + sum_k (c_k sin k w t + d_k cos k w t))

where f rises from 0 and falls back to 0, so that the motion begins and ends at rest. The link follows from the nominal
model, the torques from the equations of the motors (`prescribed`). The Fisher information of the motors' equations then
predicts every standard deviation (`via_estimators.observability`). The search minimises the largest ratio of predicted
to wanted standard deviation over w, s_0 and the coefficients, at a given duration. A candidate beyond a limit is made
smaller until it keeps all limits. The duration is the shortest for which the device's default estimator states the
wanted standard deviations on simulated measurements of that motion (`excite_design`); search and duration alternate.

Departure from the sources: they minimise the condition number or maximise the determinant of the information; here the
criterion is the standard deviation that the user specifies, over the presets of the working range.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf, pi, sqrt

import numpy as np
from via_controllers.supervision.arm_limits import ArmLimits
from via_controllers.supervision.joint_supervision import REACH
from via_core.devices import Device
from via_core.errors import ParameterError
from via_core.signals import Array
from via_estimators.joint_record import Record
from via_estimators.observability import Information, information_of

from via_gap.design.observed import declared_noise
from via_gap.design.prescribed import Prescribed, prescribed

HARMONICS = 4
RATE = 250.0  # [Hz] of candidates: far above the frequencies of the motion
FADE = 0.4  # [s] of rise and fall
SLOWEST, FASTEST = 0.15, 2.0  # [Hz] of the first harmonic
RESERVE = 0.8  # of the torque limit, for the spring alone, in the working range
LOWEST, HIGHEST = 0.25, 0.9  # of the largest deflection: the working range of presets
PRESETS = 8  # at which stiffness is evaluated
SMALLER = 0.9  # factor of a candidate's size until it keeps the limits


@dataclass(frozen=True)
class Goal:
    """What a motion is to reach.

    stiffness_sd  relative standard deviation of the joint's stiffness, root mean square over the presets; None: any
    damping_sd    relative standard deviation of the motors' viscous friction; None: any
    preset        [rad] at which stiffness is wanted; None: over the working range
    """

    stiffness_sd: float | None = 0.02
    damping_sd: float | None = None
    preset: float | None = None


@dataclass(frozen=True)
class Effort:
    """Number of candidates of the random and of the local search, and the seed of both."""

    starts: int = 40
    steps: int = 80
    seed: int = 1


@dataclass(frozen=True)
class Limits:
    """Limits of motion: (m,) each; infinite where the device file has none.

    deflection  [rad], speed [rad/s] and torque [N m] that a designed motion may use
    reach       [rad] largest deflection of the working range
    """

    deflection: Array
    speed: Array
    torque: Array
    reach: float

    @classmethod
    def of(cls, device: Device, margin: float) -> Limits:
        """A share `margin` of what the supervisor of the `excitation` node lets a controller use."""
        motors = device.torque_motors
        if not motors or not device.springs:
            raise ParameterError(
                f"'{device.name}' ({device.arrangement}, {device.drive} drive) has no torque motors on springs, whose "
                f"motion via excite designs; `via observe {device.name}` shows what its signals determine"
            )
        torque = np.array([motor.torque_limit or inf for motor in motors])
        speed = np.array([motor.speed_limit or inf for motor in motors])
        stops = np.array([spring.max_deflection for spring in device.springs])
        share = np.linspace(0.0, 1.0, 400)[1:]
        reaches = []
        for spring, most in zip(device.springs, torque, strict=False):
            tau = np.maximum(
                np.abs(spring.torque(share * spring.max_deflection)),
                np.abs(spring.torque(-share * spring.max_deflection)),
            )
            kept = share[tau <= RESERVE * margin * most]
            reaches.append(float(kept[-1]) * spring.max_deflection if len(kept) else 0.0)
        reach = min(*reaches, *(margin * REACH * stops))
        return cls(margin * REACH * stops, margin * ArmLimits.drive_share * speed, margin * torque, reach)

    def exceeded(self, motion: Prescribed) -> dict[str, float]:
        """Largest use of each limit, 1 at the limit."""
        n = len(self.deflection)
        phi = np.abs(motion.q[:, None] - motion.theta[:, :n]).max(axis=0)
        return {
            "deflection": float(np.max(phi / self.deflection)),
            "speed": float(np.max(np.abs(motion.theta_velocity).max(axis=0) / self.speed)),
            "torque": float(np.max(np.abs(motion.torque).max(axis=0) / self.torque)),
        }

    @property
    def by_name(self) -> dict[str, Array]:
        """The limits (m,) by their names."""
        return {"deflection": self.deflection, "speed": self.speed, "torque": self.torque}


@dataclass(frozen=True, eq=False)
class Series:
    """Parameters of a motion.

    frequency     [Hz] of the first harmonic
    mean          [rad] s_0
    coefficients  (2, 2, HARMONICS) [rad]: of x and s, of sine and cosine
    """

    frequency: float
    mean: float
    coefficients: Array

    def angles(self, time: Array, motors: int) -> Array:
        """theta (N, m) [rad]; the motion fills the time."""
        share = np.clip(np.minimum(time, time[-1] - time) / FADE, 0.0, 1.0)
        fade = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
        phase = 2.0 * pi * self.frequency * time[:, None] * np.arange(1, HARMONICS + 1)
        waves = [np.sin(phase) @ each[0] + np.cos(phase) @ each[1] for each in self.coefficients]
        x, s = fade * waves[0], fade * (self.mean + waves[1])
        return np.column_stack([x + s, x - s]) if motors == 2 else x[:, None]

    def scaled(self, factor: float) -> Series:
        """Smaller swings about the same mean."""
        return replace(self, coefficients=factor * self.coefficients)


@dataclass(frozen=True, eq=False)
class Candidate:
    """A series that keeps the limits, and its score: the largest ratio of predicted to wanted standard deviation."""

    series: Series
    score: float
    stiffness_sd: float
    damping_sd: float


@dataclass(frozen=True, eq=False)
class Problem:
    """Device with the noise of its sensors, limits and goal of a search."""

    device: Device
    limits: Limits
    goal: Goal
    noise: dict[str, float]

    @classmethod
    def of(cls, device: Device, goal: Goal, margin: float, torque_noise: float) -> Problem:
        return cls(device, Limits.of(device, margin), goal, declared_noise(device, torque_noise))

    @property
    def presets(self) -> Array:
        """(k,) [rad] at which stiffness is evaluated; of a joint with one motor, deflections."""
        if self.goal.preset is not None:
            if not 0.0 < self.goal.preset <= self.limits.reach:
                raise ParameterError(f"preset must lie in (0, {self.limits.reach:.3g}] rad, got {self.goal.preset:g}")
            return np.array([self.goal.preset])
        return self.limits.reach * np.linspace(LOWEST, HIGHEST, PRESETS)

    def motion(self, series: Series, duration: float, rate: float) -> Prescribed:
        """The motion of a series."""
        time = np.arange(round(duration * rate) + 1) / rate
        return prescribed(self.device, time, series.angles(time, self.device.n_motors))

    def fitted(self, series: Series, duration: float) -> Series | None:
        """The series, made smaller until it keeps all limits; None if even a tenth does not."""
        for _ in range(22):
            used = self.limits.exceeded(self.motion(series, duration, RATE))
            if all(np.isfinite(list(used.values()))) and max(used.values()) <= 1.0:
                return series
            series = series.scaled(SMALLER)
        return None

    def candidate(self, series: Series, duration: float) -> Candidate | None:
        """The series within the limits, with its predicted standard deviations."""
        kept = self.fitted(series, duration)
        if kept is None:
            return None
        information = self.information(self.motion(kept, duration, RATE))
        stiffness, damping = self.stiffness_sd(information), self.damping_sd(information)
        score = max(stiffness / (self.goal.stiffness_sd or inf), damping / (self.goal.damping_sd or inf))
        return Candidate(kept, score, stiffness, damping)

    def information(self, motion: Prescribed) -> Information:
        """Information of the motors' equations. A sample every 1/RATE represents several, whose noise averages."""
        m, average = self.device.n_motors, sqrt(RATE / self.device.sensors.rate)
        channels = {"q": motion.q}
        for i in range(m):
            channels |= {f"theta_{i + 1}": motion.theta[:, i], f"tau_{i + 1}": motion.torque[:, i]}
        noise = {name: average * sd for name, sd in self.noise.items()}
        record = Record(motion.time, channels, {}, noise)
        return information_of(self.device, record, noisy=False, only=[f"motor {i + 1}" for i in range(m)])

    def stiffness_sd(self, information: Information) -> float:
        """Predicted relative standard deviation, root mean square over the presets."""
        slope = np.zeros((len(self.presets), len(information.unknowns)))
        sigma = np.zeros(len(self.presets))
        for i, spring in enumerate(self.device.springs):
            phi = self.presets * (1.0 if i else -1.0)  # theta = (s, -s) at q = 0
            slope += information.stiffness_slope(i + 1, phi)
            sigma += spring.stiffness(phi)
        variance = np.einsum("ij,jk,ik->i", slope, information.covariance, slope)
        return sqrt(float(np.mean(variance)) / float(np.mean(sigma**2)))

    def damping_sd(self, information: Information) -> float:
        """Predicted relative standard deviation of viscous friction, the worse motor's."""
        names = [f"viscous friction of motor {i + 1}" for i in range(self.device.n_motors)]
        sizes = {each.name: each.size for each in information.unknowns}
        return max(information.standard_deviation(name) / sizes[name] for name in names)


def search(problem: Problem, duration: float, effort: Effort, start: Series | None = None) -> Candidate:
    """The best series for a duration [s]: random starts, then random steps that shrink.

    Raises ParameterError if none keeps the limits.
    """
    random = np.random.default_rng(effort.seed)
    tried = [] if start is None else [start]
    tried += [_drawn(problem, random) for _ in range(effort.starts if start is None else effort.starts // 4)]
    found = [each for each in (problem.candidate(series, duration) for series in tried) if each is not None]
    if not found:
        raise ParameterError(f"no motion of '{problem.device.name}' keeps its limits")
    best, size = min(found, key=lambda each: each.score), 0.5
    for _ in range(effort.steps):
        series = best.series
        scale = problem.limits.reach / HARMONICS
        step = Series(
            float(np.clip(series.frequency * np.exp(size * random.normal() * 0.5), SLOWEST, FASTEST)),
            float(
                np.clip(series.mean + size * 0.3 * problem.limits.reach * random.normal(), 0.0, problem.limits.reach)
            ),
            series.coefficients + size * scale * random.normal(size=series.coefficients.shape),
        )
        tested = problem.candidate(step, duration)
        better = tested is not None and tested.score < best.score
        best = tested if better and tested is not None else best
        size = min(size * 1.3, 1.0) if better else max(size * 0.95, 0.05)
    return best


def _drawn(problem: Problem, random: np.random.Generator) -> Series:
    """A random series of the size of the working range."""
    reach, one = problem.limits.reach, problem.device.n_motors == 1
    shape = random.normal(size=(2, 2, HARMONICS)) * random.uniform(0.1, 1.0, size=(2, 1, HARMONICS))
    shape *= reach * random.uniform(0.2, 0.6) / np.linalg.norm(shape, axis=(1, 2), keepdims=True)
    if one:
        shape[1] = 0.0
    middle = 0.0 if one else float(random.uniform(0.3, 0.7)) * reach
    return Series(float(np.exp(random.uniform(np.log(SLOWEST), np.log(FASTEST)))), middle, shape)
