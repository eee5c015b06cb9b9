"""Each effect against independent equations integrated with small steps, and against closed forms."""

from math import exp, pi, sin

import numpy as np
import pytest
from scipy.optimize import brentq
from sim_joints import ENCODER_ERRORS, RIPPLES, SIZES, flexible, rigid, serial_servo, servo_flexible
from via_core.errors import ParameterError
from via_core.signals import Signals
from via_sim.effects import Effect
from via_sim.joint.encoders import read_motion, true_angle, true_motions
from via_sim.plants import JointPlant
from via_sim.simulate import InitialConditions, simulate

RATE = 1000.0
K, M, DQ, G, GA, B, DTH = 10.0, 0.02, 0.1, 0.3, 0.2, 0.01, 0.1
JOINT = flexible(
    K,
    f"{{inertia: {M}, viscous_friction: {DQ}, gravity_torque: {G}, gravity_angle: {GA}}}",
    f"{{inertia: {B}, viscous_friction: {DTH}}}",
)
TICKS = 600
TORQUE = [1.5 * sin(0.02 * n) + 0.5 * sin(0.047 * n) for n in range(TICKS)]  # [N m] held over each tick
NEIGHBOUR = [sin(0.005 * n) for n in range(TICKS)]  # [rad]
START = (0.1, -0.1, 0.0, 1.0, 0.5, 0.0)


def held(**channels) -> Signals:
    time = np.arange(len(next(iter(channels.values())))) / RATE
    return Signals(time, channels, dict.fromkeys(channels, "-"), frozenset(channels))


def sign(x):
    return (x > 0.0) - (x < 0.0)


def slow(name: str, site: str, e: dict, steps: int = 25) -> np.ndarray:
    """Angles (TICKS + 1, 2) of link and motor of JOINT with one effect, by independent equations and classical RK4."""

    def friction(v, load):
        if name == "asymmetric_viscous":
            return (e["forward"] if v > 0.0 else e["backward"]) * v
        if name == "quadratic_drag":
            return e["coefficient"] * v * abs(v)
        if name == "load_dependent_friction":
            return e["coefficient"] * abs(load) * sign(v)
        return 0.0

    def rate(x, t, u, n):
        q, th, v, w, y, dahl, maxwell = x
        phi, scale, hard = q - th - (e["offset"] if name == "preset_error" else 0.0), 1.0, 0.0
        if name == "spring_law":
            scale, hard = e["scale"], e["hardening"]
        if name == "stiffness_drift":
            scale = 1.0 + e["rate"] * t
        spring = scale * (1.0 + hard * phi**2) * K * phi
        torque, inertia, gravity, angle, link, motor = u, M, G, GA, 0.0, 0.0
        if name == "torque_saturation":
            torque = max(min(u, e["limit"]), -e["limit"])
        if name == "actuator_lag":
            torque = y
        if name == "torque_bias":
            torque = u + e["torque"]
        if name == "torque_ripple":
            torque = u + sum(
                e[f"amplitude{k}"] * sin(e[f"order{k}"] * th + e[f"phase{k}"])
                for k in ("", "_2", "_8")
                if f"amplitude{k}" in e
            )
        if name == "payload":
            inertia, gravity = M + e["mass"] * e["distance"] ** 2, G + e["mass"] * 9.80665 * e["distance"]
        if name == "link_inertia":
            inertia = M + e["inertia"]
        if name == "gravity_error":
            gravity, angle = G + e["torque"], GA + e["angle"]
        if name == "joint_coupling":
            link = e["stiffness"] * NEIGHBOUR[n]
            motor = -link if site == "transmission" else 0.0
        if name == "external_torque":
            link = e["torque"] if e["start"] <= t < e["stop"] else 0.0
        if name == "contact" and q > e["angle"]:
            link = -max(e["stiffness"] * (q - e["angle"]) + e["damping"] * v, 0.0)
        if name == "spring_damping":
            spring += e["coefficient"] * (v - w)
        f_link, f_motor = (friction(v, spring), 0.0) if site == "link" else (0.0, friction(w, spring))
        d_dahl = d_maxwell = 0.0
        if name == "presliding_friction":
            speed = v if site == "link" else w
            d_dahl = e["stiffness"] * (speed - abs(speed) * dahl / e["torque"])
            f_link, f_motor = (dahl, 0.0) if site == "link" else (0.0, dahl)
        if name == "hysteresis":
            free = abs(maxwell) < e["torque"] or maxwell * (v - w) < 0.0
            d_maxwell = e["stiffness"] * (v - w) if free else 0.0
            spring += maxwell
        a = (link - spring - gravity * sin(q - angle) - DQ * v - f_link) / inertia
        b = (torque + motor + spring - DTH * w - f_motor) / B
        lag = (u - y) / e["time_constant"] if name == "actuator_lag" else 0.0
        return np.array([v, w, a, b, lag, d_dahl, d_maxwell])

    x, out, h = np.array([*START[:2], *START[3:5], 0.0, 0.0, 0.0]), [START[:2]], 1.0 / RATE / steps
    for n, u in enumerate(TORQUE):
        for k in range(steps):
            t = n / RATE + k * h
            k1 = rate(x, t, u, n)
            k2 = rate(x + 0.5 * h * k1, t + 0.5 * h, u, n)
            k3 = rate(x + 0.5 * h * k2, t + 0.5 * h, u, n)
            x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + rate(x + h * k3, t + h * (1.0 - 1e-9), u, n))
        out.append(x[:2])
    return np.array(out)


