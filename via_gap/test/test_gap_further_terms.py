"""Further terms of load-dependent friction: a position servo that sticks under its load."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from gap_models import COULOMB, fit_of
from via_core.devices import load_device
from via_core.signals import Signals
from via_gap.candidates.fit import Fit
from via_gap.candidates.further_terms import with_further_terms
from via_gap.candidates.location import Location
from via_gap.candidates.refinement import FINISHING, refine
from via_gap.candidates.scales import Scales, scales_of
from via_gap.logs.log import JointLog
from via_gap.residual.residual_model import ResidualModel
from via_gap.residual.segments import cut_log
from via_sim.effects import Effect
from via_sim.plants import JointPlant
from via_sim.sensors import Sensors
from via_sim.simulate import InitialConditions, simulate

NAME = "load_dependent_friction"
LOADED = Location(NAME, "link", 0)
PLANTED = {"coefficient": 0.25, "velocity": 0.3, "quadratic": 2.0}


@cache
def sticking(planted: tuple[tuple[str, float], ...]) -> tuple[ResidualModel, Scales, Fit]:
    """The segments of a weak servo that lifts a pendulum slowly and holds it, and their fit with one coefficient."""
    device = load_device("xl330_kp200")
    time = np.arange(round(24.0 * device.sensors.rate)) / device.sensors.rate
    goal = 1.2 * np.sin(1.1 * time) + 0.5 * np.sin(2.9 * time)
    commands = Signals(time, {"equilibrium": goal}, {"equilibrium": "rad"}, frozenset({"equilibrium"}))
    plant = JointPlant.from_device(device).with_effects([Effect(NAME, "link", dict(planted))])
    start = InitialConditions(seed=2)
    measured = simulate(plant, commands, 24.0, device.sensors.rate, Sensors.of_device(device), start).measured
    segments = cut_log(JointLog("sticking", device, measured.select(["q"]), commands))
    model = ResidualModel.of([segments], [np.arange(len(segments))], robust=True)
    scales = scales_of([segments], [None])
    none = Fit((), np.zeros(len(model.nuisances)), 0.0, np.empty(0), np.empty((0, 0)))
    simple = refine(model, none, [(LOADED, [0.2])], scales, FINISHING)
    assert simple is not None
    return model, scales, simple


def test_planted_terms_of_a_gear_are_found():
    model, scales, simple = sticking(tuple(PLANTED.items()))
    best = min(with_further_terms(model, [simple], scales), key=lambda each: each.loss)
    assert np.mean(model.per_segment(simple.residual)) > 10.0
    assert np.mean(model.per_segment(best.residual)) < 2.0
    found = best.effects[0].parameters
    assert found == {name: pytest.approx(value, rel=0.15) for name, value in PLANTED.items()}


def test_terms_are_not_added_far_from_the_best_fit():
    """Nothing is fitted if another cause explains the log far better, or if there is no fit."""
    model, scales, simple = sticking((("coefficient", 0.25),))
    other = fit_of([COULOMB])  # loss 0
    assert with_further_terms(model, [simple, other], scales) == [] and with_further_terms(model, [], scales) == []


def test_rivals_get_the_same_terms():
    """With more terms in the leader alone, it would win by them and not by its cause."""
    model, scales, simple = sticking(tuple(PLANTED.items()))
    rival = replace(simple, loss=1.2 * simple.loss)
    found = with_further_terms(model, [simple, rival], scales)
    assert [tuple(each.effects[0].parameters) for each in found[: len(found) // 2]] == [
        tuple(each.effects[0].parameters) for each in found[len(found) // 2 :]
    ]
    far = replace(simple, loss=3.0 * simple.loss)
    assert len(found) == 2 * len(with_further_terms(model, [simple, far], scales)) > 0


def test_without_further_terms_they_explain_no_more():
    model, scales, simple = sticking((("coefficient", 0.25),))
    for each in with_further_terms(model, [simple], scales):
        assert each.loss > 0.95 * simple.loss
        assert each.effects[0].parameters["coefficient"] == pytest.approx(0.25, abs=0.03)
