"""Limits of joints under random starts and disturbances with a faulty controller; `limits` does the same for an arm.

Every run starts with the link moving at a random angle within `POSTURE`, and with the motors at an equilibrium of a
random preset. The faulty controller commands twice the torque limit in random directions. During the run the link is
pushed, samples are lost, and the node is deactivated and activated. Sensors are those of the device file.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from via_controllers.contract import Controller, JointSample, Quantity, Torques
from via_controllers.joint_axes import JointAxes
from via_controllers.joints.motor_references import resting
from via_controllers.supervision.joint_supervision import JointSupervisor
from via_core.devices import Device, load_device
from via_core.signals import Array
from via_sim.plants import JointPlant
from via_sim.sensors import Sensors
from via_sim.simulate import Simulator

from via_validation.bench.limits import DURATION, LOST, OFF, PERIOD, Worst, worst_rows
from via_validation.tables.rows import Row

DEVICES = ("qbmove_a", "vsa2", "cubic_demo", "visco_elastic_demo")
POSTURE = 0.3  # [rad] to either side of zero
PRESET = 0.5  # [-] largest preset over the springs' deflection limit
VELOCITY = 0.5  # [rad/s] largest initial velocity of the link
PUSH, PUSHED = 1.0, 20  # [rad/s] largest velocity change by a push, [ticks] duration of the push
STRONG = 10.0  # [N m] commanded to motors without a torque limit


@dataclass(frozen=True, eq=False)
class FaultyJointController(Controller[int]):
    """A faulty controller: twice the torque limit, in random directions that change every 20 samples."""

    limit: Array  # (m,) [N m]
    seed: int

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        return ()

    def observe(self, state: int) -> Array:
        return np.empty(0)

    def init(self) -> int:
        return 0

    def step(self, state: int, sample: JointSample) -> tuple[int, Torques]:
        random = np.random.default_rng([self.seed, state // 20])
        return state + 1, Torques(random.choice([-2.0, 2.0], len(self.limit)) * self.limit, False)


def faulty_supervisor(device: Device, seed: int, drive: float = 0.5) -> JointSupervisor:
    """The faulty controller under the joint's limits."""
    axes = JointAxes(device)
    limit = np.where(np.isfinite(axes.torque_limit), axes.torque_limit, STRONG)
    return JointSupervisor.of(FaultyJointController(limit, seed), axes, drive=drive)


def joint_limit_rows(seeds: Iterable[int]) -> list[Row]:
    """Rows of the largest values over the runs of these seeds, device by device."""
    found: list[list[Worst]] = [[] for _ in DEVICES]
    devices = [load_device(name) for name in DEVICES]
    for seed in seeds:
        number = seed % len(DEVICES)
        found[number].append(disturbed_run(devices[number], seed, faulty_supervisor(devices[number], seed)))
    rows = []
    for device, runs in zip(devices, found, strict=True):
        if runs:
            rows += [row for row in _rows(device, runs) if row.id not in _unlimited(device)]
    return rows


def _rows(device: Device, runs: list[Worst]) -> list[Row]:
    settings = (
        f"{device.name}, {DURATION:g} s, link within {POSTURE:g} rad and {VELOCITY:g} rad/s, pushed by {PUSH:g} rad/s, "
        f"{LOST:.0%} of samples lost, activated or deactivated at {OFF:.0%} of samples"
    )
    what = f"{len(runs)} runs of {device.name} with a faulty controller"
    return worst_rows(f"limits.{device.name}", what, runs, settings)


def _unlimited(device: Device) -> list[str]:
    """Ids of rows about limits that the device file does not state; these are left out."""
    axes = JointAxes(device)
    limits = {"torque": axes.torque_limit, "speed": axes.speed_limit, "deflection": axes.deflection_limit}
    return [f"limits.{device.name}.{name}" for name, limit in limits.items() if not np.isfinite(limit).any()]


def disturbed_run(device: Device, seed: int, supervisor: JointSupervisor) -> Worst:
    """One run of DURATION with the random numbers of `seed`."""
    random, m = np.random.default_rng(seed), device.n_motors
    axes, simulator = (
        JointAxes(device),
        Simulator(JointPlant.from_device(device), 1.0 / PERIOD, Sensors.of_device(device)),
    )
    stop = min(spring.max_deflection for spring in device.springs)
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
