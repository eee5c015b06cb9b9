"""Gains of a position drive: kp alone, or everything that is proportional to the torque constant."""

import numpy as np
import pytest
from sim_joints import flexible, positioned, rigid
from sim_position_drives import KD, KP, RATE, M, goals
from via_core.errors import ParameterError
from via_sim.effects import Effect, places
from via_sim.plants import JointPlant
from via_sim.simulate import simulate

GAIN, LIMIT = 0.6, 0.3


def motion(kp: float, kd: float, limit: float, *effects: Effect) -> np.ndarray:
    """Link angle [rad] after steps of the goal, of which the larger one meets the limit."""
    servo = f"{{kp: {kp}, kd: {kd}, torque_limit: {limit}}}"
    device = positioned(f"{{inertia: {M}, viscous_friction: 0.01, gravity_torque: 0.1}}", servo=servo)
    steps = goals(np.repeat([0.03, 0.4, -0.2], 150))
    return simulate(JointPlant.from_device(device).with_effects(effects), steps, 0.45, RATE).truth["q"]


@pytest.mark.parametrize(
    ("name", "kp", "kd", "limit"),
    [("torque_gain", GAIN, GAIN, GAIN), ("position_gain", GAIN, 1.0, 1.0)],
)
def test_a_gain_moves_the_joint_as_a_drive_with_these_numbers(name, kp, kd, limit):
    scaled = motion(KP, KD, LIMIT, Effect(name, "motor", {"gain": GAIN}, 1))
    np.testing.assert_allclose(scaled, motion(kp * KP, kd * KD, limit * LIMIT), atol=1e-12)


def test_only_a_position_drive_has_a_position_gain():
    assert places("position_gain", positioned()) == (("motor", 1),)
    assert places("position_gain", rigid()) == places("position_gain", flexible()) == ()
    with pytest.raises(ParameterError, match="no position drive"):
        JointPlant.from_device(flexible()).with_effects([Effect("position_gain", "motor", {"gain": 0.9}, 1)])
