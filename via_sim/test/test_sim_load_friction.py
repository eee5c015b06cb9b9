"""Load-dependent friction: formula at every site, standstill, Stribeck curve, clutch torque."""

from itertools import product

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from sim_joints import BOTH_SIDES, antagonistic, flexible, rigid, servo_flexible
from via_core.signals import Signals
from via_sim.effects import Effect
from via_sim.joint.friction import breakaway, dry_friction
from via_sim.joint.parameters import P
from via_sim.plants import JointPlant
from via_sim.simulate import InitialConditions, simulate

RATE = 1000.0
M, B, K, G, GA = 0.02, 0.01, 10.0, 0.3, 0.2
LINK = f"{{inertia: {M}, viscous_friction: 0.0, gravity_torque: {G}, gravity_angle: {GA}}}"


def load(site: str, values=BOTH_SIDES, motor: int = 0) -> Effect:
    return Effect("load_dependent_friction", site, values, motor)


def formula(e, load, counter, speed):
    """Friction [N m] by the formula in friction.py."""
    least = min(abs(load), abs(counter)) if load * counter < 0.0 else 0.0
    standing = abs(e["stribeck"] * load - e["counter_stribeck"] * counter) + e["quadratic"] * least**2
    fading = np.exp(-((speed / e["velocity"]) ** 2))
    return abs(e["coefficient"] * load - e["counter_coefficient"] * counter) + fading * standing


def held(**channels) -> Signals:
    time = np.arange(len(next(iter(channels.values())))) / RATE
    return Signals(time, channels, dict.fromkeys(channels, "-"), frozenset(channels))


@pytest.mark.parametrize(("torque", "deflection"), list(product((-0.7, 0.4), (-0.06, 0.0, 0.09))))
@pytest.mark.parametrize("speed", [-0.9, -0.1, 0.2, 2.0])
def test_load_and_counter_torque_increase_friction(torque, deflection, speed):
    """Accelerations of a slipping axis from its equation."""
    joint, spring, q = flexible(K, LINK), K * deflection, 0.4
    gravity = G * np.sin(q - GA)
    state = (q, q - deflection, 0.0, speed, speed, 0.0)
    motor = JointPlant.from_device(joint).with_effects([load("motor", motor=1)])
    friction = np.sign(speed) * formula(BOTH_SIDES, spring, torque, speed)
    assert motor.derivative(state, (torque, 0.0, 0.0, 0.0))[4] == pytest.approx((torque + spring - friction) / B)
    link = JointPlant.from_device(joint).with_effects([load("link")])
    friction = np.sign(speed) * formula(BOTH_SIDES, -spring, 0.25 - gravity, speed)
    assert link.derivative(state, (torque, 0.0, 0.0, 0.25))[3] == pytest.approx(
        (0.25 - spring - gravity - friction) / M
    )


def test_load_of_a_link_is_the_sum_of_its_springs():
    link = JointPlant.from_device(antagonistic(LINK)).with_effects([load("link")])
    springs = [5.0 * phi + 10.0 * phi**3 for phi in (0.1, -0.05)]
    friction = formula(BOTH_SIDES, -sum(springs), -G * np.sin(-GA), 0.5)
    found = link.derivative((0.0, -0.1, 0.05, 0.5, 0.0, 0.0), np.zeros(4))[3]
    assert found == pytest.approx((-sum(springs) - G * np.sin(-GA) - friction) / M)


@pytest.mark.parametrize(("drive", "arm"), [(0.5, 0.2), (0.5, -0.2), (-0.3, 0.9), (0.4, -0.39)])
def test_drive_and_arm_torque_load_a_rigid_joint(drive, arm):
    """Friction without its Stribeck part does not depend on speed, so the acceleration is constant."""
    values = {"coefficient": 0.1, "counter_coefficient": 0.3}
    plant = JointPlant.from_device(rigid()).with_effects([load("link", values)])
    sent = held(external_torque=np.full(200, drive), arm_torque=np.full(200, arm))
    q = simulate(plant, sent, 0.2, RATE).truth["q"]
    friction = abs(0.1 * drive - 0.3 * arm)
    moving = np.sign(drive + arm) * max(abs(drive + arm) - friction, 0.0)
    assert q[-1] == pytest.approx(0.5 * moving / M * 0.2**2, rel=1e-9, abs=0.0)


