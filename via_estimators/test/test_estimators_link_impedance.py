"""The link-side estimator on a joint integrated here by scipy, with the robot's servo: dead time, speed limit, lag.

What motion determines (ratios to the inertia) and what only tolerances do (the scale) are tested apart.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from via_core.devices import load_device
from via_core.status import Status
from via_estimators import link_impedance
from via_estimators.contract import summarise
from via_estimators.link_impedance import LinkImpedance, LinkImpedanceParameters
from via_estimators.servo_models import Servos

DEVICE = load_device("maccepavd")
LAW = DEVICE.springs[0]
INERTIA, QUANTUM = 3.6e-3, 5.7e-3
SERVO = (25.0, 0.045, 6.5)  # bandwidth [rad/s], dead time [s], speed limit [rad/s]
EXACT = LinkImpedanceParameters(
    servo_dead_time=SERVO[1],
    servo_speed_limit=SERVO[2],
    inertia_tolerance=0.0,
    payload_probability=0.0,
    position_noise=0.0,
    disturbance_memory=0.0,
    torque_noise=1e-3,
)


ONE = Servos(lags=((1.0, 0.0),), speeds=(1.0,))


def exact(servos=ONE, **changes):
    """The estimator with the true inertia and, by default, the true servo alone."""
    return LinkImpedance(LAW, replace(EXACT, **changes), servos)


def servo_angle(time, command, start, bandwidth, dead_time, speed_limit, fine=5e-5):
    """Angle (N,) at the times of a servo with dead time and speed limit under command(t); small Euler steps."""
    steps = np.arange(time[0], time[-1] + fine, fine)
    angle, rate, out = start, 0.0, np.empty(len(steps))
    for k, t in enumerate(steps):
        out[k] = angle
        target = command(t - dead_time) if t - dead_time >= time[0] else start
        rate += fine * (bandwidth**2 * (target - angle) - 2.0 * bandwidth * rate)
        rate = min(max(rate, -speed_limit), speed_limit)
        angle += fine * rate
    return np.interp(time, steps, out)


def swing(damping, command, duration=1.5, start=0.9, gain=1.0, servo=SERVO, inertia=INERTIA, dry=0.0):
    """Rows (N, 5) of time, q, no logged servo angle, equilibrium and preset command; damping(t) [N m s/rad]."""
    t = np.arange(0.0, duration, 4.6e-3)
    dense = np.arange(0.0, duration + 1e-3, 5e-4)
    theta = servo_angle(dense, command, start, *servo)

    def rates(time, x):
        phi = x[0] - np.interp(time, dense, theta)
        friction = damping(time) * x[1] + dry * np.tanh(x[1] / 0.01)
        return [x[1], -(gain * float(LAW.torque(phi, 0.5)) + friction) / inertia]

    q = solve_ivp(rates, (0.0, duration), [start, 0.0], "RK45", t, rtol=1e-8, atol=1e-9, max_step=2e-3).y[0]
    return np.column_stack([t, q, np.full_like(t, np.nan), [command(time) for time in t], np.full_like(t, 0.5)])


def step_command(time):
    return -0.7


@pytest.fixture(scope="module")
def constant():
    return swing(lambda _: 0.012, step_command, gain=1.2)


def test_damping_and_gain_are_recovered(constant):
    _, estimates = exact(memory=1e9).run_rows(constant)
    excited = estimates.status == Status.OK
    assert excited.mean() > 0.3
    damping, gain = (estimates.column(name)[0][excited] for name in ("damping", "gain"))
    assert damping[-1] == pytest.approx(0.012, rel=0.05) and gain[-1] == pytest.approx(1.2, rel=0.03)
    stiffness = estimates.column("stiffness")[0]
    deflection = constant[-1, 1] + 0.7  # the servo has arrived
    assert stiffness[-1] == pytest.approx(1.2 * float(LAW.stiffness(deflection, 0.5)), rel=0.05)


def test_nothing_is_known_before_the_first_preset_on_which_the_spring_depends(constant):
    never, late = constant.copy(), constant.copy()
    never[:, 4], late[:100, 4] = np.nan, np.nan
    _, estimates = exact(memory=1e9).run_rows(never)
    assert set(estimates.status) <= {Status.WARMING_UP, Status.NOT_EXCITED}
    assert np.isfinite(estimates.column("stiffness")[0]).all()
    _, estimates = exact(memory=1e9).run_rows(late)
    assert not np.any(estimates.status[:100] == Status.OK)
    assert np.mean(estimates.status[150:] == Status.OK) > 0.3
    assert estimates.column("gain")[0][-1] == pytest.approx(1.2, rel=0.1)


def test_damping_that_changes_is_followed():
    rows = swing(lambda t: 0.005 if t < 0.75 else 0.02, lambda t: 0.8 * np.sin(9.0 * t), duration=3.0)
    _, estimates = exact(memory=1.0).run_rows(rows)
    damping = estimates.column("damping")[0]
    assert damping[(rows[:, 0] > 0.6) & (rows[:, 0] < 0.75)].mean() == pytest.approx(0.005, abs=0.003)
    assert damping[rows[:, 0] > 2.0].mean() == pytest.approx(0.02, abs=0.003)


def test_estimates_scale_with_the_inertia(constant):
    heavy = exact(
        inertia=2.0 * INERTIA, memory=1e9, damping_deviation=10.0, gain_deviation=50.0, friction_deviation=1e-6
    )
    light = heavy.with_parameters(replace(heavy.parameters, inertia=INERTIA))
    double, single = (each.run_rows(constant)[1] for each in (heavy, light))
    for name in ("damping", "gain"):
        assert double.column(name)[0][-1] == pytest.approx(2.0 * single.column(name)[0][-1], rel=0.02)


def posterior_of_scale(ratio, inertia, spring, probability, payload):
    """Geometric mean of s and mean square error of it, by sums over a fine grid of log s."""
    grid = np.linspace(-6.0, 6.0, 60001)

    def normal(x, sd):
        return np.exp(-0.5 * (x / sd) ** 2) / sd

    density = (1.0 - probability) * normal(grid, inertia) + probability * normal(grid, payload)
    density *= normal(np.log(ratio) + grid, spring)  # gain = ratio s
    density /= density.sum()
    mean = np.exp(density @ grid)
    return mean, density @ (np.exp(grid) - mean) ** 2


@pytest.mark.parametrize("ratio", [1.0, 0.5, 1.6, 0.1])
def test_the_scale_is_that_of_the_tolerances_and_of_a_payload_that_may_be_there(ratio):
    par = exact(inertia_tolerance=0.15, spring_tolerance=0.3, payload_probability=0.2)._constants[0]
    scale, doubt = link_impedance._scale(par, ratio, 0.0)
    mean, square = posterior_of_scale(ratio, 0.15, 0.3, 0.2, 0.65)
    assert scale == pytest.approx(mean, rel=1e-6) and doubt == pytest.approx(square, rel=1e-4)


def test_a_doubled_payload_is_inside_the_interval():
    """Inertia 2 and spring 1, or 1 and .5, move alike: the interval must hold the truth without a hint which it is."""
    rows = swing(lambda _: 0.012, lambda t: 0.8 * np.sin(7.0 * t), duration=3.0, inertia=2.0 * INERTIA, start=0.0)
    _, estimates = LinkImpedance.from_device(DEVICE).run_rows(rows)
    for name, truth in (("gain", 1.0), ("damping", 0.012)):
        value, sd = estimates.column(name)
        assert abs(value[-1] - truth) <= 1.96 * sd[-1]
    assert estimates.column("gain")[0][-1] < 0.9 and estimates.column("gain")[1][-1] < 0.6


@pytest.mark.parametrize("servo", [(15.0, 0.045, 6.5), (25.0, 0.045, 3.0), (18.0, 0.045, 4.0)])
def test_other_servos_than_that_of_the_file_are_found(servo):
    rows = swing(lambda _: 0.012, lambda t: 0.8 * np.sin(7.0 * t), duration=4.0, start=0.0, servo=servo)
    right, wrong = (exact(each, memory=50.0).run_rows(rows)[1].column("gain") for each in (Servos(), ONE))
    error, alone = abs(right[0][-1] - 1.0), abs(wrong[0][-1] - 1.0)
    assert error < 0.12 and error < 0.6 * alone


def test_dry_friction_is_not_counted_as_damping():
    rows = swing(lambda _: 0.01, lambda t: 0.9 * np.sin(8.0 * t) + 0.3 * np.sin(19.0 * t), duration=4.0, dry=0.05)
    free, bound = (exact(memory=50.0, friction_deviation=each).run_rows(rows)[1] for each in (0.03, 1e-6))
    right, wrong = (each.column("damping")[0][-1] for each in (free, bound))
    assert right == pytest.approx(0.01, abs=0.003) and wrong > 0.0135


def test_the_published_lag_alone_is_wrong_for_a_servo_with_dead_time_and_speed_limit(constant):
    short = {"memory": 0.3, "spring_memory": 0.3}  # else what follows the slewing corrects it
    lag = exact(servo_dead_time=0.0, servo_speed_limit=1e4, **short)
    right, wrong = (summarise(each.run_rows(constant)[1], "gain").value for each in (exact(**short), lag))
    assert abs(right - 1.2) < 0.03 and abs(wrong - 1.2) > 0.15


def test_reported_standard_deviations_match_empirical_ones_with_quantisation_and_disturbance():
    """40 swings with quantised angle and correlated torque disturbance: interval coverage and sd ratio."""
    noisy = {"position_noise": QUANTUM / np.sqrt(12.0), "disturbance_memory": 0.03, "torque_noise": 0.02}
    estimator, misses, sds = exact(memory=50.0, **noisy), [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        drive = np.zeros(400)
        for k in range(1, 400):
            drive[k] = np.exp(-4.6e-3 / 0.03) * drive[k - 1] + 0.012 * rng.normal()
        times = np.arange(400) * 4.6e-3
        rows = disturbed_swing(drive, times, phase=rng.uniform(0.0, 6.0))
        rows[:, 1] = QUANTUM * np.round(rows[:, 1] / QUANTUM)
        _, estimates = estimator.run_rows(rows)
        value, sd = estimates.column("damping")
        misses.append(value[-1] - 0.015)
        sds.append(sd[-1])
    ratio = np.sqrt(np.mean(np.square(sds)) / np.mean(np.square(misses)))
    assert 0.7 <= ratio <= 1.5
    assert np.mean(np.abs(misses) <= 1.96 * np.array(sds)) >= 0.85


def disturbed_swing(drive, times, phase):
    """A swing under a torque disturbance given at times; equilibrium moves slowly enough for the servo."""

    def command(t):
        return 0.7 * np.sin(7.0 * t + phase)

    t = np.arange(0.0, 1.5, 4.6e-3)
    dense = np.arange(0.0, 1.51, 2e-3)
    theta = servo_angle(dense, command, command(0.0), *SERVO, fine=2e-4)

    def rates(time, x):
        phi = x[0] - np.interp(time, dense, theta)
        push = np.interp(time, times, drive)
        return [x[1], (push - float(LAW.torque(phi, 0.5)) - 0.015 * x[1]) / INERTIA]

    q = solve_ivp(rates, (0.0, 1.5), [command(0.0), 0.0], "RK45", t, rtol=1e-6, atol=1e-7, max_step=4e-3).y[0]
    return np.column_stack([t, q, np.full_like(t, np.nan), command(t), np.full_like(t, 0.5)])


def test_at_standstill_the_estimate_is_constant_and_its_standard_deviation_grows(constant):
    rows = np.concatenate([constant, np.repeat(constant[-1:], 400, axis=0)])
    rows[len(constant) :, 0] += 4.6e-3 * np.arange(1, 401)
    _, estimates = exact(torque_noise=0.02, memory=3.0).run_rows(rows)
    value, sd = estimates.column("damping")
    still = len(constant) + 30
    assert np.all(estimates.status[still:] == Status.NOT_EXCITED)
    assert np.ptp(value[still:]) < 1e-12 and np.all(np.diff(sd[still:]) >= -1e-12)
    assert 1.5 * sd[still] < sd[-1] < EXACT.damping_deviation


def test_without_commands_the_servo_model_stays_at_rest(constant):
    rows = constant.copy()
    rows[:, 3:] = np.nan
    _, estimates = exact(Servos()).run_rows(rows)
    assert np.isfinite(estimates.value).all() and Status.BAD_SAMPLE not in estimates.status


@pytest.mark.parametrize("logged", [0.9, 2.5, np.nan])
def test_the_servo_model_starts_at_the_logged_angle_if_plausible(constant, logged):
    rows = constant.copy()
    rows[:, 2] = logged
    _, estimates = exact().run_rows(rows)
    np.testing.assert_array_equal(estimates.value, exact().run_rows(constant)[1].value)


def test_gravity_is_compensated():
    def rates(_, x):
        return [x[1], -(float(LAW.torque(x[0] - 0.4, 0.5)) + 0.1 * np.sin(x[0] - 0.3) + 0.01 * x[1]) / INERTIA]

    t = np.arange(0.0, 1.2, 2e-3)
    q = solve_ivp(rates, (0.0, 1.2), [-0.6, 0.0], "RK45", t, rtol=1e-8, atol=1e-9).y[0]
    rows = np.column_stack([t, q, np.full_like(t, 0.4), np.full_like(t, 0.4), np.full_like(t, 0.5)])
    rows[0, 1] = 0.4  # the first sample only initialises the servo
    estimator = exact(gravity_torque=0.1, gravity_angle=0.3, memory=1e9, window=40, sampling=2e-3)
    _, estimates = estimator.run_rows(rows)
    assert estimates.column("damping")[0][-1] == pytest.approx(0.01, rel=0.03)
    assert estimates.column("gain")[0][-1] == pytest.approx(1.0, rel=0.01)


def test_zero_stiffness_at_rest_keeps_a_standard_deviation():
    """MACCEPA without pretension has no stiffness at zero deflection; that is the prior, not an estimate."""
    estimator = LinkImpedance.from_device(DEVICE)
    time = np.arange(400) * 4.6e-3
    rows = np.column_stack([time, np.zeros(400), np.zeros(400), np.full(400, np.nan), np.full(400, np.nan)])
    value, sd = estimator.run_rows(rows)[1].column("stiffness")
    assert np.all(value == 0.0)
    assert np.all(sd > 0.05)


def test_forgetting_continues_during_a_gap():
    """A damper opened during a gap of many memories: all earlier data is forgotten, and the standard error is large."""
    before = swing(lambda _: 0.03, step_command)
    after = swing(lambda _: 0.005, lambda t: -0.7 if t < 0.05 else 0.8, start=-0.7)  # from where the servo was left
    after[:, 0] += before[-1, 0] + 20.0
    estimator = exact(memory=3.0, spring_memory=3.0)
    both = estimator.run_rows(np.concatenate([before, after]))[1]
    alone = estimator.run_rows(after)[1]
    # All but the level of the noise, whose last value remains the best guess.
    assert np.all(np.abs(both.value[-1] - alone.value[-1]) < 0.1 * alone.standard_deviation[-1])
    first = len(before) + int(np.flatnonzero(both.status[len(before) :] == Status.OK)[0])
    assert both.standard_deviation[first, 1] > 1.3 * both.standard_deviation[len(before) - 1, 1]
