"""simulate, Simulator and runs in lockstep: equal results; sensors; invalid arguments."""

import re

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from sim_joints import antagonistic, device, flexible, rigid, servo_flexible
from sim_together import simulate_many
from via_core.devices import device_names, load_device
from via_core.errors import ParameterError
from via_core.signals import Signals
from via_sim.catalogue import EFFECTS
from via_sim.effects import Effect
from via_sim.joint.layout import N_COMMANDS
from via_sim.joint.measurements import MEASURED
from via_sim.plants import JointPlant
from via_sim.sensors import IDEAL, Sensors
from via_sim.simulate import InitialConditions, Simulator, command_rows, simulate

RATE = 1000.0
NOISY = Sensors(1e-4, 2e-4, 1e-4, 1e-4, velocity_noise=0.1, torque_noise=0.05, link_torque_noise=0.02)
ALL = (
    Effect("coulomb_friction", "link", {"torque": 0.05}),
    Effect("stribeck_friction", "motor", {"breakaway": 0.2, "kinetic": 0.1, "velocity": 0.1}, 1),
    Effect("backlash", "transmission", {"gap": 0.02}, 2),
    Effect("actuator_delay", "command", {"delay": 0.0034}),
    Effect("torque_gain", "motor", {"gain": 0.9}, 2),
)


def torques(ticks: int) -> Signals:
    t = np.arange(ticks) / RATE
    motor = np.stack([2.0 * np.sin(7.0 * t), np.cos(11.0 * t)], axis=1)
    return Signals(t, {"motor": motor}, {"motor": "N m"}, frozenset({"motor"}))


@pytest.mark.parametrize("effects", [(), ALL])
def test_steps_give_the_bits_of_the_batch(effects):
    plant, commands = JointPlant.from_device(antagonistic()).with_effects(effects), torques(400)
    batch = simulate(plant, commands, 0.4, RATE, NOISY, InitialConditions(seed=7))
    simulator = Simulator(plant, RATE, NOISY)
    state = simulator.init(seed=7)
    measured = [simulator.sample(state)[0]]
    for row in command_rows(plant.device, commands, batch.truth.time[:-1]):
        state, sample, _ = simulator.step(state, row)
        measured.append(sample)
    stepped = dict(zip(MEASURED._fields, np.array(measured).T, strict=True))
    assert np.array_equal(batch.measured["q"], stepped["q"])
    assert np.array_equal(batch.measured["tau_link"], stepped["tau_link"])
    for i in (1, 2):
        assert np.array_equal(batch.measured["theta"][:, i - 1], stepped[f"theta_{i}"])
        assert np.array_equal(batch.measured["tau"][:, i - 1], stepped[f"tau_{i}"])


def test_runs_in_lockstep_equal_single_runs():
    nominal = JointPlant.from_device(antagonistic())
    plants = [nominal, nominal.with_effects(ALL), nominal.with_effects(ALL[:1]), nominal.with_effects(ALL[2:])]
    rows = command_rows(nominal.device, torques(300), np.arange(300) / RATE)
    together = simulate_many(plants, rows, RATE)
    for plant, motion in zip(plants, together, strict=True):
        alone = simulate(plant, torques(300), 0.3, RATE).truth
        moved = np.column_stack([alone["q"], alone["theta"]])
        # Packs have an exponential of their own.
        curved = any(effect.name == "stribeck_friction" for effect in plant.effects)
        assert np.max(np.abs(motion[:, :3] - moved)) <= (1e-14 if curved else 0.0)


def test_step_does_not_change_its_argument():
    simulator = Simulator(JointPlant.from_device(antagonistic()), RATE, NOISY)
    state = simulator.init(seed=3)
    kept = state.copy()
    first = simulator.step(state, (1.0, 0.0, 0.0, 0.0))
    again = simulator.step(state, (1.0, 0.0, 0.0, 0.0))
    assert np.array_equal(state, kept)
    assert all(np.array_equal(a, b, equal_nan=True) for a, b in zip(first, again, strict=True))


