"""A spring between link and base against the closed form of a free oscillation."""

import numpy as np
import pytest
from sim_joints import LINK, flexible, rigid
from via_sim.effects import Effect, places
from via_sim.joint.parameters import P
from via_sim.plants import JointPlant
from via_sim.simulate import InitialConditions, simulate

INERTIA, STIFFNESS, REST = 0.02, 3.0, 0.4
RATE, TICKS = 2000.0, 4000


@pytest.mark.parametrize("rest", [0.0, REST, -1.7])
def test_a_free_link_oscillates_about_the_rest_angle(rest):
    spring = Effect("link_spring", "link", {"stiffness": STIFFNESS, "rest": rest})
    plant = JointPlant.from_device(rigid(LINK)).with_effects([spring])
    run = simulate(plant, None, TICKS / RATE, RATE, initial=InitialConditions((1.0, 0, 0, 0, 0, 0))).truth
    wanted = rest + (1.0 - rest) * np.cos(np.sqrt(STIFFNESS / INERTIA) * run.time)
    assert np.abs(run["q"] - wanted).max() < 1e-6


def test_it_acts_on_the_link_alone():
    assert places("link_spring", flexible()) == (("link", 0),)
    spring = Effect("link_spring", "link", {"stiffness": STIFFNESS, "rest": REST})
    row = JointPlant.from_device(flexible()).with_effects([spring]).parameters
    assert row[P.link_spring : P.link_spring + 3].tolist() == [STIFFNESS, 0.0, 0.0]
