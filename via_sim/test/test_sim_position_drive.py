"""Position drives on rigid joints: closed forms, limits, delay, drive off, both kernels."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from sim_joints import MORE, SIZES, positioned
from sim_position_drives import EFFECT_SETS, GRAVITY, KD, KP, PLACES, RATE, SERVOS, M, goals, wave
from sim_together import simulate_rows
from via_core.errors import ParameterError
from via_core.signals import Signals
from via_sim.effects import Effect
from via_sim.effects.device_numbers import numbers_of
from via_sim.joint.kernel import run
from via_sim.joint.layout import GOAL, POWER, X
from via_sim.joint.measurements import MEASURED, TRUTH
from via_sim.joint.parameters import P
from via_sim.plants import JointPlant
from via_sim.sensors import IDEAL
from via_sim.simulate import InitialConditions, Simulator, command_rows, initial_state, simulate


def step(device, duration: float = 1.0, goal: float = 1.0, effects=()):
    return simulate(JointPlant.from_device(device).with_effects(effects), goals([goal]), duration, RATE).truth


def test_step_response_is_that_of_a_second_order_system() -> None:
    truth = step(positioned())
    a, w = 0.5 * KD / M, np.sqrt(KP / M - (0.5 * KD / M) ** 2)
    t = truth.time
    expected = 1.0 - np.exp(-a * t) * (np.cos(w * t) + a / w * np.sin(w * t))
    assert np.max(np.abs(truth["q"] - expected)) < 1e-6


def test_friction_and_gravity_act_on_the_link() -> None:
    q = step(positioned(f"{{inertia: {M}, viscous_friction: 0.1, gravity_torque: 0.3}}"), 5.0)["q"][-1]
    assert KP * (1.0 - q) == pytest.approx(0.3 * np.sin(q), abs=1e-9)


def test_torque_limit_bounds_kp_times_the_error() -> None:
    """A constant torque against kd: v = limit/kd (1 - exp(-kd t/M)) while the error is large."""
    truth = step(positioned(servo="{kp: 4.0, kd: 0.1, torque_limit: 0.5}"), 0.1, goal=3.0)
    expected = 5.0 * (1.0 - np.exp(-KD / M * truth.time))
    assert np.max(np.abs(truth["q_velocity"] - expected)) < 1e-9
    limited = step(positioned(), 0.1, goal=3.0, effects=[Effect("torque_saturation", "motor", {"limit": 0.5}, 1)])
    assert np.array_equal(truth["q"], limited["q"])


@pytest.mark.parametrize("gain", [1.0, 0.7])
def test_the_limit_includes_the_damping_if_the_device_says_so(gain: float) -> None:
    """As MuJoCo's forcerange; a wrong gain scales what the limit leaves."""
    servo = "{kp: 4.0, kd: 0.1, torque_limit: 0.5, limited: sum}"
    effects = [Effect("torque_gain", "motor", {"gain": gain}, 1)] if gain != 1.0 else []
    device = positioned(servo=servo)
    truth = step(device, 1.0, goal=1.0, effects=effects)

    def rate(_t, x):
        return x[1], gain * np.clip(KP * (1.0 - x[0]) - KD * x[1], -0.5, 0.5) / M

    found = solve_ivp(rate, (0.0, 1.0), np.zeros(2), t_eval=truth.time, rtol=1e-10, atol=1e-12, max_step=1e-3).y
    assert np.max(np.abs(truth["q"] - found[0])) < 2e-5
    drive = device.servo.torque(1.0 - found[0], found[1])
    assert np.max(np.abs(drive)) == 0.5 and np.mean(np.abs(drive) == 0.5) > 0.1
    free = step(positioned(servo="{kp: 4.0, kd: 0.1, torque_limit: 0.5}"), 1.0, goal=1.0, effects=effects)
    assert np.max(np.abs(truth["q"] - free["q"])) > 0.1


@pytest.mark.parametrize("limited", ["proportional", "sum"])
def test_a_dead_zone_takes_torque_from_what_the_drive_computes(limited: str) -> None:
    """Damping by the motor itself passes in full, damping that a controller computes passes the dead zone."""
    device, width = positioned(servo=f"{{kp: 4.0, kd: 0.1, torque_limit: 1.5, limited: {limited}}}"), 0.3
    truth = step(device, 1.0, goal=1.0, effects=[Effect("dead_zone", "motor", {"width": width}, 1)])

    def rate(_t, x):
        inside = KD * x[1] if limited == "sum" else 0.0
        asked = np.clip(KP * (1.0 - x[0]) - inside, -1.5, 1.5)
        return x[1], (np.sign(asked) * max(abs(asked) - width, 0.0) + inside - KD * x[1]) / M

    found = solve_ivp(rate, (0.0, 1.0), np.zeros(2), t_eval=truth.time, rtol=1e-10, atol=1e-12, max_step=1e-3).y[0]
    assert np.max(np.abs(truth["q"] - found)) < 2e-5
    assert abs(truth["q"][-1] - 1.0) > 0.01, "it rests beside its goal"


