"""Equations of joints with a position drive, which no torque measurement drives."""

import numpy as np
import pytest
from joint_records import of_commands
from sim_joints import positioned
from sim_position_drives import EFFECT_SETS, GRAVITY, KP, RATE, SERVOS, goals, wave
from via_core.weak_form import window_weights
from via_gap.residual.equation_torques import equation_torques
from via_sim.effects import Effect
from via_sim.plants import JointPlant
from via_sim.simulate import simulate

SPAN = 60  # samples of a window


def residual(plant, record, span: int = SPAN) -> np.ndarray:
    """(windows,) M <q, psi''> - <torque, psi> [N m] of the link, after the speed-limited goal is known."""
    found = equation_torques(plant.parameters, record)
    W = window_weights(4, record.time[: span + 1])
    rows = np.arange(600, len(record) - span - 1, 7)[:, None] + np.arange(span + 1)
    out = found.inertia[0] * np.einsum("k,nk->n", W[2], found.angle[rows, 0])
    out = out - np.einsum("k,nk->n", W[0], found.torque[rows, 0])
    return out[~np.any(found.standing[rows, 0], axis=1)]


def residuals(servo, effects) -> tuple[float, float]:
    """Root mean squares of the residual [N m] with the effects in the equations, and without them."""
    device = positioned(GRAVITY, servo)
    nominal = JointPlant.from_device(device)
    plant = nominal.with_effects(effects)
    sent = goals(wave(3000), neighbour=np.cos(0.003 * np.arange(3000)))
    seen = simulate(plant, sent, 2.999, RATE).measured
    velocity = np.zeros((len(seen), 3))
    velocity[:, 0] = seen["q_velocity"]
    record = of_commands(device, seen, velocity, sent)
    right, wrong = residual(plant, record), residual(nominal, record)
    return float(np.sqrt(np.mean(right**2))), float(np.sqrt(np.mean(wrong**2)))


def impact(servo, effects) -> float:
    """[N m] that the equation may miss where a drive whose limit includes its damping, or with integral, hits a wall.

    It runs fast, and the wall's damping acts at once: half the jump, with at most a sample's largest weight.
    """
    if ("sum" not in servo and "ki" not in servo) or effects[0].name != "contact":
        return 0.0
    plant = JointPlant.from_device(positioned(GRAVITY, servo)).with_effects(effects)
    speed = np.abs(simulate(plant, goals(wave(3000)), 2.999, RATE).truth["q_velocity"]).max()
    return 0.5 * effects[0].parameters["damping"] * speed * window_weights(4, np.arange(SPAN + 1) / RATE)[0].max()


@pytest.mark.parametrize("servo", ["{kp: 4.0, kd: 0.1}", *SERVOS])
@pytest.mark.parametrize(
    "effects",
    [each for each in EFFECT_SETS if each[0].name not in ("encoder_quantisation", "position_deadband")],
    ids=lambda each: "-".join(f"{e.name}-{len(e.parameters)}" for e in each),
)
def test_equations_balance_without_measured_torque(servo, effects) -> None:
    right, wrong = residuals(servo, effects)
    assert right < max(1.5e-3, impact(servo, effects)) and wrong > 20.0 * right


@pytest.mark.parametrize("servo", SERVOS)
def test_a_wall_without_damping_balances_as_everything_else(servo) -> None:
    (wall,) = next(each for each in EFFECT_SETS if each[0].name == "contact")
    right, wrong = residuals(servo, [Effect(wall.name, wall.site, {**wall.parameters, "damping": 0.0})])
    assert right < 1.5e-3 and wrong > 20.0 * right


@pytest.mark.parametrize("servo", ["{kp: 4.0, kd: 0.1}", *SERVOS])
def test_a_dead_band_balances_but_for_the_cells_at_its_edges(servo) -> None:
    """There the torque of a whole cell counts or none of it: half the jump, with at most a sample's largest weight."""
    width = 0.1
    right, wrong = residuals(servo, [Effect("position_deadband", "motor", {"width": width}, 1)])
    largest = window_weights(4, np.arange(SPAN + 1) / RATE)[0].max()
    assert right < 0.5 * KP * width * largest and wrong > 5.0 * right


def test_equations_balance_while_the_drive_is_off() -> None:
    device = positioned(GRAVITY)
    plant = JointPlant.from_device(device)
    values = wave(2000)
    values[700:1200] = np.nan
    seen = simulate(plant, goals(values), 1.999, RATE).measured
    velocity = np.zeros((len(seen), 3))
    velocity[:, 0] = seen["q_velocity"]
    record = of_commands(device, seen, velocity, goals(values))
    assert np.max(np.abs(residual(plant, record))) < 2e-3


@pytest.mark.parametrize("delay", [0.0, 0.0023])
def test_equations_know_a_goal_with_a_speed_limit_as_the_simulator_does(delay) -> None:
    """The integral keeps every error of the goal, also where a command arrives within a sample."""
    servo = f"{{kp: 4.0, kd: 0.1, ki: 8.0, speed_limit: 3.0, delay: {delay}}}"
    right, wrong = residuals(servo, [Effect("coulomb_friction", "link", {"torque": 0.1}, 0)])
    assert right < 2e-4 and wrong > 200.0 * right


def test_a_goal_leads_for_one_sample_after_each_of_few_commands() -> None:
    """Commands at a tenth of the rate of the samples: each change lasts a sample, then the goal stays."""
    device = positioned(GRAVITY, "{kp: 4.0, kd: 0.1, feedforward: 1.0}")
    plant = JointPlant.from_device(device)
    sent = goals(wave(3000)[::10], RATE / 10.0)
    seen = simulate(plant, sent, 2.989, RATE).measured
    velocity = np.zeros((len(seen), 3))
    velocity[:, 0] = seen["q_velocity"]
    record = of_commands(device, seen, velocity, sent)
    left = residual(plant, record)
    assert np.sqrt(np.mean(left**2)) < 1.5e-3
