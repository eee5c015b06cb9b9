"""A motor that is pressed against its mechanical stop is no fault, and spoils no estimate."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from elastic_joints import elastic
from via_core.faults import faulty_time
from via_core.modulated_rows import Samples
from via_core.signals import Signals
from via_core.status import Status
from via_estimators.contract import rows_of
from via_estimators.methods import estimator_for
from via_estimators.modulated_torque import ModulatedTorque

STIFFNESS, INERTIA, DAMPING, UPPER = 10.0, 0.02, 0.3, 0.25
STEP = 2.0 * np.pi / 2**16
DEVICE = elastic(
    0.1,
    {"inertia": 1.05 * INERTIA, "viscous_friction": DAMPING},
    {"stiffness": 1.1 * STIFFNESS, "max_deflection": 0.6},
    link_quantum=STEP,
    motor_quantum=STEP,
    torque_noise=0.01,
)


@cache
def pressed(side: float = 1.0, push: float = 3.0) -> tuple[Signals, np.ndarray]:
    """Signals of 14 s, and where the motor is at its stop, from 6 to 9 s; it pushes with up to `push` [N m]."""
    t = 1e-3 * np.arange(14001)
    q = 0.1 * np.sin(4.0 * t) + 0.07 * np.sin(9.3 * t + 0.4)
    outward = np.clip(np.minimum(t - 6.0, 9.0 - t), 0.0, 0.3) / 0.3
    free = 0.12 * np.sin(3.0 * t) + 0.08 * np.sin(7.1 * t) + 0.5 * outward
    held = free > UPPER
    theta = side * np.minimum(free, UPPER)
    speed = np.gradient(theta, t)
    bend = np.gradient(np.gradient(side * free, t), t) * ~held  # a stop takes the momentum
    tau = INERTIA * bend + DAMPING * speed * ~held - STIFFNESS * (q - theta) + side * push * outward * held
    tau[1:] = 0.5 * (tau[1:] + tau[:-1])
    tau += 0.01 * np.random.default_rng(3).standard_normal(len(t))
    q, theta = (STEP * np.round(angle / STEP) for angle in (q, theta))
    channels = {"q": q, "theta": theta[:, None], "tau": tau[:, None]}
    return Signals(t, channels, {"q": "rad", "theta": "rad", "tau": "N m"}), held


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("push", [1.0, 3.0, 30.0])
def test_equations_of_a_motor_at_its_stop_are_left_out(side: float, push: float) -> None:
    signals, held = pressed(side, push)
    estimates = ModulatedTorque.from_device(DEVICE).run(signals)
    value, sd = estimates.column("stiffness")
    late, ok = estimates.time > 2.0, estimates.status == Status.OK
    assert np.mean(np.abs(value - STIFFNESS)[late & ok] <= 1.96 * sd[late & ok]) >= 0.9
    assert np.max(np.abs(value - STIFFNESS)[late]) < 0.03 * STIFFNESS
    assert np.mean(estimates.status[held & (np.abs(estimates.time - 7.5) < 1.0)] == Status.NOT_EXCITED) > 0.95
    assert np.mean(ok[estimates.time > 9.2]) > 0.95  # goes on within .2 s


def test_the_stop_is_named_and_no_sample_is_implausible() -> None:
    estimator, (signals, _) = estimator_for(DEVICE), pressed()
    rows = rows_of(signals, estimator.inputs)
    state, before = estimator.run_rows(rows[:8000])
    assert "motor 1 rests at 0.25 rad, the largest angle" in estimator.fault(state)
    state, after = estimator.run_rows(rows[8000:], state)
    assert estimator.fault(state) == ""
    assert Status.IMPLAUSIBLE not in before.status and Status.IMPLAUSIBLE not in after.status


def test_a_method_that_does_not_leave_such_equations_out_is_not_ok_at_a_stop() -> None:
    estimator, (signals, _) = estimator_for(DEVICE, "modulated_stiffness"), pressed()
    rows = rows_of(signals, estimator.inputs)
    state, estimates = estimator.run_rows(rows[:8800])
    assert "mechanical stop" in estimator.fault(state)
    assert Status.OK not in estimates.status[7250:]


def test_a_recording_with_a_stop_has_no_fault() -> None:
    samples = Samples.of_signals(pressed()[0], DEVICE)
    assert samples is not None and faulty_time(DEVICE, samples) is None


@pytest.mark.parametrize("change", ["reversed", "in N mm"])
def test_a_wrong_torque_is_found_in_spite_of_a_stop(change: str) -> None:
    signals, _ = pressed()
    tau = {"reversed": -1.0, "in N mm": 1e3}[change] * signals["tau"]
    wrong = Signals(signals.time, {**signals.channels, "tau": tau}, signals.units)
    estimates = estimator_for(DEVICE).run(wrong)
    assert np.mean(estimates.status[estimates.time > 2.0] == Status.OK) <= 0.05
