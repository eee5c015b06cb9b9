"""Effects as data: neutral values change no bit, effects match their text, files round-trip."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sim_joints import SIZES, antagonistic, device, flexible, positioned, rigid, serial_servo, servo_flexible
from via_core.devices import load_device
from via_core.errors import ParameterError
from via_core.signals import Signals
from via_core.spring_equations import N_COEFFICIENTS
from via_sim.catalogue import EFFECTS
from via_sim.effects import Effect, places
from via_sim.effects.files import effects_text, load_effects, parse_effects, save_effects
from via_sim.joint.layout import X
from via_sim.joint.measurements import TRUTH
from via_sim.joint.parameters import P
from via_sim.plants import JointPlant
from via_sim.simulate import InitialConditions, Simulator, simulate

RATE = 1000.0


def torques(seconds: float = 0.5, motors: int = 2) -> Signals:
    t = np.arange(round(seconds * RATE)) / RATE
    motor = np.stack([np.sin(7.0 * t + i) for i in range(motors)], axis=1)
    return Signals(t, {"motor": motor}, {"motor": "N m"}, frozenset({"motor"}))


def commands_of(device, seconds: float = 0.5) -> Signals:
    """Commands for all inputs of a device, including a moving neighbour and arm torque."""
    t = np.arange(round(seconds * RATE)) / RATE
    wave = np.sin(7.0 * t)
    channels = {"neighbour": np.cos(3.0 * t), "arm_torque": 0.1 * np.sin(5.0 * t)}
    channels |= {"external_torque": wave if device.drive == "torque" and not device.n_motors else 0.2 * wave}
    if device.drive == "position":
        channels["equilibrium"] = wave
    if device.n_motors:
        channels["motor"] = np.stack([wave, np.sin(7.0 * t + 1.0)][: device.n_motors], axis=1)
    if device.damper is not None:
        channels["damping"] = 0.5 + 0.4 * wave
    return Signals(t, channels, dict.fromkeys(channels, "-"), frozenset(channels))


GRAVITY = "{inertia: 0.02, viscous_friction: 0.1, gravity_torque: 0.3, gravity_angle: 0.2}"
SENSED = rigid(GRAVITY.replace("{", "{coulomb_friction: 0.05, ")).model_copy(
    update={"sensors": rigid().sensors.model_copy(update={"link_torque_noise": 0.0})}
)
JOINTS = (antagonistic(GRAVITY), SENSED, serial_servo(), positioned(GRAVITY))
EVERYWHERE = [
    pytest.param(joint, name, site, motor, id=f"{joint.arrangement}-{joint.drive}-{name}-{site}-{motor}")
    for joint in JOINTS
    for name in EFFECTS
    for site, motor in places(name, joint)
]


def measured(plant, sent) -> np.ndarray:
    run = simulate(plant, sent, 0.5, RATE).measured
    return np.column_stack([run[name] for name in run.channels])


def test_every_effect_fits_some_joint():
    assert {param.values[1] for param in EVERYWHERE} == EFFECTS.keys() == SIZES.keys()
    sites = {(param.values[1], param.values[2]) for param in EVERYWHERE}
    assert sites == {(kind.name, site) for kind in EFFECTS.values() for site in kind.sites}


@pytest.mark.parametrize(("joint", "name", "site", "motor"), EVERYWHERE)
def test_neutral_effect_changes_no_bit_and_a_strong_one_does(joint, name, site, motor):
    plant, sent = JointPlant.from_device(joint), commands_of(joint)
    neutral = {parameter.name: parameter.neutral for parameter in EFFECTS[name].all_parameters}
    nominal = measured(plant, sent)
    assert np.array_equal(
        measured(plant.with_effects([Effect(name, site, neutral, motor)]), sent), nominal, equal_nan=True
    )
    changed = plant.with_effects([Effect(name, site, SIZES[name], motor)])
    assert np.nanmax(np.abs(measured(changed, sent) - nominal)) > 1e-4
    assert np.array_equal(measured(changed.with_effects([]), sent), nominal, equal_nan=True)


def test_places_of_a_joint_are_accepted_by_it():
    assert places("backlash", flexible()) == (("transmission", 1),)
    assert places("coulomb_friction", servo_flexible()) == (("link", 0),)
    assert places("coulomb_friction", rigid()) == (("link", 0),)
    assert places("torque_gain", rigid()) == (("motor", 1),)
    assert places("torque_gain", SENSED) == (("motor", 1), ("sensor", 0))
    assert places("torque_saturation", serial_servo()) == (("motor", 1), ("motor", 2), ("motor", 0))
    assert places("torque_gain", flexible()) == (("motor", 1), ("sensor", 1))
    assert places("backlash", antagonistic()) == (("transmission", 1), ("transmission", 2), ("transmission", 0))
    assert places("coulomb_friction", antagonistic()) == (("motor", 1), ("motor", 2), ("motor", 0), ("link", 0))
    assert places("speed_limit", positioned()) == (("command", 0),)
    assert places("speed_limit", rigid()) == places("speed_limit", serial_servo()) == ()
    assert places("encoder_offset", flexible()) == (("sensor", 0), ("sensor", 1))
    assert places("preset_error", load_device("maccepavd")) == (("transmission", 1),)
    spring = "{law: linear, stiffness: 10.0, max_deflection: 1.0}"
    motor = "{inertia: 0.01, viscous_friction: 0.1}"
    assert places("preset_error", device("serial", rest=f"motors: [{motor}, {motor}]\nsprings: [{spring}]")) == ()
    for joint in JOINTS:
        for name in EFFECTS:
            for site in EFFECTS[name].sites:
                for motor in (0, 1, 2):
                    try:
                        JointPlant.from_device(joint).with_effects([Effect(name, site, SIZES[name], motor)])
                        accepted = True
                    except ParameterError:
                        accepted = False
                    assert accepted is ((site, motor) in places(name, joint))


def test_link_is_free_within_the_backlash_gap():
    gap = Effect("backlash", "transmission", {"gap": 0.2}, 1)
    plant = JointPlant.from_device(servo_flexible(10.0)).with_effects([gap])
    drift = simulate(plant, None, 0.09, RATE, initial=InitialConditions((0, 0, 0, 1.0, 0, 0))).truth
    assert np.allclose(drift["q"], drift.time, rtol=0, atol=1e-14)  # nothing acts: q = t until .1 rad
    assert np.all(drift["stiffness"] == 0.0)
    # beyond it half an oscillation on the spring, closed form, then free flight back
    w = np.sqrt(10.0 / 0.02)
    truth = simulate(plant, None, 0.1 + np.pi / w + 0.15, RATE, initial=InitialConditions((0, 0, 0, 1.0, 0, 0))).truth
    t = truth.time - 0.1
    bounce = (t > 0) & (t < np.pi / w)
    assert np.allclose(truth["q"][bounce], 0.1 + np.sin(w * t[bounce]) / w, rtol=0, atol=1e-6)
    back = (t > np.pi / w) & (t < np.pi / w + 0.15)
    assert np.allclose(truth["q"][back], 0.1 - (t[back] - np.pi / w), rtol=0, atol=1e-6)


@pytest.mark.parametrize("ticks", [1, 5, 100])
def test_dead_time_of_whole_ticks_shifts_the_motion_exactly(ticks):
    plant, commands = JointPlant.from_device(flexible(10.0)), torques(0.5, 1)
    nominal = simulate(plant, commands, 0.5, RATE).truth["q"]
    late = simulate(
        plant.with_effects([Effect("actuator_delay", "command", {"delay": ticks / RATE})]), commands, 0.5, RATE
    ).truth["q"]
    assert np.array_equal(late[ticks:], nominal[:-ticks])
    assert np.all(late[:ticks] == 0.0)


def test_dead_time_of_a_fraction_of_a_tick_is_exact():
    """2.4 ticks of 1 ms equal 12 ticks of 0.2 ms for the same joint and commands."""
    plant, commands = JointPlant.from_device(flexible(10.0)), torques(0.3, 1)
    delay = Effect("actuator_delay", "command", {"delay": 2.4e-3})
    coarse = simulate(plant.with_effects([delay]), commands, 0.3, RATE).truth["q"]
    fine = simulate(plant.with_effects([delay]), commands, 0.3, 5.0 * RATE).truth["q"]
    shifted = simulate(plant, commands, 0.3, 5.0 * RATE).truth["q"]
    assert np.array_equal(fine[12:], shifted[:-12])
    assert np.max(np.abs(coarse - fine[::5])) < 1e-9
    assert np.max(np.abs(coarse - simulate(plant, commands, 0.3, RATE).truth["q"])) > 1e-5


def test_a_torque_gain_adds_to_the_scale_of_torques_in_the_device_file():
    scaled = JointPlant.from_device(rigid().model_copy(update={"torque_scale": 0.9}))
    gain = Effect("torque_gain", "motor", {"gain": 0.8}, 1)
    assert scaled.parameters[P.torque_gain] == 0.9
    assert scaled.with_effects([gain]).parameters[P.torque_gain] == pytest.approx(0.72)
    number = Effect("device_numbers", "device", {"torque scale": 0.9})
    plain = JointPlant.from_device(rigid())
    np.testing.assert_array_equal(plain.with_effects([number]).parameters, scaled.parameters)


def test_torque_gain_does_not_change_the_reported_torque():
    plant, commands = JointPlant.from_device(antagonistic()), torques()
    run = simulate(plant.with_effects([Effect("torque_gain", "motor", {"gain": 0.5}, 2)]), commands, 0.5, RATE)
    assert np.array_equal(run.truth["motor_torque"][1:], commands["motor"] * [1.0, 0.5])
    assert np.array_equal(run.measured["tau"][1:], commands["motor"])


def test_arm_torque_bypasses_the_drive():
    """Gain and dead time of the drive do not act on it, and it is not a load of the drive's gear."""
    t = np.arange(400) / RATE
    drive, arm = 0.5 * np.sin(20.0 * t), 0.2 * np.cos(13.0 * t)

    def motion(effects, **channels):
        sent = Signals(t, channels, dict.fromkeys(channels, "N m"), frozenset(channels))
        return simulate(JointPlant.from_device(rigid()).with_effects(effects), sent, 0.4, RATE).truth["q"]

    doubled = Effect("torque_gain", "motor", {"gain": 2.0}, 1)
    whole = motion([], external_torque=2.0 * drive + arm)
    np.testing.assert_allclose(motion([doubled], external_torque=drive, arm_torque=arm), whole, atol=1e-12)
    late = Effect("actuator_delay", "command", {"delay": 0.02})
    behind = np.concatenate((np.full(20, 0.0), drive[:-20]))
    np.testing.assert_allclose(
        motion([late], external_torque=drive, arm_torque=arm), motion([], external_torque=behind + arm), atol=1e-12
    )
    dragging = Effect("load_dependent_friction", "link", {"coefficient": 0.5})
    np.testing.assert_allclose(motion([dragging], arm_torque=arm), motion([], arm_torque=arm), atol=1e-12)


