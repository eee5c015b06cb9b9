"""Fisher information of a joint's equations: against an independent fit, closed forms, and structural gaps."""

from __future__ import annotations

from math import factorial, sqrt

import numpy as np
import pytest
from via_core.devices import Device, parse_device
from via_core.errors import ParameterError, SignalError
from via_core.signals import Signals
from via_estimators.joint_equations import equations_of
from via_estimators.joint_record import Record, commands_of
from via_estimators.observability import information_of

INERTIA, VISCOUS, STIFFNESS = 0.02, 0.3, 6.0
RATE, DURATION = 200.0, 6.0
ANGLE_NOISE, TORQUE_NOISE = 2e-5, 0.05


def flexible(extra: str = "", link: str = "{inertia: 0.05, viscous_friction: 0.1}") -> Device:
    return parse_device(
        f"""
name: planted
title: Planted joint
source: [test]
confidence: assumed
arrangement: flexible
link: {link}
motors: [{{inertia: {INERTIA}, viscous_friction: {VISCOUS}}}]
springs: [{{law: linear, stiffness: {STIFFNESS}, max_deflection: 1.0}}]
sensors: {{rate: {RATE}}}
{extra}""",
        "planted.yaml",
    )


def rigid() -> Device:
    return parse_device(
        "name: bar\ntitle: Bar\nsource: [test]\nconfidence: assumed\narrangement: rigid\n"
        "link: {inertia: 0.1, viscous_friction: 0.2}\nsensors: {rate: 200.0}",
        "bar.yaml",
    )


def sines(time: np.ndarray, amplitudes: tuple[float, ...], frequencies: tuple[float, ...]) -> np.ndarray:
    """(3, N) angle with its first two derivatives."""
    out = np.zeros((3, len(time)))
    for a, f in zip(amplitudes, frequencies, strict=True):
        w = 2.0 * np.pi * f
        out += a * np.array([np.sin(w * time), w * np.cos(w * time), -w * w * np.sin(w * time)])
    return out


def exact(delay: float = 0.0) -> dict[str, np.ndarray]:
    """Signals that satisfy the motor's equation; the torque of a stamp acted, on average, half an interval earlier."""
    time = np.arange(round(DURATION * RATE)) / RATE
    theta, q = sines(time, (0.2, 0.1), (0.8, 2.1)), sines(time, (0.3, 0.12), (0.5, 1.7))
    held = time - 0.5 / RATE
    then, deflected = sines(held, (0.2, 0.1), (0.8, 2.1)), sines(held, (0.3, 0.12), (0.5, 1.7))
    tau = INERTIA * then[2] + VISCOUS * then[1] - STIFFNESS * (deflected[0] - then[0])
    return {"time": time, "q": q[0], "theta_1": theta[0], "tau_1": tau}


def record(signals: dict[str, np.ndarray], noise: dict[str, float] | None = None) -> Record:
    channels = {name: values for name, values in signals.items() if name != "time"}
    levels = noise or {"q": ANGLE_NOISE, "theta_1": ANGLE_NOISE, "tau_1": TORQUE_NOISE}
    return Record(signals["time"], channels, {}, levels)


def bump(derivative: int, span: float, u: np.ndarray) -> np.ndarray:
    """psi^(i) of order 5 by polynomial differentiation: independent of via_core.weak_form."""
    shape = np.polynomial.Polynomial([0.0, 1.0]) ** 5 * np.polynomial.Polynomial([1.0, -1.0]) ** 5
    scale = factorial(11) / factorial(5) ** 2 / span ** (1 + derivative)
    return scale * (shape.deriv(derivative) if derivative else shape)(u)


LENGTH, STEP, SPAN = 41, 10, 40.0 / RATE  # samples of a window and between windows; [s]
PSI = [bump(i, SPAN, np.linspace(0.0, 1.0, LENGTH)) / RATE for i in range(3)]
PSI_HELD = np.r_[0.0, 0.5 * (PSI[0][1:] + PSI[0][:-1])]


def windows(time: np.ndarray) -> list[slice]:
    return [slice(first, first + LENGTH) for first in range(0, len(time) - LENGTH + 1, STEP)]