SLOW = [
    ("asymmetric_viscous", "link", 0, {}),
    ("asymmetric_viscous", "motor", 1, {}),
    ("quadratic_drag", "link", 0, {}),
    ("quadratic_drag", "motor", 1, {}),
    ("presliding_friction", "link", 0, {}),
    ("presliding_friction", "motor", 1, {}),
    ("hysteresis", "transmission", 1, {}),
    ("spring_damping", "transmission", 1, {}),
    ("spring_law", "transmission", 1, {}),
    ("spring_law", "transmission", 1, {"hardening": -4.0}),  # which pushes where it is deflected by more than 0.5 rad
    ("stiffness_drift", "transmission", 1, {}),
    ("preset_error", "transmission", 1, {}),
    ("joint_coupling", "transmission", 1, {}),
    ("joint_coupling", "link", 0, {}),
    ("torque_bias", "motor", 1, {}),
    ("torque_ripple", "motor", 1, {}),
    ("torque_ripple", "motor", 1, RIPPLES),
    ("torque_saturation", "motor", 1, {}),
    ("actuator_lag", "command", 0, {}),
    ("payload", "link", 0, {}),
    ("link_inertia", "link", 0, {}),
    ("gravity_error", "link", 0, {}),
    ("contact", "environment", 0, {}),
    ("external_torque", "environment", 0, {"start": 0.1, "stop": 0.3}),
]


@pytest.mark.parametrize(("name", "site", "motor", "other"), SLOW, ids=lambda value: str(value))
def test_effect_matches_its_equation(name, site, motor, other):
    values = SIZES[name] | other
    plant, sent = JointPlant.from_device(JOINT), held(motor=np.array(TORQUE)[:, None], neighbour=np.array(NEIGHBOUR))
    run = simulate(
        plant.with_effects([Effect(name, site, values, motor)]),
        sent,
        TICKS / RATE,
        RATE,
        initial=InitialConditions(START),
    ).truth
    nominal = simulate(plant, sent, TICKS / RATE, RATE, initial=InitialConditions(START)).truth
    reference = slow(name, site, values, 100 if name == "hysteresis" else 25)  # its elements switch at corners
    error = np.column_stack([run["q"], run["theta"]]) - reference
    assert np.max(np.abs(nominal["q"] - reference[:, 0])) > 1e-3
    assert np.max(np.abs(error)) < 2e-5


