"""Numbers 5 and 6 over DDS: the modal bang-bang law on the 4-dof arm in lockstep, free and against a wall."""

import numpy as np
import pytest
from arm_bench import ArmBench
from via_bringup.control.bang_bang import DIRECTIONS, MOTORS, PUSH, damped_arm, linear_modes, reference_law
from via_bringup.control.cycles import Cycles, spread
from via_bringup.control.hitting import HELD, TURNING
from via_controllers.nodes.bang_bang import BangBangNode
from via_core.errors import ViaError
from via_interfaces.srv import Hold, Push

ARM, PERIOD = damped_arm(), 1e-3
LAW = reference_law(ARM, np.array(DIRECTIONS[1]))
LINEAR = linear_modes(ARM, np.array(MOTORS))


def bench_of(graph, duration, **simulator):
    return ArmBench(
        graph, BangBangNode, {"motors": list(MOTORS), "direction": list(DIRECTIONS[1])}, mode="lockstep",
        duration=duration, posture=LINEAR.rest.tolist(), link_friction=ARM.link_friction.tolist(), **simulator,
    )  # fmt: skip


def pushed(bench, deflection):
    """The tick at which the links were put aside."""
    answer = bench.call(bench.push, Push.Request(deflection=deflection.tolist()))
    assert answer.success
    return int(answer.message.split()[-1])


def test_the_law_finds_a_mode_and_swings_regularly(graph):
    """Number 5, from a w_1(0) that names joints and knows no mode."""
    bench = bench_of(graph, 9.0)
    pushed(bench, PUSH * LAW.direction)
    graph.until(lambda: bench.simulator.finished.done() and len(bench.states) >= 9000, timeout=110.0)
    w = np.array([bench.now(f"w_{joint + 1}") for joint in range(ARM.n)])
    y = bench.quantity("y")[4500:]
    cycles = Cycles(PERIOD * np.arange(len(y)), y)
    assert np.degrees(np.arccos(min(1.0, abs(w @ LINEAR.directions[:, 0]) / np.linalg.norm(w)))) < 3.0
    assert len(cycles.periods) >= 8 and spread(cycles.periods) < 1e-3
    assert 1.03 < 1.0 / (float(cycles.periods.mean()) * LINEAR.frequencies[0]) < 1.15
    assert not any(limited for _, limited, _ in bench.states)


def test_hitting_is_steady_from_the_second_cycle(graph):
    """Number 6, a wall at .3 of the way to the turning point, the tip let go from beyond it."""
    wall, hold = 0.3, 1.2
    direction = LINEAR.directions[:, 0] * np.sign(LINEAR.directions[:, 0] @ LAW.direction)
    along = ARM.tip_jacobian(LINEAR.rest) @ direction
    along = along / np.linalg.norm(along)
    point = ARM.tip_position(LINEAR.rest + wall * TURNING * direction)
    bench = bench_of(graph, 6.2, walls=[*point.tolist(), *(-along).tolist()])
    pushed(bench, -hold * TURNING * direction)
    answer = bench.call(bench.hold, Hold.Request(duration=HELD))
    released = int(answer.message.split()[-1])
    assert answer.success and released < 1100
    graph.until(lambda: bench.simulator.finished.done() and len(bench.contacts) > 6200, timeout=110.0)
    tip = np.array([ARM.tip_position(q) for q in bench.joints[released:, 0, 0::2]])
    path, force = (tip - ARM.tip_position(LINEAR.rest)) @ along, np.array(bench.contacts[released:])
    late = path[len(path) // 2 :]
    cycles = Cycles(PERIOD * np.arange(len(path)), path, 0.5 * float(late.min() + late.max()))
    steady = cycles.swings[-6:]
    assert np.abs(cycles.swings[1:] / steady.mean() - 1.0).max() < 0.05
    assert spread(steady) < 5e-3
    assert min(np.linalg.norm(piece, axis=1).max() for piece in cycles.each(force)[-6:]) > 0.0


@pytest.mark.parametrize("parameters", [{"motors": [0.1]}, {"direction": [0.0] * 4}, {"bandwidth": 0.0}])
def test_wrong_parameters_are_refused(graph, parameters):
    with pytest.raises(ViaError):
        graph.add(BangBangNode, **parameters)
