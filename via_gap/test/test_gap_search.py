"""The search: which candidates are fitted to the end."""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
from gap_logs import flexible, log_of, rigid
from gap_models import DRAG, PAYLOAD, evaluated
from via_core.devices import load_device
from via_core.signals import Signals
from via_gap.candidates.fit import Fit
from via_gap.candidates.location import Location
from via_gap.candidates.refinement import fit_on, refine
from via_gap.candidates.screen import ranked
from via_gap.diagnosis import diagnose
from via_gap.logs.log import JointLog
from via_gap.residual.recordings import Recordings
from via_gap.selection.comparison import candidates_of
from via_gap.selection.experiment import Experiment
from via_gap.selection.plausibility import absurd
from via_gap.selection.search import PREDICTED, Search
from via_gap.selection.verdict import Decision, relevant
from via_sim.effects import Effect
from via_sim.plants import JointPlant
from via_sim.sensors import Sensors
from via_sim.simulate import InitialConditions, simulate

DEVICE = load_device("xl330_kp800")
ASYMMETRIC_VISCOUS = Location("asymmetric_viscous", "link", 0)
ASYMMETRIC_COULOMB = Location("asymmetric_coulomb", "link", 0)
LOADED = (
    Effect("load_dependent_friction", "link", {"coefficient": 0.4}),
    Effect("payload", "link", {"mass": 0.3, "distance": 0.1}),
)


def servo_log(wish, seed: int) -> JointLog:
    """Angle and goal of the position drive with both effects, for a goal `wish` of time."""
    rate, duration = DEVICE.sensors.rate, 6.0
    time = np.arange(round(duration * rate)) / rate
    commands = Signals(time, {"equilibrium": wish(time)}, {"equilibrium": "rad"}, frozenset({"equilibrium"}))
    plant = JointPlant.from_device(DEVICE).with_effects(LOADED)
    measured = simulate(
        plant, commands, duration, rate, Sensors.of_device(DEVICE), InitialConditions(seed=seed)
    ).measured
    return JointLog(f"log {seed}", DEVICE, measured.select(["q"]), commands)


def test_a_cause_that_a_linear_prediction_ranks_low_is_fitted():
    """Friction that grows with a load twice as large as filed: no small change of the file resembles it."""
    logs = [
        servo_log(lambda t: np.sin(t) + 0.5 * np.sin(5.0 * t), 1),
        servo_log(lambda t: np.sin(1.7 * t) + 0.4 * np.sin(4.1 * t), 2),
    ]
    recordings = Recordings.of(logs, None, DEVICE)
    experiment = Experiment.of(recordings.fitted, recordings.held_out)
    search = Search.of(
        experiment.fitted, experiment.evaluate, lambda _: True, experiment.tuned, candidates_of(experiment)
    )
    places = ranked(search.start, search.jacobian, search.tried)
    predicted = [place.name for _, place, _ in places].index("load_dependent_friction")
    fits = search._raced(search.start, [[(p, v)] for _, p, v in places], search.jacobian, 4)
    best = min(fits, key=lambda each: each.loss)
    assert predicted > 4 and len(fits) == 4  # the prediction alone would have left it out
    assert best.locations[0].name == "load_dependent_friction" and best.loss < 0.05 * search.start.loss
    fits = search._raced(search.start, [[(p, v)] for _, p, v in places], search.jacobian, 1)
    predictions = {place for _, place, _ in places[:PREDICTED]}
    assert {fit.locations[0] for fit in fits} == {best.locations[0], *predictions}


def test_small_effects_are_sought_although_less_than_one_standard_deviation_is_left():
    """The first of two effects leaves a mean z^2 below 2, and the search still tries a second one."""
    ripple = Effect("torque_ripple", "motor", {"amplitude": 0.0004, "order": 9.0, "phase": 0.3}, 1)
    planted = (Effect("coulomb_friction", "link", {"torque": 0.0025}), ripple)
    report = diagnose([log_of(rigid(), planted, seed=3, duration=10.0)], rigid())
    assert report.gap.after < np.sqrt(2.0) * report.gap.floor and len(report.effects) == 1
    assert any(len(trial.effects) == 2 for trial in report.figures.trials)


def test_causes_that_are_tied_with_the_named_one_are_fitted_to_convergence_as_well():
    """The tied payload begins with gravity .9 of its tolerance off, on the line where both are one sum."""
    device, moment = rigid(), 0.3 * 0.4
    payload = Effect("payload", "link", {"mass": 0.3, "distance": 0.4})
    recordings = Recordings.of([log_of(device, (payload,), seed=7, duration=10.0, tolerance=0.0)], None, device)
    experiment = Experiment.of(recordings.fitted, recordings.held_out)
    problem, scales = experiment.fitted, candidates_of(experiment).scales
    gravity = [each.name for each in problem.nuisances].index("gravity torque")
    offsets = 0.9 * (np.arange(len(problem.nuisances)) == gravity)
    weight = moment - 0.9 * device.tolerances.gravity * device.link.gravity_torque / 9.81
    mass = weight**2 / (0.3 * 0.4**2)
    near = Effect("payload", "link", {"mass": mass, "distance": weight / mass})
    gain = Effect("torque_gain", "motor", {"gain": 0.9}, 1)
    begins = ((gain, 0.0 * offsets), (near, offsets))
    fits = [Fit((each,), at, 0.0, np.empty(0), np.eye(len(each.parameters))) for each, at in begins]
    named, tied = experiment.evaluate([fit_on(problem, fit) for fit in fits])
    causes = tuple(each.fit.locations[0] for each in (named, tied))
    decision = Decision("effect", named, 1.0, tuple((each, 0.5) for each in causes), (named, tied), causes)
    _, after = decision.converged(experiment, scales).models
    mass, distance = after.fit.values
    assert after.fit.offsets[gravity] == 0.0 and abs(mass * distance - moment) < 0.01 * moment


