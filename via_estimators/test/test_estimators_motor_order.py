"""The order in which a device file lists its motors does not matter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from via_core.devices import Device, load_device
from via_estimators.methods import METHODS
from via_estimators.rows import at_rate

SWAPPABLE = ("modulated_torque", "moving_horizon", "extended_kalman", "unknown_input_observer", "residual",
             "modulated_stiffness", "signal_based", "filtered_signal_based")  # fmt: skip


def unequal(order: tuple[int, int]) -> Device:
    """A joint whose motors and springs differ 5 and 4 times, listed in `order`."""
    sound = load_device("qbmove_a")
    scales = ((1.0, 1.0), (5.0, 4.0))
    motors = [
        sound.motors[0].model_copy(
            update={
                "inertia": scales[i][0] * sound.motors[0].inertia,
                "viscous_friction": scales[i][0] * sound.motors[0].viscous_friction,
            }
        )
        for i in order
    ]
    springs = [
        replace(sound.springs[0], k=scales[i][1] * sound.springs[0].k, max_deflection=(0.8, 0.6)[i]) for i in order
    ]
    return at_rate(sound.model_copy(update={"motors": tuple(motors), "springs": tuple(springs)}), 1000.0)


def motion(order: tuple[int, int], count: int = 5000) -> dict[str, np.ndarray]:
    """Columns of one and the same motion, those of the motors in `order`."""
    device, t, random = unequal((0, 1)), 1e-3 * np.arange(count), np.random.default_rng(0)
    turn, columns = 2.0 * np.pi * t, {"time": t}
    columns["q"] = 0.15 * np.sin(0.9 * turn)
    for place, i in enumerate(order):
        motor, spring = device.motors[i], device.springs[i]
        theta = (0.3 - 0.6 * i) + 0.2 * np.sin((1.1 + 0.5 * i) * turn)
        speed = np.gradient(theta, 1e-3)
        torque = motor.inertia * np.gradient(speed, 1e-3) + motor.viscous_friction * speed
        torque -= spring.torque(columns["q"] - theta)
        columns |= {f"theta_{place + 1}": theta, f"theta_velocity_{place + 1}": speed}
        columns[f"tau_{place + 1}"] = torque + 0.01 * np.random.default_rng(i).standard_normal(count)
    columns["q"] = columns["q"] + 1e-5 * random.standard_normal(count)
    return columns


@pytest.mark.parametrize("method", SWAPPABLE)
def test_motors_in_the_other_order_give_the_same_estimate(method: str) -> None:
    found = []
    for order in ((0, 1), (1, 0)):
        estimator, columns = METHODS[method].from_device(unequal(order)), motion(order)
        rows = np.column_stack([columns[name] for name in ("time", *estimator.inputs)])
        estimates = estimator.run_rows(rows)[1]
        found.append((estimates.status, estimates.column("stiffness"), estimates.column(f"stiffness_{1 + order[0]}")))
    assert np.array_equal(found[0][0], found[1][0])
    for one, other in zip(found[0][1:], found[1][1:], strict=True):
        np.testing.assert_allclose(one[0], other[0], rtol=1e-6)
        np.testing.assert_allclose(one[1], other[1], rtol=1e-6)