def test_spring_softened_to_zero_is_slack_beyond_its_stop():
    """Released where the spring pushes outwards, a joint without friction coasts beyond the stop."""
    softened = Effect("spring_law", "transmission", {"scale": 1.0, "hardening": -0.5}, 1)
    plant = JointPlant.from_device(servo_flexible(K, f"{{inertia: {M}, viscous_friction: 0.0}}")).with_effects(
        [softened]
    )
    stop = plant.device.springs[0].max_deflection
    run = simulate(plant, None, 0.3, 8000.0, initial=InitialConditions((1.6, 0, 0, 0, 0, 0))).truth
    beyond = run["q"] > stop
    pushed = np.sqrt(K / M * (0.5 * 0.5 * (stop**4 - 1.6**4) - (stop**2 - 1.6**2)))
    assert beyond.any() and run["q_velocity"][beyond] == pytest.approx(pushed, rel=0.01)  # a step goes over the end


def test_load_dependent_friction_reduces_the_acceleration_of_a_rigid_joint():
    """Friction of 0.2 times the drive torque leaves four fifths of the acceleration."""
    plant = JointPlant.from_device(rigid()).with_effects(
        [Effect("load_dependent_friction", "link", {"coefficient": 0.2})]
    )
    for torque in (1e-3, 1.0):
        q = simulate(plant, held(external_torque=np.full(100, torque)), 0.1, RATE).truth["q"]
        assert q[-1] == pytest.approx(0.5 * 0.8 * torque / 0.02 * 0.1**2, rel=1e-9)


def test_load_dependent_friction_slows_a_link_on_its_spring():
    """The spring torque is the load: with a coefficient below 1 the link never sticks, but it slows down."""
    joint = servo_flexible(K, f"{{inertia: {M}, viscous_friction: 0.0}}")
    plant = JointPlant.from_device(joint).with_effects(
        [Effect("load_dependent_friction", "link", {"coefficient": 0.2})]
    )
    q = simulate(plant, None, 0.4, 4000.0, initial=InitialConditions((0.5, 0, 0, 0, 0, 0))).truth["q"]
    towards, away = np.sqrt(0.8 * K / M), np.sqrt(1.2 * K / M)
    quarter = 0.5 * pi / towards  # (1 - c) k pulls it to the middle
    speed = 0.5 * towards
    far = quarter + 0.5 * pi / away  # (1 + c) k beyond it
    assert q[round(quarter * 4000.0)] == pytest.approx(0.0, abs=speed / 4000.0)
    assert np.min(q) == pytest.approx(-speed / away, abs=1e-5)
    assert np.argmin(q) / 4000.0 == pytest.approx(far, abs=1e-3)


def test_asymmetric_coulomb_friction_has_two_breakaway_torques():
    effect = Effect("asymmetric_coulomb", "link", {"forward": 0.3, "backward": 0.1})
    plant = JointPlant.from_device(rigid()).with_effects([effect])
    for torque, holds in ((0.3, True), (0.301, False), (-0.1, True), (-0.101, False)):
        q = simulate(plant, held(external_torque=np.full(100, torque)), 0.1, RATE).truth["q"]
        assert bool(np.all(q == 0.0)) is holds
    fast = simulate(plant, None, 0.05, RATE, initial=InitialConditions((0, 0, 0, 2.0, 0, 0))).truth["q_velocity"]
    assert fast[-1] == pytest.approx(2.0 - 0.3 / 0.02 * 0.05, abs=1e-9)
    back = simulate(plant, None, 0.05, RATE, initial=InitialConditions((0, 0, 0, -2.0, 0, 0))).truth["q_velocity"]
    assert back[-1] == pytest.approx(-2.0 + 0.1 / 0.02 * 0.05, abs=1e-9)


def test_asymmetric_friction_is_a_symmetric_one_beside_a_constant_torque():
    torques = held(external_torque=1.2 * np.sin(0.01 * np.arange(2000)))
    asymmetric = Effect("asymmetric_coulomb", "link", {"forward": 0.1, "backward": 0.3})
    alias = Effect("coulomb_friction", "link", {"torque": 0.2}), Effect("torque_bias", "motor", {"torque": 0.1}, 1)
    one, two = (
        simulate(JointPlant.from_device(rigid()).with_effects(effects), torques, 2.0, RATE).truth["q"]
        for effects in ((asymmetric,), alias)
    )
    assert np.ptp(one) > 0.3 and np.any(np.diff(one) == 0.0), "it moves and rests"
    assert one == pytest.approx(two, abs=1e-12)


