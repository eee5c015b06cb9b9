"""A true joint under one motion, and the gap over noise that an effect of a given size causes on it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf, log, sqrt

import numpy as np
from numpy.random import Generator
from via_core.devices import Device
from via_core.signals import Array

from via_validation.sealed.catalogue import Entry, Location, Numbers, Shape
from via_validation.sealed.excitation import excite, start_of, turn
from via_validation.sealed.joints import CONTROLLED, Content, device_of, noisier_content, scaled, servo_of
from via_validation.sealed.model import STEP
from via_validation.sealed.physics import Physics, on_both_motors
from via_validation.sealed.recorder import Recorder
from via_validation.sealed.recording import Log, neighbour_angle, sense
from via_validation.sealed.residual import ratio, ratio_after_fit, residuals
from via_validation.sealed.scene import Scene, scene_of
from via_validation.sealed.stepping import Drive, Run, Servo, simulate

COARSE = 4.0 * STEP  # [s] step of the simulations during the search
SLOPE = 0.01  # [-] relative step of the finite differences over parameters


class RejectedError(Exception):
    """The draw is rejected; the caller draws again."""


@dataclass(frozen=True)
class DrawnEffect:
    """An effect at a location; its size is still to be found."""

    entry: Entry
    location: Location
    shape: Shape

    def of_size(self, scene: Scene, size: float) -> tuple[Physics, Numbers]:
        """Physics and parameters at this size. Motor 0: motor 1's values on both motors."""
        if self.location == ("motor", 0):
            physics, numbers = self.entry.of_size(scene, ("motor", 1), size, self.shape)
            return on_both_motors(physics), numbers
        return self.entry.of_size(scene, self.location, size, self.shape)


@dataclass(frozen=True)
class Experiment:
    """A true joint under one motion, and the residual that sensor noise alone causes."""

    true: Content
    drive: Drive
    initial: Array
    scene: Scene
    floor: Array
    recorder: Recorder  # rate and noise only: losses of the recording are not part of the gap
    seed: int  # of the sensor noise

    @property
    def device(self) -> Device:
        return self.scene.device

    def excite(self, rng: Generator, family: str, duration: float) -> Drive:
        """Another motion of this joint."""
        return _motion(rng, self.device, family, duration, self.drive.rate, self.drive.servo)

    def run(self, physics: Physics, step: float, acts: Array | None = None) -> Run | None:
        """The motion with `physics` added; None if the simulation diverged. `acts`: see Drive."""
        push = push_of(np.random.default_rng(self.seed), physics, self.drive)
        return simulate(self.device, physics, replace(self.drive, acts=acts), push, self.initial, step)

    def record_other(self, rng: Generator, family: str, physics: Physics, duration: float) -> Log:
        """Log of the same joint under another motion, recorded without faults. Raises RejectedError if it diverges."""
        other = self.excite(rng, family, duration)
        push = push_of(rng, physics, other)
        run = simulate(self.device, physics, other, push, start_of(self.device, other), STEP)
        if run is None:
            raise RejectedError
        return sense(rng, self.device, physics, other, run, self.recorder)

    def ratio(self, physics: Physics, run: Run) -> float:
        """Gap over noise of a run [-]."""
        return ratio(self._residuals(self.device, self._log(physics, run), run, self.drive.servo), self.floor)

    def ratio_after_fit(self, physics: Physics, run: Run, errors: dict[str, float], tolerance: float) -> float:
        """Gap over noise [-] that remains after the nominal parameters are fitted within their tolerance."""
        recorded = self._log(physics, run)
        found = self._residuals(self.device, recorded, run, self.drive.servo)
        slopes = []
        for where in errors:
            moved = scaled(self.true, where, 1.0 + SLOPE)
            slopes.append((self._residuals(device_of(moved), recorded, run, servo_of(moved)) - found) / SLOPE)
        off = np.array(list(errors.values()))
        return ratio_after_fit(found, self.floor, np.array(slopes), off - tolerance, off + tolerance)

    def _log(self, physics: Physics, run: Run) -> Log:
        return sense(np.random.default_rng(self.seed), self.device, physics, self.drive, run, self.recorder)

    def _residuals(self, device: Device, recorded: Log, run: Run, servo: Servo | None) -> Array:
        return residuals(device, recorded, run.speed[:: self.recorder.every], servo)


