"""`via bench joints`: the recordings have the planted cause at every joint, and the page states the cost of each."""

from __future__ import annotations

from pathlib import Path

from via_gap.run.arms import find_arm, read_arm_log
from via_validation.bench.joints import cost_of, page, table, urdf
from via_validation.provenance import Provenance


def test_the_planted_friction_is_found_at_every_joint() -> None:
    found = cost_of(3, 10.0)
    assert found.causes == ("coulomb_friction",) * 3
    assert min(found.reading, found.bodies, found.diagnoses) > 0.0
    text = page([found], Provenance("abc", "via bench joints", "3", "2", "0"), 10.0)
    assert f"| 3 | {found.reading:.2f} |" in text and "coulomb_friction |" in text


def test_a_single_joint_has_no_neighbour(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(urdf(1))
    table(1, 6.0).to_csv(tmp_path / "arm.csv", index=False)
    arm = find_arm(str(tmp_path / "arm.urdf"), tmp_path / "arm.csv")
    (log,) = read_arm_log(tmp_path / "arm.csv", arm)
    assert log.commands is not None and set(log.commands.channels) == {"external_torque", "arm_torque"}