def test_a_dry_friction_effect_equals_a_device_with_less_and_cannot_drive_an_axis():
    motor = "{{inertia: 0.01, viscous_friction: 0.1, coulomb_friction: {}}}"
    filed, less = (flexible(10.0, motor=motor.format(each)) for each in (0.15, 0.04))
    row = JointPlant.from_device(filed).with_effects([Effect("coulomb_friction", "motor", {"torque": -0.11}, 1)])
    np.testing.assert_allclose(row.parameters, JointPlant.from_device(less).parameters, atol=1e-15)
    with pytest.raises(ParameterError, match=r"torque -0.16 leaves -0.01 N m of dry friction, must be >= 0"):
        JointPlant.from_device(filed).with_effects([Effect("coulomb_friction", "motor", {"torque": -0.16}, 1)])


def test_viscous_friction_effect_equals_a_device_with_more_friction():
    extra = Effect("viscous_friction", "motor", {"coefficient": 0.2}, 1)
    wrong = flexible(10.0, motor="{inertia: 0.01, viscous_friction: 0.3}")
    right = flexible(10.0, motor="{inertia: 0.01, viscous_friction: 0.5}")
    commands = torques(0.2, 1)
    a = simulate(JointPlant.from_device(wrong).with_effects([extra]), commands, 0.2, RATE).truth["q"]
    assert np.array_equal(a, simulate(JointPlant.from_device(right), commands, 0.2, RATE).truth["q"])
    with pytest.raises(ParameterError, match="must be >= 0"):
        JointPlant.from_device(wrong).with_effects([Effect("viscous_friction", "motor", {"coefficient": -0.5}, 1)])