def draw_experiment(rng: Generator, true: Content, family: str, duration: float, recorder: Recorder) -> Experiment:
    """A joint with a random motion. Raises RejectedError if the joint without effect reaches a stop."""
    device = device_of(true)
    rate = device.sensors.rate * recorder.every
    drive = _motion(rng, device, family, duration, rate, servo_of(true))
    clean = Recorder(encoder_noise=recorder.encoder_noise, every=recorder.every)
    return _measured(true, drive, clean, int(rng.integers(2**31)))


def noisier(experiment: Experiment, factor: float) -> Experiment:
    """The same experiment with coarser encoders and more torque noise."""
    return _measured(noisier_content(experiment.true, factor), experiment.drive, experiment.recorder, experiment.seed)


def _measured(true: Content, drive: Drive, clean: Recorder, seed: int) -> Experiment:
    """The experiment with its noise residual. Raises RejectedError if the joint without effect reaches a stop."""
    device = device_of(true)
    initial = start_of(device, drive)
    run = simulate(device, Physics(), drive, np.zeros(len(drive.references)), initial, STEP)
    if run is None or not inside(device, run):
        raise RejectedError
    experiment = Experiment(true, drive, initial, scene_of(device, run), np.empty(0), clean, seed)
    return replace(experiment, floor=experiment._residuals(device, experiment._log(Physics(), run), run, drive.servo))


def _motion(rng: Generator, device: Device, family: str, duration: float, rate: float, servo: Servo | None) -> Drive:
    if family == CONTROLLED:
        return turn(rng, device, duration, rate)
    return excite(rng, device, duration, 1.0, rate, servo)


def push_of(rng: Generator, physics: Physics, drive: Drive) -> Array:
    """(N,) [N m] torque that the environment exerts on the link."""
    time = np.arange(len(drive.references)) / drive.rate
    push = np.where((time >= physics.push_from) & (time < physics.push_until), physics.push, 0.0)
    if physics.coupling:
        push = push + physics.coupling * neighbour_angle(physics.neighbour_period, time)
    if physics.unrest:
        keep = np.exp(-1.0 / (drive.rate * physics.unrest_time))
        steps, now = rng.standard_normal(len(time)) * physics.unrest * sqrt(1.0 - keep * keep), 0.0
        for k, step in enumerate(steps):
            now = keep * now + step
            push[k] += now
    return push


def inside(device: Device, run: Run) -> bool:
    """Whether every transmission stayed off its stops."""
    deflection = np.abs(run.angle[:, :1] - run.angle[:, 1 : 1 + device.n_transmissions]).max(axis=0)
    return all(d < 0.95 * spring.max_deflection for d, spring in zip(deflection, device.springs))


def search(experiment: Experiment, drawn: DrawnEffect, aim: float, near: float) -> tuple[float, float]:
    """(size, gap over noise) near `aim`; at the smallest size if its gap already exceeds `aim`.

    The residual's energy grows about with the square of the size, r^2 = 1 + (a s)^2. Each trial therefore predicts the
    next size, which is kept between the largest size found too small and the smallest found too large.

    near  tolerance of the ratio, as a logarithm
    """
    low, high = drawn.entry.low, drawn.entry.high
    size, best = min(max(sqrt(low * high) * 0.5, low), high), (low, inf)
    for _ in range(7):
        physics, _numbers = drawn.of_size(experiment.scene, size)
        run = experiment.run(physics, COARSE)
        found = experiment.ratio(physics, run) if run is not None else inf
        if abs(log(found / aim)) < abs(log(best[1] / aim)):
            best = (size, found)
        if abs(log(found / aim)) < near or (found > aim and size <= drawn.entry.low * 1.001):
            break
        if found > aim:
            high = size
        else:
            low = size
        if low >= high * 0.999:
            break
        guess = size * sqrt((aim * aim - 1.0) / (found * found - 1.0)) if 1.05 < found < inf else 0.0
        if found > aim and guess <= drawn.entry.low:
            size = drawn.entry.low
        else:
            size = guess if low < guess < high else sqrt(low * high)
    return best
