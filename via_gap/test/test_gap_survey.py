"""Gains of a position drive from goals, positions and the gravity torque of the model."""

import numpy as np
import pytest
from via_core.devices import load_device
from via_core.signals import Signals
from via_gap.logs.log import JointLog
from via_gap.logs.survey import fit_gains
from via_sim.effects import Effect
from via_sim.plants import JointPlant
from via_sim.simulate import simulate

DEVICE = load_device("xl330")
FRICTION = Effect("coulomb_friction", "link", {"torque": 0.03})


def test_the_gains_of_a_drive_follow_from_the_gravity_that_it_holds() -> None:
    """Although the inertia of the file is wrong and the joint has dry friction."""
    rate, duration = DEVICE.sensors.rate, 20.0
    t = np.arange(round(duration * rate)) / rate
    goal = 0.8 * np.sin(1.1 * t) + 0.3 * np.sin(3.7 * t)
    goal[: round(rate)] = np.nan  # the drive is off in the first second
    heavy = DEVICE.model_copy(update={"link": DEVICE.link.model_copy(update={"inertia": 0.012})})
    commands = Signals(t, {"equilibrium": goal}, {"equilibrium": "rad"}, frozenset({"equilibrium"}))
    run = simulate(JointPlant.from_device(heavy).with_effects([FRICTION]), commands, duration, rate)
    log = JointLog("log", DEVICE, run.measured, commands)
    found = fit_gains(log, DEVICE.link.gravity_torque, DEVICE.link.gravity_angle)
    assert DEVICE.servo is not None
    assert found["kp"].value == pytest.approx(DEVICE.servo.kp, rel=0.1)  # a joint that sticks adds some percent
    assert found["kd"].value == pytest.approx(DEVICE.servo.kd + DEVICE.link.viscous_friction, rel=0.1)
    assert fit_gains(log, 0.0, 0.0) == {}
