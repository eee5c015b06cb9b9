"""What a limit cycle asks of its motors: small orbits in closed form, and levels that the simulated arm can hold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from via_controllers.arm_methods import ModalLimitCycleParameters
from via_controllers.arms.orbit_demand import _orbit, demand_of, largest_level
from via_core.errors import ParameterError
from via_validation.control.limit_cycle import start
from via_validation.control.model_error import ModelError, run_with_error


def cycle_of(**parameters):
    return ModalLimitCycleParameters(**parameters).controller().cycle


@pytest.mark.parametrize("mode", [1, 2])
def test_a_small_orbit_is_the_linear_mode(mode):
    cycle = cycle_of(mode=mode, level=1e-8)
    q, torque, step = _orbit(cycle)
    basis, time = cycle.init(cycle.equilibrium), np.arange(len(q)) * step
    swing = cycle.amplitude * np.cos(np.sqrt(basis.eigenvalues[mode - 1]) * time)
    away = np.outer(swing, basis.W[:, mode - 1])
    assert q - cycle.equilibrium == pytest.approx(away, abs=2e-3 * np.abs(away).max())
    driving = torque - [cycle.arm.gravity(each) for each in q]
    assert driving == pytest.approx(-away @ cycle.stiffness, abs=5e-3 * np.abs(driving).max())
    limit, share = demand_of(cycle)
    resting = np.abs(cycle.equilibrium - cycle.arm.rest(cycle.equilibrium)) / cycle.arm.deflection_limit
    assert share == pytest.approx(resting.max(), rel=1e-2)
    assert limit == f"max_deflection of {cycle.arm.joints[resting.argmax()]}"


@pytest.mark.parametrize("mode", [3, 4])
def test_the_largest_level_is_the_largest_that_the_arm_holds(mode):
    level = largest_level(cycle_of(mode=mode))
    for share, reached in ((0.7, True), (1.5, False)):
        controller = ModalLimitCycleParameters(mode=mode, level=share * level).controller()
        run = run_with_error(controller.cycle.arm, controller, start(controller), ModelError(), 4.0)
        off = np.abs(run.quantity("H")[run.time > 3.0] / (share * level) - 1.0).max()
        assert (off < 0.02) == reached
        assert (demand_of(controller.cycle).share <= 1.0) == reached


def test_a_level_that_motors_cannot_give_is_refused_with_the_largest_one():
    with pytest.raises(ParameterError, match=r"level 0\.02 of mode 3 needs 79\.1 times the torque limit of") as error:
        ModalLimitCycleParameters(mode=3).build()
    largest = float(str(error.value).rpartition(" ")[2])
    ModalLimitCycleParameters(mode=3, level=largest, adapt=True).build()
    with pytest.raises(ParameterError, match="needs more than the range of the springs; largest level: "):
        ModalLimitCycleParameters(mode=2, level=0.3).build()


@pytest.mark.parametrize(("mode", "level"), [(1, 2.0), (3, 0.3), (4, 100.0)])
def test_a_level_beyond_all_bounds_is_refused_alike(mode, level):
    with pytest.raises(ParameterError, match="largest level: ") as error:
        ModalLimitCycleParameters(mode=mode, level=level).build()
    largest = float(str(error.value).rpartition(" ")[2])
    assert 0.8 < demand_of(cycle_of(mode=mode, level=largest)).share <= 1.0


def test_no_level_is_possible_where_the_arm_cannot_be_held():
    cycle = cycle_of(mode=1)
    weak = cycle.arm.corrected(200.0, np.ones(cycle.arm.n))
    heavy = replace(cycle, arm=weak)
    assert demand_of(heavy).share > 1.0 and largest_level(heavy) == 0.0
