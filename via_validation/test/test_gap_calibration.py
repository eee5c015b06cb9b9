"""Calibration of the diagnosis: conformal sets and widths of intervals from answers whose true cause is known."""

from __future__ import annotations

import numpy as np
import pytest
from via_gap.selection import reliability
from via_validation.calibration import Calibrated, calibrated


def test_no_set_is_stated_for_signals_that_were_not_calibrated(monkeypatch):
    """With 19 cases the smallest share of a true cause is the least of the set; with 18 none is known."""

    def counted(count: int) -> reliability.Reliability:
        shares = np.linspace(0.3, 1.0, count)
        cases = [Calibrated("effect", "full", 0.1, True, float(share)) for share in shares]
        cases.append(Calibrated("cannot_tell", "full", 0.1, False, 0.0))  # names no cause, and has no set
        return calibrated(cases, "a test", "1-19")

    monkeypatch.setattr(reliability, "shipped", lambda: counted(19))
    assert reliability.in_conformal_set([0.9, 0.31, 0.29], "full") == (True, True, False)
    assert reliability.in_conformal_set([0.9, 0.31], "link_only") is None
    monkeypatch.setattr(reliability, "shipped", lambda: counted(18))
    assert reliability.in_conformal_set([0.9, 0.31], "full") is None


def test_intervals_are_as_wide_as_the_distances_of_known_parameters():
    """Of 39 distances the second largest is the 95 % quantile; intervals that are too wide do not get narrower."""

    def wider(distances: list[float], widened: float = 1.0) -> float:
        case = Calibrated("effect", "full", 0.1, True, 1.0, tuple(distances), widened)
        other = Calibrated("main_effect", "full", 0.1, True, 1.0, (9.0,) * 20)
        found = calibrated([case, other], "a test", "1")
        assert found.wider["main_effect"] == 9.0 and found.wider["several_effects"] == 1.0
        assert found.parameters == {"effect": len(distances), "several_effects": 0, "main_effect": 20}
        return found.wider["effect"]

    distances = [*np.linspace(0.0, 1.5, 37), 2.0, 7.0]
    assert wider(distances) == 2.0 and wider([each / 3.0 for each in distances], 3.0) == pytest.approx(2.0)
    assert wider([*distances, np.inf]) == 2.0  # no width holds a harmonic that the answer lacks
    assert wider([each / 10.0 for each in distances]) == 1.0
    assert wider(distances[19:]) == 2.0
    assert wider(distances[20:]) == 1.0  # too few


def test_answers_that_leave_more_are_trusted_less():
    """Right, wrong, right, wrong by what is left: the two in the middle are one group, since 0 and 1 would rise."""
    lefts = {0.4: True, 0.9: False, 0.05: True, 0.2: False, 0.1: True}
    cases = [Calibrated("main_effect", "full", left, right, 1.0) for left, right in lefts.items()]
    cases += [Calibrated("main_effect", "full", None, False, None), Calibrated("effect", "full", 0.3, True, 1.0)]
    numbers = calibrated(cases, "a test", "1-7")
    groups = [(each.left, each.answers, each.right) for each in numbers.verdicts["main_effect"]]
    assert groups == [(0.1, 2, 2), (0.4, 2, 1), (0.9, 1, 0)]
    trusted = [reliability.reliability("main_effect", left, numbers) for left in (0.0, 0.1, 0.11, 0.4, 0.9, 5.0)]
    assert trusted == [2.5 / 3.0, 2.5 / 3.0, 0.5, 0.5, 0.25, 0.25]
    assert reliability.reliability("effect", 2.0, numbers) == 0.75
    assert reliability.reliability("no_gap", 0.0, numbers) == 1.0
