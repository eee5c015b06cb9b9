"""Inverse dynamics is asked where simulation names no cause, and answers only if simulation agrees."""

from dataclasses import replace

import numpy as np
import pytest
from gap_logs import flexible, log_of, positioned, rigid
from via_core.signals import Signals
from via_gap import diagnosis
from via_gap.candidates.refinement import fit_on
from via_gap.diagnosis import diagnose
from via_gap.logs.log import JointLog
from via_gap.residual.recordings import Recordings
from via_gap.selection.comparison import ModelComparison, compare_models
from via_gap.selection.evidence import significantly_worse
from via_gap.selection.experiment import Experiment
from via_gap.selection.search import MOST
from via_gap.selection.second_view import most_effects, second_view, upheld
from via_gap.selection.verdict import Decision
from via_sim.effects import Effect
from via_sim.plants import JointPlant
from via_sim.sensors import Sensors
from via_sim.simulate import simulate

DRY = Effect("coulomb_friction", "link", {"torque": 0.03})


def experiment_of(log):
    return Experiment.of(Recordings.of([log], None, log.device).fitted, ())


@pytest.fixture(scope="module")
def simulated():
    return experiment_of(log_of(rigid(), (DRY,), seed=1))


def with_position_drive():
    device, rate = positioned(), 500.0
    time = np.arange(6000) / rate
    sent = {"equilibrium": 0.5 * np.sin(1.3 * time) + 0.3 * np.sin(3.1 * time)}
    commands = Signals(time, sent, {"equilibrium": "rad"}, frozenset(sent))
    plant = JointPlant.from_device(device).with_effects((DRY,))
    measured = simulate(plant, commands, time[-1], rate, Sensors.of_device(device)).measured
    return JointLog("log", device, measured.select(["q"]), commands)


def decision(experiment, verdict, *effects):
    """A decision with the device parameters of the tuned device and some effects."""
    fit = replace(experiment.tuned.fit, effects=effects)
    return Decision(verdict, replace(experiment.tuned, fit=fit), 0.0)


@pytest.mark.parametrize(
    ("verdict", "asked"),
    [("cannot_tell", True), ("unknown", True), ("no_gap", False), ("effect", False), ("main_effect", False)],
)
def test_torques_are_asked_only_where_simulation_names_nothing(simulated, verdict, asked):
    torques = second_view(simulated, decision(simulated, verdict))
    assert (torques is not None) == asked
    if torques is not None:
        assert torques.by_equations and second_view(torques, decision(torques, verdict)) is None


def test_there_is_no_second_view_without_an_equation_or_with_a_control_loop():
    both = log_of(flexible(), (DRY,), seed=1)
    link = replace(both, measured=Signals(both.measured.time, {"q": both.measured["q"]}, {"q": "rad"}))
    for log in (link, with_position_drive()):
        experiment = experiment_of(log)
        assert second_view(experiment, decision(experiment, "cannot_tell")) is None


def test_a_strong_push_does_not_prevent_a_second_view():
    """It spoils the flexible torque, which then predicts less than a constant. The device itself still predicts."""
    push = Effect("external_torque", "environment", {"torque": -100.0, "start": 5.0, "stop": 5.6})
    experiment = experiment_of(log_of(rigid(), (DRY, push), seed=1))
    torques = second_view(experiment, decision(experiment, "cannot_tell"))
    flexible = replace(torques.tuned, segments=torques.bound_of_equations(torques.tuned.fit), fitted=np.empty(0))
    assert significantly_worse(flexible, torques.baseline) and significantly_worse(torques.baseline, torques.tuned)


def test_the_answer_stands_only_if_its_repair_lowers_the_simulated_error(simulated):
    first, torques = decision(simulated, "cannot_tell"), second_view(simulated, decision(simulated, "cannot_tell"))
    right, wrong = (replace(DRY, parameters={"torque": torque}) for torque in (0.03, 0.2))
    assert upheld(simulated, first, decision(torques, "main_effect", right))
    assert not upheld(simulated, first, decision(torques, "main_effect", wrong))
    needless = Effect("quadratic_drag", "link", {"coefficient": 0.002})  # the friction beside it makes up for its error
    both = decision(torques, "main_effect", right, needless)
    (repaired,) = simulated.evaluate([fit_on(simulated.fitted, both.chosen.fit)])
    assert repaired.on_all.score < simulated.tuned.on_all.score and not upheld(simulated, first, both)
    worse = replace(simulated, tuned=simulated.nominal)  # device parameters alone are no answer
    assert not upheld(worse, first, decision(simulated, "cannot_tell"))


def test_only_one_effect_that_explains_everything_stands_where_the_cause_is_unknown(simulated):
    first, torques = decision(simulated, "unknown"), second_view(simulated, decision(simulated, "unknown"))
    assert upheld(simulated, first, decision(torques, "effect", DRY))
    assert not upheld(simulated, first, decision(torques, "several_effects", DRY))
    assert not upheld(simulated, first, decision(torques, "main_effect", DRY))
    cannot_tell = decision(simulated, "cannot_tell")
    assert upheld(simulated, cannot_tell, decision(torques, "several_effects", DRY))
    assert most_effects(first) == 1 and most_effects(cannot_tell) == MOST > 1


def test_a_diagnosis_whose_simulation_finds_no_model_asks_the_torques(monkeypatch):
    """Without a model compared by simulation, inverse dynamics names the cause; otherwise it is not asked."""
    asked: list[tuple[str, int]] = []

    def without_simulation(experiment, candidates, progress, most):
        asked.append((experiment.by, most))
        if experiment.by_equations:
            return compare_models(experiment, candidates, progress, most)
        return ModelComparison(experiment, candidates, [])

    log = log_of(rigid(), (DRY,), seed=1)
    shares = []
    monkeypatch.setattr(diagnosis, "compare_models", without_simulation)
    report = diagnose([log], log.device, progress=lambda _what, share: shares.append(share))
    assert asked == [("segments", MOST), ("inverse dynamics", 1)] and shares == sorted(shares)
    assert [each.effect for each in report.effects] == ["coulomb_friction"] and report.gap.by == "inverse dynamics"
    assert report.causes[0].parameters["torque"].value == pytest.approx(0.03, rel=0.05)
    monkeypatch.undo()
    assert diagnose([log], log.device).gap.by == "segments"
