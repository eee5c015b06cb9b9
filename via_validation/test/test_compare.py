"""`via compare`: measures of planted runs, equal experiments for all methods, and a small comparison."""

from __future__ import annotations

import json
from dataclasses import replace
from math import inf, isnan

import numpy as np
import pytest
from via_core.devices import load_device
from via_core.errors import ParameterError, ViaError
from via_core.status import Status
from via_estimators.methods import estimator_for, methods_for
from via_validation.compare import decision, page, picture
from via_validation.compare.experiment import LEVELS, RATE, motion_of, seen_by_estimators
from via_validation.compare.figures import Run, accuracy, convergence, figures
from via_validation.compare.parallel import results_of, within_budget
from via_validation.compare.run import Effort, compare, outputs_of
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
        compare([QBMOVE, load_device("compact_vpda")], Effort(1), lambda *_: None)


@pytest.fixture(name="comparison", scope="module")
def _comparison():
    reports = []
    levels = (IDEAL, REALISTIC)
    made = compare([QBMOVE], Effort(2, duration=12.0), lambda *words: reports.append(words), levels)
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
    assert all(case.cost > 0.0 and case.seeds == 2 for case in comparison.cases)


def test_examples_are_runs_of_the_estimator_on_the_simulated_joint(comparison):
    case = comparison.case("modulated_torque", "qbmove_b", "realistic")
    measured = motion_of(QBMOVE, friction=True, duration=12.0).measured(REALISTIC, 0)
    estimates = estimator_for(seen_by_estimators(QBMOVE, REALISTIC), "modulated_torque").run(measured.measured)
    assert np.array_equal(case.example.value, estimates.column("stiffness")[0])
    assert np.array_equal(case.example.ok, estimates.status == Status.OK)
    assert np.array_equal(case.example.truth, measured.truth["stiffness"])


def test_table_page_picture_and_json_agree(comparison, tmp_path, monkeypatch):
    monkeypatch.setattr(picture, "SHOWN", (8.0, 12.0))
    source = Provenance("abc", "via compare", "3.11", "2", "0.6")
    picture.draw(comparison, tmp_path / "picture.png")
    page.write_markdown(comparison, tmp_path / "picture.png", source, tmp_path / "docs" / "comparison.md")
    text = (tmp_path / "docs" / "comparison.md").read_text(encoding="utf-8")
    tables = [(page.DECISION, list(page.decision_rows(comparison))), page.other_rules(comparison)]
    for level in comparison.levels:
        tables.append((page.titles(comparison, level.name), list(page.level_rows(comparison, level.name))))
    assert [len(rows) for _, rows in tables] == [2, 2, len(comparison.methods), len(comparison.methods)]
    for titles, rows in tables:
        for row in rows:
            assert len(row) == len(titles)
            assert "| " + " | ".join(row) + " |" in text
    assert "commit abc" in text and (tmp_path / "docs" / "comparison.png").stat().st_size < 200_000
    written = json.loads(json.dumps(page.as_json(comparison, source), allow_nan=False))
    assert len(written["cases"]) == 2 * len(comparison.methods)
    assert written["cases"][0]["over_scatter"] is None
    assert written["cases"][0]["accuracy"] == comparison.cases[0].figures.accuracy
    assert written["best"]["qbmove_b"]["ideal"] == tables[0][1][0][2]


def cases_of(comparison, **figures):
    """One case per name, with these (error, coverage, OK, convergence, cost)."""
    base = comparison.cases[0]
    return [
        replace(
            base, method=name, cost=cost, wrong_motors=None,
            figures=replace(base.figures, accuracy=error, coverage=held, trusted=ok, convergence=converged),
        )
        for name, (error, held, ok, converged, cost) in figures.items()
    ]  # fmt: skip


def test_the_best_method_is_usable_then_accurate_then_cheap(comparison):
    good, liar, silent = (0.02, 0.95, 0.99, 4.0, 5.0), (0.01, 0.5, 1.0, 1.0, 1.0), (0.001, 1.0, 0.5, 1.0, 1.0)
    cheap, worse = (0.0209, 0.95, 0.99, 9.0, 1.0), (0.03, 0.95, 0.99, 2.0, 0.5)
    cases = cases_of(comparison, good=good, liar=liar, silent=silent, worse=worse)
    assert decision.best(cases).method == "good" and decision.usable(cases[0])
    assert not decision.usable(cases[1]) and not decision.usable(cases[2])
    assert decision.best(cases_of(comparison, good=good, cheap=cheap)).method == "cheap"  # 4.5 % more error is equal
    assert decision.best(cases_of(comparison, liar=liar, silent=silent)).method == "silent"  # none is usable
    undefined = cases_of(comparison, never=(0.01, np.nan, 0.0, 1.0, 1.0))
    assert not decision.usable(undefined[0])
    others = [rule(cases) for rule in decision.OTHER_RULES.values()]
    assert [other and other.method for other in others] == ["silent", "worse", "worse", None]


def test_a_better_method_replaces_the_default_of_its_device(comparison):
    best = decision.best(comparison.of("qbmove_b", "realistic")).method
    kept, swapped = (replace(comparison, defaults={"qbmove_b": name}) for name in (best, "residual"))
    assert best != "residual" and decision.replaced(kept) == {}
    assert decision.replaced(swapped) == {"qbmove_b": best}
    assert next(page.decision_rows(swapped))[-1].startswith("residual: error ")
    rows = dict(zip((level.name for level in comparison.levels), page.decision_rows(kept), strict=False))
    assert rows["realistic"][-1] == page.SAME


def test_a_budget_of_processor_time_limits_the_seeds(monkeypatch):
    clock = iter((0.0, 3.0) * 4)
    monkeypatch.setattr("via_validation.compare.parallel.time.process_time", lambda: next(clock))
    assert within_budget(int, 20, 20.0) == [0, 1, 2, 3, 4]  # 6 fit; rounded down
    assert within_budget(int, 20, 1.0) == [0]
    assert within_budget(int, 20, 1.0, least=2) == [0, 1]
    assert within_budget(int, 2, 20.0) == [0, 1]


def half(part, report):
    """A part that fails for odd numbers."""
    report(f"half of {part}")
    if part % 2:
        raise ParameterError(f"{part} is odd")
    return part // 2


def test_parts_run_in_processes_in_order_and_their_errors_arrive():
    seen = []
    assert results_of(half, [4, 8, 2], 3, lambda *words: seen.append(words)) == [2, 4, 1]
    assert seen[0][:2] == (0, 3) and seen[-1][:2] == (3, 3)
    with pytest.raises(ViaError, match="ParameterError: 3 is odd"):
        results_of(half, [4, 3], 2, lambda *_: None)