def test_effects_can_change_during_a_simulation():
    """A state belongs to the joint and not to its effects: the next simulator continues with it."""
    plant = JointPlant.from_device(flexible(10.0))
    delayed = plant.with_effects([Effect("actuator_delay", "command", {"delay": 0.003})])
    before, after = Simulator(plant, RATE), Simulator(delayed, RATE)
    state = before.init()
    for tick in range(10):
        state, _, _ = before.step(state, (float(tick), 0.0, 0.0, 0.0))
    state, _, truth = after.step(state, (10.0, 0.0, 0.0, 0.0))
    assert truth[TRUTH.motor_torque_1] == 7.0  # the command of three ticks ago, which the nominal joint already had
    assert state[X.tick] == 11.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("rust", "motor", {}, 1), "effect: must be one of coulomb_friction, .*, got 'rust'"),
        (("backlash", "link", {"gap": 0.1}), "backlash.site: must be one of transmission, got 'link'"),
        (("backlash", "transmission", {"gap": 0.1}, 3), "must be 1, 2 or 0 .both., got 3"),
        (("encoder_offset", "sensor", {"offset": 0.1}, 3), "must be 0 .the link's., 1 or 2, got 3"),
        (("coulomb_friction", "link", {"torque": 0.1}, 1), "must be left out at site 'link', got 1"),
        (("backlash", "transmission", {"gap": 0.9}, 1), "backlash.gap: must be 0 to 0.5 rad, got 0.9"),
        (("backlash", "transmission", {"gap": float("nan")}, 1), "must be a finite number, 0 to 0.5 rad, got nan"),
        (("backlash", "transmission", {"gap": "wide"}, 1), "must be a finite number, 0 to 0.5 rad, got 'wide'"),
        (("backlash", "transmission", {}, 1), "backlash.gap: is missing, 0 to 0.5 rad"),
        (("backlash", "transmission", {"gap": 0.1, "width": 1.0}, 1), "backlash.width: unknown key; choose from gap"),
    ],
)
def test_invalid_effects_are_refused_with_key_value_and_range(arguments, message):
    with pytest.raises(ParameterError, match=message):
        Effect(*arguments)


