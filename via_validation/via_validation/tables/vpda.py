"""The document's damping experiments (Section 5.2) in simulation: a hand moves the link while the motor stands still.

Values that are not printed were chosen (estimation.md): velocity 1.5 sin(2 pi .5 t) plus .4 sin(2 pi 1.3 t + 1) rad/s
after a .3 s ramp, Stribeck friction .3 N m at breakaway and .1 N m at speed (falling over .05 rad/s), torque noise
.05 N m, 16 bit, 1 kHz. The hand applies the torque that this velocity needs; the motion is not prescribed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from via_core.devices import Device, load_device
from via_core.signals import Array, Signals
from via_estimators.contract import Estimates
from via_sim.effects import Effect
from via_sim.plants import JointPlant
from via_sim.sensors import Sensors
from via_sim.simulate import InitialConditions, Simulation, simulate

DEVICE = "compact_vpda"
DURATION = 20.0  # [s]
RATE = 1000.0  # [Hz]
CONVERGED = 1.0  # [s] after which errors count
PRIOR_FORGOTTEN = 4.0  # [s] after which standard deviations count; the prior is forgotten by then, with friction too
CONSTANT = 3.0  # [N m s/rad]
KINETIC = 0.1  # [N m]
STANDSTILL = (6.0, 12.0)  # [s] rest of the hand, if any
SETTINGS = (
    "compact_vpda, 20 s at 1 kHz, velocity 1.5 sin(2 pi .5 t) + .4 sin(2 pi 1.3 t + 1) rad/s, torque noise .05 N m, "
    "16 bit, errors from 1 s on, standard deviations from 4 s on"
)


@dataclass(frozen=True)
class Experiment:
    """One of the document's experiments, or a variation."""

    name: str
    title: str
    varying: bool  # damping of eq. (80), else constant
    stribeck: float  # [rad/s] velocity of the Stribeck friction in the clutch; 0 without friction
    rests: bool = False  # the hand rests for 6 s
    constant: float = CONSTANT  # [N m s/rad] of the damper unless it varies
    bend: float = 0.0  # [N m s^3/rad^3] D(v) = D + bend v^2
    offset: float = 0.0  # [N m] of the torque sensor

    def damping(self, time: Array) -> Array:
        """Commanded damping (N,) [N m s/rad]."""
        if not self.varying:
            return np.full_like(time, self.constant)
        return 1.0 + 1.4 * np.sin(0.05 * np.pi * time) ** 2 + 1.7 * np.sin(0.1 * np.pi * time) ** 2  # (80)

    def run(self, seed: int) -> Simulation:
        """Measured and true signals of one realisation."""
        device = load_device(DEVICE)
        time = np.arange(round(DURATION * RATE)) / RATE
        slow, fast = 2.0 * np.pi * 0.5, 2.0 * np.pi * 1.3
        velocity = 1.5 * np.sin(slow * time) + 0.4 * np.sin(fast * time + 1.0)
        acceleration = 1.5 * slow * np.cos(slow * time) + 0.4 * fast * np.cos(fast * time + 1.0)
        damping = self.damping(time)
        dry = KINETIC * np.tanh(velocity / 0.05) if self.stribeck > 0.0 else 0.0
        torque = device.link.inertia * acceleration + (damping + device.link.viscous_friction) * velocity + dry
        torque *= np.clip(time / 0.3, 0.0, 1.0)
        if self.rests:
            torque[(time >= STANDSTILL[0]) & (time < STANDSTILL[1])] = 0.0
        channels = {"external_torque": torque, "damping": _command(device, damping)}
        commands = Signals(time, channels, {"external_torque": "N m", "damping": "-"}, frozenset(channels))
        friction = {"breakaway": 0.3, "kinetic": KINETIC, "velocity": self.stribeck}
        effects = [Effect("stribeck_friction", "link", friction)] if self.stribeck > 0.0 else []
        plant, sensors = JointPlant.from_device(device), Sensors.of_device(device)
        run = simulate(plant.with_effects(effects), commands, DURATION, RATE, sensors, InitialConditions(seed=seed))
        return self._bent(run)

    def _bent(self, run: Simulation) -> Simulation:
        """The run with the cubic part of the damper's torque, which the hand overcomes too, and the sensor's offset."""
        velocity = run.truth["q_velocity"]
        more = self.bend * velocity**3 / 3.0
        measured = {**run.measured.channels, "tau_link": run.measured["tau_link"] + more + self.offset}
        truth = {**run.truth.channels, "damping": run.truth["damping"] + self.bend * velocity**2}
        return Simulation(replace(run.measured, channels=measured), replace(run.truth, channels=truth))