@pytest.mark.parametrize("lag", [0.0, 0.05])
def test_goal_speed_is_limited_before_the_lag(lag: float) -> None:
    """Against independent equations integrated with tight tolerances."""
    effects = [Effect("actuator_lag", "command", {"time_constant": lag})] if lag else []
    truth = step(positioned(servo="{kp: 4.0, kd: 0.1, speed_limit: 2.0}"), 1.0, effects=effects)

    def rate(t, x):
        asked = min(2.0 * t, 1.0)
        goal = x[2] if lag else asked
        return x[1], (KP * (goal - x[0]) - KD * x[1]) / M, (asked - x[2]) / lag if lag else 0.0

    found = solve_ivp(rate, (0.0, 1.0), np.zeros(3), t_eval=truth.time, rtol=1e-10, atol=1e-12, max_step=0.01).y[0]
    assert np.max(np.abs(truth["q"] - found)) < 2e-6


def test_delay_of_the_goal_in_fractions_of_a_tick() -> None:
    prompt, late = step(positioned()), step(positioned(servo="{kp: 4.0, kd: 0.1, delay: 0.0105}"))
    assert np.all(late["q"][:11] == 0.0)
    between = np.interp(late.time[11:], prompt.time + 0.0105, prompt["q"])
    assert np.max(np.abs(late["q"][11:] - between)) < 5e-5  # of the interpolation: h^2/8 times 200 rad/s^2
    both = step(
        positioned(servo="{kp: 4.0, kd: 0.1, delay: 0.0065}"),
        effects=[Effect("actuator_delay", "command", {"delay": 0.004})],
    )
    assert np.max(np.abs(both["q"] - late["q"])) < 1e-12


def test_delays_longer_than_the_command_queue_are_refused() -> None:
    late = JointPlant.from_device(positioned(servo="{kp: 4.0, kd: 0.1, delay: 0.05}"))
    with pytest.raises(ParameterError, match=r"that of the drive is 0.11 s, must be <= 0.1"):
        late.with_effects([Effect("actuator_delay", "command", {"delay": 0.06})])


def test_drive_that_is_off_has_no_torque() -> None:
    """The pendulum falls as without a drive, until there is a goal again."""
    off = np.full(600, np.nan)
    plant, start = JointPlant.from_device(positioned(GRAVITY)), (1.5, 0, 0, 0, 0, 0)
    fallen = simulate(plant, goals(off), 0.6, RATE, initial=InitialConditions(start)).truth
    free = simulate(
        JointPlant.from_device(positioned(GRAVITY, "{kp: 1e-9, kd: 0.0}")),
        goals(off),
        0.6,
        RATE,
        initial=InitialConditions(start),
    ).truth
    assert np.array_equal(fallen["q"], free["q"])
    assert fallen["q"].min() < 0.2
    passive = simulate(plant, None, 0.6, RATE, initial=InitialConditions(start)).truth
    assert np.array_equal(fallen["q"], passive["q"])
    biased = simulate(
        plant.with_effects([Effect("torque_bias", "motor", {"torque": 0.2}, 1)]),
        goals(off),
        0.6,
        RATE,
        initial=InitialConditions(start),
    )
    assert np.array_equal(fallen["q"], biased.truth["q"])
    back = simulate(
        plant, goals(np.concatenate([off, np.full(6000, 0.5)])), 6.6, RATE, initial=InitialConditions(start)
    ).truth
    q = back["q"][-1]
    assert KP * (0.5 - q) == pytest.approx(0.3 * np.sin(q - 0.2), abs=1e-6)


def test_speed_limited_goal_starts_at_the_link_angle() -> None:
    slow = positioned(servo="{kp: 4.0, kd: 0.1, speed_limit: 1.0}")
    sent = goals(np.concatenate([np.full(100, np.nan), np.full(1000, 1.0)]))
    truth = simulate(
        JointPlant.from_device(slow), sent, 1.0, RATE, initial=InitialConditions((0.8, 0, 0, 0, 0, 0))
    ).truth
    assert np.all(truth["q"][:100] == 0.8)
    assert 0.0 < truth["q_velocity"].max() < 2.0  # the ramp from .8, and not a jump to 1 or a fall to 0
    assert truth["q"].min() == 0.8


