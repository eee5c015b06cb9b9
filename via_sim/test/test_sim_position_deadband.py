"""A position drive with a dead band: no torque for small errors, the whole torque for large ones."""

import numpy as np
import pytest
from sim_joints import flexible, positioned, rigid
from sim_position_drives import KP, RATE, M, goals
from via_core.errors import ParameterError
from via_sim.effects import Effect, places
from via_sim.plants import JointPlant
from via_sim.simulate import simulate

WIDTH = 0.05


def speed(error: float) -> float:
    """Of a link at rest without friction [rad/s], one tick after a goal `error` [rad] away."""
    device = positioned(f"{{inertia: {M}, viscous_friction: 0.0}}", servo=f"{{kp: {KP}, kd: 0.0}}")
    plant = JointPlant.from_device(device).with_effects([Effect("position_deadband", "motor", {"width": WIDTH}, 1)])
    return float(simulate(plant, goals([error] * 2), 1.0 / RATE, RATE).truth["q_velocity"][-1])


@pytest.mark.parametrize("error", [0.0, 0.049, -0.049])
def test_a_small_error_moves_nothing(error):
    assert speed(error) == 0.0


@pytest.mark.parametrize("error", [0.051, -0.4])
def test_a_large_error_is_corrected_in_full(error):
    """A free oscillator: q = error (1 - cos w t), w^2 = kp / M."""
    w = np.sqrt(KP / M)
    assert speed(error) == pytest.approx(error * w * np.sin(w / RATE), rel=1e-9)


def test_only_a_position_drive_has_a_dead_band_of_its_error():
    assert places("position_deadband", positioned()) == (("motor", 1),)
    assert places("position_deadband", rigid()) == places("position_deadband", flexible()) == ()
    with pytest.raises(ParameterError, match="no position drive"):
        JointPlant.from_device(flexible()).with_effects([Effect("position_deadband", "motor", {"width": 0.1}, 1)])
