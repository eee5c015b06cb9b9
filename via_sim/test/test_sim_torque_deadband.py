"""A drive with a deadband: closed form of a rigid joint, and no influence on large commands."""

import numpy as np
import pytest
from sim_joints import flexible, positioned, rigid, serial_servo
from via_core.errors import ParameterError
from via_core.signals import Signals
from via_sim.effects import Effect, places
from via_sim.plants import JointPlant
from via_sim.simulate import simulate

RATE, THRESHOLD = 1000.0, 0.2


def moved(torque: float) -> float:
    """Velocity [rad/s] of a rigid link of 0.02 kg m^2 after 0.1 s under a constant torque [N m]."""
    plant = JointPlant.from_device(rigid()).with_effects(
        [Effect("torque_deadband", "motor", {"threshold": THRESHOLD}, 1)]
    )
    time = np.arange(100) / RATE
    sent = Signals(time, {"external_torque": np.full(100, torque)}, {"external_torque": "N m"}, frozenset())
    return float(simulate(plant, sent, 0.1, RATE).truth["q_velocity"][-1])


@pytest.mark.parametrize("torque", [0.1, -0.199, 0.0])
def test_a_small_command_moves_nothing(torque):
    assert moved(torque) == 0.0


@pytest.mark.parametrize("torque", [0.2, -0.5])
def test_a_large_command_acts_in_full(torque):
    assert moved(torque) == pytest.approx(torque * 0.1 / 0.02, rel=1e-12)


def test_only_drives_with_a_commanded_torque_have_a_deadband():
    assert places("torque_deadband", flexible()) == (("motor", 1),)
    assert places("torque_deadband", serial_servo()) == places("torque_deadband", positioned()) == ()
    with pytest.raises(ParameterError, match="has a position drive"):
        JointPlant.from_device(positioned()).with_effects([Effect("torque_deadband", "motor", {"threshold": 0.1}, 1)])