def test_dahl_friction_stops_a_link_by_energy_and_pulls_it_back():
    """1/2 M v^2 = integral of F_c (1 - exp(-s x/F_c)) dx up to the turning point."""
    Fc, s, v = 0.1, 20.0, 0.8
    plant = JointPlant.from_device(rigid()).with_effects(
        [Effect("presliding_friction", "link", {"torque": Fc, "stiffness": s})]
    )
    q = simulate(plant, None, 0.5, 10_000.0, initial=InitialConditions((0, 0, 0, v, 0, 0))).truth["q"]
    turn = brentq(lambda x: Fc * x - Fc**2 / s * (1.0 - exp(-s * x / Fc)) - 0.5 * 0.02 * v**2, 0.0, 1.0)
    assert np.max(q) == pytest.approx(turn, abs=2e-7)
    assert q[np.argmax(q) : np.argmax(q) + 500].min() < turn - 0.2 * Fc / s  # elastic: it swings back


def test_maxwell_element_dissipates_the_area_of_its_loop():
    """Area 4 F (A - F/k) per cycle of deflection amplitude A; a servo swings against a nearly fixed link."""
    F, k, A = 0.2, 4.0, 0.3
    joint = servo_flexible(K, "{inertia: 1000.0, viscous_friction: 0.0}")
    effect = Effect("hysteresis", "transmission", {"torque": F, "stiffness": k}, 1)
    time = np.arange(round(8.0 * pi * RATE)) / RATE
    run = simulate(
        JointPlant.from_device(joint).with_effects([effect]), held(motor=A * np.sin(time)[:, None]), time[-1], RATE
    )
    phi, torque = run.truth["deflection"][:, 0], run.measured["tau_link"]
    cycle = slice(round(4.0 * pi * RATE), round(6.0 * pi * RATE) + 1)
    reach = 0.5 * np.ptp(phi[cycle])
    area = np.trapezoid(torque[cycle], phi[cycle])
    assert area == pytest.approx(4.0 * F * (reach - F / k), rel=1e-3)
    assert np.max(np.abs(torque - K * phi)) == pytest.approx(F, abs=1e-12)


def test_step_response_of_a_lag_matches_its_closed_form():
    T, u = 0.03, 0.5
    plant = JointPlant.from_device(rigid()).with_effects([Effect("actuator_lag", "command", {"time_constant": T})])
    truth = simulate(plant, held(external_torque=np.full(200, u)), 0.2, RATE).truth
    t = truth.time
    exact = u / 0.02 * (0.5 * t**2 - T * t + T**2 * (1.0 - np.exp(-t / T)))
    assert np.max(np.abs(truth["q"] - exact)) < 1e-9


@pytest.mark.parametrize("T", [1e-6, 1e-4, 4e-4])
def test_lag_much_shorter_than_a_tick_acts_as_dead_time(T):
    plant = JointPlant.from_device(rigid()).with_effects([Effect("actuator_lag", "command", {"time_constant": T})])
    q = simulate(plant, held(external_torque=np.full(200, 0.5)), 0.2, RATE).truth["q"]
    assert q[-1] == pytest.approx(0.5 / 0.02 * (0.5 * 0.2**2 - T * 0.2 + T**2), abs=6e-5)


def test_lag_of_a_servo_adds_to_its_time_constant():
    joint = servo_flexible()
    slower = Effect("actuator_lag", "command", {"time_constant": 0.05})
    run = simulate(
        JointPlant.from_device(joint).with_effects([slower]), held(motor=np.full((500, 1), 0.4)), 0.5, RATE
    ).truth
    w = 2.0 / (2.0 / 40.0 + 0.05)
    assert run["theta"][:, 0] == pytest.approx(0.4 * (1.0 - (1.0 + w * run.time) * np.exp(-w * run.time)), abs=1e-12)


