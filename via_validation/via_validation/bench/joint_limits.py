"""Limits of joints under random starts and disturbances, as `limits` has them for an arm.

Every course begins with the link anywhere within `POSTURE`, moving, the motors where it would rest with some preset.
The law is out of its mind: twice the torque limit, to and fro at random. On the way somebody pushes the link, samples
get lost, and the node is deactivated and activated again. Sensors are those of the device file.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from via_controllers.contract import Controller, JointSample, Quantity, Torques
from via_controllers.joint_axes import JointAxes
from via_controllers.joint_supervision import JointSupervisor
from via_controllers.motor_references import resting
from via_core.devices import Device, load_device
from via_core.signals import Array
from via_sim.plants import JointPlant
from via_sim.sensors import Sensors
from via_sim.simulate import Simulator

from via_validation.bench.limits import DURATION, LOST, OFF, PERIOD, Worst, worst_rows
from via_validation.tables.rows import Row

DEVICES = ("qbmove_a", "vsa2", "cubic_demo", "visco_elastic_demo")
POSTURE = 0.3  # [rad] to either side of zero
PRESET = 0.5  # of the springs' stops, at most
VELOCITY = 0.5  # [rad/s] of the link at the start, at most
PUSH, PUSHED = 1.0, 20  # [rad/s] that a push gives the link at most, [ticks] that it takes
STRONG = 10.0  # [N m] of a law for motors without a limit


@dataclass(frozen=True, eq=False)
class WildJoint(Controller[int]):
    """A law that should not be: at every tenth sample or so another direction, twice as much as motors give."""

    limit: Array  # (m,) [N m]
    seed: int

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        return ()

    def told(self, state: int) -> Array:
        return np.empty(0)

    def init(self) -> int:
        return 0

    def step(self, state: int, sample: JointSample) -> tuple[int, Torques]:
        random = np.random.default_rng([self.seed, state // 20])
        return state + 1, Torques(random.choice([-2.0, 2.0], len(self.limit)) * self.limit, False)


def wild_supervisor(device: Device, seed: int, drive: float = 0.5) -> JointSupervisor:
    """The law of this file under the joint's limits."""
    axes = JointAxes(device)
    limit = np.where(np.isfinite(axes.torque_limit), axes.torque_limit, STRONG)
    return JointSupervisor.of(WildJoint(limit, seed), axes, drive=drive)


def joint_limit_rows(seeds: Iterable[int]) -> list[Row]:
    """The worst of the courses of these seeds, device by device."""
    found: list[list[Worst]] = [[] for _ in DEVICES]
    devices = [load_device(name) for name in DEVICES]
    for seed in seeds:
        number = seed % len(DEVICES)
        found[number].append(course(devices[number], seed, wild_supervisor(devices[number], seed)))
    rows = []
    for device, courses in zip(devices, found, strict=True):
        if courses:
            rows += [row for row in _rows(device, courses) if row.id not in _unlimited(device)]
    return rows


def _rows(device: Device, courses: list[Worst]) -> list[Row]:
    settings = (
        f"{device.name}, {DURATION:g} s, link within {POSTURE:g} rad and {VELOCITY:g} rad/s, pushed by {PUSH:g} rad/s, "
        f"{LOST:.0%} of samples lost, activity changed at {OFF:.0%}"
    )
    what = f"{len(courses)} courses of {device.name}, a law out of its mind"
    return worst_rows(f"limits.{device.name}", what, courses, settings)


def _unlimited(device: Device) -> list[str]:
    """Rows about limits that no device file tells: nothing is judged by them."""
    axes = JointAxes(device)
    limits = {"torque": axes.torque_limit, "speed": axes.speed_limit, "deflection": axes.deflection_limit}
    return [f"limits.{device.name}.{name}" for name, limit in limits.items() if not np.isfinite(limit).any()]


def course(device: Device, seed: int, supervisor: JointSupervisor) -> Worst:
    """One course from random numbers of its own."""
    random, m = np.random.default_rng(seed), device.n_motors
    axes, simulator = (
        JointAxes(device),
        Simulator(JointPlant.from_device(device), 1.0 / PERIOD, Sensors.of_device(device)),
    )
    stop = min(law.max_deflection for law in device.spring_laws)
    q, preset = random.uniform(-POSTURE, POSTURE), random.uniform(0.0, PRESET) * stop
    body = simulator.init(seed=seed).copy()
    body[0], body[1 : 1 + m] = q, device.motor_angles(resting(device, q, preset), preset)
    body[3] = random.uniform(-VELOCITY, VELOCITY)
    ticks = round(DURATION / PERIOD)
    pushed = random.integers(ticks // 8, ticks - PUSHED)
    load = device.link.inertia * random.uniform(-PUSH, PUSH) / (PUSHED * PERIOD)
    state, active = supervisor.init(), True
    worst, guarded = np.zeros(3), 0
    for tick in range(ticks):
        measured, _ = simulator.sample(body)
        seen = measured[: 1 + m] if random.random() >= LOST else np.full(1 + m, np.nan)
        active ^= bool(random.random() < OFF)
        state, answer = supervisor.step(state, JointSample(tick * PERIOD, float(seen[0]), seen[1:].copy()), active)
        guarded += bool(answer.limited)
        command = np.zeros(2)
        command[:m] = answer.torque
        external = load if pushed <= tick < pushed + PUSHED else 0.0
        body, _, _ = simulator.step(body, [*command, 0.0, external])
        now = (
            answer.torque / axes.torque_limit,
            body[4 : 4 + m] / axes.speed_limit,
            (body[0] - body[1 : 1 + m]) / axes.deflection_limit,
        )
        worst = np.maximum(worst, np.abs(now).max(axis=1))
    torque, speed, deflection = worst.tolist()
    return Worst(torque, speed, deflection, guarded / ticks)
