"""Section 7's table: limits of all rows, and pictures."""

import pytest
from via_controllers.joints.visco_elastic import ViscoElasticJoint
from via_validation.tables import section7


def silent(done, of, what):
    assert done <= of and what


@pytest.fixture(name="found", scope="module")
def _found():
    return {row.id: row for row in section7.rows(1, silent)}


def test_every_limit_is_kept(found):
    for D in section7.DAMPING:
        for check, limit in (("quadrature", 1e-9), ("program", 1e-6), ("collocation", 3e-4)):
            assert found[f"7.{check}.D{D:g}"].limit == limit
    assert found["7.uniform.D0.4"].limit == 0.9
    assert [found[f"7.motor.{drive}.methods"].limit for drive in ("acceleration", "torque")] == [3e-4, 3e-4]
    assert found["7.check.n2.D0.1"].limit == 5e-7
    assert [row.id for row in found.values() if row.ok is False] == []


def test_a_closed_form_that_is_off_would_be_missed(monkeypatch):
    fastest = ViscoElasticJoint.fastest
    monkeypatch.setattr(ViscoElasticJoint, "fastest", lambda self, horizon: 1.001 * fastest(self, horizon))
    monkeypatch.setattr(section7, "DAMPING", (0.2,))
    missed = {row.id for row in section7._checks() if row.ok is False}
    assert missed == {"7.quadrature.D0.2", "7.program.D0.2", "7.collocation.D0.2"}


def test_there_is_no_bound_without_damping_and_no_turns_beyond_critical_damping(found):
    assert "7.epsilon.inf.D0" not in found and "7.epsilon.n1.D1.5" not in found
    assert found["7.epsilon.n4.D0"].ours == pytest.approx(10.0)


def test_the_figures_are_drawn(tmp_path):
    drawn = section7.pictures(tmp_path, silent)
    assert [path.name for path in drawn] == ["figure20.png", "figure21.png"] and all(path.exists() for path in drawn)
