"""Limits of joints under random starts and disturbances with a faulty controller; `limits` does the same for an arm.

Every run starts with the link moving at a random angle within `POSTURE`, and with the motors at an equilibrium of a
random preset. The faulty controller commands twice the torque limit in random directions. During the run the link is
pushed, samples are lost, and the node is deactivated and activated. Sensors are those of the device file. In half of
the runs torques act LATE ticks after their samples, as the supervisor knows.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

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
LATE = 5  # [ticks]


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


def faulty_supervisor(device: Device, seed: int, drive: float = 0.5, late: int = 0) -> JointSupervisor:
    """The faulty controller under the joint's limits, whose torques act `late` [ticks] after their samples."""
    axes = JointAxes(device)
    limit = np.where(np.isfinite(axes.torque_limit), axes.torque_limit, STRONG)
    supervisor = JointSupervisor.of(FaultyJointController(limit, seed), axes, drive=drive)
    return replace(supervisor, supervisor=replace(supervisor.supervisor, delay=late * PERIOD))


def joint_limit_rows(seeds: Iterable[int]) -> list[Row]:
    """Rows of the largest values over the runs of these seeds, device by device, in time and late."""
    kinds = [(load_device(name), late) for late in (0, LATE) for name in DEVICES]
    found: list[list[Worst]] = [[] for _ in kinds]
    for seed in seeds:
        number = seed % len(kinds)
        device, late = kinds[number]
        found[number].append(disturbed_run(device, seed, faulty_supervisor(device, seed, late=late), late))
    return [row for kind, runs in zip(kinds, found, strict=True) if runs for row in _rows(*kind, runs)]


def _rows(device: Device, late: int, runs: list[Worst]) -> list[Row]:
    settings = (
        f"{device.name}, {DURATION:g} s, link within {POSTURE:g} rad and {VELOCITY:g} rad/s, pushed by {PUSH:g} rad/s, "
        f"{LOST:.0%} of samples lost, activated or deactivated at {OFF:.0%} of samples"
    )
    at, what = f"limits.{device.name}", f"{len(runs)} runs of {device.name} with a faulty controller"
    if late:
        at, what = f"{at}.late", f"{what}, torques {late * PERIOD * 1e3:g} ms late"
    unlimited = [f"{at}.{name}" for name in _unlimited(device)]
    return [row for row in worst_rows(at, what, runs, settings) if row.id not in unlimited]


def _unlimited(device: Device) -> list[str]:
    """Limits that the device file does not state; their rows are left out."""
    axes = JointAxes(device)
    limits = {"torque": axes.torque_limit, "speed": axes.speed_limit, "deflection": axes.deflection_limit}
    return [name for name, limit in limits.items() if not np.isfinite(limit).any()]


def disturbed_run(device: Device, seed: int, supervisor: JointSupervisor, late: int = 0) -> Worst:
    """One run of DURATION with the random numbers of `seed`; torques act `late` [ticks] after their samples."""
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
    worst, guarded, waiting = np.zeros(3), 0, [np.zeros(m)] * late
    for tick in range(ticks):
        measured, _ = simulator.sample(body)
        seen = measured[: 1 + m] if random.random() >= LOST else np.full(1 + m, np.nan)
        active ^= bool(random.random() < OFF)
        state, answer = supervisor.step(state, JointSample(tick * PERIOD, float(seen[0]), seen[1:].copy()), active)
        guarded += bool(answer.limited)
        command = np.zeros(2)
        waiting.append(answer.torque)
        command[:m] = waiting.pop(0)
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
