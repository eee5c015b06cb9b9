"""`via changes`: changing springs in the simulator, measures of planted runs, limits and page."""

from dataclasses import replace
from math import inf, isnan, nan

import numpy as np
import pytest
from via_core.devices import load_device
from via_core.errors import ParameterError
from via_core.signals import Signals
from via_estimators.methods import estimator_for
from via_sim.effects import Effect
from via_sim.joint.measurements import TRUTH
from via_sim.plants import JointPlant
from via_sim.sensors import IDEAL
from via_sim.simulate import simulate
from via_validation.changes import experiment, figures, page, run
from via_validation.changes.schedules import AMPLITUDE, CONSTANT, SCHEDULES, SINES, STEP, STEP_SIZE, STEP_TIME
from via_validation.changes.springs import changing_springs
from via_validation.compare.figures import Run
from via_validation.provenance import provenance

JOINT = load_device("qbmove_b")
TIME = np.arange(30_000) / 1000.0


def test_a_drift_by_the_tick_is_the_drift_of_the_simulator():
    time, rate = TIME[:1500], 0.05
    torques = 0.3 * np.stack([np.sin(5.0 * time), -np.sin(7.0 * time)], axis=1)
    plant = JointPlant.from_device(JOINT)
    _, truth = changing_springs(plant, 1.0 + rate * time, lambda k, _: torques[k], IDEAL)
    effects = [Effect("stiffness_drift", "transmission", {"rate": rate}, 0)]
    commands = Signals(time, {"motor": torques}, {"motor": "N m"}, frozenset({"motor"}))
    wanted = simulate(plant.with_effects(effects), commands, (len(time) - 1) / 1000.0, 1000.0).truth
    np.testing.assert_allclose(truth[:, TRUTH.q], wanted["q"], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(truth[:, TRUTH.stiffness], wanted["stiffness"], rtol=1e-9)


def test_the_truth_has_the_factor_of_the_schedule():
    joint = experiment.recording(JOINT, SINES[-1], 1.2)
    spring, measured = JOINT.springs[0], joint.measured(3)
    phi = measured["q"][:, None] - measured["theta"]
    nominal = np.sum(spring.stiffness(phi), axis=1)
    np.testing.assert_allclose(joint.truth / joint.unchanged, SINES[-1].factor(joint.time), rtol=1e-12)
    np.testing.assert_allclose(joint.unchanged, nominal, rtol=0.01)  # encoder steps
    assert not np.array_equal(measured["tau"], joint.measured(4)["tau"])
    assert list(STEP.factor(np.array([STEP_TIME - 0.001, STEP_TIME]))) == [1.0, STEP_SIZE]


@pytest.mark.parametrize("name", ["compact_vpda", "maccepavd"])
def test_a_damper_follows_the_schedule(name):
    device = load_device(name)
    joint = experiment.recording(device, SINES[0], 12.0)
    estimates = estimator_for(device).run(joint.measured(0))
    late = joint.time > 10.0
    error = estimates.column("damping")[0] - joint.truth
    assert joint.output == "damping" and len(estimates) == len(joint.truth)
    assert np.sqrt(np.mean(error[late] ** 2)) < 0.15 * joint.unchanged[0] < np.ptp(joint.truth)


def test_a_device_without_changing_parts_is_refused():
    with pytest.raises(ParameterError, match="'odrive_rotor' has neither a damper nor two springs"):
        experiment.changing_output(load_device("odrive_rotor"))


def planted(schedule, gain=1.0, delay=0.0, bias=0.0, scatter=0.0, seed=0):
    """A run whose estimate follows the schedule with this gain and delay [s]; truth 10 + 4 sin(3 t) unchanged."""
    base = 10.0 + 4.0 * np.sin(3.0 * TIME)
    factor = 1.0 + gain * (schedule.factor(np.maximum(TIME - delay, 0.0)) - 1.0)
    noise = scatter * np.random.default_rng(seed).standard_normal(len(TIME))
    value = base * (factor * (1.0 + bias)) + noise
    return Run(TIME, base * schedule.factor(TIME), value, np.full(len(TIME), 0.5), np.ones(len(TIME), bool)), base


def test_what_is_missed_of_a_sine_is_planted():
    for sine in SINES:
        for gain, delay in ((1.0, 0.0), (0.4, 0.0), (0.0, 0.0), (0.8, 0.05 / sine.frequency)):
            run_, base = planted(sine, gain, delay, bias=0.02, scatter=0.1)
            H = 1.02 * gain * np.exp(-2j * np.pi * sine.frequency * delay)
            assert figures.missed(sine, [run_], base) == pytest.approx(abs(1.0 - H), abs=5e-3)
    assert figures.fastest({0.1: (0.0, 1.0), 0.2: (0.7, 1.0), 0.5: (0.71, 1.0), 1.0: (0.1, 1.0)}) == 0.2
    assert figures.fastest({0.1: (nan, 1.0), 0.2: (0.1, 1.0)}) == 0.0
    assert figures.fastest({0.1: (0.1, 0.9), 0.2: (0.1, 0.89), 0.5: (0.1, 1.0)}) == 0.1  # no estimate, no following


def test_a_step_is_followed_from_when_it_stays_within_ten_percent():
    run_, base = planted(STEP, delay=1.3)
    assert figures.followed(run_, base) == pytest.approx(1.3, abs=0.06)
    assert figures.followed(planted(STEP, 0.6)[0], base) == inf
    assert figures.followed(planted(STEP, 0.75)[0], base) == 0.0  # 1.375 is within 10 % of 1.5
    both = [planted(STEP, delay=d)[0] for d in (1.0, 1.2, 3.0)]
    assert figures.outcome(STEP, both, base).followed == pytest.approx(1.2, abs=0.06)


def test_bias_random_error_and_coverage_are_planted():
    runs, base = zip(*(planted(CONSTANT, bias=0.03, scatter=0.5, seed=k) for k in range(6)), strict=True)
    found = figures.outcome(CONSTANT, runs, base[0])
    size = float(np.sqrt(np.mean(base[0][10_000:] ** 2)))
    assert found.bias == pytest.approx(0.03, rel=0.02) and found.random == pytest.approx(0.5 / size, rel=0.02)
    assert found.error == pytest.approx(np.hypot(0.03, 0.5 / size), rel=0.02) and isnan(found.missed)
    fair = figures.outcome(CONSTANT, [planted(CONSTANT, scatter=0.5, seed=k)[0] for k in range(6)], base[0])
    assert fair.bias < 0.002 and fair.coverage == pytest.approx(0.95, abs=0.005) and fair.ok == 1.0
    assert isnan(figures.outcome(CONSTANT, runs[:1], base[0]).bias)


def test_one_device_is_run_and_the_extra_error_is_that_of_noticing_change():
    effort = run.Effort(1, schedules=(CONSTANT,), duration=12.0)
    found = run._device((JOINT, effort), lambda _: None)
    assert [each.method for each in found] == list(run.methods_that_follow(JOINT))
    default = found[0]
    assert default.outcomes["constant"].error < 0.1 and abs(default.extra) < 0.05
    fixed = run.for_constant_springs(estimator_for(JOINT, "modulated_torque"))
    assert fixed is not None and fixed.parameters.steadiness == 1.0


def planted_results():
    """A default that loses the step, and a peer."""
    good = figures.Outcome(0.01, 0.95, 1.0, 0.001, 0.002, 0.1, nan, 3)
    outcomes = {each.name: good for each in SCHEDULES}
    outcomes["step x 1.5"] = replace(good, coverage=0.4, followed=0.7)
    outcomes["2 Hz"] = replace(good, coverage=nan, ok=0.0, missed=1.2)
    step = (np.linspace(-1.0, 6.0, 50), np.ones(50))
    default = run.Followed("qbmove_b", "stiffness", "modulated_torque", outcomes, 0.005, step)
    return [default, replace(default, method="residual", steady_error=nan)]


def test_limits_and_page_name_what_is_missed(tmp_path):
    found, defaults = planted_results(), {"qbmove_b": "modulated_torque"}
    limits = page.limits_of(found, defaults)
    missed = [words for words, kept in limits if not kept]
    assert len(limits) == len(SCHEDULES) + 1 and missed == [
        "qbmove_b, step x 1.5: coverage 0.40",
        "qbmove_b, 2 Hz: no sample is OK",
        "qbmove_b: extra error of 0.5 % on constant springs",
    ]
    assert found[0].fastest == 1.0 and found[0].weakest == ("step x 1.5", 0.4) and AMPLITUDE == 0.3
    page.draw(found, tmp_path / "change.png")
    page.write(found, defaults, provenance("via changes"), "change.png", tmp_path / "change.md")
    text = (tmp_path / "change.md").read_text("utf-8")
    assert "7 of 10 limits are kept" in text and "- qbmove_b, 2 Hz: no sample is OK" in text
    assert "| modulated_torque (default) | 0.1 | 0.2 | 0.5 | 1 | 0.70 | 0.40 (step x 1.5) | 100 | 3 |" in text
    assert "1 %; **0.40**" in text and "1 %; **-**, OK 0 %" in text and "| residual | 0.1 |" in text
    assert (tmp_path / "change.png").stat().st_size > 10_000
