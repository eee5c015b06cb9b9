"""Equations of a record balance with the plant that made the log, and not with another plant."""

from dataclasses import replace

import numpy as np
import pytest
from joint_records import of_commands, of_torques
from sim_joints import BOTH_SIDES, ENCODER_ERRORS, RIPPLES, SIZES, antagonistic, flexible, rigid, serial_servo
from via_core.errors import ParameterError, SignalError
from via_core.signals import Signals
from via_core.weak_form import window_weights
from via_gap.residual.equation_torques import equation_torques
from via_gap.residual.record import Record
from via_sim.catalogue import EFFECTS
from via_sim.effects import Effect, places
from via_sim.joint.parameters import ABSENT, P
from via_sim.plants import JointPlant
from via_sim.simulate import simulate

RATE = 1000.0
SECONDS = 4.0
SPAN = 60  # samples of a window


def commands(device, channels=None) -> Signals:
    """Torques [N m] (angles [rad] of servos) that move the joint through its range."""
    time = np.arange(round(SECONDS * RATE)) / RATE
    ramp = np.minimum(time / 0.3, 1.0)
    wave = ramp * (1.2 * np.sin(5.0 * time) + 0.6 * np.sin(13.0 * time + 1.0))
    given = {"neighbour": np.cos(3.0 * time), "arm_torque": 0.1 * np.sin(5.0 * time), **(channels or {})}
    if device.damper is not None:
        given["damping"] = 0.5 + 0.3 * wave / 1.8
    if device.n_motors:
        size = 0.4 if device.drive == "servo" else 1.0
        given["motor"] = size * np.stack([wave, 0.7 * wave[::-1]][: device.n_motors], axis=1)
    else:
        given["external_torque"] = wave
    return Signals(time, given, dict.fromkeys(given, "-"), frozenset(given))


def recorded(plant, sent) -> Record:
    """Noise-free record of the joint with measured velocities."""
    run = simulate(plant, sent, SECONDS - 1.0 / RATE, RATE).measured
    velocity = np.zeros((len(run), 3))
    velocity[:, 0] = run["q_velocity"]
    if plant.device.n_motors:
        velocity[:, 1 : 1 + plant.device.n_motors] = run["theta_velocity"]
    return of_commands(plant.device, run, velocity, sent)


def residual(plant, record) -> np.ndarray:
    """(windows, 3) inertia <angle, psi''> - <torque, psi> [N m]; NaN for windows with an axis nearly at standstill."""
    found = equation_torques(plant.parameters, record)
    W = window_weights(4, record.time[: SPAN + 1])
    starts = np.arange(100, len(record) - SPAN - 1, 7)
    rows = starts[:, None] + np.arange(SPAN + 1)
    out = found.inertia * np.einsum("k,nka->na", W[2], found.angle[rows])
    out = out - np.einsum("k,nka->na", W[0], found.torque[rows])
    out[np.any(found.standing[rows], axis=1)] = np.nan
    return out


def largest(values) -> np.ndarray:
    """Largest magnitude (3,) of each axis."""
    return np.nanmax(np.abs(values), axis=0, initial=0.0)


def worst(values) -> float:
    return float(np.max(largest(values)))


GRAVITY = "{inertia: 0.02, viscous_friction: 0.1, gravity_torque: 0.3, gravity_angle: 0.2}"
MOTOR = "{inertia: 0.01, viscous_friction: 0.1}"
JOINTS = (flexible(10.0, GRAVITY, MOTOR), antagonistic(GRAVITY), rigid(GRAVITY), serial_servo())
SILENT = {"encoder_quantisation", "torque_gain-sensor", "torque_bias-sensor"}  # they change no equation
PLANTED = [
    pytest.param(joint, Effect(name, site, SIZES[name], motor), id=f"{joint.arrangement}-{name}-{site}-{motor}")
    for joint in JOINTS
    for name in EFFECTS
    for site, motor in places(name, joint)
    if not {name, f"{name}-{site}"} & SILENT
    and not (name == "encoder_offset" and joint.arrangement == "serial" and motor == 2)
]
PLANTED += [
    pytest.param(joint, Effect(name, site, SIZES[name] | more, 1), id=f"{joint.arrangement}-{name}-several")
    for name, site, more in (
        ("torque_ripple", "motor", RIPPLES),
        ("encoder_eccentricity", "sensor", ENCODER_ERRORS),
        ("load_dependent_friction", "motor", BOTH_SIDES),
    )
    for joint in JOINTS[:3]
    if (site, 1) in places(name, joint)
]
PLANTED += [
    pytest.param(joint, Effect("load_dependent_friction", "link", BOTH_SIDES), id=f"{joint.arrangement}-both_sides")
    for joint in JOINTS[:3]
]


