"""`via compare`: measures of planted runs, equal experiments for all methods, and a small comparison."""

from __future__ import annotations

import json
from math import inf, isnan

import numpy as np
import pytest
from via_core.devices import load_device
from via_core.errors import ParameterError
from via_core.status import Status
from via_estimators.methods import estimator_for, methods_for
from via_validation.compare import page
from via_validation.compare.experiment import LEVELS, RATE, motion_of, seen_by_estimators
from via_validation.compare.figures import Run, accuracy, convergence, figures
from via_validation.compare.run import compare, outputs_of
from via_validation.provenance import Provenance

QBMOVE = load_device("qbmove_b")
IDEAL, _, REALISTIC, HARSH = LEVELS


def planted(seed, error=0.0, scatter=0.0, reported=1.0, late=0.0, seconds=30):
    """A run of a known kind: truth 10 + 5 sin, relative error, white scatter [N m/rad], `late` seconds of nonsense."""
    time = np.arange(round(seconds * RATE)) / RATE
    truth = 10.0 + 5.0 * np.sin(time)
    value = truth * (1.0 + error) + scatter * np.random.default_rng(seed).standard_normal(len(time))
    value[time < late] = 100.0
    return Run(time, truth, value, np.full(len(time), reported), time >= late)


def test_accuracy_is_the_rms_error_over_the_rms_truth_after_convergence():
    assert accuracy([planted(0, error=0.03, late=9.9)]) == pytest.approx(0.03)
    truth = planted(0).truth[10_000:]
    expected = 0.5 / np.sqrt(np.mean(truth**2))
    assert accuracy([planted(k, scatter=0.5) for k in range(4)]) == pytest.approx(expected, rel=0.02)


def test_convergence_is_when_it_begins_to_stay_within_ten_percent():
    assert convergence(planted(0, error=0.09)) == 0.0
    assert convergence(planted(0, error=0.11)) == inf
    assert convergence(planted(0, late=7.5)) == 8.0
    relapsed = planted(0)
    relapsed.value[20_100:20_200] = 1e3
    assert convergence(relapsed) == 21.0


def test_coverage_and_standard_deviations_are_those_planted():
    honest = figures([planted(k, scatter=0.5, reported=0.5, late=4.0) for k in range(20)])
    assert honest.coverage == pytest.approx(0.95, abs=0.005)
    assert honest.over_scatter == pytest.approx(1.0, rel=0.02) and honest.over_error == pytest.approx(1.0, rel=0.02)
    assert honest.trusted == pytest.approx(26.0 / 28.0, abs=1e-3) and honest.convergence == 4.0
    boasting = figures([planted(k, scatter=0.5, reported=0.1) for k in range(5)])
    assert boasting.over_scatter == pytest.approx(0.2, rel=0.03) and boasting.coverage < 0.4
    biased = figures([planted(k, error=0.1, scatter=0.1, reported=0.1) for k in range(20)])
    assert biased.over_scatter == pytest.approx(1.0, rel=0.03) and biased.over_error < 0.2


def test_undefined_measures_are_nan():
    still = figures([planted(0), planted(0)])
    assert isnan(still.over_scatter) and isnan(figures([planted(0)]).over_scatter)
    never = figures([planted(k, late=31.0) for k in range(2)])
    assert isnan(never.coverage) and isnan(never.over_error) and never.trusted == 0.0


def test_seeds_and_levels_change_the_measurements_and_not_the_motion():
    motion = motion_of(QBMOVE, friction=True, duration=1.0)
    one, other, noisier = motion.measured(REALISTIC, 0), motion.measured(REALISTIC, 1), motion.measured(HARSH, 0)
    assert np.array_equal(one.truth["q"], other.truth["q"]) and np.array_equal(one.truth["q"], noisier.truth["q"])
    torque = motion.torques["motor"]
    for run, level in ((one, REALISTIC), (noisier, HARSH)):
        noise = run.measured["tau"][1:] - torque
        assert np.std(noise) == pytest.approx(level.torque_noise, rel=0.05)
        steps = run.measured["q"] / level.quantum
        assert np.allclose(steps, np.round(steps), atol=1e-6)
        assert np.std(run.measured["theta_velocity"] - run.truth["theta_velocity"]) == pytest.approx(
            level.velocity_noise, rel=0.05
        )
    assert not np.array_equal(one.measured["tau"], other.measured["tau"])
    exact = motion_of(QBMOVE, friction=False, duration=1.0).measured(IDEAL, 0)
    assert np.array_equal(exact.measured["q"], exact.truth["q"])
    assert np.abs(exact.truth["deflection"]).max() > 0.3  # both transmissions move
    assert np.ptp(exact.truth["deflection"][300:], axis=0).min() > 0.1