EXPERIMENTS = (
    Experiment("constant", "D = 3 N m s/rad", False, 0.0),
    Experiment("varying", "D(t) of eq. (80)", True, 0.0),
    Experiment("constant_stribeck", "D = 3 N m s/rad, Stribeck .3/.1 N m", False, 0.05),
    Experiment("varying_stribeck", "D(t) of eq. (80), Stribeck .3/.1 N m", True, 0.05),
)
RESTING = Experiment("standstill", "D = 3 N m s/rad, 6 s of standstill", False, 0.0, rests=True)


def _variations() -> tuple[Experiment, ...]:
    """Experiments that no parameter of an estimator was chosen for, with constant and with varying damping."""
    found = []
    for varying, damper in ((False, "D = {:g} N m s/rad"), (True, "D(t) of eq. (80)")):
        name = "varying" if varying else "constant"
        for velocity in (0.02, 0.2, 0.5):
            title = f"{damper.format(CONSTANT)}, Stribeck .3/.1 N m over {velocity:g} rad/s"
            found.append(Experiment(f"{name}_stribeck_{velocity:g}".replace("0.", ""), title, varying, velocity))
        curved = f"{damper.format(2)} + .9 v^2"
        bent = Experiment(f"{name}_bend", curved, varying, 0.0, constant=2.0, bend=0.9)
        found += [
            bent,
            Experiment(f"{name}_offset", f"{damper.format(CONSTANT)}, torque offset .1 N m", varying, 0.0, offset=0.1),
        ]
        for velocity in (0.05, 0.2, 0.5):
            title = f"{curved}, torque offset .1 N m, Stribeck .3/.1 N m over {velocity:g} rad/s"
            at = f"{name}_all_{velocity:g}".replace("0.", "")
            found.append(replace(bent, name=at, title=title, stribeck=velocity, offset=0.1))
    return tuple(found)


VARIATIONS = _variations()


@dataclass(frozen=True)
class DampingErrors:
    """Errors of one estimator in one run."""

    mean: float  # [-] relative error
    largest: float  # [-]
    empirical: float  # [N m s/rad] root mean square error, after PRIOR_FORGOTTEN
    reported: float  # [N m s/rad] root mean square of the standard deviations, after PRIOR_FORGOTTEN
    covered: float  # [-] share of 95 % intervals that contain the truth, after PRIOR_FORGOTTEN


def _command(device: Device, damping: Array) -> Array:
    """Damper commands (N,) [-] for a linear damper."""
    low, high = device.damping_of([0.0, 1.0])
    return np.asarray((damping - low) / (high - low))


def damping_errors(estimates: Estimates, simulation: Simulation, width: float) -> DampingErrors:
    """Errors of the estimates; `width`: half width of a 95 % interval in standard deviations."""
    value, sd = estimates.column("damping")
    truth = simulation.truth["damping"]
    error = np.abs(value - truth)
    late, later = estimates.time >= CONVERGED, estimates.time >= PRIOR_FORGOTTEN
    relative = error[late] / truth[late]
    return DampingErrors(
        mean=float(np.mean(relative)),
        largest=float(np.max(relative)),
        empirical=float(np.sqrt(np.mean(error[later] ** 2))),
        reported=float(np.sqrt(np.mean(sd[later] ** 2))),
        covered=float(np.mean(error[later] <= width * sd[later])),
    )
