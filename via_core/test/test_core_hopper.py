"""Hopper: equilibrium as minimum of potential energy, and refused parameters."""

from dataclasses import replace

import numpy as np
import pytest
from via_core.errors import ParameterError
from via_core.hopper import Hopper

HOPPER, ANGLE = Hopper(), 0.6


def potential(hopper: Hopper, a: float) -> float:
    """Of robot and springs, feet below the hips [J]: masses by their heights above ground."""
    length = hopper.segment_length
    hip, knee = 2.0 * length * np.cos(a), length * np.cos(a)
    legs = 2.0 * (hopper.thigh_mass * 0.5 * (hip + knee) + hopper.shank_mass * 0.5 * knee)
    height = 9.81 * ((hopper.trunk_mass + hopper.payload) * hip + legs)
    deflection = hopper.crouched(a) - hopper.crouched(ANGLE)
    return float(height + 0.5 * hopper.stiffness @ deflection**2)


@pytest.mark.parametrize("payload", [0.0, 6.0])
def test_standing_is_the_minimum_of_energy(payload):
    hopper, h = replace(HOPPER, payload=payload), 1e-5
    q = hopper.standing(ANGLE)
    assert q == pytest.approx(hopper.crouched(q[0]))
    below, here, above = (potential(hopper, q[0] + s) for s in (-h, 0.0, h))
    assert (above - below) / (2.0 * h) == pytest.approx(0.0, abs=1e-4)
    assert above + below > 2.0 * here
    assert q[0] > ANGLE + 0.02


def test_a_stretched_leg_is_as_long_as_its_segments():
    assert HOPPER.leg_height(np.zeros(2)) == pytest.approx(0.515)
    assert HOPPER.leg_height(np.array([np.pi / 3, -2 * np.pi / 3])) == pytest.approx(0.265)


def test_springs_are_linear():
    torque, stiffness, slope = HOPPER.spring_state(np.array([0.1, -0.2, 0.0, 1.0]))
    assert torque == pytest.approx([15.0, -16.0, 0.0, 80.0])
    assert stiffness.tolist() == [150.0, 80.0, 150.0, 80.0] and not slope.any()


def test_too_heavy_a_load_is_not_carried():
    with pytest.raises(ParameterError, match="carry"):
        replace(HOPPER, payload=500.0).standing(ANGLE)


@pytest.mark.parametrize("change", [{"trunk_mass": 0.0}, {"payload": -1.0}, {"hip_stiffness": np.nan}])
def test_impossible_hoppers_are_refused(change):
    with pytest.raises(ParameterError):
        replace(HOPPER, **change)
