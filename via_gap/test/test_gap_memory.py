"""Elements with memory along a measured motion: the law step by step, and segments that need no past."""

from math import exp

import numpy as np
import pytest
from gap_logs import flexible, log_of
from via_gap.residual.memory import held_along, with_memory
from via_gap.residual.residual_model import ResidualModel
from via_gap.residual.segments import cut_log
from via_sim.effects import Effect
from via_sim.parameters import P
from via_sim.plants import JointPlant

MAXWELL = Effect("hysteresis", "transmission", {"torque": 0.05, "stiffness": 0.25}, 1)
BRISTLE = Effect("presliding_friction", "link", {"torque": 0.03, "stiffness": 0.2}, 0)


def test_what_is_held_is_the_law_step_by_step():
    time = np.arange(4000) * 1e-3
    link, motor = 0.6 * np.sin(3.0 * time) + 0.1 * np.sin(11.0 * time), 0.3 * np.sin(2.2 * time + 1.0)
    angles = np.column_stack([link, motor, np.full(len(time), np.nan)])
    row = JointPlant.from_device(flexible()).parameters.copy()
    plain = row.copy()
    for effect in (MAXWELL, BRISTLE):
        effect.write(row)
    ticks = np.array([3999, 0, 1234, 700])
    held = held_along(np.stack([plain, row]), angles, ticks)

    spring, bristle, springs, bristles = 0.0, 0.0, [0.0], [0.0]
    for k in range(1, len(time)):
        travel = (link[k] - motor[k]) - (link[k - 1] - motor[k - 1])
        spring = min(max(spring + 0.25 * travel, -0.05), 0.05)
        way = link[k] - link[k - 1]
        end = np.sign(way) * 0.03
        bristle = end + (bristle - end) * exp(-abs(way) * 0.2 / 0.03)
        springs.append(spring)
        bristles.append(bristle)
    assert not held[0].any()
    assert held[1, :, 3] == pytest.approx([springs[k] for k in ticks], abs=1e-12)
    assert np.abs(held[1, :, 0]) == pytest.approx(np.abs([bristles[k] for k in ticks]), abs=1e-12)
    assert max(map(abs, springs)) == 0.05 and min(map(abs, springs[500:])) < 0.02
    assert with_memory(np.stack([plain, row])).tolist() == [False, True]
    assert row[P.hysteresis_torque] == 0.05


@pytest.mark.parametrize("effect", [MAXWELL, BRISTLE], ids=str)
def test_shots_cut_out_of_a_log_know_what_was_held_before_them(effect):
    """Both reverse many times between two slips, so that a start that holds nothing is far off."""
    log = log_of(flexible(), (effect,), seed=5, duration=6.0, tolerance=0.0)
    segments = cut_log(log)
    whole = ResidualModel.of([segments], [np.arange(1, len(segments))])
    few, _ = whole.part([np.arange(4, len(segments) - 1, 5)])
    assert np.max(few.per_segment(few.residual([few.row([effect])])[0])) < 3.0
    assert np.median(few.per_segment(few.residual([few.row(())])[0])) > 10.0