def test_noise_has_its_standard_deviation_is_white_and_depends_on_the_seed():
    plant = JointPlant.from_device(flexible())
    sensors = Sensors(link_noise=2.0, motor_noise=3.0, velocity_noise=0.5, torque_noise=0.1)
    run = simulate(plant, None, 20.0, RATE, sensors, InitialConditions(seed=5))
    columns = {"q": 2.0, "theta": 3.0, "q_velocity": 0.5, "tau": 0.1}
    noises = [(run.measured[name].ravel(), sd) for name, sd in columns.items()]
    for noise, sd in noises:  # the joint rests at zero
        assert np.std(noise) == pytest.approx(sd, rel=0.03)
        assert abs(np.mean(noise)) < 4.0 * sd / np.sqrt(len(noise))
        assert abs(np.corrcoef(noise[1:], noise[:-1])[0, 1]) < 0.03
    assert abs(np.corrcoef(noises[0][0], noises[1][0])[0, 1]) < 0.03
    assert np.mean(np.abs(noises[0][0]) < 2.0) == pytest.approx(0.6827, abs=0.02)  # normal, not merely its variance
    same = simulate(plant, None, 0.1, RATE, sensors, InitialConditions(seed=5)).measured["q"]
    other = simulate(plant, None, 0.1, RATE, sensors, InitialConditions(seed=6)).measured["q"]
    assert np.array_equal(same, run.measured["q"][:101])
    assert not np.array_equal(same, other)


def test_noise_of_any_two_channels_ticks_and_seeds_is_independent():
    """Streams with a common counter would be shifted copies of one another."""
    plant, ticks = JointPlant.from_device(antagonistic()), 8000
    sensors = Sensors(link_noise=1.0, motor_noise=1.0, velocity_noise=1.0, torque_noise=1.0, link_torque_noise=1.0)
    streams = []
    for seed in (0, 1, 2, 32):
        run = simulate(plant, None, ticks / RATE, RATE, sensors, InitialConditions(seed=seed)).measured
        for name in ("q", "theta", "q_velocity", "theta_velocity", "tau", "tau_link"):
            streams.extend(run[name].reshape(ticks + 1, -1).T)  # the joint rests at zero: noise is all there is
    noise = np.array(streams)
    for lag in range(3):
        for moment in (noise, noise**2 - 1.0):
            correlation = moment[:, lag:] @ moment[:, : moment.shape[1] - lag].T / moment.shape[1]
            if lag == 0:
                np.fill_diagonal(correlation, 0.0)
            assert np.max(np.abs(correlation)) < 0.12


def test_quantisation_follows_noise():
    sensors = Sensors(link_quantum=0.5, motor_quantum=0.25, link_noise=0.3, motor_noise=0.2)
    run = simulate(JointPlant.from_device(antagonistic()), None, 0.5, RATE, sensors, InitialConditions(seed=2))
    for name, quantum in (("q", 0.5), ("theta", 0.25)):
        steps = run.measured[name] / quantum
        assert np.array_equal(steps, np.rint(steps))
        assert len(np.unique(steps)) > 2


def test_encoders_quantise_and_unmeasured_channels_are_nan():
    plant = JointPlant.from_device(antagonistic())
    run = simulate(plant, torques(200), 0.2, RATE, sensors=Sensors(link_quantum=0.01, motor_quantum=0.1))
    for name, quantum in (("q", 0.01), ("theta", 0.1)):
        steps = run.measured[name] / quantum
        assert np.allclose(steps, np.rint(steps), rtol=0, atol=1e-9)
        assert np.max(np.abs(run.measured[name] - run.truth[name])) <= 0.5 * quantum + 1e-12
    for name in ("q_velocity", "theta_velocity", "tau_link"):
        assert np.all(np.isnan(run.measured[name]))
    assert np.all(np.isfinite(run.measured["tau"]))
    servo = simulate(JointPlant.from_device(servo_flexible()), None, 0.01, RATE)
    assert np.all(np.isnan(servo.measured["tau"]))


def test_slow_sensor_keeps_every_nth_sample():
    plant = JointPlant.from_device(antagonistic())
    fast = simulate(plant, torques(100), 0.1, RATE, NOISY, InitialConditions(seed=1))
    slow = simulate(
        plant, torques(100), 0.1, RATE, Sensors(**{**vars(NOISY), "rate": 250.0}), InitialConditions(seed=1)
    )
    assert np.array_equal(slow.measured.time, fast.measured.time[::4])
    assert np.array_equal(slow.measured["q"], fast.measured["q"][::4])
    assert len(slow.truth) == len(fast.truth)
    with pytest.raises(ParameterError, match="must divide"):
        simulate(plant, None, 0.1, RATE, sensors=Sensors(rate=300.0))