def test_the_device_file_has_the_sensors_of_the_level_and_wrong_motors():
    seen = seen_by_estimators(QBMOVE, REALISTIC, 0.8, 1.2)
    assert seen.sensors.motor_quantum == pytest.approx(2.0 * np.pi / 2**14)
    assert seen.sensors.torque_noise == 0.03
    assert [motor.inertia for motor in seen.motors] == [0.8 * motor.inertia for motor in QBMOVE.motors]
    assert [motor.viscous_friction for motor in seen.motors] == [1.2 * m.viscous_friction for m in QBMOVE.motors]
    assert estimator_for(seen).parameters.inertia_prior == 0.8 * QBMOVE.motors[0].inertia
    assert seen_by_estimators(QBMOVE, IDEAL).sensors.link_quantum is None
    with pytest.raises(ParameterError, match="no torque-driven motors"):
        seen_by_estimators(load_device("maccepavd"), IDEAL)
    with pytest.raises(ParameterError, match="'maccepavd' is not an antagonistic joint"):
        motion_of(load_device("maccepavd"), friction=True)
    with pytest.raises(ParameterError, match="no stiffness estimator suits all of qbmove_b, compact_vpda"):
        compare([QBMOVE, load_device("compact_vpda")], 1, lambda *_: None)


@pytest.fixture(name="comparison", scope="module")
def _comparison():
    reports = []
    levels = (IDEAL, REALISTIC)
    made = compare([QBMOVE], 2, lambda *words: reports.append(words), levels, duration=12.0)
    assert reports[0][0] == 0 and reports[-1][0] == reports[-1][1]
    return made


def test_every_suitable_method_is_compared_and_exact_signals_give_exact_stiffness(comparison):
    assert comparison.methods == tuple(m for m in methods_for(QBMOVE) if "stiffness" in outputs_of(QBMOVE, m))
    best = comparison.case("modulated_torque", "qbmove_b", "ideal").figures
    assert best.accuracy < 2e-3 and best.convergence <= 2.0 and isnan(best.over_scatter)
    noisy = comparison.case("modulated_torque", "qbmove_b", "realistic")
    assert best.accuracy < noisy.figures.accuracy < 0.3
    assert noisy.wrong_motors == pytest.approx(noisy.figures.accuracy, rel=0.3)  # it estimates them
    assert comparison.case("modulated_torque", "qbmove_b", "ideal").wrong_motors is None
    for method in comparison.methods:
        assert comparison.cost[method] > 0.0


def test_examples_are_runs_of_the_estimator_on_the_simulated_joint(comparison):
    case = comparison.case("modulated_torque", "qbmove_b", "realistic")
    measured = motion_of(QBMOVE, friction=True, duration=12.0).measured(REALISTIC, 0)
    estimates = estimator_for(seen_by_estimators(QBMOVE, REALISTIC), "modulated_torque").run(measured.measured)
    assert np.array_equal(case.example.value, estimates.column("stiffness")[0])
    assert np.array_equal(case.example.ok, estimates.status == Status.OK)
    assert np.array_equal(case.example.truth, measured.truth["stiffness"])


def test_table_page_picture_and_json_agree(comparison, tmp_path, monkeypatch):
    monkeypatch.setattr(page, "SHOWN", (8.0, 12.0))
    source = Provenance("abc", "via compare", "3.11", "2", "0.6")
    page.draw(comparison, tmp_path / "picture.png")
    page.write_markdown(comparison, tmp_path / "picture.png", source, tmp_path / "docs" / "comparison.md")
    text = (tmp_path / "docs" / "comparison.md").read_text(encoding="utf-8")
    rows = list(page.table_rows(comparison))
    assert len(rows) == 2 * len(comparison.methods)
    for row in rows:
        assert len(row) == len(page.titles(comparison))
        assert "| " + " | ".join(row) + " |" in text
    assert "commit abc" in text and (tmp_path / "docs" / "comparison.png").stat().st_size < 150_000
    written = json.loads(json.dumps(page.as_json(comparison, source), allow_nan=False))
    assert len(written["cases"]) == len(rows)
    assert written["cases"][0]["over_scatter"] is None
    assert written["cases"][0]["accuracy"] == comparison.cases[0].figures.accuracy