@pytest.mark.parametrize("limit", [0.5, 2.0, 8.0])
def test_servo_speed_is_limited(limit):
    """Against Euler's method with microsecond steps; the command jumps in both directions, also at the speed limit."""
    effect = Effect("torque_saturation", "motor", {"limit": limit}, 1)
    asked = np.where(np.arange(400) < 150, 1.0, -0.5)
    asked[300:] = 0.3
    run = simulate(
        JointPlant.from_device(servo_flexible()).with_effects([effect]), held(motor=asked[:, None]), 0.4, RATE
    ).truth
    x = v = 0.0
    expected, w, h = [0.0], 40.0, 1e-5
    for u in asked:
        for _ in range(100):
            v = min(max(v + h * (w * w * (u - x) - 2.0 * w * v), -limit), limit)
            x += h * v
        expected.append(x)
    assert np.max(np.abs(run["theta_velocity"])) <= limit
    assert np.max(np.abs(run["theta"][:, 0] - expected)) < 1e-3
    assert np.max(np.abs(run["theta_velocity"])) == limit


@pytest.mark.parametrize("restitution", [False, True])
def test_impact_on_a_wall_matches_its_closed_form(restitution):
    """A free link hits a wall: half an oscillation, then release; a damped wall never pulls."""
    k, d, v = 50.0, 0.4 if restitution else 0.0, 1.0
    effect = Effect("contact", "environment", {"angle": -0.1, "stiffness": k, "damping": d, "side": -1.0})
    plant = JointPlant.from_device(rigid()).with_effects([effect])
    truth = simulate(plant, None, 0.3, RATE, initial=InitialConditions((0, 0, 0, -v, 0, 0))).truth
    a = d / (2.0 * 0.02)
    w = np.sqrt(k / 0.02 - a * a)
    depth = lambda t: v / w * np.exp(-a * t) * np.sin(w * t)  # noqa: E731
    speed = lambda t: v * np.exp(-a * t) * (np.cos(w * t) - a / w * np.sin(w * t))  # noqa: E731
    leaves = brentq(lambda t: k * depth(t) + d * speed(t), 1e-3, pi / w)  # from there on it would have to pull
    t = truth.time - 0.1
    inside = (t > 0.0) & (t < leaves)
    assert np.allclose(truth["q"][inside], -0.1 - depth(t[inside]), rtol=0, atol=2e-6)
    after = t > leaves + 2e-3
    assert np.allclose(truth["q_velocity"][after], -speed(leaves), rtol=0, atol=2e-3 if restitution else 1e-5)
    assert np.all(truth["q"][t < 0.0] > -0.1)


def test_pulse_between_ticks_has_the_correct_impulse():
    effect = Effect("external_torque", "environment", {"torque": 0.4, "start": 0.01234, "stop": 0.05678})
    plant = JointPlant.from_device(rigid()).with_effects([effect])
    v = simulate(plant, None, 0.1, RATE).truth["q_velocity"]
    assert np.all(v[:13] == 0.0)
    assert v[-1] == pytest.approx(0.4 * (0.05678 - 0.01234) / 0.02, rel=1e-12)
    late = simulate(plant, None, 0.1, RATE, initial=InitialConditions(age=0.05)).truth["q_velocity"]
    assert late[-1] == pytest.approx(0.4 * 0.00678 / 0.02, rel=1e-12)


def test_drift_depends_on_the_age_of_the_run():
    drift = Effect("stiffness_drift", "transmission", {"rate": 0.5}, 1)
    plant = JointPlant.from_device(servo_flexible()).with_effects([drift])
    assert simulate(plant, None, 0.0, RATE, initial=InitialConditions(age=2.0)).truth["stiffness"][0] == pytest.approx(
        2.0 * 10.0
    )
    assert simulate(plant, None, 1.0, RATE).truth["stiffness"][-1] == pytest.approx(1.5 * 10.0)


