"""`via bench soak` for seconds from stamp 0, after a day and after a month; an injected fault is detected."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from via_core.devices import load_device
from via_core.errors import ParameterError
from via_core.status import Status
from via_estimators.contract import Estimates
from via_estimators.methods import METHODS, estimator_for
from via_validation.bench import soak as bench
from via_validation.bench import soak_motion
from via_validation.bench.estimators import device_for
from via_validation.bench.soak import (
    HOUR,
    Hour,
    Scenario,
    soak,
    soak_rows,
    write_markdown,
)
from via_validation.bench.soak_motion import measured, motion_of, moving
from via_validation.provenance import Provenance

DAY, MONTH = 24.0 * HOUR, 30.0 * 24.0 * HOUR
SHORT = 40.0  # [s] a period with one stop


def quiet(*_):
    """Show no progress."""


@pytest.fixture(autouse=True)
def _short_stop(monkeypatch):
    monkeypatch.setattr(soak_motion, "STOPS", ((20.0, 25.0),))
    monkeypatch.setattr(soak_motion, "LOST", 0.2)


@pytest.mark.parametrize("method", METHODS)
def test_minutes_at_any_time_are_finite_bounded_and_as_accurate(method):
    device = device_for(method)
    runs = [soak(device, method, SHORT / HOUR, quiet, Scenario(start, period=SHORT)) for start in (0.0, DAY, MONTH)]
    first = runs[0].hours[0]
    for run in runs:
        rows = {row.id: row for row in soak_rows(run)}
        assert rows[f"soak.{method}.not_finite"].ok and rows[f"soak.{method}.memory"].ok
        (hour,) = run.hours
        assert hour.samples > 0.9 * SHORT * bench.RATE
        # A burst in every fifth second costs a filter over equidistant samples its whole window, here a second.
        assert hour.shares["OK"] > (0.5 if method == "filtered_signal_based" else 0.7)
        assert hour.shares["NOT_EXCITED"] > 0.02 and hour.shares["BAD_SAMPLE"] > 0.0
        assert np.isfinite(hour.condition)
        # Rounding of stamps: a step at 30 days is wrong by 5e-7 of itself.
        assert hour.error == pytest.approx(first.error, rel=0.01, abs=1e-6)
        assert hour.sd == pytest.approx(first.sd, rel=0.01)
        assert hour.largest_sd == pytest.approx(first.largest_sd, rel=0.01)


def test_motion_stops_and_begins_smoothly():
    time = np.arange(0.0, 600.0, 0.001)
    share = moving(time)
    assert np.all(share[(time > 20.0) & (time < 25.0)] == 0.0)
    assert share[15_000] == share[50_000] == 1.0 and share[0] == 0.0
    assert np.abs(np.diff(share)).max() < 2e-3


def test_noise_invalid_samples_and_gaps_differ_in_every_repetition():
    device = load_device("qbmove_b")
    motion = motion_of(device, "modulated_torque", 30.0)
    assert motion.output == "stiffness" and np.ptp(motion.truth) > 0.5
    rows, truth = measured(motion, 0, 30_000, 1e6, np.random.default_rng(1))
    again, _ = measured(motion, 0, 30_000, 1e6, np.random.default_rng(2))
    assert len(rows) == len(truth) < 30_000 and rows[0, 0] == 1e6
    steps = np.diff(rows[:, 0])
    assert np.count_nonzero(steps > 0.05) == 1 and steps.max() < 2.1
    good = np.isfinite(rows).all(axis=1) & (np.abs(rows[:, 1:]) < 1e9).all(axis=1)
    assert 0 < np.count_nonzero(~good) < 1000
    quanta = rows[good, 1] / device.sensors.link_quantum
    assert np.allclose(quanta, np.round(quanta), atol=1e-6)
    assert not np.array_equal(rows[:100, 3], again[:100, 3])
    kept = np.searchsorted(motion.rows[:, 0], rows[good, 0] - 1e6 + 1e-6) - 1
    assert np.std(rows[good, 3] - motion.rows[kept, 3]) == pytest.approx(0.01, rel=0.05)


def test_a_faulty_estimator_misses_every_limit(monkeypatch):
    """From the third chunk on, the estimate and its standard deviation are wrong."""
    device = load_device("qbmove_b")
    kind = type(estimator_for(device, "modulated_torque"))
    honest, taken = kind.run_rows, []

    def run_rows(self, rows, state=None):
        state, found = honest(self, rows, state)
        if state is None or len(taken) < 2:
            taken.append(None)
            return state, found
        sd = 99.0 * found.standard_deviation
        sd[0, -1] = np.nan
        return state, Estimates(found.time, found.status, 2.0 * found.value, sd, found.outputs)

    monkeypatch.setattr(kind, "run_rows", run_rows)
    monkeypatch.setattr(bench, "HOUR", SHORT)
    run = soak(device, "modulated_torque", 3.0, quiet, Scenario(period=SHORT))
    verdicts = {row.id.rpartition("modulated_torque.")[2]: row.ok for row in soak_rows(run)}
    assert (verdicts["not_finite"], verdicts["error.last"], verdicts["sd"]) == (False, False, False)
    grown = replace(run, hours=(run.hours[0], replace(run.hours[-1], resident=run.hours[0].resident + 10**7)))
    assert {row.id: row.ok for row in soak_rows(grown)}["soak.modulated_torque.memory"] is False


def test_the_page_has_every_run_and_the_missed_limits(tmp_path):
    shares = dict.fromkeys((status.name for status in Status), 0.2)
    good = Hour(3_600_000, 0.01, 1.0, 1.0, shares, 12.0, 10**8, True)
    run = bench.Endurance("modulated_torque", "qbmove_a", DAY, (good, good), 100.0)
    bad = replace(run, method="signal_based", hours=(good, replace(good, error=0.05, finite=False)))
    source = Provenance("abc", "via bench soak", "3.11", "2", "0.6")
    write_markdown([run], ["residual", "damping_rls"], source, tmp_path / "soak.md")
    assert "**Unfinished**: no result yet for residual, damping_rls." in (tmp_path / "soak.md").read_text("utf-8")
    write_markdown([run, bad], [], source, tmp_path / "soak.md")
    text = (tmp_path / "soak.md").read_text(encoding="utf-8")
    assert "Unfinished" not in text
    assert "| modulated_torque | qbmove_a | 2 | 86400 | yes | 1 | 1 | 1 | 1 | 0 | 12 | 20.00 " in text
    assert "| signal_based | qbmove_a | 2 | 86400 | **no** |" in text
    assert "Missed: soak.signal_based.not_finite, soak.signal_based.error.last." in text
    table = [line.count("|") for line in text.splitlines() if line.startswith("|")]
    assert len(set(table)) == 1 and len(table) == 4


def test_a_joint_without_a_defined_motion_is_refused():
    with pytest.raises(ParameterError, match="no motion defined for 'edinburgh_vsa'"):
        motion_of(load_device("edinburgh_vsa"), "modulated_torque")
    with pytest.raises(ParameterError, match="no shipped device suits the method 'magic'"):
        device_for("magic")
