"""`check`: the gap of a log in MuJoCo equals that in via_sim where MJCF has a slot, and does not where it has none."""

from __future__ import annotations

import numpy as np
import pytest
from export_joints import commands_of, device_of, start_of
from via_export import check
from via_gap.logs.log import JointLog
from via_gap.report.report import LogInterval
from via_sim.effects import Effect
from via_sim.plants import JointPlant
from via_sim.sensors import Sensors
from via_sim.simulate import InitialConditions, simulate

POINTS = 0.02  # of the gap: agreement that is required wherever there is a slot


def log_of(name: str, effects: list[Effect], seconds: float = 3.0) -> JointLog:
    device = device_of(name)
    commands = commands_of(device, seconds)
    plant, initial = JointPlant.from_device(device).with_effects(effects), InitialConditions(start_of(device), seed=1)
    measured = simulate(plant, commands, seconds, 1000.0, Sensors.of_device(device), initial).measured
    seen = {key: values for key, values in measured.channels.items() if np.isfinite(values).any()}
    return JointLog("log", device, measured.select([*seen]), commands)


CASES = {
    "friction": ("cubic_demo", [Effect("coulomb_friction", "motor", {"torque": 0.2}, 1)]),
    "memory": (
        "cubic_demo",
        [
            Effect("hysteresis", "transmission", {"torque": 0.1, "stiffness": 3.0}, 1),
            Effect("presliding_friction", "motor", {"torque": 0.1, "stiffness": 10.0}, 2),
        ],
    ),
    "timing": (
        "cubic_demo",
        [
            Effect("actuator_delay", "command", {"delay": 0.012}),
            Effect("actuator_lag", "command", {"time_constant": 0.01}),
            Effect("channel_skew", "timing", {"delay": 0.01}),
            Effect("encoder_offset", "sensor", {"offset": 0.1}, 1),
        ],
    ),
    "goal": (
        "xl330",
        [Effect("speed_limit", "command", {"limit": 3.0}), Effect("actuator_delay", "command", {"delay": 0.02})],
    ),
    "ripple": (
        "dfki_simple_pendulum",
        [Effect("torque_ripple", "motor", {"amplitude": 0.3, "order": 7.0, "phase": 0.4}, 1)],
    ),
    "servo": ("maccepavd", [Effect("actuator_delay", "command", {"delay": 0.045})]),
    "numbers": (
        "cubic_demo",
        [
            Effect("torque_gain", "motor", {"gain": 0.9}, 0),
            Effect("device_numbers", "device", {"link inertia": 1.1, "spring 1 torque": 0.9}),
        ],
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_the_gap_in_mujoco_is_that_of_the_simulator(case: str) -> None:
    name, effects = CASES[case]
    log = log_of(name, effects)
    found = check([log], log.device, effects)
    for ours, theirs in zip(found.mujoco, found.via_sim, strict=True):
        assert ours.overall == pytest.approx(theirs.overall, abs=0.1 * POINTS)
    assert abs(found.difference) < 0.1 * POINTS
    assert found.mujoco[1].overall < 0.2 * found.mujoco[0].overall


def test_a_loss_shows_in_the_check() -> None:
    effects = [Effect("asymmetric_viscous", "motor", {"forward": 0.6, "backward": 0.0}, 1)]
    log = log_of("cubic_demo", effects)
    found = check([log], log.device, effects)
    assert found.difference > 10.0 * found.via_sim[1].overall


def test_the_check_keeps_to_the_held_out_intervals() -> None:
    name, effects = CASES["friction"]
    log = log_of(name, effects)
    part = LogInterval(log="log", begin=1.0, end=2.0)
    whole, held = (check([log], log.device, effects, held_out=parts) for parts in ((), (part,)))
    assert len(held.mujoco[0].squares) == len(held.via_sim[0].squares) < len(whole.mujoco[0].squares)


def test_a_motor_without_encoder_starts_where_the_simulator_puts_it() -> None:
    effects = [Effect("coulomb_friction", "motor", {"torque": 0.3}, 1)]
    log = log_of("visco_elastic_demo", effects)
    hidden = JointLog("log", log.device, log.measured.select(["q"]), log.commands)
    found = check([hidden], log.device, effects)
    assert abs(found.difference) < 0.1 * POINTS
