"""The benchmark of controllers: contenders return equal torques; the controller of 4 joints keeps its limit."""

import pytest
from via_core.errors import ViaError
from via_validation.bench import controllers, controllers_reference


def test_every_law_is_timed_and_the_whole_one_judged(monkeypatch):
    monkeypatch.setattr(controllers, "SAMPLES", 40)
    found = {row.id: row for row in controllers.controller_rows(3)}
    assert found["controller.limit_cycle"].limit == 250.0
    assert all(row.ours > 0.0 for row in found.values())
    assert (
        found["controller.limit_cycle.rigid"].ours
        < found["controller.limit_cycle"].ours
        < found["controller.limit_cycle.numpy"].ours
    )
    assert found["controller.limit_cycle.over_numpy"].ours < 1.0


def test_contenders_that_disagree_are_not_timed(monkeypatch):
    step = controllers_reference.step
    monkeypatch.setattr(controllers_reference, "step", lambda *args: (1.001 * step(*args)[0], step(*args)[1]))
    with pytest.raises(ViaError, match="disagrees"):
        controllers.controller_rows(1)
