"""A controller that falls behind its samples: its torques do not act, which is no stall."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
from via_controllers.contract import Controller, JointSample, Torques
from via_controllers.joint_axes import JointAxes
from via_controllers.nodes import controller
from via_controllers.nodes.single import NODES
from via_controllers.supervision.arm_supervision import LOST
from via_controllers.supervision.joint_supervision import JointSupervisor
from via_controllers.supervision.lateness import DRIFT, LATEST, Lateness
from via_core.devices import load_device
from via_ros.conversions import JointStateWriter
from via_ros.serialised import JointStateBytes
from via_sim.plants import JointPlant
from via_sim.sensors import Sensors
from via_sim.simulate import Simulator

TICK = 1e-3  # [s]
QUICK = 3e-4  # [s] per sample while a queue is worked off
OFFSET = 1e4  # [s] between the clocks of robot and controller
DEVICE = load_device("qbmove_a")


@dataclass(frozen=True)
class Push(Controller[None]):
    """Opposite torques on both motors."""

    quantities = ()

    def init(self):
        return None

    def observe(self, state):
        return np.empty(0)

    def step(self, state, sample):
        return None, Torques(np.array([3.0, -3.0]), False)


def arrivals(ticks, *pauses):
    """Times [s] at which samples are answered, with pauses (begin, end) [s]."""
    times, free = [], 0.0
    for tick in range(ticks):
        due = max(tick * TICK, free)
        due = next((end for begin, end in pauses if begin <= due < end), due)
        free = due + QUICK
        times.append(due)
    return times


def answered(times, known, frozen=False):
    """Whether each sample was answered by a stall, in a loop whose robot ignores commands older than LATEST.

    known   whether the supervisor gets what `Lateness` finds
    frozen  whether the motor encoders repeat one number
    """
    simulator = Simulator(JointPlant.from_device(DEVICE), 1.0 / TICK, Sensors.of_device(DEVICE))
    supervisor, body = JointSupervisor.of(Push(), JointAxes(DEVICE)), simulator.init()
    state, lateness, command, stalls, samples = supervisor.init(), Lateness(), (-1.0, np.zeros(2)), [], []
    for tick in range(len(times)):
        measured, _ = simulator.sample(body)
        theta = np.zeros(2) if frozen else measured[1:3].copy()
        samples.append(JointSample(tick * TICK, float(measured[0]), theta))
        while len(stalls) <= tick and times[len(stalls)] <= tick * TICK:
            sample = samples[len(stalls)]
            lateness, acts = lateness.step(sample.time + OFFSET, times[len(stalls)])
            state, answer = supervisor.step(state, sample, True, acts or not known)
            stalls.append(answer.fault == LOST)
            command = (sample.time, answer.torque)
        torque = command[1] if tick * TICK - command[0] <= LATEST else np.zeros(2)
        body, _, _ = simulator.step(body, [*torque, 0.0, 0.0])
    return stalls


PAUSES = [((0.0, 0.08),), ((0.0, 0.08), (0.3, 0.5), (0.6, 0.8))]


@pytest.mark.parametrize("pauses", PAUSES)
def test_torques_that_come_too_late_are_no_stall(pauses):
    times = arrivals(1000, *pauses)
    assert any(answered(times, known=False))
    assert not any(answered(times, known=True))


def test_a_stall_is_found_after_samples_were_late():
    times = arrivals(1000, (0.0, 0.08))
    stalls = answered(times, known=True, frozen=True)
    assert 0.08 < times[stalls.index(True)] < 0.2


@pytest.mark.parametrize(("simulated", "stalled"), [(False, False), (True, True)])
def test_a_node_judges_lateness_by_stamps_of_its_own_clock(graph, monkeypatch, simulated, stalled):
    """Samples of 80 ms, answered at once by a node that was busy meanwhile; simulated time may run at any pace."""
    clock = SimpleNamespace(now=100.0)
    clock.monotonic = lambda: clock.now
    clock.time_ns = lambda: 10**18 + round(1e9 * clock.now)
    node = graph.add(NODES["excitation"], device=DEVICE.name, told_every=1000)
    monkeypatch.setattr(controller, "time", clock)
    node._supervisor = JointSupervisor.of(Push(), JointAxes(DEVICE))
    node._state = node._supervisor.init()
    writer, first = JointStateWriter(DEVICE), clock.time_ns() - 80_000_000
    writer.position[:] = 0.0
    samples = JointStateBytes(writer)
    for tick in range(80):
        clock.now += QUICK
        node._samples._receive(samples.stamped((10**9 if simulated else first) + tick * 10**6))
    assert node.answered == 80 and (LOST in node._faults) == stalled
    assert (node._late > 0) != simulated


def acting(stamps, times):
    """What `Lateness` says about each sample."""
    state, found = Lateness(), []
    for stamp, time in zip(stamps, times, strict=True):
        state, acts = state.step(stamp, time)
        found.append(acts)
    return np.array(found)


def test_torques_act_whatever_the_offset_and_drift_of_the_clocks():
    stamps = np.arange(20_000) * TICK
    delay = np.random.default_rng(0).uniform(0.0, 1e-4, len(stamps))
    for offset in (-OFFSET, 0.0, OFFSET):
        for rate in (-0.5 * DRIFT, 0.5 * DRIFT):
            assert acting(stamps, (1.0 + rate) * stamps + delay + offset)[1:].mean() > 0.8


@pytest.mark.parametrize("rate", [200.0, 1000.0])
@pytest.mark.parametrize("jitter", [1e-4, 3e-4, 1e-3])
def test_arrivals_that_vary_are_not_lateness(rate, jitter):
    stamps = np.arange(20_000) / rate
    for seed in range(5):
        delay = np.random.default_rng(seed).exponential(jitter, len(stamps))
        assert acting(stamps, np.maximum.accumulate(stamps + delay) + OFFSET).mean() > 0.998


def test_only_samples_that_are_late_do_not_act():
    times = np.array(arrivals(1000, (0.4, 0.5)))
    late = times - np.arange(1000) * TICK > LATEST
    assert 90 < late.sum() < 200
    acts = acting(np.arange(1000) * TICK, times)
    assert not acts[late].any()
    assert np.count_nonzero(~acts[~late]) <= 2  # the first one, and the first one on time after the pause


def test_a_clock_that_is_set_back_is_not_lateness():
    stamps = np.arange(2000) * TICK
    set_back = np.where(stamps < 1.0, stamps, stamps - 0.5)
    assert acting(set_back, stamps)[1002:].all()
