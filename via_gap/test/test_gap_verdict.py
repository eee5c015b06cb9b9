"""From what causes leave of held-out segments, and what a flexible model leaves, to the answer."""

import numpy as np
import pytest
from via_gap.candidates.fit import Fit
from via_gap.candidates.location import Location
from via_gap.selection.calibration import calibration
from via_gap.selection.evidence import Evaluation
from via_gap.selection.gap import Gap
from via_gap.selection.verdict import against_ceiling, decide, helps

FROZEN = calibration("flexible")
NOTHING = np.empty(0)
BACKLASH = Location("backlash", "transmission", 1).effect({"gap": 0.01})
PAYLOAD = Location("payload", "link", 0).effect({"mass": 0.1, "distance": 0.1})
FRICTION = Location("coulomb_friction", "link", 0).effect({"torque": 0.1})


def judged(segments: np.ndarray, *effects) -> Evaluation:
    """Effects, the device's own numbers alone without, and what they leave of each segment."""
    return Evaluation(Fit(effects, NOTHING, 0.0, NOTHING, np.zeros(4)), NOTHING, segments, 4)


@pytest.mark.parametrize(
    ("left", "verdict"),
    [
        (np.full(40, 2.0), "unknown"),
        (np.r_[np.full(36, 1.0), np.full(4, 11.0)], "effect"),
        (np.full(40, 1.3), "effect"),
    ],
    ids=["every shot sticks out", "a few do", "none does"],
)
def test_what_the_typical_shot_still_shows_is_not_explained(left, verdict):
    tuned = judged(np.full(40, 45.0))
    assert decide(tuned, [judged(left, BACKLASH)], [], FROZEN).verdict == verdict


def test_a_second_cause_closes_a_part_of_much_and_a_good_part_of_little():
    def leaving(square: float) -> Evaluation:
        return judged(np.full(40, square))

    assert helps(leaving(81.0), leaving(101.0), leaving(101.0), FROZEN)
    assert not helps(leaving(96.0), leaving(101.0), leaving(101.0), FROZEN)
    assert helps(leaving(1.1), leaving(3.0), leaving(3.0), FROZEN)
    assert not helps(leaving(2.0), leaving(3.0), leaving(3.0), FROZEN)


@pytest.mark.parametrize(("left", "verdict"), [(6.0, "unknown"), (1.2, "two_effects")])
def test_three_effects_that_leave_much_are_none_either(left, verdict):
    tuned, best = judged(np.full(40, 300.0)), judged(np.full(40, 100.0), BACKLASH)
    three = judged(np.full(40, left), BACKLASH, PAYLOAD, FRICTION)
    decision = decide(tuned, [best], [three], FROZEN)
    assert decision.verdict == verdict
    assert decision.chosen is three, "the repair keeps what makes the simulator better"


@pytest.mark.parametrize(
    ("effects", "tuned", "after", "verdict"),
    [
        (1, 10.0, 1.2, "effect"),
        (1, 50.0, 2.0, "effect"),
        (1, 10.0, 2.0, "unknown"),
        (1, 1.3, 1.2, "effect"),
        (3, 10.0, 1.2, "two_effects"),
        (3, 50.0, 2.0, "unknown"),
    ],
    ids=["at the ceiling", "nearly all", "far from it", "little to close", "three at the ceiling", "three near it"],
)
def test_an_answer_far_from_the_ceiling_is_none(effects, tuned, after, verdict):
    alone = judged(np.full(40, 1.0 if effects == 1 else 20.0), BACKLASH)
    three = [judged(np.full(40, 1.0), BACKLASH, PAYLOAD, FRICTION)] if effects == 3 else []
    decision = decide(judged(np.full(40, 45.0)), [alone], three, FROZEN)
    gap = Gap(
        by="shots", before=2.0 * tuned, tuned=tuned, after=after, interval=(after, after), floor=0.9, ceiling=1.0,
        closes=1.0, signals={},
    )  # fmt: skip
    told = against_ceiling(decision, gap, FROZEN)
    assert decision.verdict == ("effect" if effects == 1 else "two_effects") and told.verdict == verdict
    assert told.locations == decision.locations, "the repair keeps what makes the simulator better"
    assert (told.ranked[0][1] < 0.5) == (verdict == "unknown")
