"""Physics that the second simulator can add to a joint, against closed forms and against SciPy's integrator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import pi, sin

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from via_core.devices import Device
from via_core.signals import Array
from via_validation.sealed.catalogue import CATALOGUE
from via_validation.sealed.excitation import excite, start_of, turn
from via_validation.sealed.experiment import Experiment, draw_experiment
from via_validation.sealed.joints import CONTROLLED, POSITIONED, WIDE, believed, device_of, draw_joint, servo_of
from via_validation.sealed.loop import read_angles
from via_validation.sealed.physics import HARMONICS, Physics, at_axis, at_motor, on_both_motors, terms_at
from via_validation.sealed.planted import DIRT, with_dirt
from via_validation.sealed.recorder import Recorder
from via_validation.sealed.scene import scene_of
from via_validation.sealed.selections import OF_BOTH, OF_POSITION
from via_validation.sealed.stepping import Drive, Run, Servo, simulate

AMPLITUDES, ORDERS, PHASES = (0.12, 0.07, 0.04), (7.0, 12.0, 28.0), (0.3, -1.2, 2.0)


def rigid() -> Device:
    """A smooth rigid joint with gravity: nothing in it that an integrator of ordinary equations could stumble over."""
    link = {"inertia": 0.03, "viscous_friction": 0.1, "gravity_torque": 0.8, "gravity_angle": 0.1}
    content = {"name": "joint", "title": "t", "source": ["s"], "confidence": "assumed", "arrangement": "rigid"}
    return device_of({**content, "link": link, "sensors": {"rate": 500.0}})


def held(drive: Drive, values: Array) -> Callable[[float], float]:
    """A command per tick as a function of time."""
    return lambda t: float(values[min(max(int(np.floor(t * drive.rate + 1e-9)), 0), len(values) - 1)])


def solved(device: Device, run: Run, torque: Callable[[float, float, float], float]) -> Array:
    """(N+1,) link angle [rad] by SciPy under a torque (t, q, v), tick by tick: commands jump there."""
    link, out, state = device.link, [run.angle[0, 0]], np.array([run.angle[0, 0], 0.0])

    def rate_of(t: float, x: Array) -> list[float]:
        weight = link.gravity_torque * sin(x[0] - link.gravity_angle)
        return [x[1], (torque(t, x[0], x[1]) - weight - link.viscous_friction * x[1]) / link.inertia]

    for begin, end in zip(run.time[:-1], run.time[1:]):
        middle = 1e-9 * (end - begin)  # inside the tick
        state = solve_ivp(rate_of, (begin + middle, end - middle), state, rtol=1e-9, atol=1e-11).y[:, -1]
        out.append(state[0])
    return np.array(out)


def test_a_ripple_of_several_orders_is_the_sum_of_its_terms() -> None:
    device = rigid()
    drive = excite(np.random.default_rng(1), device, 2.0, 1.0)
    ripple, order, phase = (terms_at(0, 2, values) for values in (AMPLITUDES, ORDERS, PHASES))
    physics = Physics(ripple=ripple, ripple_order=order, ripple_phase=phase)
    run = simulate(device, physics, drive, np.zeros(len(drive.references)), start_of(device, drive))
    assert run is not None
    asked = held(drive, run.commands[:, 0])

    def torque(t: float, q: float, _v: float) -> float:
        return asked(t) + sum(a * sin(n * q + p) for a, n, p in zip(AMPLITUDES, ORDERS, PHASES))

    assert np.abs(solved(device, run, torque) - run.angle[:, 0]).max() < 2e-5
    plain = solved(device, run, lambda t, _q, _v: asked(t))
    assert np.abs(plain - run.angle[:, 0]).max() > 0.01


def test_an_encoder_error_of_several_orders_is_the_sum_of_its_terms() -> None:
    device = rigid()
    drive = excite(np.random.default_rng(1), device, 2.0, 1.0)
    wrong = {
        name: terms_at(0, 3, values)
        for name, values in (("eccentricity", AMPLITUDES), ("eccentric_order", ORDERS), ("eccentric_phase", PHASES))
    }
    run = simulate(device, Physics(**wrong), drive, np.zeros(len(drive.references)), start_of(device, drive))
    assert run is not None
    angles = np.linspace(-4.0, 4.0, 101)
    expected = angles + sum(a * np.sin(n * angles + p) for a, n, p in zip(AMPLITUDES, ORDERS, PHASES))
    np.testing.assert_allclose(read_angles(run.row, 0, angles, np.zeros(101)), expected, atol=1e-12)
    np.testing.assert_array_equal(read_angles(run.row, 1, angles, np.zeros(101)), angles)  # another axis


def test_half_of_the_periodic_effects_have_several_orders() -> None:
    device = rigid()
    drive = excite(np.random.default_rng(1), device, 2.0, 1.0)
    run = simulate(device, Physics(), drive, np.zeros(len(drive.references)), start_of(device, drive))
    assert run is not None
    scene, rng = scene_of(device, run), np.random.default_rng(3)
    for name, place in (("torque_ripple", ("motor", 1)), ("encoder_eccentricity", ("sensor", 0))):
        counts = []
        for _ in range(60):
            physics, numbers = CATALOGUE[name].of_size(scene, place, 0.1, CATALOGUE[name].shape(rng, scene))
            terms = [key.removeprefix("amplitude") for key in numbers if key.startswith("amplitude")]
            counts.append(len(terms))
            assert len({numbers.get(f"order{each}", 1.0) for each in terms}) == len(terms) <= HARMONICS
            given = physics.ripple if name == "torque_ripple" else physics.eccentricity
            assert given[: len(terms)] == tuple(numbers[f"amplitude{each}"] for each in terms)
            assert numbers["amplitude"] >= max(numbers[f"amplitude{each}"] for each in terms)
        assert 20 < sum(count > 1 for count in counts) < 40 and max(counts) == HARMONICS


SERVO = Servo(kp=12.0, kd=0.4, torque_limit=2.0, speed_limit=3.0, delay=0.0125)


def followed(goals: Array, start: float, rate: float, limit: float, delay: float, time: Array) -> Array:
    """The goal of a drive at `time`: held, late, then a walk of at most `limit` [rad/s], followed exactly."""
    stamps, now, at, out = np.arange(len(goals)) / rate + delay, start, 0.0, []
    for t in time:
        while at < t:
            target = goals[np.searchsorted(stamps, at + 1e-12, side="right") - 1] if at + 1e-12 >= stamps[0] else start
            later = stamps[stamps > at + 1e-9]
            until = min(t, later[0]) if later.size else t
            now += float(np.clip(target - now, -limit * (until - at), limit * (until - at)))
            at = until
        out.append(now)
    return np.array(out)


@pytest.mark.parametrize("changed", ["nothing", "delay", "speed_limit", "position_deadband", "torque_ripple"])
def test_a_position_drive_follows_its_law(changed: str) -> None:
    """Clipped proportional torque on a late goal of limited speed, minus damping, with effects added."""
    device = rigid()
    drive = excite(np.random.default_rng(2), device, 2.0, 1.0, 200.0, SERVO)
    drive = replace(drive, references=drive.references + 0.6 * (np.arange(400) > 150)[:, None])  # a step that saturates
    physics = {
        "nothing": Physics(),
        "delay": Physics(delay=0.02),
        "speed_limit": Physics(goal_speed=1.5),
        "position_deadband": Physics(goal_band=0.05),
        "torque_ripple": Physics(ripple=terms_at(0, 2, [0.2]), ripple_order=terms_at(0, 2, [9.0])),
    }[changed]
    run = simulate(device, physics, drive, np.zeros(400), start_of(device, drive))
    assert run is not None
    np.testing.assert_array_equal(run.commands[:, 0], drive.references[:, 0])  # what is recorded is the goal
    grid = np.arange(0.0, 2.0005, 0.25e-3)
    goal = followed(
        drive.references[:, 0], run.angle[0, 0], 200.0, min(SERVO.speed_limit, physics.goal_speed),
        SERVO.delay + physics.delay, grid,
    )  # fmt: skip

    def torque(t: float, q: float, v: float) -> float:
        error = np.interp(t, grid, goal) - q
        pull = np.clip(SERVO.kp * error * (abs(error) >= physics.goal_band), -SERVO.torque_limit, SERVO.torque_limit)
        more = 0.2 * sin(9.0 * q) if changed == "torque_ripple" else 0.0
        return float(pull) - SERVO.kd * v + more

    assert np.abs(solved(device, run, torque) - run.angle[:, 0]).max() < 5e-4  # a substep of the goal's walk
    assert np.abs(SERVO.kp * (run.commands[:, 0] - run.angle[:-1, 0])).max() > 1.5 * SERVO.torque_limit
    moved = run.angle[1:, 0], run.speed[1:, 0]
    shown = np.array([torque(t, q, v) for t, q, v in zip(run.time[1:], *moved)])
    if changed == "nothing":
        assert np.abs(np.interp(run.time[1:-1] - 0.0025, run.time[1:], shown) - run.mean[:-1, 0]).std() < 0.05


def test_load_friction_of_a_position_drive_grows_with_its_torque() -> None:
    """Held against gravity within its friction, then moved evenly: dry torque is the share of what the drive gives."""
    device = rigid()
    time = np.arange(800) / 200.0
    goals = (0.1 + 0.3 * time)[:, None]
    zero = np.zeros((800, 1))
    stiff = Servo(kp=200.0, kd=1.0)
    drive = Drive(goals, zero, zero, zero[:, 0], (0.0,), (0.0,), 200.0, (), stiff)
    run = simulate(device, Physics(load_friction=at_axis(0, 0.25)), drive, np.zeros(800), np.array([0.1]))
    assert run is not None
    late = slice(500, 780)
    angle, speed = run.angle[late, 0], run.speed[late, 0]
    smooth = device.link.gravity_torque * np.sin(angle - device.link.gravity_angle) + 0.1 * speed
    np.testing.assert_allclose(run.mean[late, 0], smooth / (1.0 - 0.25), rtol=0.03)  # tau = smooth + .25 tau


def test_position_drives_alone_have_effects_of_their_goal_and_their_effects_have_a_place() -> None:
    device = device_of(draw_joint(np.random.default_rng(0), POSITIONED))
    assert set(OF_POSITION) - set(CATALOGUE) == {
        "speed_limit", "position_gain", "position_deadband", "integral_action", "velocity_feedforward",
    }  # fmt: skip
    assert all(entry.locations(device) for entry in OF_POSITION.values())
    assert not any(place[0] == "transmission" for entry in OF_POSITION.values() for place in entry.locations(device))


@pytest.mark.parametrize("seed", range(4))
def test_a_controlled_motor_turns_evenly_and_its_torque_answers_the_disturbance(seed: int) -> None:
    """At constant speed the drive's torque is friction and ripple; inertia has no part in it."""
    rng = np.random.default_rng(seed)
    device = device_of(draw_joint(rng, CONTROLLED))
    drive = turn(rng, device, 12.0, 1000.0)
    ripple, order = 0.5 * device.link.coulomb_friction, 12.0
    physics = Physics(ripple=terms_at(0, 2, [ripple]), ripple_order=terms_at(0, 2, [order]))
    run = simulate(device, physics, drive, np.zeros(len(drive.references)), start_of(device, drive))
    assert run is not None
    angle, speed = (0.5 * (each[1:, 0] + each[:-1, 0]) for each in (run.angle, run.speed))
    acceleration = np.diff(run.speed[:, 0]) * 1000.0
    own = device.link.viscous_friction * speed + device.link.coulomb_friction * np.sign(speed)
    needed = device.link.inertia * acceleration + own - ripple * np.sin(order * angle)
    moving = np.abs(speed) > 0.1
    assert moving.mean() > 0.3
    assert np.quantile(np.abs(run.mean[:, 0] - needed)[moving], 0.95) < 0.02 * device.link.coulomb_friction
    smooth = np.convolve(acceleration, np.ones(20) / 20.0, mode="same")
    assert device.link.inertia * np.median(np.abs(smooth[moving])) < 0.3 * device.link.coulomb_friction


