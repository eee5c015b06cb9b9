"""Transmission error of a gear: torques as gradients of the spring's energy, and conservation of energy."""

import numpy as np
import pytest
from sim_joints import GEAR_ERRORS, device
from via_core.errors import ParameterError
from via_sim.effects import Effect
from via_sim.plants import JointPlant
from via_sim.simulate import InitialConditions, simulate

JOINT = device(
    "flexible",
    rest="motors: [{inertia: 0.01, viscous_friction: 0.0}]\n"
    "springs: [{law: linear, stiffness: 10.0, max_deflection: 3.0}]",
)
GIVEN = {"amplitude": 0.03, "order": 3.0, "phase": 0.4, **GEAR_ERRORS}
PLANT = JointPlant.from_device(JOINT).with_effects([Effect("gear_error", "transmission", GIVEN, 1)])


def energy_of_spring(q, theta):
    """Energy [J] of a spring of 10 N m/rad behind the gear."""
    error = 0.03 * np.sin(3.0 * theta + 0.4) + 0.01 * np.sin(7.5 * theta + 1.0) + 0.005 * np.sin(21.0 * theta)
    return 5.0 * (q - theta - error) ** 2


@pytest.mark.parametrize(("q", "theta"), [(0.3, 0.1), (-0.2, 0.5), (0.0, -0.7)])
def test_torques_are_gradients_of_the_energy(q, theta):
    found = PLANT.derivative((q, theta, 0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0))
    h = 1e-6
    by_link = (energy_of_spring(q + h, theta) - energy_of_spring(q - h, theta)) / (2.0 * h)
    by_motor = (energy_of_spring(q, theta + h) - energy_of_spring(q, theta - h)) / (2.0 * h)
    assert found[3] * 0.02 == pytest.approx(-by_link, abs=1e-7)
    assert found[4] * 0.01 == pytest.approx(-by_motor, abs=1e-7)


def test_energy_is_conserved():
    start = InitialConditions((0.4, 0.0, 0.0, 0.0, 2.0, 0.0))
    run = simulate(PLANT, None, 5.0, 1000.0, initial=start).truth
    motor, speed = run["theta"][:, 0], run["theta_velocity"][:, 0]
    total = energy_of_spring(run["q"], motor) + 0.01 * run["q_velocity"] ** 2 + 0.005 * speed**2
    assert np.ptp(total) < 1e-6 * total[0]
    assert np.ptp(motor) > 1.5


def test_a_gear_that_would_reverse_is_refused():
    with pytest.raises(ParameterError, match="the gear would reverse"):
        JointPlant.from_device(JOINT).with_effects(
            [Effect("gear_error", "transmission", {"amplitude": 0.2, "order": 6.0, "phase": 0.0}, 1)]
        )
