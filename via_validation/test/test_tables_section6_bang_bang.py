"""Section 6.2's table: limits of the rows, with short runs. The long runs have their own tests."""

from dataclasses import replace

import numpy as np
import pytest
from via_bringup.demo import reference
from via_validation.control import bang_bang, hitting
from via_validation.tables import section6_bang_bang


def test_every_number_has_its_limit(monkeypatch):
    monkeypatch.setattr(section6_bang_bang, "FREE", 1.6)
    found = {row.id.split(".")[-1]: row for row in section6_bang_bang._free(1)}
    assert found["angle"].limit == 3.0 and found["period"].limit == 1e-3
    assert found["frequency"].limit == pytest.approx(0.06) and found["swing"].limit is None
    assert found["frequency"].ours < 0.06
    assert found["nonlinear"].limit is None and found["bent"].limit is None and "plane" not in found
    limits = {"second": 0.05, "steady": 5e-3, "missed": 0.0}
    case = hitting.hitting(0.3, 1.2, 1.5)
    monkeypatch.setattr(section6_bang_bang, "_case", lambda wall, hold: case)
    monkeypatch.setattr(section6_bang_bang, "WALLS", (0.3,))
    monkeypatch.setattr(section6_bang_bang, "HOLDS", (1.2,))
    assert {row.id.split(".")[-1]: row.limit for row in section6_bang_bang._hitting()} == limits


def test_a_wrong_direction_misses_its_limit_and_has_a_remark(monkeypatch):
    whole = bang_bang.free_motion(1, 1.6)
    monkeypatch.setattr(section6_bang_bang, "free_motion", lambda mode, duration: replace(whole, angle=13.0))
    row = section6_bang_bang._free(1)[0]
    assert row.ok is False and "modes 3 and 4" in row.remark


def test_modes_with_overlapping_resonances_have_a_row_for_their_plane(monkeypatch):
    """w_1 between modes 3 and 4 is in their plane; a share of mode 1 turns it out of the plane."""
    whole = bang_bang.free_motion(3, 1.6)
    modes = reference.linear_modes(reference.damped_arm(), np.array(reference.MOTORS)).directions

    def plane(w):
        w = w / np.linalg.norm(w)
        monkeypatch.setattr(section6_bang_bang, "free_motion", lambda *_: replace(whole, direction=w, swing=0.1))
        return next(row.ours for row in section6_bang_bang._free(3) if row.id.endswith("plane"))

    assert plane(modes[:, 2] - 0.7 * modes[:, 3]) < 1e-5
    assert 5.0 < plane(modes[:, 2] + 0.2 * modes[:, 0]) < 12.0


def test_the_hopper_rows_have_their_limits(monkeypatch):
    def case(amplitude, **changes):
        values = {"apex": 0.03, "apex_sd": 1e-3, "flight": 0.5, "frequency": 3.5, "direction": np.ones(4)} | changes
        return type("Case", (), {**values, "amplitude": amplitude})()

    hops = {
        "controller": case(1.0), "controller, loaded": case(0.9), "sinusoid": case(1.0), "sinusoid, loaded": case(0.95),
        "high sinusoid": case(1.0), "high sinusoid, loaded": case(0.8),
    }  # fmt: skip
    monkeypatch.setattr(section6_bang_bang, "_hops", lambda: hops)
    monkeypatch.setattr(section6_bang_bang, "toppling", lambda payload=0.0: 3.0 + payload)
    found = {row.id: row for row in section6_bang_bang._hopping()}
    assert found["6.2.hopper.toppling"].ours == 3.0 and "3.6" in found["6.2.hopper.toppling"].remark
    assert found["6.2.hopper.payload"].limit == 0.08 and found["6.2.hopper.payload"].ok is False
    assert found["6.2.hopper.sinusoid"].limit == 0.85 and found["6.2.hopper.sinusoid"].ok is False
    assert found["6.2.hopper.ground"].limit == 0.6 and found["6.2.hopper.apex"].limit == 1e-2
