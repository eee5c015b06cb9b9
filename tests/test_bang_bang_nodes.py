"""Numbers 5 and 6 over DDS: modal bang-bang control of the 4-dof arm in lockstep, free and against a wall."""

import numpy as np
import pytest
from arm_bench import ArmBench
from via_bringup.demo.reference import DIRECTIONS, MOTORS, damped_arm, linear_modes
from via_controllers.nodes.single import NODES
from via_core.errors import ViaError
from via_interfaces.srv import Push
from via_validation.bench.hitting import hitting_over_dds
from via_validation.control.bang_bang import PUSH, reference_controller
from via_validation.control.cycles import Cycles, relative_sd
from via_validation.control.hitting import STEADY

ARM, PERIOD = damped_arm(), 1e-3
CONTROLLER = reference_controller(ARM, np.array(DIRECTIONS[1]))
LINEAR = linear_modes(ARM, np.array(MOTORS))


def test_it_finds_a_mode_and_oscillates_regularly(graph):
    """Number 5, from a w_1(0) that selects joints without a mode of the model."""
    bench = ArmBench(
        graph, NODES["bang_bang"], {"motors": list(MOTORS), "direction": list(DIRECTIONS[1])}, mode="lockstep",
        duration=9.0, posture=LINEAR.rest.tolist(), link_friction=ARM.link_friction.tolist(),
    )  # fmt: skip
    assert bench.call(bench.push, Push.Request(deflection=(PUSH * CONTROLLER.direction).tolist())).success
    graph.until(lambda: bench.simulator.finished.done() and len(bench.states) >= 9000)
    w = np.array([bench.now(f"w_{joint + 1}") for joint in range(ARM.n)])
    y = bench.quantity("y")[4500:]
    cycles = Cycles(PERIOD * np.arange(len(y)), y)
    assert np.degrees(np.arccos(min(1.0, abs(w @ LINEAR.directions[:, 0]) / np.linalg.norm(w)))) < 3.0
    assert len(cycles.periods) >= 8 and relative_sd(cycles.periods) < 1e-3
    assert 1.03 < 1.0 / (float(cycles.periods.mean()) * LINEAR.frequencies[0]) < 1.15
    assert not any(limited for _, limited, _ in bench.states)


def test_hitting_is_steady_from_the_second_cycle(domain):
    """Number 6, a wall at .3 of the turning point, released from beyond it; all nine: `via bench hitting`."""
    case = hitting_over_dds(0.3, 1.2, 6.0)
    assert len(case.swings) > STEADY
    assert case.second < 0.05 and case.steady_sd < 5e-3 and case.least_force > 0.0


@pytest.mark.parametrize("parameters", [{"motors": [0.1]}, {"direction": [0.0] * 4}, {"bandwidth": 0.0}])
def test_wrong_parameters_are_refused(graph, parameters):
    with pytest.raises(ViaError):
        graph.add(NODES["bang_bang"], **parameters)