def test_ideal_sensors_measure_the_true_motion():
    run = simulate(JointPlant.from_device(antagonistic()), torques(100), 0.1, RATE, sensors=IDEAL)
    for name in ("q", "theta", "q_velocity", "theta_velocity"):
        assert np.array_equal(run.measured[name], run.truth[name])
    assert np.array_equal(run.measured["tau"][1:], torques(100)["motor"])
    assert np.array_equal(run.measured["tau_link"], run.truth["transmission_torque"].sum(axis=1))


@pytest.mark.parametrize("name", device_names())
def test_every_shipped_device_simulates_and_matches_its_spring_laws(name):
    joint = load_device(name)
    t = np.arange(200) / RATE
    size = 0.3 if joint.drive == "servo" else 0.1
    command = np.full((200, joint.n_motors), size) * np.sin(20.0 * t)[:, None]
    held = Signals(t, {"motor": command}, {"motor": "N m"}) if joint.n_motors else None
    truth = simulate(JointPlant.from_device(joint), held, 0.2, RATE).truth
    assert all(np.all(np.isfinite(values)) for channel, values in truth.channels.items() if channel != "motor_torque")
    if joint.n_transmissions:
        assert np.allclose(truth["stiffness"], joint.stiffness(truth["q"], truth["theta"]), rtol=1e-12, atol=0)
        assert np.allclose(truth["deflection"][:, 0], truth["q"] - truth["theta"][:, 0], rtol=0, atol=0)


def test_torque_is_limited_by_the_motor():
    motor = "{inertia: 0.01, viscous_friction: 0.3, torque_limit: 0.7}"
    run = simulate(JointPlant.from_device(flexible(motor=motor)), None, 0.0, RATE)
    assert len(run.truth) == 1
    held = Signals(np.zeros(1), {"motor": np.array([[5.0]])}, {"motor": "N m"})
    run = simulate(JointPlant.from_device(flexible(motor=motor)), held, 0.1, RATE)
    assert np.all(run.truth["motor_torque"][1:] == 0.7)
    assert np.all(run.measured["tau"][1:] == 0.7)
    weak = [Effect("torque_gain", "motor", {"gain": 0.5}, 1)]  # the drive saturates, what is lost is lost behind it
    run = simulate(JointPlant.from_device(flexible(motor=motor)).with_effects(weak), held, 0.1, RATE)
    assert np.all(run.truth["motor_torque"][1:] == 0.35)


def test_equilibrium_and_preset_reach_the_servos():
    joint = load_device("maccepavd")
    units = {"equilibrium": "rad", "preset": "rad", "damping": "-"}
    held = Signals(np.zeros(1), {"equilibrium": [0.4], "preset": [0.9], "damping": [0.5]}, units, frozenset(units))
    truth = simulate(JointPlant.from_device(joint), held, 8.0, RATE).truth
    assert truth["theta"][-1] == pytest.approx([0.4, 0.9], abs=1e-9)
    assert truth["q"][-1] == pytest.approx(0.4, abs=1e-6)
    assert truth["damping"][-1] == float(joint.damping_of(0.5))


def finite_commands(**channels) -> Signals:
    units = dict.fromkeys(channels, "-")
    return Signals(np.zeros(1), {name: np.atleast_1d(value) for name, value in channels.items()}, units)


@pytest.mark.parametrize(
    ("joint", "commands", "message"),
    [
        (flexible(), finite_commands(speed=1.0), "no command channel 'speed'"),
        (flexible(), finite_commands(motor=np.nan), "command 'motor' is not finite at 0 s"),
        (flexible(), finite_commands(equilibrium=1.0), "has no position servos"),
        (servo_flexible(), finite_commands(preset=1.0), "no 'equilibrium'"),
        (servo_flexible(), finite_commands(motor=1.0, equilibrium=1.0), "give only one of them"),
        (antagonistic(), finite_commands(motor=1.0), "has 1 columns, 'joint' 2 motors"),
    ],
)
def test_commands_that_do_not_fit_are_refused(joint, commands, message):
    with pytest.raises(ParameterError, match=message):
        simulate(JointPlant.from_device(joint), commands, 0.1, RATE)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"rate": 0.0}, "rate must lie in (0, 1e+06] Hz, got 0.0"),
        ({"duration": -1.0}, "duration must be finite and >= 0 s, got -1.0"),
        ({"initial": InitialConditions((0.0, 1.0))}, "initial must be 6 finite numbers"),
        ({"initial": InitialConditions((0.0, 0.0, 0.0, np.inf, 0.0, 0.0))}, "initial must be 6 finite numbers"),
        ({"initial": InitialConditions(seed=-1)}, "seed must be 0 to"),
    ],
)
def test_misuse_is_refused(arguments, message):
    with pytest.raises(ParameterError, match=re.escape(message)):
        simulate(JointPlant.from_device(rigid()), None, **{"duration": 0.1, "rate": RATE, **arguments})


