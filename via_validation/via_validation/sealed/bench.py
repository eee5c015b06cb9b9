"""A true joint with one motion: the gap over noise of an effect of any size on it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf, log, sqrt

import numpy as np
from numpy.random import Generator
from via_core.devices import Device
from via_core.signals import Array

from via_validation.sealed.catalogue import Entry, Numbers, Place, Shape
from via_validation.sealed.excitation import excite, start_of, turn
from via_validation.sealed.joints import CONTROLLED, Content, device_of, noisier_content, scaled, servo_of
from via_validation.sealed.model import STEP
from via_validation.sealed.physics import Physics, alike
from via_validation.sealed.recorder import Recorder
from via_validation.sealed.recording import Log, neighbour_angle, sense
from via_validation.sealed.residual import left_by_numbers, ratio, residuals
from via_validation.sealed.scene import Scene, scene_of
from via_validation.sealed.stepping import Drive, Run, Servo, simulate

COARSE = 4.0 * STEP  # [s] of the search
SLOPE = 0.01  # relative step of a number of the joint


class AgainError(Exception):
    """This draw is rejected."""


@dataclass(frozen=True)
class Drawn:
    """An effect at its place, before its size."""

    entry: Entry
    place: Place
    shape: Shape

    def of_size(self, scene: Scene, size: float) -> tuple[Physics, Numbers]:
        """Motor 0: the same on both motors, of the size that it has for the first."""
        if self.place == ("motor", 0):
            physics, numbers = self.entry.of_size(scene, ("motor", 1), size, self.shape)
            return alike(physics), numbers
        return self.entry.of_size(scene, self.place, size, self.shape)


@dataclass(frozen=True)
class Bench:
    """A true joint with one motion, and the residual of sensor noise alone."""

    true: Content
    drive: Drive
    initial: Array
    scene: Scene
    floor: Array
    recorder: Recorder  # only rate and noise: losses of the recording are not part of the gap
    noise: int  # seed of the sensor noise

    @property
    def device(self) -> Device:
        return self.scene.device

    def excite(self, rng: Generator, family: str, duration: float) -> Drive:
        """Another motion of this joint."""
        return _motion(rng, self.device, family, duration, (self.drive.rate, self.drive.servo))

    def run(self, physics: Physics, step: float, acts: Array | None = None) -> Run | None:
        push = push_of(np.random.default_rng(self.noise), physics, self.drive)
        return simulate(self.device, physics, self.drive, push, self.initial, step, acts)

    def record_other(self, rng: Generator, family: str, physics: Physics, duration: float) -> Log:
        """The same joint under another motion, recorded without faults. Raises AgainError if the run diverges."""
        other = self.excite(rng, family, duration)
        push = push_of(rng, physics, other)
        run = simulate(self.device, physics, other, push, start_of(self.device, other), STEP)
        if run is None:
            raise AgainError
        return sense(rng, self.device, physics, other, run, self.recorder)

    def ratio(self, physics: Physics, run: Run) -> float:
        """Gap over noise of a run."""
        return ratio(self._residuals(self.device, self._log(physics, run), run, self.drive.servo), self.floor)

    def beyond(self, physics: Physics, run: Run, errors: dict[str, float], tolerance: float) -> float:
        """Gap over noise that remains after the nominal parameters were fitted inside their tolerance."""
        recorded = self._log(physics, run)
        found = self._residuals(self.device, recorded, run, self.drive.servo)
        slopes = []
        for where in errors:
            moved = scaled(self.true, where, 1.0 + SLOPE)
            slopes.append((self._residuals(device_of(moved), recorded, run, servo_of(moved)) - found) / SLOPE)
        off = np.array(list(errors.values()))
        return left_by_numbers(found, self.floor, np.array(slopes), off - tolerance, off + tolerance)

    def _log(self, physics: Physics, run: Run) -> Log:
        return sense(np.random.default_rng(self.noise), self.device, physics, self.drive, run, self.recorder)

    def _residuals(self, device: Device, recorded: Log, run: Run, servo: Servo | None) -> Array:
        return residuals(device, recorded, run.speed[:: self.recorder.every], servo)


def draw_bench(rng: Generator, true: Content, family: str, duration: float, recorder: Recorder) -> Bench:
    """A motion that keeps the joint without effect inside its stops. Raises AgainError if it does not."""
    device = device_of(true)
    rate = device.sensors.rate * recorder.every
    drive = _motion(rng, device, family, duration, (rate, servo_of(true)))
    clean = Recorder(encoder_noise=recorder.encoder_noise, every=recorder.every)
    return _measured(true, drive, clean, int(rng.integers(2**31)))


def noisier(bench: Bench, factor: float) -> Bench:
    """The same with coarser encoders and more torque noise."""
    return _measured(noisier_content(bench.true, factor), bench.drive, bench.recorder, bench.noise)


def _measured(true: Content, drive: Drive, clean: Recorder, noise: int) -> Bench:
    device = device_of(true)
    initial = start_of(device, drive)
    run = simulate(device, Physics(), drive, np.zeros(len(drive.references)), initial, STEP)
    if run is None or not inside(device, run):
        raise AgainError
    bench = Bench(true, drive, initial, scene_of(device, run), np.empty(0), clean, noise)
    return replace(bench, floor=bench._residuals(device, bench._log(Physics(), run), run, drive.servo))


def _motion(
    rng: Generator, device: Device, family: str, duration: float, law: tuple[float, Servo | None]
) -> Drive:  # fmt: skip
    rate, servo = law
    if family == CONTROLLED:
        return turn(rng, device, duration, rate)
    return excite(rng, device, duration, 1.0, rate, servo)


def push_of(rng: Generator, physics: Physics, drive: Drive) -> Array:
    """(N,) [N m] torque of the environment on the link."""
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


def search(bench: Bench, drawn: Drawn, aim: float, near: float) -> tuple[float, float]:
    """(size, gap over noise) near `aim`, or at the least size where that is already above it.

    Residual energy grows about as the square of the size, r^2 = 1 + (a s)^2: each trial gives the next one's size, kept
    between the largest size known to be too small and the smallest known to be too large.
    """
    low, high = drawn.entry.low, drawn.entry.high
    size, best = min(max(sqrt(low * high) * 0.5, low), high), (low, inf)
    for _ in range(7):
        physics, _numbers = drawn.of_size(bench.scene, size)
        run = bench.run(physics, COARSE)
        found = bench.ratio(physics, run) if run is not None else inf
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
