"""Standard deviations, errors and coverage of the device's default estimator on a motion, by simulation."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, sqrt

import numpy as np
from via_core.devices import Device
from via_core.metrics import WIDTH_95
from via_core.signals import Array, Signals
from via_core.status import Status
from via_estimators.contract import Estimates, Estimator
from via_estimators.methods import METHODS, method_for
from via_sim.plants import JointPlant
from via_sim.sensors import Sensors
from via_sim.simulate import InitialConditions, Simulation, simulate

from via_gap.design.commands import rate_of

LAST = 25  # estimates of a preset that are averaged: its last pass


@dataclass(frozen=True)
class Reached:
    """Outcome of one run at the end of a motion.

    stiffness_sd, damping_sd        relative, as the estimator states them; infinite where a preset was never OK
    error, truth                    (k,) of stiffness at the presets [N m/rad]
    sd                              (k,) stated
    damping_error                   (m,) relative
    """

    stiffness_sd: float
    damping_sd: float
    error: Array
    sd: Array
    truth: Array
    damping_error: Array
    damping_each: Array


@dataclass(frozen=True)
class Verification:
    """Outcome of several seeds.

    stiffness_sd, damping_sd            stated, root mean square over seeds
    stiffness_scatter, damping_scatter  root mean square error about the truth, relative as the standard deviations
    coverage, damping_coverage          share of errors within 95 % intervals
    used                                largest use of each limit in the simulated runs, 1 at the limit
    """

    method: str
    seeds: int
    stiffness_sd: float
    stiffness_scatter: float
    coverage: float
    damping_sd: float
    damping_scatter: float
    damping_coverage: float
    used: dict[str, float]


def preset_of(theta: Array, presets: Array) -> Array:
    """(N,) [rad] preset of motor angles (N, m); with one motor there is none, and every sample counts for the first."""
    return 0.5 * (theta[:, 0] - theta[:, 1]) if theta.shape[1] == 2 else np.full(len(theta), presets[0])


@dataclass(frozen=True, eq=False)
class Check:
    """Runs of a device's default estimator.

    device   with the noise of its sensors
    presets  (k,) [rad] at which stiffness is evaluated, one for a joint with one motor
    """

    device: Device
    presets: Array

    @property
    def method(self) -> str:
        return method_for(self.device)

    @property
    def estimator(self) -> Estimator:
        return METHODS[self.method].from_device(self.device)

    def run(self, commands: Signals, seed: int) -> tuple[Simulation, Estimates]:
        """Simulated measurements of commands and the estimates. Encoders start at a random place within their step."""
        rate, sensors = rate_of(self.device), Sensors.of_device(self.device)
        start = np.zeros(6)
        step = max(sensors.link_quantum, sensors.motor_quantum)
        start[: 1 + self.device.n_motors] = np.random.default_rng(seed).uniform(0.0, step, 1 + self.device.n_motors)
        simulation = simulate(
            JointPlant.from_device(self.device), commands, len(commands) / rate, rate, sensors,
            InitialConditions(start, seed=seed),
        )  # fmt: skip
        return simulation, self.estimator.run(simulation.measured)

    def reached(self, simulation: Simulation, estimates: Estimates, until: float = inf) -> Reached:
        """The last estimates at each preset up to a time [s]."""
        measured, truth = simulation.measured, simulation.truth.resample(simulation.measured.time)
        theta = measured["theta"]
        at = preset_of(theta, self.presets)
        value, sd = estimates.column("stiffness")
        good = (estimates.status == Status.OK) & (measured.time <= until)
        width = 0.5 * float(np.min(np.diff(self.presets))) if len(self.presets) > 1 else 0.1 * float(self.presets[0])
        rows = [np.flatnonzero(good & (np.abs(at - preset) <= width))[-LAST:] for preset in self.presets]
        if not all(len(each) for each in rows):
            nothing = np.full(len(self.presets), inf)
            m = theta.shape[1]
            return Reached(inf, inf, nothing, nothing, nothing, np.full(m, inf), np.full(m, inf))
        true = truth["stiffness"]
        error = np.array([np.mean(value[each] - true[each]) for each in rows])
        stated, real = np.array([np.mean(sd[each]) for each in rows]), np.array([np.mean(true[each]) for each in rows])
        last = np.flatnonzero(good)[-1]
        columns = [estimates.column(f"motor_damping_{i + 1}") for i in range(len(self.device.springs))]
        friction = np.array([max(motor.viscous_friction, 1e-6) for motor in self.device.torque_motors])[: len(columns)]
        damping = np.array([x[last] for x, _ in columns]) / friction - 1.0
        each = np.array([s[last] for _, s in columns]) / friction
        relative = sqrt(float(np.mean(stated**2) / np.mean(real**2)))
        return Reached(relative, float(each.max()), error, stated, real, damping, each)

    def verified(self, commands: Signals, seeds: int, limits: dict[str, Array]) -> Verification:
        """Outcome of several seeds of one motion."""
        found, used = [], dict.fromkeys(limits, 0.0)
        for seed in range(1, seeds + 1):
            simulation, estimates = self.run(commands, seed)
            found.append(self.reached(simulation, estimates))
            n, truth = len(self.device.springs), simulation.truth
            most = {
                "deflection": np.abs(truth["q"][:, None] - truth["theta"][:, :n]).max(axis=0),
                "speed": np.abs(truth["theta_velocity"]).max(axis=0),
                "torque": np.abs(commands["motor"]).max(axis=0),
            }
            used = {name: max(used[name], float(np.max(most[name] / limits[name]))) for name in limits}
        error, sd, truth_each = (np.array([getattr(each, name) for each in found]) for name in ("error", "sd", "truth"))
        damping, each_sd = (
            np.array([getattr(each, name) for each in found]) for name in ("damping_error", "damping_each")
        )
        scale = np.mean(truth_each**2)
        return Verification(
            self.method,
            seeds,
            sqrt(float(np.mean(sd**2) / scale)),
            sqrt(float(np.mean(error**2) / scale)),
            float(np.mean(np.abs(error) <= WIDTH_95 * sd)),
            sqrt(float(np.mean(each_sd**2))),
            sqrt(float(np.mean(damping**2))),
            float(np.mean(np.abs(damping) <= WIDTH_95 * each_sd)),
            used,
        )