def test_an_effect_on_both_motors_is_the_effect_on_each() -> None:
    one = Physics(
        friction=at_axis(1, 0.1), gain=at_motor(1, 0.8, 1.0), stribeck_velocity=at_axis(1, 0.2, 1.0),
        ripple=terms_at(0, 2, [0.3]), eccentricity=terms_at(1, 3, [0.1, 0.2]),
    )  # fmt: skip
    both = on_both_motors(one)
    assert both.friction == (0.0, 0.1, 0.1) and both.gain == (0.8, 0.8) and both.stribeck_velocity == (1.0, 0.2, 0.2)
    assert both.ripple == (0.3, 0.0, 0.0, 0.0) * 2
    assert both.eccentricity == (0.0,) * 4 + (0.1, 0.2, 0.0, 0.0) * 2
    assert on_both_motors(Physics(friction=at_axis(0, 0.2))).friction == (0.2, 0.0, 0.0)  # the link's stays what it is
    device = device_of(draw_joint(np.random.default_rng(1), "polynomial_pair"))
    drive = excite(np.random.default_rng(1), device, 2.0, 1.0)
    run = simulate(device, Physics(), drive, np.zeros(len(drive.references)), start_of(device, drive))
    assert run is not None
    scene, rng = scene_of(device, run), np.random.default_rng(2)
    assert set(OF_BOTH) <= set(CATALOGUE)
    for name in OF_BOTH:
        assert ("motor", 1) in CATALOGUE[name].locations(device) and ("motor", 2) in CATALOGUE[name].locations(device)
        physics = on_both_motors(
            CATALOGUE[name].of_size(scene, ("motor", 1), 0.2, CATALOGUE[name].shape(rng, scene))[0]
        )
        for value in (getattr(physics, field) for field in vars(physics)):
            if isinstance(value, tuple):
                each = len(value) // 2 if len(value) in (2, 2 * HARMONICS) else len(value) // 3
                assert value[-each:] == value[-2 * each : -each]


