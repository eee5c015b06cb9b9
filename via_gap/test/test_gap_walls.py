"""Walls that hardly yield, such as mechanical stops: touched for a few samples, less deep than encoders resolve."""

import numpy as np
import pytest
from gap_logs import flexible, log_of, rigid
from gap_models import COULOMB, evaluated
from via_gap.candidates.bounds import bounds_of
from via_gap.candidates.location import Location, locations
from via_gap.diagnosis import diagnose
from via_gap.residual.recordings import Recordings
from via_gap.selection.comparison import candidates_of
from via_gap.selection.evidence import vetoed
from via_gap.selection.experiment import Experiment
from via_sim.effects import Effect

WALL = Location("contact", "environment", 0)
OFFERED = ("contact", "coulomb_friction", "viscous_friction", "external_torque", "torque_saturation")  # to be short


@pytest.mark.parametrize(
    ("device", "seed", "angle", "stiffness", "damping", "factor"),
    [
        (rigid, 3, 0.6, 5e3, 0.0, 1.1),
        (rigid, 3, 0.6, 2e4, 15.0, 2.0),
        (rigid, 4, 0.7, 6e3, 20.0, 1.05),  # from starts without damping, fits end at a stiffness that is 8 % less
        (flexible, 3, 0.45, 3e3, 4.0, 1.1),
    ],
)
def test_a_hard_wall_is_named_with_its_place_and_stiffness(
    monkeypatch, device, seed, angle, stiffness, damping, factor
):
    """An encoder step changes the torque of the hardest one by 2 N m: its stiffness is known to a factor of two."""
    wall = Effect("contact", "environment", {"angle": angle, "stiffness": stiffness, "damping": damping, "side": 1.0})
    log = log_of(device(), (wall,), seed=seed, duration=20.0)
    assert 0.0 < np.mean(log.measured["q"] > angle) < 0.2
    monkeypatch.setattr(
        "via_gap.candidates.candidate_set.locations",
        lambda *of: tuple(location for location in locations(*of) if location.name in OFFERED),
    )
    report = diagnose([log], log.device)
    assert report.effects[0].effect == "contact"
    found = report.causes[0].parameters
    assert found["angle"].value == pytest.approx(angle, abs=0.005)
    assert stiffness / factor < found["stiffness"].value < stiffness * factor


def test_the_damping_of_a_wall_is_not_bounded_by_that_of_the_motion():
    log = log_of(rigid(), (), seed=3, duration=8.0)
    recordings = Recordings.of([log], None, rigid())
    scales = candidates_of(Experiment.of(recordings.fitted, recordings.held_out)).scales
    _, high = bounds_of(WALL, scales)
    assert high[1] == high[2] == 1e6
    _, friction = bounds_of(Location("viscous_friction", "link", 0), scales)
    assert friction[0] < 100.0


def test_the_equations_along_a_measured_motion_do_not_veto_a_wall():
    """Its torque is its stiffness times a depth below the encoder's step."""
    tuned = evaluated(np.full(40, 9.0), other_view=np.full(40, 1.0))
    friction, wall = (evaluated(np.full(40, 1.0), at, other_view=np.full(40, 50.0)) for at in (COULOMB, WALL))
    assert vetoed(friction, tuned) and not vetoed(wall, tuned)
