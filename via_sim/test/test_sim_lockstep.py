"""Runs in lockstep against single runs: motion and final states."""

import math
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sim_joints import (
    BOTH_SIDES,
    MORE,
    SIZES,
    antagonistic,
    device,
    flexible,
    rigid,
    serial_servo,
    servo_flexible,
)
from sim_together import simulate_rows
from via_core.devices import load_device
from via_core.signals import Array
from via_sim.catalogue import EFFECTS
from via_sim.effects import Effect, places
from via_sim.joint.compiled import compiled
from via_sim.joint.encoders import true_motion
from via_sim.joint.kernel import advance_tick, begin, run
from via_sim.joint.layout import N_COMMANDS, N_INPUTS, N_MODES, X
from via_sim.joint.parameters import P
from via_sim.joint.step import N_WEIGHTS
from via_sim.joint.torques import find_modes
from via_sim.lockstep.pack import LANES, get, put, rows_of_packs
from via_sim.lockstep.run import lead_many, run_many
from via_sim.plants import JointPlant
from via_sim.sensors import IDEAL
from via_sim.simulate import initial_state

RATE = 1000.0
GRAVITY = "{inertia: 0.02, viscous_friction: 0.1, gravity_torque: 0.3, gravity_angle: 0.2}"
DAMPED = device(
    "flexible",
    GRAVITY,
    "motors: [{inertia: 0.01, viscous_friction: 0.1}]\n"
    "springs: [{law: sinh, k: 0.5, a: 6.0, max_deflection: 0.5}]\n"
    "damper: {site: transmission, map: linear, minimum: 0.0, maximum: 0.2}",
)
EXPONENTIAL = device(
    "flexible",
    GRAVITY,
    "motors: [{inertia: 0.01, viscous_friction: 0.1}]\n"
    "springs: [{law: exponential, k: 0.5, rise: 1.0, fall: 0.6, a: 6.0, max_deflection: 0.3}]",
)
JOINTS = (flexible(10.0, GRAVITY), antagonistic(GRAVITY), rigid(GRAVITY), DAMPED, serial_servo(), servo_flexible())


def commands(ticks: int) -> Array:
    t = np.arange(ticks) / RATE
    waves = [np.sin(7.0 * t), np.cos(11.0 * t), 0.5 + 0.4 * np.sin(3.0 * t), 0.3 * np.sin(5.0 * t), np.cos(2.0 * t)]
    return np.stack([*waves, 0.1 * np.sin(4.0 * t)], axis=1)


def alone(row: Array, state: Array, sent: Array) -> Array:
    """Measured motion (N+1, 6) of one run."""
    measured, truth = np.empty((len(sent) + 1, 9)), np.empty((len(sent) + 1, 16))
    run(row, IDEAL.row(), state, sent, measured, truth)
    return np.nan_to_num(np.column_stack([measured[:, :3], measured[:, 5:8]]))


@pytest.mark.parametrize("joint", JOINTS, ids=lambda joint: f"{joint.arrangement}-{joint.drive}")
def test_every_effect_in_lockstep_equals_single_runs(joint):
    """All effects of a joint in lanes next to nominal ones, with stops, reversals and flank changes."""
    nominal = JointPlant.from_device(joint)
    plants = [nominal]
    for name in EFFECTS.keys() - {"encoder_quantisation"}:
        for site, motor in places(name, joint):
            plants += [nominal.with_effects([Effect(name, site, SIZES[name], motor)]), nominal]
            if name in MORE:
                more = MORE[name]
                plants += [nominal.with_effects([Effect(name, site, SIZES[name] | more, motor)]), nominal]
            if name == "spring_law":  # to where it pushes
                softened = Effect(name, site, {"scale": 1.0, "hardening": -12.0}, motor)
                plants += [nominal.with_effects([softened]), nominal]
    rows, sent = np.stack([plant.at_rate(RATE) for plant in plants]), commands(400)
    states = np.stack([initial_state(plant, RATE, (0.1, 0.0, 0.0, 0.5, 0.2, -0.2), 0) for plant in plants])
    own = states.copy()
    together = simulate_rows(rows, states, sent)
    assert len(plants) % LANES != 0
    for k, plant in enumerate(plants):
        motion = alone(rows[k], own[k], sent)
        assert np.max(np.abs(together[k] - motion)) < 1e-9, plant.effects
        assert np.max(np.abs(states[k] - own[k])) < 1e-9, plant.effects


ALL_AT_ONCE = [
    Effect("presliding_friction", "motor", {"torque": 0.1, "stiffness": 2.0}, 1),
    Effect("stribeck_friction", "link", {"breakaway": 0.03, "kinetic": 0.01, "velocity": 0.5}),
    Effect("hysteresis", "transmission", {"torque": 0.05, "stiffness": 3.0}, 1),
    Effect("spring_damping", "transmission", {"coefficient": 0.03}, 1),
    Effect("quadratic_drag", "link", {"coefficient": 0.02}),
    Effect("load_dependent_friction", "link", {name: 0.3 * value for name, value in BOTH_SIDES.items()}),
    Effect("torque_ripple", "motor", {"amplitude": 0.1, "order": 7.0, "phase": 0.5}, 1),
    Effect("contact", "environment", {"angle": 0.2, "stiffness": 30.0, "damping": 0.1, "side": 1.0}),
    Effect("actuator_lag", "command", {"time_constant": 0.02}),
    Effect("channel_skew", "timing", {"delay": 0.0043}, 1),
]