def test_a_wide_tolerance_is_stated_and_kept() -> None:
    errors = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        true = draw_joint(rng, POSITIONED)
        nominal, off = believed(rng, true, WIDE)
        assert set(nominal["tolerances"].values()) == {WIDE} and {"kp", "kd", "torque_limit"} <= set(
            nominal["tolerances"]
        )
        assert nominal["servo"]["kp"] == pytest.approx(true["servo"]["kp"] * (1.0 + off["servo.kp"]), rel=1e-5)
        assert nominal["servo"]["delay"] == true["servo"]["delay"]
        assert servo_of(nominal) is not None and nominal["drive"] == "position"
        errors += list(off.values())
    assert 0.09 < max(map(abs, errors)) <= 0.10
    assert np.std(errors) == pytest.approx(0.10 / np.sqrt(3.0), rel=0.15)  # evenly drawn


def precise(family: str, seed: int) -> Experiment:
    """A joint whose sensors resolve everything."""
    rng = np.random.default_rng(seed)
    true = draw_joint(rng, family)
    sensors = {"rate": 500.0, "link_quantum": 1e-8, "motor_quantum": 1e-8, "torque_noise": 1e-8}
    return draw_experiment(rng, true | {"sensors": sensors}, family, 8.0, Recorder())


def test_dirt_is_a_small_share_of_the_effects_gap() -> None:
    shares, kinds = [], set()
    for seed in range(6):
        experiment, rng = precise("series_elastic", seed), np.random.default_rng(seed)
        main = Physics(friction=at_axis(0, 0.1 * experiment.scene.torque[0]))
        run = experiment.run(main, 0.25e-3)
        assert run is not None
        gap = experiment.ratio(main, run)
        both, dirt = with_dirt(rng, experiment, main, gap)
        alone = Physics(**{name: value for name, value in vars(both).items() if name != "friction"})
        small = experiment.run(alone, 0.25e-3)
        assert small is not None
        assert both.friction == main.friction and DIRT[0] <= dirt.share <= DIRT[1]
        shares.append(np.sqrt((experiment.ratio(alone, small) ** 2 - 1.0) / (gap**2 - 1.0)) / dirt.share)
        kinds.add(dirt.effect)
    assert 0.4 < np.median(shares) < 2.5 and max(shares) < 5.0
    assert len(kinds) > 2


def test_the_grid_of_a_step_is_fine_enough_for_a_servo() -> None:
    device = rigid()
    drive = excite(np.random.default_rng(2), device, 2.0, 1.0, 200.0, SERVO)
    runs = [
        simulate(device, Physics(), drive, np.zeros(400), start_of(device, drive), step) for step in (1e-3, 0.25e-3)
    ]
    assert runs[0] is not None and runs[1] is not None
    assert np.abs(runs[0].angle - runs[1].angle).max() < 2e-3 * pi
