"""Combinations of parameters: the delta method against samples, and only what is better known than its parameters."""

import numpy as np
import pytest
from via_gap.report.combinations import combinations
from via_sim.effects import Effect

PAYLOAD = Effect("payload", "link", {"mass": 0.45, "distance": 0.5}, 0)


def test_standard_deviations_are_those_of_samples():
    sd = np.array([0.01, 0.012])
    covariance = np.outer(sd, sd) * np.array([[1.0, -0.9], [-0.9, 1.0]])
    samples = np.random.default_rng(3).multivariate_normal([0.45, 0.5], covariance, 200_000)
    moment, inertia = combinations(PAYLOAD, covariance)
    assert (moment.expression, moment.unit) == ("mass * distance", "kg m")
    assert (inertia.expression, inertia.unit) == ("mass * distance^2", "kg m^2")
    assert moment.value == pytest.approx(0.225) and inertia.value == pytest.approx(0.1125)
    assert moment.sd == pytest.approx(float(np.std(samples[:, 0] * samples[:, 1])), rel=0.02)
    assert inertia.sd == pytest.approx(float(np.std(samples[:, 0] * samples[:, 1] ** 2)), rel=0.02)


def test_what_is_known_no_better_than_its_parameters_is_left_out():
    assert combinations(PAYLOAD, np.diag([0.01, 0.01]) ** 2) == ()
    assert combinations(Effect("backlash", "transmission", {"gap": 0.02}, 1), np.eye(1)) == ()


def test_a_slipping_element_is_known_by_its_deflection():
    element = Effect("hysteresis", "transmission", {"torque": 0.2, "stiffness": 10.0}, 1)
    sd = np.array([0.1, 5.0])
    (slip,) = combinations(element, np.outer(sd, sd) * np.array([[1.0, 0.99], [0.99, 1.0]]))
    assert slip.value == pytest.approx(0.02) and slip.unit == "rad"
    assert slip.sd < 0.2 * slip.value


def test_friction_of_two_directions_is_stated_as_a_symmetric_one_beside_a_constant_torque():
    friction = Effect("asymmetric_coulomb", "link", {"forward": 0.1, "backward": 0.3})
    errors = np.outer([0.02, 0.02], [0.02, 0.02]) * np.array([[1.0, -0.9], [-0.9, 1.0]])  # of a constant torque
    dry, constant = combinations(friction, errors)
    assert dry.value == pytest.approx(0.2) and dry.sd == pytest.approx(0.02 * np.sqrt(0.05))
    assert constant.value == pytest.approx(0.1) and constant.sd == pytest.approx(0.02 * np.sqrt(0.95))