def test_effects_that_do_not_fit_the_joint_are_refused():
    gain = Effect("torque_gain", "motor", {"gain": 0.9}, 1)
    with pytest.raises(ParameterError, match="has servos, which impose the angle"):
        JointPlant.from_device(load_device("maccepavd")).with_effects([gain])
    with pytest.raises(ParameterError, match="has 0 motors"):
        JointPlant.from_device(rigid()).with_effects([Effect("coulomb_friction", "motor", {"torque": 0.1}, 1)])
    with pytest.raises(ParameterError, match="has no torque sensor at the link"):
        JointPlant.from_device(rigid()).with_effects([Effect("torque_gain", "sensor", {"gain": 0.9})])
    with pytest.raises(ParameterError, match="has 1 transmissions"):
        JointPlant.from_device(flexible()).with_effects([Effect("backlash", "transmission", {"gap": 0.1}, 2)])
    with pytest.raises(ParameterError, match="occurs twice"):
        JointPlant.from_device(flexible()).with_effects([gain, gain])
    with pytest.raises(ParameterError, match="joint is 'other'"):
        JointPlant.from_device(flexible()).with_effects([Effect("torque_gain", "motor", {"gain": 1.0}, 1, "other")])


@pytest.mark.parametrize("joint", JOINTS, ids=lambda joint: f"{joint.arrangement}-{joint.drive}")
def test_effect_at_both_motors_equals_one_at_each(joint):
    nominal, found = JointPlant.from_device(joint), 0
    for name in EFFECTS:
        for site in {site for site, motor in places(name, joint) if site in ("motor", "transmission") and motor == 0}:
            both = Effect(name, site, SIZES[name], 0)
            each = [Effect(name, site, SIZES[name], motor) for motor in (1, 2)]
            assert np.array_equal(nominal.with_effects([both]).parameters, nominal.with_effects(each).parameters)
            assert parse_effects(effects_text([both]), "x") == (both,)
            found += 1
    assert found == {"antagonistic": 14 + 8, "serial": 1, "rigid": 0}[joint.arrangement]