def test_a_cause_far_behind_after_one_step_is_fitted():
    """A spring to a rest angle is a product of two parameters: one step leaves forty times the best loss."""
    device = rigid()
    spring = Effect("link_spring", "link", {"stiffness": 0.03, "rest": 0.6})
    recordings = Recordings.of([log_of(device, (spring,), seed=3, duration=12.0)], None, device)
    experiment = Experiment.of(recordings.fitted, recordings.held_out)
    search = Search.of(
        experiment.fitted, experiment.evaluate, lambda _: True, experiment.tuned, candidates_of(experiment)
    )
    fits = search._joined(search.tuned.fit)
    best = min(fits, key=lambda each: each.loss)
    assert best.locations[0].name == "link_spring"


def test_a_shape_at_the_end_of_its_range_is_sought_again_from_the_other_starts():
    """At the least speed there is no Stribeck friction; with the size of that fit, another start finds it."""
    device = flexible()
    effect = Effect("stribeck_friction", "motor", {"breakaway": 0.3, "kinetic": 0.15, "velocity": 0.2}, 1)
    recordings = Recordings.of([log_of(device, (effect,), seed=3, duration=12.0)], None, device)
    experiment = Experiment.of(recordings.fitted, recordings.held_out)
    search = Search.of(
        experiment.fitted, experiment.evaluate, lambda _: True, experiment.tuned, candidates_of(experiment)
    )
    slow = Effect("stribeck_friction", "motor", {"breakaway": 0.4, "kinetic": 0.15, "velocity": 1e-3}, 1)
    stuck = fit_on(search.few, replace(search.start, effects=(slow,), covariance=np.eye(3)))
    assert absurd(stuck, search.scales)
    best = min(search._reshaped([stuck]), key=lambda fit: fit.loss)
    assert best.loss < 0.1 * stuck.loss and not absurd(best, search.scales)
    assert best.values == pytest.approx([0.3, 0.15, 0.2], rel=0.1)
    assert search._reshaped([best]) == []


def test_two_effects_whose_richer_forms_fit_best_are_tried_in_their_plainer_form():
    """Both directions of each friction are equal, so a pair with one asymmetric friction may not be named."""
    effects = (
        Effect("viscous_friction", "link", {"coefficient": 0.3}),
        Effect("coulomb_friction", "link", {"torque": 0.4}),
    )
    log = log_of(rigid(), effects, seed=6, duration=12.0)
    recordings = Recordings.of([log], None, log.device)
    experiment = Experiment.of(recordings.fitted, recordings.held_out)
    search = Search.of(
        experiment.fitted, experiment.evaluate, lambda _: True, experiment.tuned, candidates_of(experiment)
    )
    members = [(ASYMMETRIC_VISCOUS, [0.3, 0.3]), (ASYMMETRIC_COULOMB, [0.4, 0.4])]
    best = refine(search.few, search.start, members, search.scales)
    found = {frozenset(each.name for each in fit.locations) for fit in search._plainer([best])}
    plain = {"viscous_friction", "coulomb_friction"}
    assert found == {
        frozenset(plain),
        frozenset({"asymmetric_viscous", "coulomb_friction"}),
        frozenset({"viscous_friction", "asymmetric_coulomb"}),
    }


@pytest.mark.parametrize(("fitted", "sizes"), [(500.0, [0, 1]), (5000.0, [0])], ids=["helps fitted", "helps none"])
def test_a_step_that_helps_fitted_segments_alone_is_followed(monkeypatch, fitted, sizes):
    """A torque limit that only fitted recordings reach improves no held-out segment, but a pair with it may."""
    before, after = (
        replace(evaluated(np.full(20, held), *places), fitted=np.full(20, error))
        for held, error, places in ((50.0, 5000.0, ()), (49.8, fitted, (PAYLOAD,)))
    )
    assert not relevant(after, before, before)
    assert sizes_tried(monkeypatch, before, [after]) == sizes


@pytest.mark.parametrize(("most", "sizes"), [(4, [0, 1, 2]), (2, [0, 1]), (1, [0])])
def test_models_have_at_most_as_many_effects_as_asked_for(monkeypatch, most, sizes):
    before, *steps = (
        evaluated(np.full(20, error), *places)
        for error, places in ((400.0, ()), (200.0, (PAYLOAD,)), (100.0, (PAYLOAD, DRAG)))
    )
    assert sizes_tried(monkeypatch, before, steps, most) == sizes


def sizes_tried(monkeypatch, before, steps, most=4):
    """Numbers of effects beside which the search tries a further one, if it finds the models `steps` in turn."""
    extended: list[int] = []
    coming = iter(steps)
    for name, instead in (
        ("_extended", lambda _self, fit: extended.append(len(fit.effects))),
        ("_finished", lambda _self, _fits: list(islice(coming, 1))),
        ("_evaluated", lambda _self, models, _models: models),
        ("_reduced", lambda _self, _fit: []),
        ("_beside", lambda self, _fit: self),
    ):
        monkeypatch.setattr(Search, name, instead)
    search = Search(None, None, None, None, before, before.fit, np.empty(0), [], None)
    search.run(lambda _what, _share: None, most)
    return extended
