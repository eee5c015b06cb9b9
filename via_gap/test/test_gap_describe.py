"""What drives a joint that a recording and a model describe together."""

import pytest
from via_core.robots.description import Description
from via_gap.run.describe import _choose_drive

GOAL, TORQUE = ({"column": "goal"}, "by its name"), ({"column": "torque", "measured": True}, "by its name")


@pytest.mark.parametrize("measured", [True, False])
def test_a_torque_beside_goals_is_what_the_position_drive_gave_unless_it_was_commanded(measured: bool):
    """Both at once would move the joint twice: by the PD loop, and by what it was measured to give."""
    made = Description("joint", "joint", "via device new")
    made.drive = "position"
    torque = TORQUE if measured else ({"column": "torque"}, "by its name")
    made.columns = {"q": ({"column": "q"}, ""), "equilibrium": GOAL, "external_torque": torque}
    _choose_drive(made)
    assert made.drive == "position" and made.columns["equilibrium"] == GOAL
    if measured:
        assert made.columns["tau_1"] == ({"column": "torque"}, "by its name")
        assert "external_torque" not in made.columns
    else:
        assert made.columns["external_torque"] == torque and "tau_1" not in made.columns
