"""Calibration of the diagnosis: conformal sets and widths of intervals from answers whose true cause is known."""

from __future__ import annotations

import numpy as np
from via_gap.selection import reliability
from via_validation.calibration import Calibrated, calibrated


def test_no_set_is_stated_for_signals_that_were_not_calibrated(monkeypatch):
    """With 19 cases the smallest share of a true cause is the least of the set; with 18 none is known."""

    def counted(count: int) -> reliability.Reliability:
        shares = np.linspace(0.3, 1.0, count)
        cases = [Calibrated("effect", "full", True, True, float(share)) for share in shares]
        return calibrated(cases, "a test", "1-19")

    monkeypatch.setattr(reliability, "shipped", lambda: counted(19))
    assert reliability.in_conformal_set([0.9, 0.31, 0.29], "full") == (True, True, False)
    assert reliability.in_conformal_set([0.9, 0.31], "link_only") == (False, False)
    monkeypatch.setattr(reliability, "shipped", lambda: counted(18))
    assert reliability.in_conformal_set([0.9, 0.31], "full") == (False, False)


def test_intervals_are_as_wide_as_the_distances_of_known_parameters():
    """Of 39 distances the second largest is the 95 % quantile; intervals that were too wide do not get narrower."""

    def wider(distances: list[float], before: float) -> float:
        case = Calibrated("effect", "full", True, True, 1.0, tuple(distances))
        return calibrated([case], "a test", "1", before).wider

    distances = [*np.linspace(0.0, 1.5, 37), 2.0, 7.0]
    assert wider(distances, 1.0) == 2.0 and wider(distances, 1.5) == 3.0
    assert wider([each / 10.0 for each in distances], 1.0) == 1.0
    assert wider(distances[:18], 1.5) == 1.5  # too few: unchanged