@pytest.mark.parametrize("more", [0.999, 1.001])
def test_breakaway_of_a_rigid_joint_matches_its_formula(more):
    """Opposed torques with the quadratic part; drive and arm torque are scaled to the threshold."""
    e = BOTH_SIDES | {
        "coefficient": 0.3,
        "stribeck": 0.3,
        "counter_coefficient": 0.0,
        "counter_stribeck": 0.0,
        "quadratic": 4.0,
    }
    plant = JointPlant.from_device(rigid()).with_effects([load("link", e)])
    size = (1.0 - 0.3 - 0.6) / (4.0 * 0.3**2)  # drive - .3 drive - .6 drive = 4 (.3 drive)^2
    drive, arm = size * more, -0.3 * size * more
    assert formula(e, size, -0.3 * size, 0.0) == pytest.approx(0.7 * size)
    sent = held(external_torque=np.full(300, drive), arm_torque=np.full(300, arm))
    stays = np.all(simulate(plant, sent, 0.3, RATE).truth["q"] == 0.0)
    assert bool(stays) is (more > 1.0)  # friction grows faster than what pushes


def test_stuck_link_balances_spring_and_external_torque():
    """Spring and external torque from both sides of a gear increase the breakaway torque."""
    e = BOTH_SIDES | {"coefficient": 0.3, "counter_coefficient": 0.4}
    plant = JointPlant.from_device(servo_flexible(K)).with_effects([load("link", e)])
    for push, start in ((0.5, 0.08), (0.0, 0.08), (0.2, 0.06), (-0.3, 0.02)):
        asked, friction = push - K * start, formula(e, -K * start, push, 0.0)
        acceleration = plant.derivative((start, 0, 0, 0, 0, 0), (0.0, 0.0, 0.0, push))[3]
        expected = np.sign(asked) * max(abs(asked) - friction, 0.0) / M
        assert acceleration == pytest.approx(expected, abs=1e-12)
    truth = simulate(
        plant, held(external_torque=np.full(200, 0.5)), 0.2, RATE, initial=InitialConditions((0.08, 0, 0, 0, 0, 0))
    ).truth
    assert np.all(truth["q"] == 0.08)


def test_pendulum_on_a_gear_matches_scipy():
    """Motion in one direction at a time with the Stribeck part, so that scipy needs no events."""
    plant = JointPlant.from_device(rigid(LINK)).with_effects([load("link")])
    drive = 0.55

    def rate(_t, x):
        counter = -G * np.sin(x[0] - GA)
        return [x[1], (drive + counter - formula(BOTH_SIDES, drive, counter, x[1])) / M]

    reference = solve_ivp(rate, (0.0, 0.6), [0.0, 0.05], "DOP853", rtol=1e-11, atol=1e-13, dense_output=True)
    truth = simulate(
        plant, held(external_torque=np.full(600, drive)), 0.6, RATE, initial=InitialConditions((0, 0, 0, 0.05, 0, 0))
    ).truth
    assert np.min(truth["q_velocity"]) > 0.0 and np.max(truth["q"]) > 2.0
    assert np.max(np.abs(truth["q"] - reference.sol(truth.time)[0])) < 1e-6


def test_equal_coefficients_give_models_m3_and_m4():
    """Friction is proportional to |T - C|."""
    row = JointPlant.from_device(rigid()).parameters.copy()
    row[P.load_friction] = row[P.counter_friction] = 0.2
    row[P.load_stribeck] = row[P.counter_stribeck] = 0.1
    row[P.load_velocity], row[P.both_sides] = 0.5, 1.0
    for one, other in ((0.3, -0.4), (0.3, 0.1), (-0.2, 0.0)):
        assert dry_friction(row, 0, 1, 0.4, one, other) == pytest.approx(
            abs(one - other) * (0.2 + 0.1 * np.exp(-((0.4 / 0.5) ** 2)))
        )
        assert breakaway(row, 0, -1, one, other) == pytest.approx(0.3 * abs(one - other))


def test_clutch_torque_includes_load_friction():
    """Torque measured at the link of a rigid joint, in motion and at standstill."""
    e = BOTH_SIDES | {"counter_coefficient": 0.6, "counter_stribeck": 0.5}
    plant = JointPlant.from_device(rigid(LINK)).with_effects([load("link", e)])
    time = np.arange(400) / RATE
    sent = held(external_torque=0.6 * np.sin(20.0 * time), arm_torque=0.2 * np.cos(13.0 * time))
    run = simulate(plant, sent, 0.4, RATE)
    q, v, read = run.truth["q"][1:], run.truth["q_velocity"][1:], run.measured["tau_link"][1:]
    counter = sent["arm_torque"] - G * np.sin(q - GA)
    expected = [np.sign(s) * formula(e, *two, s) for *two, s in zip(sent["external_torque"], counter, v, strict=True)]
    moving = v != 0.0
    assert moving.mean() > 0.7 and not moving.all()
    np.testing.assert_allclose(read[moving], np.array(expected)[moving], atol=1e-12)
    still = ~moving
    np.testing.assert_allclose(read[still], (sent["external_torque"] + counter)[still], atol=1e-12)
