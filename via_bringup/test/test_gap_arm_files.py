"""Names of the files with what all joints of an arm feel."""

from __future__ import annotations

from via_bringup.cli.gap_arm import named_causes
from via_gap.run.arm_offset import AngleOffset
from via_gap.run.arm_payload import Payload
from via_gap.run.arms import ArmDiagnosis


def test_causes_of_one_sort_have_the_names_of_their_joints() -> None:
    payload = Payload("wrist", (), 0.3, 0.01, (0.0, 0.0, 0.1), (0.01, 0.01, 0.01), 0.9)
    offsets = [AngleOffset(joint, (), 0.03, 0.001, 0.9) for joint in ("lift", "elbow")]
    found = ArmDiagnosis((payload, *offsets), ())
    assert [name for name, _ in named_causes(found)] == ["payload", "offset_lift", "offset_elbow"]
    assert [name for name, _ in named_causes(ArmDiagnosis((offsets[0],), ()))] == ["offset"]
    assert named_causes(None) == []