def test_effects_at_both_motors_and_at_one_add_up_or_conflict():
    plant = JointPlant.from_device(antagonistic())
    friction = [
        Effect("coulomb_friction", "motor", {"torque": torque}, motor) for torque, motor in ((0.1, 0), (0.2, 2))
    ]
    row = plant.with_effects(friction).parameters
    assert row[P.kinetic_friction : P.kinetic_friction + 3] == pytest.approx([0.0, 0.1, 0.3])
    gains = [Effect("torque_gain", "motor", {"gain": 0.9}, motor) for motor in (0, 2)]
    with pytest.raises(ParameterError, match="torque_gain at motor 2: occurs twice"):
        plant.with_effects(gains)
    with pytest.raises(ParameterError, match="torque_gain at both motors: occurs twice"):
        plant.with_effects(gains[::-1])
    with pytest.raises(ParameterError, match="torque_gain at both motors: 'joint' does not have two motors"):
        JointPlant.from_device(flexible()).with_effects(gains[:1])
    slack = Effect("backlash", "transmission", {"gap": 0.1})
    with pytest.raises(ParameterError, match="backlash at both transmissions: 'joint' does not have two transmissions"):
        JointPlant.from_device(serial_servo()).with_effects([slack])


def test_omitted_harmonics_are_neutral():
    """An effect with one harmonic equals one with neutral further harmonics of default orders 2, 3, ..."""
    for name, site in (("torque_ripple", "motor"), ("encoder_eccentricity", "sensor")):
        kind, plant = EFFECTS[name], JointPlant.from_device(flexible())
        short = Effect(name, site, SIZES[name], 1)
        assert short.parameters.keys() == SIZES[name].keys()
        full = Effect(name, site, {p.name: p.neutral for p in kind.optional} | SIZES[name], 1)
        rows = [plant.with_effects([effect]).parameters for effect in (short, full)]
        assert np.array_equal(*rows)
        third = plant.with_effects(
            [Effect(name, site, {"amplitude": 0.0, "phase": 0.0, "order": 1.0, "amplitude_3": 0.1}, 1)]
        )
        changed = np.flatnonzero(third.parameters != plant.parameters)
        amplitude, order = (
            (P.ripple_amplitude, P.ripple_order) if site == "motor" else (P.eccentricity, P.eccentricity_order)
        )
        assert {amplitude + 7, order + 7} <= set(changed)
        assert (third.parameters[amplitude + 7], third.parameters[order + 7]) == (0.1, 3.0)
    with pytest.raises(ParameterError, match="amplitude_9: unknown key"):
        Effect("torque_ripple", "motor", SIZES["torque_ripple"] | {"amplitude_9": 0.1}, 1)
    with pytest.raises(ParameterError, match=r"torque_ripple\.order: is missing"):
        Effect("torque_ripple", "motor", {"amplitude": 0.1, "phase": 0.0, "order_2": 3.0}, 1)


@st.composite
def effects(draw):
    kind = draw(st.sampled_from(list(EFFECTS.values())))
    site = draw(st.sampled_from(kind.sites))
    numbered = site in ("motor", "transmission", "sensor", "timing")
    motor = draw(st.sampled_from((0, 1, 2))) if numbered else 0
    given = (*kind.parameters, *(p for p in kind.optional if draw(st.booleans())))
    values = {p.name: draw(st.floats(p.low, p.high)) for p in given}
    return Effect(kind.name, site, values, motor, draw(st.sampled_from(["", "joint"])))