@pytest.mark.parametrize("joint", [flexible(10.0, GRAVITY), DAMPED, EXPONENTIAL], ids=["linear", "sinh", "exponential"])
def test_rare_terms_in_neighbouring_lanes_with_substeps(joint):
    """Each lane has one term more than the previous one, so all lanes of a block differ."""
    plants = [JointPlant.from_device(joint).with_effects(ALL_AT_ONCE[:n]) for n in range(len(ALL_AT_ONCE) + 1)]
    rows, sent = np.stack([plant.at_rate(RATE) for plant in plants]), commands(600)
    rows[:, P.substeps] = 2.0
    states = np.stack([initial_state(plant, RATE, (0.1, 0.0, 0.0, 0.5, 0.2, 0.0), 0) for plant in plants])
    own = states.copy()
    together = simulate_rows(rows, states, sent)
    for k in range(len(plants)):
        assert np.max(np.abs(together[k] - alone(rows[k], own[k], sent))) < 1e-9, plants[k].effects[-1:]
        assert np.max(np.abs(states[k] - own[k])) < 1e-9, plants[k].effects[-1:]
    assert np.ptp(together[:, -1, 0]) > 1e-3


@pytest.mark.parametrize("joint", JOINTS, ids=lambda joint: f"{joint.arrangement}-{joint.drive}")
def test_lanes_with_different_dead_times_and_lags_in_substeps(joint):
    """Each lane divides its ticks elsewhere, and has at least as many steps as alone."""
    delays = (0.0, 0.0043, 0.0007, 0.005, 0.0098)
    effects = [[Effect("actuator_delay", "command", {"delay": delay})] if delay else [] for delay in delays]
    effects += [[*each, Effect("actuator_lag", "command", {"time_constant": 0.02})] for each in effects]
    plants = [JointPlant.from_device(joint).with_effects(each) for each in effects]
    rows, sent = np.stack([plant.at_rate(RATE) for plant in plants]), commands(300)
    rows[:, P.substeps] = 2.0
    states = np.stack([initial_state(plant, RATE, (0.1, 0.0, 0.0, 0.5, 0.2, 0.0), 0) for plant in plants])
    own, fine = states.copy(), states.copy()
    together = simulate_rows(rows, states, sent)
    exact = rows.copy()
    exact[:, P.substeps] = 32.0
    for k in range(len(plants)):
        reference = alone(exact[k], fine[k], sent)
        error = np.max(np.abs(alone(rows[k], own[k], sent) - reference))
        assert np.max(np.abs(together[k] - reference)) < error + 1e-9, plants[k].effects
        assert np.array_equal(states[k, X.queue :], own[k, X.queue :])
    assert np.ptp(together[:, -1, 0]) > 1e-4


def test_run_in_pieces_equals_the_whole_run():
    """A run can continue from the state after lockstep: queue, ring buffer, tick number."""
    joint = flexible(10.0, GRAVITY)
    effects = [
        Effect("actuator_delay", "command", {"delay": 0.007}),
        Effect("actuator_lag", "command", {"time_constant": 0.02}),
        Effect("presliding_friction", "motor", {"torque": 0.02, "stiffness": 2.0}, 1),
        Effect("hysteresis", "transmission", {"torque": 0.02, "stiffness": 3.0}, 1),
        Effect("stiffness_drift", "transmission", {"rate": 0.2}, 1),
    ]
    plant = JointPlant.from_device(joint).with_effects(effects)
    rows, sent = np.repeat(plant.at_rate(RATE)[None], 20, axis=0), commands(300)
    states = np.repeat(initial_state(plant, RATE, None, 0)[None], 20, axis=0)
    whole = simulate_rows(rows, states.copy(), sent)
    pieces = [simulate_rows(rows, states, sent[a : a + 60])[:, 1:] for a in range(0, 300, 60)]
    assert np.max(np.abs(np.concatenate(pieces, axis=1) - whole[:, 1:])) < 1e-12
    assert np.all(states[:, X.tick] == 300.0)


def test_runs_with_different_beginnings_in_one_block():
    plant = JointPlant.from_device(flexible(10.0, GRAVITY))
    plants = [plant, plant.with_effects([Effect("actuator_delay", "command", {"delay": 0.005})])] * 4
    rows, sent, begins = np.stack([each.at_rate(RATE) for each in plants]), commands(400), 40 * np.arange(8)
    states = np.repeat(initial_state(plant, RATE, (0.1, 0, 0, 0.5, 0, 0), 0)[None], 8, axis=0)
    states[:, X.tick] = begins
    own, out = states.copy(), np.empty((8, 101, 6))
    run_many(rows, states, sent, begins, out)
    for k, first in enumerate(begins):
        assert np.max(np.abs(out[k] - alone(rows[k], own[k], sent[first : first + 100]))) < 1e-12
        assert np.max(np.abs(states[k] - own[k])) < 1e-12


