"""`via bench joints`: the recordings have the planted cause at every joint, and the page states the cost of each."""

from __future__ import annotations

from via_validation.bench.joints import cost_of, page
from via_validation.provenance import Provenance


def test_the_planted_friction_is_found_at_every_joint() -> None:
    found = cost_of(3, 10.0)
    assert found.causes == ("coulomb_friction",) * 3
    assert min(found.reading, found.bodies, found.diagnoses) > 0.0
    text = page([found], Provenance("abc", "via bench joints", "3", "2", "0"), 10.0)
    assert f"| 3 | {found.reading:.2f} |" in text and "coulomb_friction |" in text
