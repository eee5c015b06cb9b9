"""Section 6.1's table: what is judged, and that a miss says why. Long runs behind other rows have their own tests."""

from via_bringup.control import hold
from via_bringup.tables import section6_modal


def test_closed_forms_are_judged_and_kept():
    found = {row.id: row for row in section6_modal._derivatives()}
    limits = {"6.1.residual": 1e-10, "6.1.rates.W": 1e-6, "6.1.rates.lambda": 1e-6, "6.1.crossing": 0.02}
    assert {name: row.limit for name, row in found.items()} == limits
    assert all(row.ok and row.ours > 0.0 for row in found.values())


def test_a_hold_without_a_push_is_missed_and_says_why(monkeypatch):
    monkeypatch.setattr(hold, "AFTER", 1.3)
    monkeypatch.setattr(section6_modal, "MODES", (0,))
    monkeypatch.setattr(section6_modal, "PHASES", 3)
    section6_modal._releases_of.cache_clear()
    found = {row.id: row for row in section6_modal._held()}
    section6_modal._releases_of.cache_clear()
    worst = found["6.1.hold.mode1.after1.worst"]
    assert worst.limit == 0.1 and found["6.1.hold.mode1.after1.5.worst"].limit == 0.02
    assert worst.ours >= found["6.1.hold.mode1.after1.median"].ours
    assert worst.ok or "z = 0 is an equilibrium" in worst.remark
    assert (found["6.1.hold.mode1.after1.misses"].ours == 0.0) == worst.ok
