"""Section 6.1's table: limits and remarks of the rows. The long runs have their own tests."""

import numpy as np
import pytest
from via_validation.control import hold
from via_validation.control.limit_cycle import CycleCourse
from via_validation.tables import section6_modal
from via_validation.tables.section6_derivatives import derivative_rows


def test_closed_forms_keep_their_limits():
    found = {row.id: row for row in derivative_rows()}
    limits = {"6.1.residual": 1e-10, "6.1.rates.W": 1e-6, "6.1.rates.lambda": 1e-6, "6.1.crossing": 0.02}
    assert {name: row.limit for name, row in found.items()} == limits
    assert all(row.ok and row.ours > 0.0 for row in found.values())


def test_every_hold_has_limits_and_the_published_controller_has_none(monkeypatch):
    """At the turning point, at half of the amplitude and at z = 0, where the published controller stays."""
    monkeypatch.setattr(section6_modal, "MODES", (0,))

    def released(grip, least):
        H = np.concatenate([np.full(500, grip**2 - 1.0), np.full(900, least)])
        course = CycleCourse(H, np.zeros(1400), np.zeros(1400), np.full(1400, 115.0))
        return hold.Released(0.0, grip, grip**2, 0.5, 115.0, course, False, 30.0 + 10.0 * grip)

    def rows(*errors):
        ours, printed = (
            tuple(released(grip, error) for grip, error in zip((1.0, 0.5, 0.0), each, strict=True))
            for each in (errors, (0.001, 0.019, -1.0))
        )
        monkeypatch.setattr(section6_modal, "_releases_of", lambda mode, start=0.5: ours if start else printed)
        return {row.id.removeprefix("6.1.hold.mode1."): row for row in section6_modal._held()}

    found = rows(0.001, 0.019, -0.05)
    assert found["after1.worst"].limit == 0.1 and found["after1.5.worst"].limit == 0.02
    assert found["after1.worst"].ours == 0.05 and found["after1.worst"].ok and not found["after1.5.worst"].ok
    assert found["after1.misses"].ours == 0.0 and found["after1.5.misses"].ours == pytest.approx(1.0 / 3.0)
    assert not rows(0.001, 0.0, 0.021)["after1.5.worst"].ok and rows(0.001, 0.0, 0.019)["after1.5.worst"].ok
    printed = found["printed.after1.worst"]
    assert printed.ours == 1.0 and printed.limit is None and printed.ok is None
    assert "1 of 3 phases" in printed.remark and "z = 0 is an equilibrium" in printed.remark
    assert found["force"].ours == 40.0


def test_the_grip_of_a_hold_is_measured_in_amplitudes(monkeypatch):
    """The grip is |z_k| at the start of the hold, not at its end."""
    monkeypatch.setattr(hold, "SETTLING", 2.0)
    monkeypatch.setattr(hold, "AFTER", 0.05)
    hold_of = next(hold.held_and_released(1, 7, duration=0.05))
    assert hold_of.grip == pytest.approx(abs(np.cos(hold_of.phase)), abs=0.01)