@pytest.mark.parametrize("late", [0.0037, 0.001, 0.0002, 0.05])
@pytest.mark.parametrize("rate", [200.0, 1000.0, 4000.0])
def test_late_channel_measures_the_past(late, rate):
    time = np.arange(round(0.4 * rate)) / rate
    sent = Signals(time, {"motor": np.sin(20.0 * time)[:, None]}, {"motor": "N m"}, frozenset({"motor"}))
    effect = Effect("channel_skew", "timing", {"delay": late}, 0)
    run = simulate(
        JointPlant.from_device(JOINT).with_effects([effect]),
        sent,
        0.4,
        rate,
        initial=InitialConditions((0.2, 0, 0, 0, 0, 0)),
    )
    fine = np.arange(0, round(0.4 * rate) * 20 + 1) / (20.0 * rate)
    dense = simulate(
        JointPlant.from_device(JOINT), sent, 0.4, 20.0 * rate, initial=InitialConditions((0.2, 0, 0, 0, 0, 0))
    ).truth["q"]
    expected = np.interp(np.maximum(run.truth.time - late, 0.0), fine, dense)
    assert np.max(np.abs(run.measured["q"] - expected)) < 2e-5
    assert np.array_equal(run.measured["theta"], run.truth["theta"])
    assert np.max(np.abs(run.measured["q"] - run.truth["q"])) > 1e-4


def test_encoder_errors_match_their_equations():
    sent = held(motor=np.sin(0.01 * np.arange(500))[:, None])
    effects = [
        Effect("encoder_offset", "sensor", {"offset": 0.1}, 0),
        Effect("encoder_eccentricity", "sensor", {"amplitude": 0.05, "phase": 0.3}, 0),
        Effect("encoder_quantisation", "sensor", {"quantum": 0.01}, 1),
    ]
    run = simulate(JointPlant.from_device(JOINT).with_effects(effects), sent, 0.5, RATE)
    q, theta = run.truth["q"], run.truth["theta"]
    assert np.allclose(run.measured["q"], q + 0.1 + 0.05 * np.sin(q + 0.3), rtol=0, atol=1e-15)
    assert np.allclose(run.measured["q_velocity"], run.truth["q_velocity"] * (1.0 + 0.05 * np.cos(q + 0.3)), atol=1e-14)
    assert np.allclose(run.measured["theta"], 0.01 * np.rint(theta / 0.01), rtol=0, atol=1e-15)
    nominal = simulate(JointPlant.from_device(JOINT), sent, 0.5, RATE).truth
    assert np.array_equal(q, nominal["q"])  # a sensor moves nothing


def test_encoder_error_has_several_orders():
    sent = held(motor=np.sin(0.01 * np.arange(500))[:, None])
    values = {"amplitude": 0.03, "phase": 0.7} | ENCODER_ERRORS
    run = simulate(
        JointPlant.from_device(JOINT).with_effects([Effect("encoder_eccentricity", "sensor", values, 1)]),
        sent,
        0.5,
        RATE,
    )
    theta, w = run.truth["theta"], run.truth["theta_velocity"]
    terms = ((0.03, 2.0, 0.7), (0.01, 7.5, 1.0), (0.005, 36.0, 0.0))
    error, slope = (sum(a * o**d * f(o * theta + c) for a, o, c in terms) for d, f in ((0, np.sin), (1, np.cos)))
    assert np.allclose(run.measured["theta"], theta + error, rtol=0, atol=1e-15)
    assert np.allclose(run.measured["theta_velocity"], w * (1.0 + slope), rtol=0, atol=1e-13)