@settings(max_examples=50, deadline=None)
@given(st.lists(effects(), max_size=6))
def test_effects_files_round_trip(tmp_path_factory, chosen):
    file = tmp_path_factory.mktemp("effects") / "effects.yaml"
    save_effects(file, chosen)
    assert load_effects(file) == tuple(chosen)


def test_factors_on_device_numbers_apply_before_effects():
    """The order in the list does not matter; intervals are ignored."""
    numbers = Effect("device_numbers", "device", {"link viscous friction": 2.0, "spring 1 torque": 0.5})
    added = Effect("viscous_friction", "link", {"coefficient": 0.01})
    nominal = JointPlant.from_device(flexible()).parameters
    text = effects_text([added, numbers], [{"coefficient": (0.009, 0.011)}])
    assert "intervals:\n    coefficient:\n    - 0.009\n    - 0.011\n" in text
    row = JointPlant.from_device(flexible()).with_effects(parse_effects(text, "x")).parameters
    assert row[P.viscous_friction] == pytest.approx(2.0 * nominal[P.viscous_friction] + 0.01)
    spring = slice(P.spring, P.spring + N_COEFFICIENTS)
    assert np.any(nominal[spring]) and row[spring] == pytest.approx(0.5 * nominal[spring])
    changed = np.flatnonzero(row != nominal)
    assert {int(k) for k in changed} <= {P.viscous_friction, *range(spring.start, spring.stop)}


def test_factor_on_an_unknown_device_number_is_refused():
    other = Effect("device_numbers", "device", {"motor 2 inertia": 1.1})
    with pytest.raises(
        ParameterError, match="'motor 2 inertia' is not a number of this joint; choose from link inertia, link"
    ):
        JointPlant.from_device(flexible()).with_effects([other])
    for name, value, message in (("colour", 1.0, "unknown key"), ("link inertia", 0.0, "must be 0.1 to 10 -")):
        with pytest.raises(ParameterError, match=message):
            Effect("device_numbers", "device", {name: value})


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{effect: backlash}", "test.yaml: an effects file is a list of effects, got dict"),
        ("- 3", "test.yaml: entry 1: must be a mapping"),
        (
            "- {effect: backlash, site: transmission, motor: 1, parameters: {gap: 2.0}}",
            "entry 1: backlash.gap: must be 0 to",
        ),
        ("- {effect: backlash, site: transmission, motor: 1, gap: 0.1}", "entry 1: gap: unknown key"),
        ("- {site: link}", "entry 1: effect: must be actuator_delay, .* or viscous_friction, got None"),
        ("- {effect: coulomb_friction}", "entry 1: site: must be motor or link, got None"),
        ("- {effect: none, site: 1}", "entry 1: site: must be a site of the effect, got 1"),
        (
            "- {effect: backlash, site: transmission, motor: one, parameters: {gap: 0.1}}",
            "motor: must be 1, 2 or 0 .both., got 'one'",
        ),
        ("- {effect: backlash, site: transmission, parameters: {gap: 0.1}}", "entry 1: motor: is missing at site 'tra"),
        ("- {effect: [", "test.yaml: line"),
        ("- {effect: backlash, site: transmission, motor: 1, parameters: {gap: wide}}", "must be a finite number"),
    ],
)
def test_invalid_effects_files_give_one_line_errors(text, message):
    with pytest.raises(ParameterError, match=message) as caught:
        parse_effects(text, "test.yaml")
    assert "\n" not in str(caught.value)


def test_missing_file_and_empty_file(tmp_path):
    with pytest.raises(ParameterError, match=r"nowhere\.yaml: cannot be read"):
        load_effects(tmp_path / "nowhere.yaml")
    with pytest.raises(ParameterError, match="cannot be written"):
        save_effects(tmp_path / "no" / "folder.yaml", [])
    (tmp_path / "empty.yaml").write_text("")
    assert load_effects(tmp_path / "empty.yaml") == ()
    assert parse_effects("- {effect: torque_gain, site: motor, motor: 1, parameters: {gain: 1e-1}}", "x")[
        0
    ].parameters == {"gain": 0.1}
