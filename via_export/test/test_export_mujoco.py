"""The exported MJCF moves in MuJoCo as the joint with the same effects in via_sim: planted effects, one by one."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from export_joints import (
    MOTIONS,
    RATE,
    angles_in_mujoco,
    angles_in_via_sim,
    commands_of,
    device_of,
    difference,
    start_of,
)
from via_core.springs import ExponentialSpring, FourBarSpring, SinhSpring
from via_export import export
from via_export.mujoco_joint import MujocoJoint
from via_export.springs import preload, spring_terms
from via_export.target import Target
from via_sim.catalogue import EFFECTS
from via_sim.effects import Effect
from via_sim.plants import JointPlant
from via_sim.simulate import InitialConditions, command_rows, simulate

SECONDS = 1.0
EXACT, SLOT = 1e-4, 2e-3  # of the standard deviation of the motion


def e(name: str, site: str, motor: int = 0, **parameters: float) -> Effect:
    return Effect(name, site, parameters, motor)


PENDULUM, CUBIC, SERVO, MACCEPA = "dfki_simple_pendulum", "cubic_demo", "xl330", "maccepavd"
PLANTED = (
    (PENDULUM, e("coulomb_friction", "link", torque=0.3)),
    (PENDULUM, e("asymmetric_coulomb", "link", forward=0.1, backward=0.3)),
    (PENDULUM, e("stribeck_friction", "link", breakaway=0.5, kinetic=0.2, velocity=0.5)),
    (PENDULUM, e("viscous_friction", "link", coefficient=0.1)),
    (PENDULUM, e("quadratic_drag", "link", coefficient=0.05)),
    (PENDULUM, e("presliding_friction", "link", torque=0.3, stiffness=10.0)),
    (PENDULUM, e("torque_gain", "motor", 1, gain=0.8)),
    (PENDULUM, e("torque_bias", "motor", 1, torque=0.4)),
    (PENDULUM, e("torque_ripple", "motor", 1, amplitude=0.3, order=7.0, phase=0.4, amplitude_2=0.1, order_2=12.5)),
    (PENDULUM, e("torque_saturation", "motor", 1, limit=1.2)),
    (PENDULUM, e("actuator_lag", "command", time_constant=0.03)),
    (PENDULUM, e("actuator_delay", "command", delay=0.0231)),
    (PENDULUM, e("encoder_offset", "sensor", offset=0.2)),
    (PENDULUM, e("channel_skew", "timing", delay=0.0123)),
    (PENDULUM, e("payload", "link", mass=0.45, distance=0.5)),
    (PENDULUM, e("link_inertia", "link", inertia=0.05)),
    (PENDULUM, e("gravity_error", "link", torque=-0.5, angle=0.2)),
    (PENDULUM, e("link_spring", "link", stiffness=0.8, rest=0.6)),
    (PENDULUM, e("contact", "environment", angle=0.1, stiffness=50.0, damping=0.5, side=1.0)),
    (PENDULUM, e("external_torque", "environment", torque=0.5, start=0.0, stop=1e6)),
    (CUBIC, e("coulomb_friction", "motor", 2, torque=0.2)),
    (CUBIC, e("backlash", "transmission", 1, gap=0.05)),
    (CUBIC, e("hysteresis", "transmission", 1, torque=0.1, stiffness=3.0)),
    (CUBIC, e("spring_damping", "transmission", 1, coefficient=0.05)),
    (CUBIC, e("spring_law", "transmission", 1, scale=1.2, hardening=0.8)),
    (CUBIC, e("preset_error", "transmission", 1, offset=0.1)),
    (CUBIC, e("encoder_offset", "sensor", 1, offset=0.1)),
    (CUBIC, e("link_spring", "link", stiffness=0.5, rest=-0.2)),
    ("qbmove_a", e("backlash", "transmission", 1, gap=0.05)),
    (SERVO, e("speed_limit", "command", limit=3.0)),
    (SERVO, e("actuator_lag", "command", time_constant=0.03)),
    (SERVO, e("actuator_delay", "command", delay=0.03)),
    (SERVO, e("torque_gain", "motor", 1, gain=0.8)),
    (SERVO, e("position_gain", "motor", 1, gain=0.8)),
    (SERVO, e("integral_action", "motor", 1, rate=6.0, start=0.1)),
    (SERVO, e("torque_saturation", "motor", 1, limit=0.4)),
    (SERVO, e("encoder_offset", "sensor", offset=0.2)),
    (MACCEPA, e("encoder_offset", "sensor", 1, offset=0.1)),
    (MACCEPA, e("encoder_offset", "sensor", 2, offset=0.1)),
    (MACCEPA, e("actuator_delay", "command", delay=0.045)),
    (MACCEPA, e("actuator_lag", "command", time_constant=0.045)),
    (MACCEPA, e("torque_saturation", "motor", 1, limit=2.0)),
    (MACCEPA, e("hysteresis", "transmission", 1, torque=0.02, stiffness=90.0)),
    (MACCEPA, e("preset_error", "transmission", 1, offset=0.2)),
    (MACCEPA, e("device_numbers", "device", **{"link inertia": 1.3, "spring 1 torque": 0.8, "damper": 0.7})),
)  # fmt: skip
NOT_HELD = (
    (PENDULUM, e("asymmetric_viscous", "link", forward=0.2, backward=0.0)),
    (PENDULUM, e("external_torque", "environment", torque=1.0, start=0.2, stop=0.8)),
    (PENDULUM, e("encoder_eccentricity", "sensor", amplitude=0.05, phase=0.3)),
    (CUBIC, e("stiffness_drift", "transmission", 1, rate=-0.8)),
    (PENDULUM, e("torque_deadband", "motor", 1, threshold=1.0)),
    (PENDULUM, e("dead_zone", "motor", 1, width=0.4)),
    (SERVO, e("position_deadband", "motor", 1, width=0.2)),
    (SERVO, e("velocity_feedforward", "motor", 1, share=1.0)),
    (CUBIC, e("gear_error", "transmission", 1, amplitude=0.1, order=3.0, phase=0.4)),
    (SERVO, e("load_dependent_friction", "link", coefficient=0.3)),
)
CASES = [pytest.param(*each, id=f"{each[1].name}-{each[0]}-{each[1].motor}") for each in PLANTED]


@pytest.mark.parametrize("name", MOTIONS)
def test_a_device_without_effects_moves_alike(name: str) -> None:
    device = device_of(name)
    approximated = any(isinstance(spring, SinhSpring | ExponentialSpring | FourBarSpring) for spring in device.springs)
    found = difference(angles_in_via_sim(device, (), SECONDS), angles_in_mujoco(device, (), SECONDS))
    # friction constraints are soft; a nonlinear spring is accurate to 0.1 %
    dry = device.link.coulomb_friction > 0.0 or name == MACCEPA
    assert found < (SLOT if approximated or dry else EXACT)


@pytest.mark.parametrize(("name", "effect"), CASES)
def test_an_effect_with_a_slot_moves_the_joint_alike(name: str, effect: Effect) -> None:
    device = device_of(name)
    truth = angles_in_via_sim(device, [effect], SECONDS)
    found = difference(truth, angles_in_mujoco(device, [effect], SECONDS))
    assert effect.name not in [loss.item for loss in export(device, [effect]).losses]
    assert found < SLOT
    assert difference(truth, angles_in_via_sim(device, (), SECONDS)) > 5.0 * SLOT  # the effect matters


@pytest.mark.parametrize(("name", "effect"), NOT_HELD, ids=[each[1].name for each in NOT_HELD])
def test_an_effect_without_a_slot_is_listed_and_moves_the_joint_differently(name: str, effect: Effect) -> None:
    device = device_of(name)
    assert [loss for loss in export(device, [effect]).losses if loss.item == effect.name]
    truth = angles_in_via_sim(device, [effect], SECONDS)
    assert difference(truth, angles_in_mujoco(device, [effect], SECONDS)) > 5.0 * SLOT


def test_every_effect_is_planted_or_known_to_have_no_slot() -> None:
    tried = {effect.name for _, effect in (*PLANTED, *NOT_HELD)}
    assert set(EFFECTS) - tried == {"joint_coupling", "encoder_quantisation"}


def test_several_effects_act_together() -> None:
    device = device_of(CUBIC)
    effects = [
        e("torque_ripple", "motor", 1, amplitude=0.1, order=9.0, phase=0.4),
        e("encoder_offset", "sensor", 1, offset=0.1),
        e("torque_gain", "motor", 0, gain=0.9),
        e("coulomb_friction", "motor", 2, torque=0.1),
        e("hysteresis", "transmission", 1, torque=0.1, stiffness=3.0),
    ]
    assert difference(angles_in_via_sim(device, effects, SECONDS), angles_in_mujoco(device, effects, SECONDS)) < SLOT


def test_a_goal_with_a_speed_limit_acts_when_it_does_in_the_simulator() -> None:
    device, high = (
        device_of(SERVO),
        [e("speed_limit", "command", limit=8.0), e("actuator_delay", "command", delay=0.02)],
    )
    found = difference(angles_in_via_sim(device, high, SECONDS), angles_in_mujoco(device, high, SECONDS))
    assert found < 0.2 * SLOT


@pytest.mark.parametrize("more", [{}, {"speed_limit": 8.0}, {"integral_limit": 0.05}])
def test_the_integral_of_a_device_moves_the_joint_alike(more: dict[str, float]) -> None:
    device = device_of(SERVO)
    assert device.servo is not None
    with_integral = device.model_copy(update={"servo": device.servo.model_copy(update={"ki": 12.0, **more})})
    truth = angles_in_via_sim(with_integral, (), SECONDS)
    assert difference(truth, angles_in_mujoco(with_integral, (), SECONDS)) < SLOT
    assert difference(truth, angles_in_via_sim(device, (), SECONDS)) > 5.0 * SLOT
    assert "servo: ki" not in [loss.item for loss in export(with_integral, ()).losses]


@pytest.mark.parametrize("more", [{}, {"speed_limit": 8.0}, {"ki": 12.0}, {"speed_limit": 8.0, "torque_limit": None}])
def test_a_position_drive_keeps_its_torque_bias(more: dict[str, float | None]) -> None:
    device, bias = device_of(SERVO), [e("torque_bias", "motor", 1, torque=0.1)]
    assert device.servo is not None
    device = device.model_copy(update={"servo": device.servo.model_copy(update=more)})
    truth = angles_in_via_sim(device, bias, SECONDS)
    assert difference(truth, angles_in_mujoco(device, bias, SECONDS)) < SLOT
    assert difference(truth, angles_in_via_sim(device, (), SECONDS)) > 5.0 * SLOT
    assert "torque_bias" not in [loss.item for loss in export(device, bias).losses]


@pytest.mark.parametrize(
    ("more", "kv", "damping"), [({"torque_limit": None}, 0.2, 0.0), ({"torque_limit": 1.0}, 0.0, 0.2)]
)
def test_kd_is_the_kv_of_a_position_actuator_unless_a_limit_excludes_it(
    more: dict[str, float | None], kv: float, damping: float
) -> None:
    device = device_of(SERVO)
    assert device.servo is not None
    device = device.model_copy(update={"servo": device.servo.model_copy(update=more | {"kd": 0.2})})
    model = mujoco.MjModel.from_xml_string(export(device).text)
    assert -model.actuator_biasprm[0, 2] == pytest.approx(kv) and model.actuator_damping[0] == pytest.approx(damping)


@pytest.mark.parametrize("speed_limit", [None, 8.0])
def test_a_torque_limit_that_includes_the_damping_is_the_force_range(speed_limit: float | None) -> None:
    device = device_of(SERVO)
    assert device.servo is not None
    gains = {"kd": 0.2, "torque_limit": 0.15, "speed_limit": speed_limit}
    plain, whole = (
        device.model_copy(update={"servo": device.servo.model_copy(update=gains | {"limited": limited})})
        for limited in ("proportional", "sum")
    )
    truth = angles_in_via_sim(whole, (), SECONDS)
    assert difference(truth, angles_in_mujoco(whole, (), SECONDS)) < SLOT
    assert difference(truth, angles_in_via_sim(plain, (), SECONDS)) > 5.0 * SLOT  # it matters


@pytest.mark.parametrize("rate", [1000.0, 750.0, 510.0])
def test_a_delay_is_kept_at_every_rate_of_commands(rate: float) -> None:
    made = export(device_of(CUBIC), [e("actuator_delay", "command", delay=0.01)])
    model = MujocoJoint(made.text, made.target, rate=rate).model
    assert model.actuator_delay[0] == pytest.approx(0.01, abs=model.opt.timestep)


def test_friction_that_vanishes_at_speed_stays_stable() -> None:
    device, effect = device_of(PENDULUM), e("stribeck_friction", "link", breakaway=0.1, kinetic=0.0, velocity=1.8)
    start = np.zeros(6)
    start[3] = 5.0  # [rad/s]
    made = export(device, [effect])
    commands = commands_of(device, 0.5)
    plant = JointPlant.from_device(device).with_effects([effect])
    truth = simulate(plant, commands, 0.5, RATE, initial=InitialConditions(start)).measured["q"]
    joint = MujocoJoint(made.text, made.target, rate=RATE)
    found = joint.run(joint.start(start, np.zeros((1, 6))), command_rows(device, commands, commands.time))[:, 0]
    assert np.max(np.abs(found - truth)) < 1e-4


@pytest.mark.parametrize("name", [PENDULUM, CUBIC, MACCEPA])
def test_the_constraint_solver_converges_in_a_few_iterations(name: str) -> None:
    device = device_of(name)
    made = export(device, [e("coulomb_friction", "link", torque=0.01)])
    joint = MujocoJoint(made.text, made.target, rate=RATE)
    commands = commands_of(device, 0.2)
    rows = command_rows(device, commands, commands.time)
    data = joint.start(start_of(device), rows[:1])
    most = 0
    for row in rows:
        joint.run(data, row[None])
        most = max(most, int(data.solver_niter.max()))
    assert 0 < most < 10  # a tolerance of 0 takes 100


@pytest.mark.parametrize("name", ["cubic_demo", "qbmove_b", "dlr_bavs", "vsa2", "visco_elastic_demo"])
def test_the_sum_of_tendons_is_the_spring_and_its_tangent_beyond_the_stop(name: str) -> None:
    target = Target.of(device_of(name))
    spring = target.device.springs[0]
    stop = spring.max_deflection
    phi = np.linspace(-stop, stop, 401)
    terms = spring_terms(target, 0)
    torque = sum(term.torque(phi) for term in terms) + preload(target, 0)
    assert np.max(np.abs(torque - spring.torque(phi))) < 1e-3 * np.max(np.abs(spring.torque(phi)))
    for side in (-1.0, 1.0):
        beyond = sum(term.torque(np.array([side * 1.3 * stop])) for term in terms)[0] + preload(target, 0)
        tangent = spring.torque(side * stop) + side * 0.3 * stop * spring.stiffness(side * stop)
        assert beyond == pytest.approx(float(tangent), rel=1e-9)