@pytest.mark.parametrize(
    "values",
    [
        {"amplitude": 0.03, "phase": 0.7},
        {"amplitude": 0.03, "phase": 0.7} | ENCODER_ERRORS,
        {"amplitude": 0.45, "phase": 0.7, "order": 2.2},
        {
            "amplitude": 0.24,
            "phase": 0.3,
            "order": 2.0,
            "amplitude_2": 0.12,
            "order_2": 2.2,
            "amplitude_3": 2.4e-4,
            "order_3": 1e3,
        },
    ],
    ids=["one", "several", "steep", "steep sum"],
)
def test_true_angle_inverts_the_encoder_error(values):
    """Includes encoder errors with almost zero slope of the measured angle; the velocity likewise."""
    plant = JointPlant.from_device(JOINT).with_effects(
        [Effect("encoder_eccentricity", "sensor", values, 1), Effect("encoder_offset", "sensor", {"offset": 0.2}, 1)]
    )
    angle, velocity = np.linspace(-20.0, 20.0, 4001), np.linspace(-3.0, 5.0, 4001)
    row = plant.parameters.copy()
    read, speed = np.array([read_motion(row, 1, a, v) for a, v in zip(angle, velocity, strict=True)]).T
    assert np.all(np.diff(read) > 0.0)
    many = np.tile(row, (len(angle), 1))
    for found in (true_angle(row, 1, read), true_angle(many, 1, read), true_motions(many, 1, read, speed)[0]):
        assert np.max(np.abs(found - angle)) < 1e-11
    assert true_motions(row, 1, read, speed)[1] == pytest.approx(velocity, abs=1e-8)
    assert true_angle(row, 1, read[7]) == pytest.approx(angle[7], abs=1e-11)
    assert np.isnan(true_angle(row, 1, np.nan))
    assert np.array_equal(true_angle(row, 0, read), read)


def test_torque_sensor_errors_do_not_change_the_motion():
    sent = held(motor=np.sin(0.01 * np.arange(500))[:, None])
    effects = [Effect("torque_gain", "sensor", {"gain": 1.2}, 1), Effect("torque_bias", "sensor", {"torque": 0.05}, 1)]
    run = simulate(JointPlant.from_device(JOINT).with_effects(effects), sent, 0.5, RATE)
    assert np.allclose(run.measured["tau"][1:], 1.2 * sent["motor"] + 0.05, rtol=0, atol=1e-15)
    assert np.array_equal(run.truth["q"], simulate(JointPlant.from_device(JOINT), sent, 0.5, RATE).truth["q"])


def test_payload_on_an_upright_axis_adds_only_inertia():
    load = Effect("payload", "link", {"mass": 0.5, "distance": 0.2})
    more = Effect("link_inertia", "link", {"inertia": 0.5 * 0.2**2})
    plant, push = JointPlant.from_device(rigid()), held(external_torque=np.full(100, 0.1))
    one, other = (simulate(plant.with_effects([effect]), push, 0.1, RATE).truth["q"] for effect in (load, more))
    assert one == pytest.approx(other, abs=1e-15)


def test_preset_error_of_a_serial_joint_shifts_the_preset():
    plant = JointPlant.from_device(serial_servo())
    effect = Effect("preset_error", "transmission", {"offset": 0.2}, 1)
    start = (0.3, 0.0, 0.5, 0.0, 0.0, 0.0)
    off = simulate(plant.with_effects([effect]), None, 0.5, RATE, initial=InitialConditions(start)).truth["q"]
    moved = simulate(plant, None, 0.5, RATE, initial=InitialConditions((0.3, 0.0, 0.7, 0.0, 0.0, 0.0))).truth["q"]
    assert off == pytest.approx(moved, abs=1e-12)


@pytest.mark.parametrize(
    ("effect", "message"),
    [
        (Effect("link_inertia", "link", {"inertia": -0.02}), "leaves 0 kg m"),
        (
            Effect("contact", "environment", {"angle": 0.0, "stiffness": 1.0, "damping": 0.0, "side": 0.5}),
            "side must be",
        ),
        (Effect("external_torque", "environment", {"torque": 1.0, "start": 2.0, "stop": 1.0}), "must not be before"),
        (Effect("asymmetric_viscous", "link", {"forward": 0.1, "backward": -0.2}), "must be >= 0"),
        (
            Effect("encoder_eccentricity", "sensor", {"amplitude": 0.3, "phase": 0.0, "amplitude_2": 0.35}),
            "amplitude times order adds up to 1, must be < 1",
        ),
    ],
)
def test_inconsistent_parameters_are_refused(effect, message):
    with pytest.raises(ParameterError, match=message):
        JointPlant.from_device(rigid()).with_effects([effect])
