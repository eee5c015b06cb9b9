"""Gains of a position drive from goals, positions and the gravity of the model; a joint's numbers from its torque."""

import numpy as np
import pytest
from via_core.devices import load_device
from via_core.signals import Signals
from via_gap.logs.log import JointLog
from via_gap.logs.survey import fit_gains, fit_joint
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


@pytest.mark.parametrize("rate", [100.0, 1000.0])
@pytest.mark.parametrize("gravity", [0.0, 1.5])
def test_a_joint_far_from_zero_gets_no_gravity_from_the_filter(rate: float, gravity: float) -> None:
    """The second derivative of a constant angle must vanish: an inertia of .5 would show 2 N m at 2 rad."""
    t = np.arange(round(30.0 * rate)) / rate
    w, amplitude = np.array([1.3, 2.9, 7.1]), np.array([0.5, 0.3, 0.1])
    q = 2.0 + np.sin(np.outer(t, w)) @ amplitude
    speed, acceleration = np.cos(np.outer(t, w)) @ (w * amplitude), -np.sin(np.outer(t, w)) @ (w**2 * amplitude)
    noise = np.random.default_rng(0).normal(0.0, 0.01, len(t))
    tau = 0.5 * acceleration + 0.2 * speed + 0.1 * np.sign(speed) + gravity * np.sin(q) + noise
    device = load_device("dfki_simple_pendulum")
    found = fit_joint(
        JointLog("log", device, Signals(t, {"q": q, "tau": tau[:, None]}, {"q": "rad", "tau": "N m"}), None)
    )
    assert found["gravity_torque"].value == pytest.approx(gravity, abs=0.02)
    assert found["inertia"].value == pytest.approx(0.5, rel=0.01)