def test_feedback_uses_the_encoder_of_the_drive() -> None:
    """With an encoder offset of 0.1 rad the link stops 0.1 rad before the goal."""
    device = positioned(f"{{inertia: {M}, viscous_friction: 0.1}}")
    found = simulate(
        JointPlant.from_device(device).with_effects([Effect("encoder_offset", "sensor", {"offset": 0.1})]),
        goals([1.0]),
        8.0,
        RATE,
    )
    assert found.truth["q"][-1] == pytest.approx(0.9, abs=1e-9)
    assert found.measured["q"][-1] == pytest.approx(1.0, abs=1e-9)


def test_locations_of_effects_on_a_position_drive() -> None:
    taken = {(name, site, motor) for name, site, motor in PLACES}
    for name in ("torque_gain", "torque_bias", "torque_ripple", "torque_saturation"):
        assert (name, "motor", 1) in taken
        assert (name, "sensor", 1) not in taken  # no torque is measured
    for name in ("coulomb_friction", "stribeck_friction", "load_dependent_friction", "payload"):
        assert (name, "link", 0) in taken and (name, "motor", 1) not in taken
    for name, site in (("actuator_delay", "command"), ("actuator_lag", "command"), ("encoder_offset", "sensor")):
        assert (name, site, 0) in taken
    assert ("channel_skew", "timing", 0) in taken and ("encoder_eccentricity", "sensor", 0) in taken


def test_gains_are_device_numbers() -> None:
    row = JointPlant.from_device(positioned(servo="{kp: 4.0, kd: 0.1, torque_limit: 0.7}")).parameters
    named = {each.name: (each.value, each.unit) for each in numbers_of(row)}
    assert named["servo kp"] == (4.0, "N m/rad")
    assert named["servo kd"] == (0.1, "N m s/rad")
    assert named["servo torque limit"] == (0.7, "N m")
    assert "servo torque limit" not in {
        each.name for each in numbers_of(JointPlant.from_device(positioned()).parameters)
    }
    scaled = JointPlant.from_device(positioned()).with_effects([Effect("device_numbers", "device", {"servo kp": 1.1})])
    assert scaled.parameters[P.drive_stiffness] == pytest.approx(4.4)


@pytest.mark.parametrize("servo", SERVOS)
def test_lockstep_equals_the_scalar_kernel(servo: str) -> None:
    """Every effect in its own lane; the drive is switched off and on again."""
    device = positioned(GRAVITY, servo)
    nominal = JointPlant.from_device(device)
    plants = [nominal, *map(nominal.with_effects, EFFECT_SETS)]
    values = wave(500)
    values[200:260] = np.nan
    sent = command_rows(device, goals(values, neighbour=np.cos(0.003 * np.arange(500))), np.arange(500) / RATE)
    rows = np.stack([plant.at_rate(RATE) for plant in plants])
    rows[:, P.substeps] = rows[:, P.substeps].max()
    states = np.stack([initial_state(plant, RATE, (0.1, 0, 0, 0.5, 0, 0), 0) for plant in plants])
    own = states.copy()
    together = simulate_rows(rows, states, sent)
    for k, plant in enumerate(plants):
        measured, truth = np.empty((501, 9)), np.empty((501, 16))
        run(rows[k], IDEAL.row(), own[k], sent, measured, truth)
        if "encoder_quantisation" not in [effect.name for effect in plant.effects]:
            assert np.max(np.abs(together[k, :, 0] - measured[:, MEASURED.q])) < 1e-9, plant.effects
            assert np.max(np.abs(together[k, :, 3] - measured[:, MEASURED.q_velocity])) < 1e-9, plant.effects
        assert np.max(np.abs(states[k] - own[k])) < 1e-9, plant.effects


def test_steps_give_the_bits_of_the_batch() -> None:
    device = positioned(GRAVITY, SERVOS[1])
    plant = JointPlant.from_device(device).with_effects([Effect("actuator_lag", "command", {"time_constant": 0.01})])
    values = wave(300)
    values[100:150] = np.nan
    batch = simulate(plant, goals(values), 0.3, RATE).truth
    simulator = Simulator(plant, RATE)
    state = simulator.init()
    for k, row in enumerate(command_rows(device, goals(values), np.arange(300) / RATE)):
        state, _, truth = simulator.step(state, row)
        assert truth[TRUTH.q] == batch["q"][k + 1]
    assert state[X.behind] != 0.0 or state[X.lag] != 0.0


def test_commands_of_a_position_drive() -> None:
    device = positioned()
    rows = command_rows(device, goals([0.5, np.nan], preset=np.array([np.nan, 0.0])), np.arange(2) / RATE)
    assert np.array_equal(rows[:, [GOAL, POWER]], [[0.5, 1.0], [0.0, 0.0]])
    with pytest.raises(ParameterError, match="'equilibrium' is not finite"):
        command_rows(device, goals([np.inf]), np.zeros(1))
    with pytest.raises(ParameterError, match="'joint' 0 motors"):
        command_rows(device, Signals(np.zeros(1), {"motor": np.ones((1, 1))}, {"motor": "-"}), np.zeros(1))


