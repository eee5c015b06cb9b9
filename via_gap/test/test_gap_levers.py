"""A payload is fitted in m l and m l^2, so that a valley of equal pairs (m, l) leads to the most likely one."""

import numpy as np
import pytest
from gap_logs import log_of, rigid
from via_gap.candidates.converged import converged
from via_gap.candidates.fit import Axes, fit_device_parameters
from via_gap.candidates.levers import bending, bent, straightened
from via_gap.candidates.location import Location
from via_gap.candidates.refinement import refine
from via_gap.candidates.scales import scales_of
from via_gap.candidates.starts import combined, starts
from via_gap.residual.residual_model import ResidualModel
from via_gap.residual.segments import cut_log
from via_sim.effects import Effect

PAYLOAD = Location("payload", "link", 0)
VALUES = np.array([7.0, 0.3, 0.2, 5.0])


def test_both_ways_lead_back():
    straight = straightened(VALUES, (1,))
    assert straight == pytest.approx([7.0, 0.06, 0.012, 5.0])
    assert bent(straight, (1,)) == pytest.approx(VALUES)
    assert list(bent(np.array([0.0, 0.01]), (0,))) == [0.0, 0.0]


def test_derivatives_are_those_of_finite_differences():
    straight, step = straightened(VALUES, (1,)), 1e-7
    ahead, behind = ([bent(straight + sign * step * unit, (1,)) for unit in np.eye(4)] for sign in (1.0, -1.0))
    slopes = (np.array(ahead) - np.array(behind)).T / (2.0 * step)
    assert bending(straight, (1,)) == pytest.approx(slopes, rel=1e-6, abs=1e-6)


def test_a_start_reaches_every_pair_of_weight_and_inertia_between_its_directions():
    log = log_of(rigid(), (), seed=3, duration=5.0)
    segments = cut_log(log)
    scales = scales_of([segments], [None])
    (start,) = starts(PAYLOAD, scales, log.device)
    near, far = (each["distance"] for each in start.directions)
    assert near < 0.05 < 0.5 < far
    masses = np.array([each["mass"] for each in start.directions])
    weights = masses * [near, far]
    mass, distance = combined(PAYLOAD, start, [2.0, 3.0])
    assert mass * distance == pytest.approx(weights @ [2.0, 3.0])
    assert mass * distance**2 == pytest.approx((weights * [near, far]) @ [2.0, 3.0])


def test_an_upright_axis_shows_the_inertia_of_a_payload_alone():
    device = rigid()
    device = device.model_copy(update={"link": device.link.model_copy(update={"gravity_torque": 0.0})})
    log = log_of(device, (Effect("payload", "link", {"mass": 0.3, "distance": 0.3}),), seed=3, duration=10.0)
    segments = cut_log(log)
    model = ResidualModel.of([segments], [np.flatnonzero(segments.valid)], robust=True)
    scales = scales_of([segments], [None])
    found = refine(model, fit_device_parameters(model), [(PAYLOAD, [0.2, 0.2])], scales)
    assert found is not None
    best = converged(model, found, scales)
    mass, distance = best.values
    turning = np.array([distance**2, 2.0 * mass * distance])  # derivatives of m l^2
    of_inertia = np.sqrt(turning @ best.covariance @ turning) / (mass * distance**2)
    assert mass * distance**2 == pytest.approx(0.027, rel=0.2) and 0.0 < of_inertia < 0.3
    assert mass < best.sd[0] < 100.0, "the mass alone is not known, but for its range"
    (of_tolerance,) = best.tolerances
    assert of_tolerance @ turning == pytest.approx(device.link.inertia * device.tolerances.link_inertia, rel=1e-3)
    assert np.abs(of_tolerance).max() < 1.0, "the weight shows nothing and takes up nothing"
    axes = Axes.of(model, best.members, scales)
    assert axes.sd(best)[1] * axes.size[1] == pytest.approx(of_inertia * mass * distance**2, rel=0.01)


@pytest.mark.parametrize("begin", [[0.13, 0.39], [0.57, 0.11]], ids=["long", "short"])
def test_the_most_likely_pair_is_found_from_both_ends_of_the_valley(begin):
    """Tolerances of 10 % of inertia and gravity hide mass and distance; at the truth, both are as in the file."""
    log = log_of(rigid(), (Effect("payload", "link", {"mass": 0.3, "distance": 0.2}),), seed=3, duration=10.0)
    segments = cut_log(log)
    model = ResidualModel.of([segments], [np.flatnonzero(segments.valid)], robust=True)
    scales = scales_of([segments], [None])
    found = refine(model, fit_device_parameters(model), [(PAYLOAD, begin)], scales)
    assert found is not None
    best = converged(model, found, scales)
    mass, distance = best.values
    assert mass * distance == pytest.approx(0.06, rel=0.08)
    weight = np.array([distance, mass])  # derivatives of m l
    of_weight, of_mass = np.sqrt(weight @ best.covariance @ weight) / (mass * distance), best.sd[0] / mass
    assert 0.01 < of_weight < 0.5 * of_mass, "m l is better known than m"
