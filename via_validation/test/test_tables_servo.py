"""Rows of `link_impedance` with servos that are not those of the file: one motion, one seed, two cases."""

from via_validation.tables import servo


def test_a_slower_servo_stays_inside_the_interval_and_one_shortened_interval_does_not(monkeypatch):
    monkeypatch.setattr(servo, "MOTIONS", ("tones",))
    monkeypatch.setattr(servo, "CASES", (servo.CASES[0], servo.CASES[3]))
    found = {row.id: row for row in servo.rows(1, lambda *_: None)}
    assert len(found) == 20 and found["servo.as_filed.stiffness.error"].ours < 8.0
    for case in ("as_filed", "bandwidth_15"):
        for name in ("stiffness", "damping"):
            assert found[f"servo.{case}.{name}.missed"].ok
    monkeypatch.setattr(servo, "WIDTH_95", 0.02)
    assert not {row.id: row for row in servo.rows(1, lambda *_: None)}["servo.bandwidth_15.damping.missed"].ok
