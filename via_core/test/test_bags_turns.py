"""Angles from encoders that start again after a turn become continuous, and goals stay beside their angle."""

from math import pi, tau
from pathlib import Path

import numpy as np
import pytest
from via_core.bags.inspection import check
from via_core.bags.turns import continuous, unrolled
from via_core.device_parts import WireColumn
from via_core.devices import parse_device
from via_core.recordings.channels import read_joint
from via_core.signals import Array, Signals

TIME = np.arange(2000) * 0.005
TURNING = 2.0 + 4.0 * TIME - 6.0 * np.sin(1.3 * TIME)  # passes pi in both directions
DEVICE = (
    "{name: elbow, title: t, source: [s], confidence: assumed, arrangement: rigid, drive: position, link: {inertia: "
    "1.0, viscous_friction: 0.0}, servo: {kp: 9.0, kd: 0.5}, sensors: {rate: 200.0}, wire: {columns: {q: {column: "
    "position_deg, unit: deg}, equilibrium: {column: goal_deg, unit: deg}}}}"
)


def wrapped(angle: Array, turn: float = tau) -> Array:
    return (angle + turn / 2.0) % turn - turn / 2.0


@pytest.mark.parametrize("turn", [tau, tau / 25.0])
@pytest.mark.parametrize("lost", [False, True])
def test_turns_are_joined_at_any_gear(turn: float, lost: bool) -> None:
    angle = TURNING * turn / tau
    read = wrapped(angle, turn)
    if lost:
        read[5::7] = np.nan
    found, ends = unrolled(TIME, read, turn)
    known = np.isfinite(read)
    np.testing.assert_allclose(found[known] - found[0], angle[known] - angle[0], atol=1e-12)
    assert not np.isfinite(found[~known]).any()
    assert ends == np.count_nonzero(np.diff(np.floor((angle[known] + turn / 2.0) / turn)))


@pytest.mark.parametrize("value", [0.0, -tau])
def test_a_value_that_the_motion_cannot_reach_is_no_end_of_a_turn(value: float) -> None:
    angle = 4.0 + 0.5 * np.sin(3.0 * TIME)
    angle[700:720] = value
    found, ends = unrolled(TIME, angle, tau)
    assert ends == 0 and np.array_equal(found, angle)


def test_a_goal_is_at_the_turn_of_its_angle() -> None:
    late = 2.0 + 4.0 * (TIME + 0.05) - 6.0 * np.sin(1.3 * (TIME + 0.05))
    units = {"q": "rad", "theta": "rad", "equilibrium": "rad", "motor": "rad"}
    measured = Signals(TIME, {"q": wrapped(TURNING), "theta": np.stack([np.sin(TIME), wrapped(TURNING)], 1)}, units)
    goals = {"equilibrium": wrapped(late), "motor": np.stack([4.0 * np.sin(TIME), wrapped(late)], 1)}
    goals["equilibrium"][40:60] = np.nan
    joined = continuous(measured, Signals(TIME, goals, units, frozenset(goals)))
    assert joined.commands is not None and joined.passed.keys() == {"q", "theta_2"}
    begin = TURNING[0] - wrapped(TURNING)[0]
    np.testing.assert_allclose(joined.measured["q"], TURNING - begin, atol=1e-12)
    on = np.isfinite(goals["equilibrium"])
    np.testing.assert_allclose(joined.commands["equilibrium"][on], late[on] - begin, atol=1e-12)
    assert np.isnan(joined.commands["equilibrium"][~on]).all()
    np.testing.assert_array_equal(joined.commands["motor"][:, 0], goals["motor"][:, 0])
    np.testing.assert_allclose(joined.commands["motor"][:, 1], late - begin, atol=1e-12)


def test_goals_of_a_continuous_angle_stay() -> None:
    goal = np.where(TIME < 5.0, -3.0, 3.0)
    measured = Signals(TIME, {"q": np.clip(2.0 * (TIME - 5.0), -3.0, 3.0)}, {"q": "rad"})
    commands = Signals(TIME, {"equilibrium": goal}, {"equilibrium": "rad"}, frozenset({"equilibrium"}))
    assert continuous(measured, commands) == (measured, commands, {})


@pytest.mark.parametrize(
    ("entry", "turn"),
    [({}, tau), ({"unit": "deg"}, tau), ({"unit": "deg", "scale": -0.04}, 0.04 * tau), ({"scale": pi / 180.0}, tau)],
)
def test_a_scale_is_a_gear_only_beside_a_unit(entry: dict[str, object], turn: float) -> None:
    assert WireColumn(column="a", **entry).turn == pytest.approx(turn)  # type: ignore[arg-type]


def test_a_table_is_read_continuously_and_the_check_says_so(tmp_path: Path) -> None:
    rows = np.degrees(np.stack([wrapped(TURNING), wrapped(TURNING + 0.1)], 1))
    lines = [f"{t:.3f},{q:.9f},{goal:.9f}" for t, (q, goal) in zip(TIME, rows, strict=True)]
    lines.insert(300, lines[299])
    lines.insert(600, lines[500])
    path = tmp_path / "turning.csv"
    path.write_text("\n".join(["time,position_deg,goal_deg", *lines]) + "\n", encoding="utf-8")
    device = parse_device(DEVICE, "elbow.yaml")
    measured, commands, reports = read_joint(path, device)
    ends = np.count_nonzero(np.diff(np.floor((TURNING + pi) / tau)))
    assert commands is not None and reports[0].passed == {"q": ends}
    np.testing.assert_allclose(commands["equilibrium"] - measured["q"], 0.1, atol=1e-6)
    assert np.abs(np.diff(measured["q"])).max() < 0.1 < pi
    found = {(each.check, each.severity): each.text for each in check(path, device)}
    assert found["turn", "note"].startswith(f"passes the end of its turn {ends} times")
    assert found["repeated", "warning"].startswith("1 of 2002 stamps repeat")
    assert found["backward", "warning"].startswith("1 of 2002 stamps are out of order")
