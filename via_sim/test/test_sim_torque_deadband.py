"""A drive with a deadband, which passes large commands in full, and one with a dead zone: closed forms."""

import numpy as np
import pytest
from sim_joints import flexible, positioned, rigid, serial_servo
from via_core.errors import ParameterError
from via_core.signals import Signals
from via_sim.effects import Effect, places
from via_sim.plants import JointPlant
from via_sim.simulate import simulate

RATE, THRESHOLD = 1000.0, 0.2


DEADBAND, DEAD_ZONE = ("torque_deadband", "threshold"), ("dead_zone", "width")


def moved(torque: float, effect: tuple[str, str] = DEADBAND) -> float:
    """Velocity [rad/s] of a rigid link of 0.02 kg m^2 after 0.1 s under a constant torque [N m]."""
    name, size = effect
    plant = JointPlant.from_device(rigid()).with_effects([Effect(name, "motor", {size: THRESHOLD}, 1)])
    time = np.arange(100) / RATE
    sent = Signals(time, {"external_torque": np.full(100, torque)}, {"external_torque": "N m"}, frozenset())
    return float(simulate(plant, sent, 0.1, RATE).truth["q_velocity"][-1])


@pytest.mark.parametrize("effect", [DEADBAND, DEAD_ZONE])
@pytest.mark.parametrize("torque", [0.1, -0.199, 0.0])
def test_a_small_command_moves_nothing(torque, effect):
    assert moved(torque, effect) == 0.0


@pytest.mark.parametrize("torque", [0.2, -0.5])
def test_a_large_command_acts_in_full(torque):
    assert moved(torque) == pytest.approx(torque * 0.1 / 0.02, rel=1e-12)


@pytest.mark.parametrize("torque", [0.3, -0.5])
def test_from_a_large_command_the_dead_zone_is_missing(torque):
    passed = torque - np.sign(torque) * THRESHOLD
    assert moved(torque, DEAD_ZONE) == pytest.approx(passed * 0.1 / 0.02, rel=1e-12)


def test_servos_have_neither_and_the_deadband_of_a_position_drive_is_that_of_its_error():
    for name, _ in (DEADBAND, DEAD_ZONE):
        assert places(name, flexible()) == (("motor", 1),) and places(name, serial_servo()) == ()
    assert places("dead_zone", positioned()) == places("position_deadband", positioned()) == (("motor", 1),)
    with pytest.raises(ParameterError, match="has a position drive"):
        JointPlant.from_device(positioned()).with_effects([Effect("torque_deadband", "motor", {"threshold": 0.1}, 1)])