def test_derivative_includes_the_drive() -> None:
    plant = JointPlant.from_device(positioned())
    on = plant.derivative((0.2, 0, 0, 0.5, 0, 0), (1.0, 1.0, 0.0, 0.1))
    assert on[3] == pytest.approx((KP * 0.8 - KD * 0.5 + 0.1) / M)
    off = plant.derivative((0.2, 0, 0, 0.5, 0, 0), (1.0, 0.0, 0.0, 0.1))
    assert off[3] == pytest.approx(0.1 / M)


def gear_friction(load, counter, speed):
    """Friction [N m] of BOTH_SIDES by its formula."""
    e = MORE["load_dependent_friction"]
    least = np.where(load * counter < 0.0, np.minimum(np.abs(load), np.abs(counter)), 0.0)
    standing = np.abs(e["stribeck"] * load - e["counter_stribeck"] * counter) + e["quadratic"] * least**2
    sliding = np.abs(e["coefficient"] * load - e["counter_coefficient"] * counter)
    return sliding + np.exp(-((speed / e["velocity"]) ** 2)) * standing


GEAR = Effect("load_dependent_friction", "link", MORE["load_dependent_friction"])


@pytest.mark.parametrize("speed", [-0.9, 0.2, 2.0])
@pytest.mark.parametrize(("goal", "push"), [(0.5, 0.1), (-0.3, 0.1), (0.45, -0.6), (np.nan, 0.3)])
def test_gear_load_is_the_drive_torque_with_damping(goal, push, speed) -> None:
    """Load: drive torque with damping, zero while off; counter torque: gravity and external torque."""
    plant = JointPlant.from_device(positioned(GRAVITY)).with_effects([GEAR])
    on, q = float(np.isfinite(goal)), 0.4
    rate = plant.derivative((q, 0, 0, speed, 0, 0), (np.nan_to_num(goal), on, 0.0, push))[3]
    load = KP * (goal - q) - KD * speed if on else 0.0
    counter = push - 0.3 * np.sin(q - 0.2)
    friction = np.sign(speed) * gear_friction(load, counter, speed)
    assert M * rate == pytest.approx(load + counter - 0.02 * speed - friction, abs=1e-12)


def test_clutch_sensor_measures_load_friction() -> None:
    plant = JointPlant.from_device(positioned(GRAVITY)).with_effects([GEAR])
    sent = goals(wave(600), arm_torque=0.2 * np.cos(0.013 * np.arange(600)))
    run_ = simulate(plant, sent, 0.6, RATE)
    q, v, read = run_.truth["q"][1:], run_.truth["q_velocity"][1:], run_.measured["tau_link"][1:]
    load = KP * (sent["equilibrium"] - q) - KD * v
    counter = sent["arm_torque"] - 0.3 * np.sin(q - 0.2)
    moving = v != 0.0
    assert moving.mean() > 0.7
    np.testing.assert_allclose(read[moving], (np.sign(v) * gear_friction(load, counter, v))[moving], atol=1e-12)


def test_feedback_uses_every_encoder_harmonic() -> None:
    wrong = Effect("encoder_eccentricity", "sensor", SIZES["encoder_eccentricity"] | MORE["encoder_eccentricity"])
    device = positioned(f"{{inertia: {M}, viscous_friction: 0.1}}")
    found = simulate(JointPlant.from_device(device).with_effects([wrong]), goals([1.0]), 8.0, RATE)
    assert found.measured["q"][-1] == pytest.approx(1.0, abs=1e-9)
    q, e = found.truth["q"][-1], wrong.parameters
    error = e["amplitude"] * np.sin(e["order"] * q + e["phase"])
    error += e["amplitude_2"] * np.sin(e["order_2"] * q + e["phase_2"]) + e["amplitude_4"] * np.sin(e["order_4"] * q)
    assert abs(error) > 1e-3 and q + error == pytest.approx(1.0, abs=1e-9)


def test_ripple_of_a_drive_has_every_harmonic() -> None:
    """The ripple of the motor acts while the drive is off: its cause is the magnets and not the current."""
    more = SIZES["torque_ripple"] | MORE["torque_ripple"]
    plant = JointPlant.from_device(positioned()).with_effects([Effect("torque_ripple", "motor", more, 1)])
    for power in (0.0, 1.0):
        rate = plant.derivative((0.4, 0, 0, 0, 0, 0), (0.4, power, 0.0, 0.0))[3]
        torque = sum(
            more[f"amplitude{k}"] * np.sin(more[f"order{k}"] * 0.4 + more[f"phase{k}"]) for k in ("", "_2", "_8")
        )
        assert M * rate == pytest.approx(torque, abs=1e-12)