def test_lanes_with_different_ticks_or_substeps():
    nominal = JointPlant.from_device(flexible(10.0, GRAVITY))
    rows = np.repeat(nominal.at_rate(RATE)[None], 4, axis=0)
    rows[1, P.substeps] = 3.0
    states = np.repeat(initial_state(nominal, RATE, (0.1, 0, 0, 0, 0, 0), 0)[None], 4, axis=0)
    states[2, X.tick] = 7.0
    own, sent = states.copy(), commands(100)
    together = simulate_rows(rows, states, sent)
    for k in range(4):
        assert np.max(np.abs(together[k] - alone(rows[k], own[k], sent))) < 1e-12
    assert np.max(np.abs(together[1] - together[0])) > 1e-12


def test_stiff_shipped_joint_in_lockstep():
    plant = JointPlant.from_device(load_device("cubic_aa_vsa"))
    sent = np.zeros((200, N_COMMANDS))
    sent[:, 0] = 40.0 * np.sin(0.02 * np.arange(200))
    rows = np.repeat(plant.at_rate(RATE)[None], 40, axis=0)
    states = np.repeat(initial_state(plant, RATE, None, 0)[None], 40, axis=0)
    own = states[0].copy()
    assert np.max(np.abs(simulate_rows(rows, states, sent)[-1] - alone(rows[0], own, sent))) < 1e-12


@compiled
def _functions_of_packs(z: Array) -> None:
    """Sine, cosine and exponential of rows 0 and 1 of z (5, LANES) into rows 2 to 4."""
    put(z, 2, math.sin(get(z, 0)))
    put(z, 3, math.cos(get(z, 0)))
    put(z, 4, math.exp(get(z, 1)))


@settings(max_examples=200, deadline=None)
@given(st.lists(st.floats(-1e4, 1e4), min_size=LANES, max_size=LANES), st.floats(-700.0, 700.0))
def test_functions_of_packs_match_the_library(x, y):
    z = rows_of_packs(5)
    z[0], z[1] = x, y * np.linspace(-1.0, 1.0, LANES)
    _functions_of_packs(z)
    assert np.max(np.abs(z[2] - np.sin(z[0]))) < 1e-11
    assert np.max(np.abs(z[3] - np.cos(z[0]))) < 1e-11
    assert np.max(np.abs(z[4] / np.exp(z[1]) - 1.0)) < 1e-14


def led(row: Array, state: Array, sent: Array, measured: Array, axes: Sequence[int]) -> None:
    """One run with axes set to their measurement before every tick; a late encoder measured it later."""
    u, modes, weights = np.zeros(N_INPUTS), np.zeros(N_MODES, np.int64), np.zeros((2, N_WEIGHTS))
    begin(row, state, u, modes, weights)
    times = np.arange(len(measured)) / RATE

    def lead(tick: int) -> None:
        for axis in axes:
            then = tick / RATE + row[P.skew + axis]
            angle, speed = (float(np.interp(then, times, measured[:, k])) for k in (axis, 3 + axis))
            state[axis], state[3 + axis] = true_motion(row, axis, angle, speed)

    for tick, command in enumerate(sent):
        lead(tick)
        find_modes(row, state, u, modes)
        advance_tick(row, state, command, u, modes, weights, np.zeros(9))
    lead(len(sent))


@pytest.mark.parametrize(
    ("joint", "axes"),
    [(flexible(10.0, GRAVITY), (0,)), (antagonistic(GRAVITY), (0,)), (antagonistic(GRAVITY), (0, 1)), (DAMPED, (0,))],
    ids=["one", "two", "two, a motor measured", "damped"],
)
def test_prescribed_axes_in_lockstep_equal_single_runs(joint, axes):
    """Axes follow the motion of another run, which rests at times, under rows with every effect."""
    nominal = JointPlant.from_device(joint)
    plants = [nominal]
    for name in EFFECTS.keys() - {"encoder_quantisation"}:
        plants += [nominal.with_effects([Effect(name, site, SIZES[name], i)]) for site, i in places(name, joint)]
    rows, sent = np.stack([plant.at_rate(RATE) for plant in plants]), commands(300)
    start = initial_state(nominal, RATE, (0.1, 0.0, 0.0, 0.5, 0.2, -0.2), 0)
    measured = alone(nominal.at_rate(RATE), start.copy(), 0.8 * sent)
    for rest in (slice(0, 60), slice(150, 170)):
        measured[rest, :3], measured[rest, 3:] = measured[rest.stop, :3], 0.0
    states = np.repeat(start[None], len(rows), axis=0)
    own, out = states.copy(), np.empty((len(rows), len(sent) + 1, 6))
    lead_many(rows, states, sent, np.zeros(len(rows), np.int64), measured, np.array(axes), out)
    for row, state, mine, plant in zip(rows, states, own, plants, strict=True):
        led(row, mine, sent, measured, axes)
        assert np.max(np.abs(state - mine)) < 1e-9, plant.effects
    moved = np.ptp(out[:, -1, 1:3], axis=0)
    assert moved.max() > 1e-3