def equation(signals: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Motor's equation in the long way: regressors of B, D, F, delay, a cubic spring; right side."""
    time, q, theta, tau = signals["time"], signals["q"], signals["theta_1"], signals["tau_1"]
    sign = np.sign(np.interp(time + 0.025, time, theta) - np.interp(time - 0.025, time, theta))
    A, y = [], []
    for at in windows(time):
        phi = q[at] - theta[at]
        A.append((
            PSI[2] @ theta[at], -PSI[1] @ theta[at], PSI[0] @ sign[at], PSI[1] @ tau[at], -PSI[0] @ phi,
            -PSI[0] @ phi**3,
        ))  # fmt: skip
        y.append(PSI_HELD @ tau[at])
    return np.array(A), np.array(y)


def covariance(time: np.ndarray) -> np.ndarray:
    """Noise covariance of the equation's rows."""
    rows = windows(time)
    G = {name: np.zeros((len(rows), len(time))) for name in ("q", "theta_1", "tau_1")}
    for k, at in enumerate(rows):
        G["theta_1"][k, at] = INERTIA * PSI[2] - VISCOUS * PSI[1] + STIFFNESS * PSI[0]
        G["q"][k, at], G["tau_1"][k, at] = -STIFFNESS * PSI[0], -PSI_HELD
    noise = {"q": ANGLE_NOISE, "theta_1": ANGLE_NOISE, "tau_1": TORQUE_NOISE}
    C = sum(noise[name] ** 2 * gain @ gain.T for name, gain in G.items())
    return C + 1e-9 * np.diag(np.diag(C))


def test_predicted_standard_deviations_match_the_scatter_of_a_weighted_fit():
    signals, random = exact(), np.random.default_rng(7)
    weight = np.linalg.inv(covariance(signals["time"]))
    found = []
    for _ in range(200):
        noisy = dict(signals)
        for name, sd in (("q", ANGLE_NOISE), ("theta_1", ANGLE_NOISE), ("tau_1", TORQUE_NOISE)):
            noisy[name] = signals[name] + sd * random.normal(size=len(signals[name]))
        A, y = equation(noisy)
        x = np.linalg.solve(A.T @ weight @ A, A.T @ weight @ y)
        found.append([x[0], x[1], x[2], x[3], x[4] + 3.0 * x[5] * 0.2**2])
    scatter = np.std(found, axis=0, ddof=1)
    information = information_of(flexible(), record(signals), noisy=False, only=["motor 1"])
    names = [f"{what} of motor 1" for what in ("inertia", "viscous friction", "dry friction", "torque delay")]
    stated = [information.standard_deviation(name) for name in names]
    stated.append(sqrt(information.stiffness(1, np.array([0.2]))[0, 0]))
    assert np.array(stated) == pytest.approx(scatter, rel=0.2)
    assert np.mean(found, axis=0)[[0, 1, 4]] == pytest.approx([INERTIA, VISCOUS, STIFFNESS], rel=0.01)


def test_white_torque_noise_alone_gives_the_closed_form_of_continuous_white_noise():
    """With noise of density s^2 h and a motion a sin wt, sd(M)^-2 = T a^2 w^4 / (2 s^2 h): all of it is in the band."""
    time = np.arange(round(20.0 * RATE)) / RATE
    q = sines(time, (0.3,), (1.0,))
    still = np.zeros(len(time))
    signals = {"time": time, "q": q[0], "tau_1": 0.1 * q[2] + 0.2 * q[1] + still}
    levels = {"q": 1e-9, "tau_1": TORQUE_NOISE}
    information = information_of(rigid(), record(signals, levels), noisy=False)
    covered = 20.0 - 0.2  # the windows vanish at both ends
    expected = sqrt(2.0 / RATE / covered) * TORQUE_NOISE / (0.3 * (2.0 * np.pi) ** 2)
    assert information.standard_deviation("inertia of the link") == pytest.approx(expected, rel=0.05)


def test_without_torque_only_ratios_are_determined():
    signals = {name: values for name, values in exact().items() if name != "tau_1"}
    information = information_of(flexible(), record(signals), noisy=False)
    values = {each.name: each.value / each.size for each in information.unknowns}
    scale = np.array([values[each.name] for each in information.unknowns])
    assert np.abs(information.matrix @ scale).max() <= 1e-9 * np.abs(information.matrix).max()
    assert information.rank < len(information.unknowns)
    assert information.standard_deviation("inertia of the link") > 10.0 * 0.05
    inertia = information.with_file("inertia of the link") / 0.05
    assert inertia <= 0.06  # with the spring of the file: its tolerance of 5 % at most


def test_noise_of_a_motor_at_rest_is_no_information():
    random, signals = np.random.default_rng(3), exact()
    signals["theta_1"] = 0.0 * signals["time"]
    signals["tau_1"] = -STIFFNESS * signals["q"]
    for name, sd in (("q", ANGLE_NOISE), ("theta_1", ANGLE_NOISE), ("tau_1", TORQUE_NOISE)):
        signals[name] = signals[name] + sd * random.normal(size=len(signals["time"]))
    information = information_of(flexible(), record(signals), noisy=True, only=["motor 1"])
    assert information.standard_deviation("inertia of motor 1") > INERTIA
    # scatter of samples without motion has information for the naive matrix
    naive = information_of(flexible(), record(signals), noisy=False, only=["motor 1"])
    assert naive.standard_deviation("inertia of motor 1") < information.standard_deviation("inertia of motor 1")


def test_a_misfit_of_the_model_widens_its_standard_deviations():
    signals, random = exact(), np.random.default_rng(5)
    for name, sd in (("q", ANGLE_NOISE), ("theta_1", ANGLE_NOISE), ("tau_1", TORQUE_NOISE)):
        signals[name] = signals[name] + sd * random.normal(size=len(signals["time"]))
    good = information_of(flexible(), record(signals), noisy=True, only=["motor 1"])
    signals["tau_1"] = signals["tau_1"] + 0.3 * np.sin(9.0 * signals["time"] ** 1.5)
    bad = information_of(flexible(), record(signals), noisy=True, only=["motor 1"])
    assert good.misfit["motor 1"] < 1.2 and bad.misfit["motor 1"] > 3.0
    name = "viscous friction of motor 1"
    ratio = bad.standard_deviation(name) / good.standard_deviation(name)
    assert ratio == pytest.approx(bad.misfit["motor 1"] / good.misfit["motor 1"], rel=0.3)


def test_a_velocity_sensor_and_a_torque_sensor_add_information():
    signals = exact()
    velocity = sines(signals["time"], (0.2, 0.1), (0.8, 2.1))[1]
    noise = {"q": 1e-3, "theta_1": 5e-3, "tau_1": 0.005, "theta_velocity_1": 1e-3, "tau_link": 0.01}
    name = "viscous friction of motor 1"
    base = information_of(flexible(), record(signals, noise), noisy=False).standard_deviation(name)
    fast = information_of(flexible(), record(signals | {"theta_velocity_1": velocity}, noise), noisy=False)
    assert fast.standard_deviation(name) < 0.9 * base
    torque = STIFFNESS * (signals["q"] - signals["theta_1"])
    more = information_of(flexible(), record(signals | {"tau_link": torque}, noise), noisy=False)
    at = np.array([0.2])
    before = information_of(flexible(), record(signals, noise), noisy=False).stiffness(1, at)
    assert more.stiffness(1, at)[0, 0] < before[0, 0]


def test_damper_and_friction_separate_only_if_the_command_varies():
    device = flexible("damper: {site: link, map: linear, minimum: 0.1, maximum: 1.0}")
    signals = exact()
    for command, apart in ((np.full(len(signals["time"]), 0.5), False), (0.5 + 0.5 * np.sin(signals["time"]), True)):
        given = Record(signals["time"], record(signals).channels, {"damping": command}, record(signals).noise)
        information = information_of(device, given, noisy=False)
        mixed = {"viscous friction of the link", "scale of the damper"}
        assert (mixed not in [set(direction) for direction in information.weak()]) == apart


def test_gaps_split_windows_and_too_few_samples_are_refused():
    signals = exact()
    kept = np.ones(len(signals["time"]), dtype=bool)
    kept[400:500] = False
    cut = {name: values[kept] for name, values in signals.items()}
    whole = information_of(flexible(), record(signals), noisy=False)
    assert information_of(flexible(), record(cut), noisy=False).windows < whole.windows
    with pytest.raises(SignalError, match="no window"):
        information_of(flexible(), record({name: values[:20] for name, values in signals.items()}), noisy=False)
    with pytest.raises(ParameterError, match="link angle"):
        equations_of(flexible(), record({"time": signals["time"], "theta_1": signals["theta_1"]}))


def test_the_servo_equation_is_exact_at_the_filed_bandwidth():
    device = parse_device(
        "name: servo\ntitle: Servo\nsource: [test]\nconfidence: assumed\narrangement: serial\ndrive: servo\n"
        "link: {inertia: 0.01, viscous_friction: 0.01}\nmotors: [{bandwidth: 20.0}, {bandwidth: 20.0}]\n"
        "springs: [{law: linear, stiffness: 3.0, max_deflection: 1.0}]\nsensors: {rate: 200.0}",
        "servo.yaml",
    )
    time = np.arange(1200) / 200.0
    theta = sines(time, (0.3,), (1.1,))
    goal = theta[0] + theta[2] / 20.0**2 + 2.0 * theta[1] / 20.0
    channels = {"q": 0.0 * time, "theta_1": theta[0], "theta_2": 0.0 * time}
    given = Record(time, channels, {"servo_1": goal}, {"theta_1": 1e-4})
    (equation,) = [each for each in equations_of(device, given).equations if each.name == "servo 1"]
    window = slice(100, 141)
    span, u = 0.2, np.linspace(0.0, 1.0, 41)
    weights = [bump(i, span, u) / 200.0 for i in range(3)]
    known = sum(p.factor * weights[p.weights] @ p.values[window] for p in equation.known)
    slope = sum(p.factor * weights[p.weights] @ p.values[window] for p in equation.unknown["bandwidth of servo 1"])
    assert 20.0 * slope == pytest.approx(known, rel=1e-3)  # trapezoids of 41 samples


@pytest.mark.parametrize(("limited", "known"), [("proportional", True), ("sum", False)])
def test_a_limit_that_includes_the_damping_hides_the_velocity_gain(limited: str, known: bool) -> None:
    """The drive is at its limit in every sample; in one that limits kp times the error alone, kd still acts."""
    device = parse_device(
        "name: bar\ntitle: Bar\nsource: [test]\nconfidence: assumed\narrangement: rigid\ndrive: position\n"
        "link: {inertia: 0.1, viscous_friction: 0.0}\nsensors: {rate: 200.0}\n"
        f"servo: {{kp: 4.0, kd: 0.2, torque_limit: 0.5, limited: {limited}}}",
        "bar.yaml",
    )
    time = np.arange(round(DURATION * RATE)) / RATE
    q = sines(time, (0.3, 0.1), (0.6, 1.9))[0]
    goal = np.where(np.arange(len(time)) // 40 % 2 == 0, 5.0, -5.0)
    seen = Record(time, {"q": q}, {"goal": goal}, {"q": ANGLE_NOISE, "goal": 1e-12})
    (drive,) = [each for each in equations_of(device, seen).equations if "velocity gain" in each.unknown]
    weights = [np.abs(part.values).max() for part in drive.unknown["velocity gain"]]
    assert bool(max(weights) > 0.0) == known


def position_drive(more: str) -> Device:
    return parse_device(
        "name: bar\ntitle: Bar\nsource: [test]\nconfidence: assumed\narrangement: rigid\ndrive: position\n"
        "link: {inertia: 0.1, viscous_friction: 0.3}\nsensors: {rate: 200.0}\n"
        f"servo: {{kp: 4.0, kd: 0.2{more}}}",
        "bar.yaml",
    )


def imbalance(device: Device, seen: Record) -> float:
    """Largest residual [N m] of the link's equation at the filed numbers, and an integral that began at .3 N m."""
    made = equations_of(device, seen)
    (equation,) = [each for each in made.equations if "position gain" in each.unknown]
    values = {each.name: each.value for each in made.unknowns} | {"torque of the integral at the start": 0.3}
    u, worst = np.linspace(0.0, 1.0, 81), 0.0
    weights = [bump(i, 0.4, u) / 200.0 for i in range(3)]

    def sum_of(parts, window) -> float:
        return sum(p.factor * weights[p.weights] @ p.values[window] for p in parts)

    for begin in range(0, len(seen.time) - 81, 40):
        window = slice(begin, begin + 81)
        left = sum(values[name] * sum_of(parts, window) for name, parts in equation.unknown.items())
        worst = max(worst, abs(left - sum_of(equation.known, window)))
    return worst


def test_the_integral_of_a_position_drive_is_in_its_equation():
    """The error e of a drive that follows a smooth motion: kp e + i - kd q' = M q'' + D q', i' = ki e."""
    time = np.arange(1200) / 200.0
    q, speed, change = sines(time, (0.3, 0.1), (0.6, 1.9))
    fine = np.linspace(0.0, time[-1], 20 * 1199 + 1)
    load = np.interp(fine, time, 0.1 * change + 0.5 * speed)
    error, torque, step = np.empty_like(fine), 0.3, fine[1]
    for k in range(len(fine)):
        error[k] = (load[k] - torque) / 4.0
        torque += 8.0 * step * error[k]
    seen = Record(time, {"q": q}, {"goal": q + error[::20]}, {"q": ANGLE_NOISE, "goal": 1e-12})
    assert imbalance(position_drive(", ki: 8.0"), seen) < 2e-3
    assert imbalance(position_drive(""), seen) > 0.1


def test_commands_of_a_drive_with_feedforward_lead():
    device, time = position_drive(", feedforward: 1.0"), np.arange(200) / 200.0
    goal = np.sin(3.0 * time)
    sent = Signals(time, {"equilibrium": goal}, {"equilibrium": "rad"}, frozenset({"equilibrium"}))
    found = commands_of(sent, device, time)["goal"]
    np.testing.assert_allclose(found[1:], goal[1:] + 0.2 / 4.0 * np.diff(goal) * 200.0)
