"""A range of deflection that the device file states too small is named, and costs no estimate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from via_core.devices import Device, load_device
from via_core.signals import Signals
from via_core.status import Status
from via_estimators.contract import rows_of
from via_estimators.methods import estimator_for

JOINT = load_device("cubic_demo")


def moved() -> Signals:
    """6 s of planted motion, deflections up to 1.19 rad, with the torques that cubic_demo needs for it."""
    t = 1e-3 * np.arange(6001)
    q = 0.3 * np.sin(5.0 * t)
    theta = np.column_stack([0.7 + 0.2 * np.sin(7.0 * t), -0.7 + 0.2 * np.sin(9.0 * t)])
    speed = np.gradient(theta, t, axis=0)
    bend = np.gradient(speed, t, axis=0)
    tau = np.column_stack(
        [motor.inertia * bend[:, i] + motor.viscous_friction * speed[:, i] - spring.torque(q - theta[:, i])
         for i, (motor, spring) in enumerate(zip(JOINT.torque_motors, JOINT.springs, strict=True))]
    )  # fmt: skip
    tau[1:] = 0.5 * (tau[1:] + tau[:-1])
    return Signals(t, {"q": q, "theta": theta, "tau": tau}, {"q": "rad", "theta": "rad", "tau": "N m"})


def stated(reach: float) -> Device:
    springs = tuple(replace(spring, max_deflection=reach) for spring in JOINT.springs)
    return JOINT.model_copy(update={"springs": springs})


@pytest.mark.parametrize("reach", [0.9, 0.6])
def test_deflections_beyond_the_file_are_named_and_estimated(reach: float) -> None:
    device, signals = stated(reach), moved()
    estimator = estimator_for(device)
    state, estimates = estimator.run_rows(rows_of(signals, estimator.inputs))
    assert f"reached 1.2 rad, beyond the max_deflection of {reach:g} rad" in estimator.fault(state)
    late = estimates.time > 1.0
    assert Status.IMPLAUSIBLE not in estimates.status[late]  # before, no samples were compared with the file
    assert np.mean(estimates.status[late] == Status.OK) > 0.9
    phi = signals["q"][:, None] - signals["theta"]
    truth = sum(spring.stiffness(phi[:, i]) for i, spring in enumerate(JOINT.springs))
    value, sd = estimates.column("stiffness")
    assert np.all(np.abs(value - truth)[late] < 0.01 * truth[late] + 3.0 * sd[late])


def test_deflections_within_the_file_are_not_named() -> None:
    estimator = estimator_for(JOINT)
    assert estimator.fault(estimator.run_rows(rows_of(moved(), estimator.inputs))[0]) == ""


def test_one_wild_sample_is_no_deflection() -> None:
    estimator, signals = estimator_for(stated(1.3)), moved()
    q = signals["q"].copy()
    q[3000] += 0.5
    rows = rows_of(Signals(signals.time, {**signals.channels, "q": q}, signals.units), estimator.inputs)
    assert "max_deflection" not in estimator.fault(estimator.run_rows(rows)[0])