def test_overflow_raises():
    held = Signals(np.zeros(1), {"motor": np.array([[1e308, -1e308]])}, {"motor": "N m"})
    with pytest.raises(ParameterError, match="'joint' overflows at"):
        simulate(JointPlant.from_device(antagonistic()), held, 0.1, RATE)


def test_simulator_refuses_invalid_commands():
    simulator = Simulator(JointPlant.from_device(rigid()), RATE)
    for command in ((0.0, 0.0, 0.0), (0.0, np.nan, 0.0, 0.0), (0.0, 0.0, 0.0, np.inf)):
        with pytest.raises(ParameterError, match="4 or 6 finite numbers"):
            simulator.step(simulator.init(), command)


def test_sensors_refuse_negative_numbers():
    with pytest.raises(ParameterError, match=r"link_noise must be finite and >= 0, got -1\.0"):
        Sensors(link_noise=-1.0)


positive = st.floats(1e-4, 10.0)
# Their substeps are refused, their sums negative or their drag beyond all steps for most draws.
REFUSED = ("stribeck_friction", "viscous_friction", "asymmetric_viscous", "quadratic_drag", "link_inertia", "contact")


@settings(max_examples=60, deadline=None)
@given(
    inertias=st.tuples(positive, positive),
    viscous=st.tuples(st.floats(0.0, 100.0), st.floats(0.0, 100.0)),
    stiffness=st.floats(1e-3, 1e3),
    commands=st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=8),
    speeds=st.lists(st.floats(-50.0, 50.0), min_size=3, max_size=3),
    sizes=st.lists(st.floats(0.0, 1.0), min_size=53, max_size=53),
)
@example((1.0, 0.03125), (0.0, 0.0), 201.0, [0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 7e-98, *(49 * [0.0])])
def test_states_stay_finite_for_random_joints_effects_and_commands(
    inertias, viscous, stiffness, commands, speeds, sizes
):
    motor = f"{{inertia: {inertias[1]!r}, viscous_friction: {viscous[1]!r}}}"
    joint = device(
        "antagonistic",
        f"{{inertia: {inertias[0]!r}, viscous_friction: {viscous[0]!r}, gravity_torque: 1.0}}",
        f"motors: [{motor}, {motor}]\nsprings: [{{law: linear, stiffness: {stiffness!r}, max_deflection: 1.0}}, "
        f"{{law: sinh, k: 0.01, a: 7.0, max_deflection: 0.8}}]",
    )
    chosen, number = [], 0
    for kind in EFFECTS.values():
        if kind.name in REFUSED or kind.of_goal:  # of a goal: another drive's
            continue
        values = {}
        for parameter in kind.parameters:
            low, high = max(parameter.low, -5.0), min(parameter.high, 5.0)
            values[parameter.name] = low + sizes[number % len(sizes)] * (high - low)
            number += 1
        if kind.name == "external_torque":
            values["stop"] += values["start"]
        if kind.name == "coulomb_friction":  # less than none is refused
            values["torque"] = abs(values["torque"])
        if kind.name == "gear_error":  # steeper ones are refused
            values["amplitude"] /= 1.0 + values["order"]
        chosen.append(Effect(kind.name, kind.sites[0], values, 1 if kind.sites[0] in ("motor", "transmission") else 0))
    rows = np.zeros((len(commands), N_COMMANDS))
    rows[:, 0] = commands
    plant = JointPlant.from_device(joint).with_effects(chosen)
    motion = simulate_many([plant], rows, RATE, (0.0, 0.0, 0.0, *speeds))
    assert np.all(np.isfinite(motion))