@pytest.mark.parametrize(("joint", "effect"), PLANTED)
def test_equations_balance_with_the_true_plant_and_not_with_the_nominal_one(joint, effect):
    nominal = JointPlant.from_device(joint)
    if (joint.arrangement, effect.name) == ("serial", "stribeck_friction"):  # as much as elsewhere would hold its link
        effect = Effect("stribeck_friction", "link", {"breakaway": 0.06, "kinetic": 0.02, "velocity": 0.5})
    planted = nominal.with_effects([effect])
    record = recorded(planted, commands(joint))
    left, right = residual(nominal, record), residual(planted, record)
    axes = np.flatnonzero(nominal.parameters[P.axis_kind : P.axis_kind + 3] != ABSENT)
    assert np.isfinite(right).any(axis=0)[axes].all()
    rounding = 2.0 * largest(residual(nominal, recorded(nominal, commands(joint)))) + 1e-5
    before, after = largest(left)[axes], largest(right)[axes]
    assert np.all(after < 0.02 * before + rounding[axes])
    assert np.any(after < 0.05 * before)


@pytest.mark.parametrize("joint", [rigid, flexible, antagonistic])
def test_equations_of_a_nominal_joint_balance(joint):
    plant = JointPlant.from_device(joint())
    assert worst(residual(plant, recorded(plant, commands(plant.device)))) < 2e-4


def test_measured_torques_replace_commands():
    plant = JointPlant.from_device(antagonistic())
    sent = commands(plant.device, {"arm_torque": np.zeros(round(SECONDS * RATE))})
    run = simulate(plant, sent, 2.0, RATE).measured
    velocity = np.column_stack([run["q_velocity"], run["theta_velocity"]])
    record = of_torques(plant.device, run, velocity, None)
    assert worst(residual(plant, record)) < 2e-4
    same = of_commands(plant.device, run, velocity, sent)
    assert np.allclose(
        equation_torques(plant.parameters, record).torque[2:-2],
        equation_torques(plant.parameters, same).torque[2:-2],
        atol=1e-9,
        equal_nan=True,
    )


WITH_MEMORY = ("presliding_friction", "hysteresis", "actuator_lag")


@pytest.mark.parametrize("name", ["torque_saturation", "torque_ripple", "channel_skew", "actuator_delay", *WITH_MEMORY])
def test_selected_samples_equal_those_of_the_whole_record(name):
    """Includes effects with memory of samples before the selected ones."""
    joint = flexible()
    kind, nominal = EFFECTS[name], JointPlant.from_device(joint)
    site = next(place for place in places(name, joint) if place[0] in kind.sites)
    effect = Effect(name, site[0], SIZES[name], site[1])
    record = recorded(nominal, commands(joint))
    row, wanted = nominal.with_effects([effect]).parameters, np.r_[700:760, 2000:2300, 3999]
    whole, some = equation_torques(row, record), equation_torques(row, record, wanted)
    for field in ("torque", "friction", "forward", "backward", "standing", "angle", "velocity", "transmission"):
        assert np.array_equal(getattr(some, field), getattr(whole, field)[wanted], equal_nan=field != "standing"), field


@pytest.mark.parametrize(
    ("name", "number", "value"),
    [("torque_limit", 0, 0.4), ("saturation", 1, 0.3), ("delay", 0, 0.0123), ("sensed_gain", 1, 1.3),
     ("sensed_bias", 1, 0.2), ("inertia", 0, 0.5), ("torque_gain", 1, 0.7)],
)  # fmt: skip
def test_cached_means_belong_to_the_row(name, number, value):
    """Rows that differ in any slot that the means depend on have different cache entries."""
    joint = flexible()
    row, sent = JointPlant.from_device(joint).parameters.copy(), commands(joint)
    run = simulate(JointPlant.from_device(joint), sent, 2.0, RATE).measured
    velocity = np.column_stack([run["q_velocity"], run["theta_velocity"], np.zeros(len(run))])
    record = of_torques(joint, run, velocity, sent)
    other = row.copy()
    other[getattr(P, name) + number] = value
    for each in (row, other, row):
        late, prompt = record.means(each)
        fresh = replace(record).means(each)
        assert np.array_equal(late, fresh[0]) and np.array_equal(prompt, fresh[1])
    moved = not np.array_equal(record.means(row)[0], record.means(other)[0])
    assert moved == (name not in ("inertia", "torque_gain"))


def test_misuse_is_refused():
    time, three = np.arange(3.0), np.zeros((3, 3))
    with pytest.raises(SignalError, match="'velocity' of a record must have shape"):
        Record(time, three, np.zeros((3, 2)), time, np.zeros((3, 6)))
    with pytest.raises(SignalError, match="'time' of a record must increase"):
        Record(time[::-1], three, three, time, np.zeros((3, 6)))
    with pytest.raises(SignalError, match="commands of a record must be finite"):
        Record(time, three, three, time, np.full((3, 6), np.nan))
    with pytest.raises(ParameterError, match="a parameter row has shape"):
        equation_torques(np.zeros(3), Record(time, three, three, time, np.zeros((3, 6))))
