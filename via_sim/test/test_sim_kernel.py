"""The joint's equations and its integrator against closed forms, conserved quantities and independent integrators."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from sim_joints import SIZES, antagonistic, device, flexible, positioned, rigid, serial_servo, servo_flexible
from via_core.devices import device_names, load_device
from via_core.errors import ParameterError
from via_core.signals import Signals
from via_sim.catalogue import EFFECTS
from via_sim.effects import Effect, places
from via_sim.joint.kernel import run, run_in
from via_sim.joint.layout import N_COMMANDS
from via_sim.joint.measurements import TRUTH
from via_sim.joint.parameters import P
from via_sim.joint.structure import EVERYTHING, is_smooth, structure_of
from via_sim.plants import JointPlant, substeps_for
from via_sim.sensors import IDEAL, Sensors
from via_sim.simulate import InitialConditions, initial_state, simulate

RATE = 1000.0


def excitation(ticks: int) -> np.ndarray:
    """E1 of the cubic joint (N, N_COMMANDS) with its .3 s ramp."""
    t = np.arange(ticks) / RATE
    ramp = np.where(t < 0.3, 0.5 - 0.5 * np.cos(np.pi * t / 0.3), 1.0)
    rows = np.zeros((ticks, N_COMMANDS))
    rows[:, 0] = ramp * (60.0 + 20.0 * np.sin(2.0 * np.pi * 0.5 * t))
    rows[:, 1] = -ramp * (60.0 + 20.0 * np.sin(2.0 * np.pi * 0.8 * t))
    return rows


def motion(plant: JointPlant, commands: np.ndarray, finer: int = 1, initial=None) -> np.ndarray:
    """(N+1, 6) with `finer` times the usual number of substeps."""
    row = plant.at_rate(RATE)
    row[P.substeps] *= finer
    state = initial_state(plant, RATE, initial, 0)
    measured, truth = np.empty((len(commands) + 1, 9)), np.empty((len(commands) + 1, 16))
    run(row, IDEAL.row(), state, commands, measured, truth)
    return np.nan_to_num(truth[:, :6])  # axes that are not there stand still


def test_stiff_cubic_joint_converges_to_a_finer_integration():
    plant = JointPlant.from_device(load_device("cubic_aa_vsa"))
    commands = excitation(10_000)
    coarse, fine = motion(plant, commands), motion(plant, commands, finer=20)
    assert np.ptp(fine[:, 1]) > 1.0  # it moves
    assert np.max(np.abs(coarse - fine)[:, :3]) < 1e-6


def test_stiff_cubic_joint_agrees_with_an_independent_implicit_integrator():
    joint = load_device("cubic_aa_vsa")
    plant, commands = JointPlant.from_device(joint), excitation(400)
    M, Dq, B, D = (
        joint.link.inertia,
        joint.link.viscous_friction,
        joint.motors[0].inertia,
        joint.motors[0].viscous_friction,
    )

    def rate(_t, x, tau_1, tau_2):  # the equations once more, from the notation page
        q, th1, th2, v, w1, w2 = x
        e1, e2 = 10.0 * (q - th1) ** 3, 10.0 * (q - th2) ** 3
        return [v, w1, w2, (-Dq * v - e1 - e2) / M, (tau_1 + e1 - D * w1) / B, (tau_2 + e2 - D * w2) / B]

    def jacobian(_t, x, _tau_1, _tau_2):
        s1, s2 = 30.0 * (x[0] - x[1]) ** 2, 30.0 * (x[0] - x[2]) ** 2
        out = np.zeros((6, 6))
        out[:3, 3:] = np.eye(3)
        out[3] = [-(s1 + s2) / M, s1 / M, s2 / M, -Dq / M, 0.0, 0.0]
        out[4] = [s1 / B, -s1 / B, 0.0, 0.0, -D / B, 0.0]
        out[5] = [s2 / B, 0.0, -s2 / B, 0.0, 0.0, -D / B]
        return out

    ours, x = motion(plant, commands), np.zeros(6)
    for k, command in enumerate(commands):  # one restart per tick
        x = solve_ivp(
            rate, (0.0, 1.0 / RATE), x, "Radau", args=tuple(command[:2]), jac=jacobian, rtol=1e-9, atol=1e-11
        ).y
        x = x[:, -1]
        assert np.max(np.abs(ours[k + 1, :3] - x[:3])) < 1e-6


def test_error_falls_with_the_fourth_power_of_the_step():
    plant = JointPlant.from_device(flexible(200.0))
    commands, start = np.zeros((200, N_COMMANDS)), (0.5, -0.5, 0.0, 0.0, 0.0, 0.0)
    fine = motion(plant, commands, 64, start)
    errors = [np.max(np.abs(motion(plant, commands, finer, start) - fine)) for finer in (1, 2, 4)]
    assert 13.0 < errors[0] / errors[1] < 20.0
    assert 13.0 < errors[1] / errors[2] < 20.0


def test_energy_is_conserved_without_friction():
    joint = device(
        "antagonistic",
        "{inertia: 0.02, viscous_friction: 0.0, gravity_torque: 0.4, gravity_angle: 0.3}",
        "motors: [{inertia: 0.01, viscous_friction: 0.0}, {inertia: 0.02, viscous_friction: 0.0}]\n"
        "springs: [{law: cubic, coefficient: 10.0, max_deflection: 2.0}, "
        "{law: sinh, k: 0.02, a: 6.0, max_deflection: 1.0}]",
    )
    x = motion(JointPlant.from_device(joint), np.zeros((5000, N_COMMANDS)), 4, (0.4, -0.2, 0.1, 0.0, 1.0, -1.0))
    q, th1, th2, v, w1, w2 = x.T
    kinetic = 0.5 * (0.02 * v**2 + 0.01 * w1**2 + 0.02 * w2**2)
    stored = 2.5 * (q - th1) ** 4 + 0.02 / 6.0 * np.cosh(6.0 * (q - th2)) - 0.4 * np.cos(q - 0.3)
    energy = kinetic + stored
    assert np.ptp(kinetic) > 0.01
    assert np.ptp(energy) < 1e-7


@pytest.mark.parametrize("viscous", [0.0, 0.05, 3.0])
def test_linear_oscillator_matches_its_closed_form(viscous):
    """A link on a spring with a resting servo: underdamped to overdamped."""
    link = f"{{inertia: 0.02, viscous_friction: {viscous}}}"
    x = motion(
        JointPlant.from_device(servo_flexible(10.0, link)), np.zeros((2000, N_COMMANDS)), initial=(0.3, 0, 0, 0, 0, 0)
    )
    t = np.arange(2001) / RATE
    r = np.roots([0.02, viscous, 10.0]).astype(complex)  # q = A e^(r1 t) + B e^(r2 t), q(0) = .3, qd(0) = 0
    exact = 0.3 * (r[1] * np.exp(r[0] * t) - r[0] * np.exp(r[1] * t)) / (r[1] - r[0])
    assert np.max(np.abs(x[:, 0] - exact.real)) < 2e-6


def test_linear_flexible_joint_matches_the_matrix_exponential():
    from scipy.linalg import expm

    joint = flexible(10.0, "{inertia: 0.02, viscous_friction: 0.01}", "{inertia: 0.01, viscous_friction: 0.2}")
    commands = np.zeros((500, N_COMMANDS))
    commands[:, 0] = np.sin(np.arange(500) * 0.02)
    commands[:, 3] = 0.1
    x = motion(JointPlant.from_device(joint), commands)
    A = np.zeros((6, 6))  # q, th, v, w and the held torques on link and motor
    A[0, 2] = A[1, 3] = 1.0
    A[2, :3] = -10.0 / 0.02, 10.0 / 0.02, -0.01 / 0.02
    A[3, [0, 1, 3]] = 10.0 / 0.01, -10.0 / 0.01, -0.2 / 0.01
    A[2, 4], A[3, 5] = 1.0 / 0.02, 1.0 / 0.01
    step, z = expm(A / RATE), np.zeros(6)
    for k, command in enumerate(commands):
        z[4], z[5] = command[3], command[0]
        z = step @ z
        assert np.allclose(x[k + 1, [0, 1, 3, 4]], z[:4], rtol=0.0, atol=2e-5 if k == 0 else 1e-6)


def test_rigid_pendulum_has_the_period_of_the_elliptic_integral():
    from scipy.special import ellipk

    plant = JointPlant.from_device(rigid("{inertia: 0.02, viscous_friction: 0.0, gravity_torque: 2.0}"))
    x = motion(plant, np.zeros((3000, N_COMMANDS)), initial=(1.5, 0, 0, 0, 0, 0))
    period = 4.0 / np.sqrt(2.0 / 0.02) * ellipk(np.sin(0.75) ** 2)
    v = x[:, 3]
    up = np.flatnonzero((v[:-1] < 0.0) & (v[1:] >= 0.0))  # the speed turns positive: once per period, at q = -1.5
    crossings = (up - v[up] / (v[up + 1] - v[up])) / RATE
    assert np.diff(crossings) == pytest.approx(period, abs=1e-5)


def test_maccepa_vd_matches_the_published_model():
    """The authors' equations and numbers with a plain Runge-Kutta method against the plant of the device file."""
    B, C, A0, r, K, inertia, viscous = 0.036, 0.135, 0.099, 0.015, 394.0, 3.6e-3, 0.0077
    d_max = 0.0212**2 * 40**2 / (21.2 + 25.3)

    def rate(x, u):
        q, w, m1, m1d, m2, m2d = x
        phi = m1 - q
        A = np.sqrt(C * C + B * B - 2.0 * B * C * np.cos(phi))
        spring = K * B * C * np.sin(phi) * (1.0 + (r * m2 - A0) / A)
        d = d_max * np.clip(u[2] / 0.5, 0, 1) + 0.848 * d_max * np.clip((u[2] - 0.5) / 0.5, 0, 1)
        servo_1, servo_2 = 625.0 * (u[0] - m1) - 50.0 * m1d, 625.0 * (u[1] - m2) - 50.0 * m2d
        return np.array([w, (spring - (d + viscous) * w) / inertia, m1d, servo_1, m2d, servo_2])

    t = np.arange(0.0, 1.5, 0.02)
    commands = np.stack([0.6 * np.sin(5.0 * t) + 0.3, 0.8 + 0.5 * np.sin(9.0 * t), 0.5 + 0.6 * np.sin(7.0 * t)], axis=1)
    x, h, reference = np.array([0.1, 0.0, 0.3, 0.0, 0.8, 0.0]), 2.5e-4, []
    for k in range(6000):
        u = commands[min(int(k * h / 0.02 + 1e-9), len(commands) - 1)]
        if k % 4 == 0:
            reference.append(x[0])
        k1 = rate(x, u)
        k2 = rate(x + 0.5 * h * k1, u)
        k3 = rate(x + 0.5 * h * k2, u)
        x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + rate(x + h * k3, u))
    units = {"equilibrium": "rad", "preset": "rad", "damping": "-"}
    held = Signals(t, dict(zip(units, commands.T, strict=True)), units, frozenset(units))
    plant = JointPlant.from_device(load_device("maccepavd"))
    q = simulate(plant, held, 1.499, RATE, initial=InitialConditions((0.1, 0.3, 0.8, 0.0, 0.0, 0.0))).truth["q"]
    assert np.ptp(q) > 0.3
    assert np.max(np.abs(q - reference)) < 1e-6


def test_transmission_damper_conserves_momentum():
    joint = device(
        "flexible",
        "{inertia: 0.02, viscous_friction: 0.0}",
        "motors: [{inertia: 0.01, viscous_friction: 0.0}]\n"
        "springs: [{law: linear, stiffness: 10.0, max_deflection: 3.0}]\n"
        "damper: {site: transmission, map: linear, minimum: 0.0, maximum: 2.0}",
    )
    commands = np.zeros((1000, N_COMMANDS))
    commands[:, 2] = 0.5
    x = motion(JointPlant.from_device(joint), commands, initial=(0.0, 0.0, 0.0, 3.0, 0.0, 0.0))
    momentum = 0.02 * x[:, 3] + 0.01 * x[:, 4]
    assert np.allclose(momentum, 0.06, rtol=0, atol=1e-8)
    assert x[-1, 3] == pytest.approx(x[-1, 4], abs=1e-3)  # the damper has brought both to one speed


def test_substeps_resolve_a_strong_transmission_damper():
    """Relative velocity of two inertias decays as exp(-d (1/M + 1/B) t), here with a rate of 2 per ms; weak spring."""
    joint = device(
        "flexible",
        "{inertia: 0.02, viscous_friction: 0.0}",
        "motors: [{inertia: 0.01, viscous_friction: 0.0}]\n"
        "springs: [{law: linear, stiffness: 1.0e-6, max_deflection: 3.0}]\n"
        "damper: {site: transmission, map: linear, minimum: 0.0, maximum: 13.333333333333334}",
    )
    commands = np.zeros((10, N_COMMANDS))
    commands[:, 2] = 1.0
    x = motion(JointPlant.from_device(joint), commands, initial=(0.0, 0.0, 0.0, 3.0, 0.0, 0.0))
    assert x[:, 3] - x[:, 4] == pytest.approx(3.0 * np.exp(-2.0 * np.arange(11)), abs=2e-4)


def test_right_hand_side_is_pure_and_matches_the_integrator():
    plant = JointPlant.from_device(antagonistic())
    state, inputs = np.array([0.1, 0.3, -0.2, 0.5, 1.0, -1.0]), np.array([0.5, -0.3, 0.0, 0.2])
    rate = plant.derivative(state, inputs)
    commands = np.array([[0.5, -0.3, 0.0, 0.2, 0.0, 0.0]])
    row = plant.at_rate(1e6)
    x = initial_state(plant, 1e6, state, 0)
    run(row, IDEAL.row(), x, commands, np.empty((2, 9)), np.empty((2, 16)))
    assert np.allclose((x[:6] - state) * 1e6, rate, rtol=1e-3, atol=1e-3)
    assert np.array_equal(plant.derivative(state, inputs), rate)


def test_substeps_increase_with_stiffness_up_to_a_limit():
    soft, hard = flexible(10.0), flexible(1e5)
    row = JointPlant.from_device(soft).at_rate(RATE)
    assert row[P.substeps] == 1.0
    assert substeps_for(JointPlant.from_device(hard).at_rate(RATE), hard) > 10.0
    with pytest.raises(ParameterError, match="at most 4096"):
        JointPlant.from_device(flexible(1e14)).at_rate(RATE)


@pytest.mark.parametrize("name", ["qbmove_b", "dlr_bavs", "vsa2", "cubic_demo"])
def test_spring_laws_continue_along_their_tangent_beyond_the_stop(name):
    joint = load_device(name)
    plant, spring = JointPlant.from_device(joint), joint.springs[0]
    row = plant.at_rate(RATE)
    for side in (-1.0, 1.0):
        stop, beyond = side * spring.max_deflection, side * 0.5
        truth = np.empty((1, 16))
        run(row, IDEAL.row(), initial_state(plant, RATE, (stop + beyond, 0, 0, 0, 0, 0), 0), np.empty((0, N_COMMANDS)),
            np.empty((1, 9)), truth)  # fmt: skip
        slope = float(spring.stiffness(stop))
        torque = float(spring.torque(stop)) + slope * beyond
        assert truth[0, TRUTH.transmission_torque_1] == pytest.approx(torque, rel=1e-12)
        assert truth[0, TRUTH.stiffness_1] == pytest.approx(slope, rel=1e-12)


@pytest.mark.parametrize("joint", [flexible(), antagonistic(), rigid(), serial_servo(), positioned()])
def test_the_short_kernel_gives_the_bits_of_the_full_one(joint):
    """`run` takes the kernel without rare terms for joints that lack them."""
    nominal, sent = JointPlant.from_device(joint), np.zeros((60, N_COMMANDS))
    sent[:, :4] = 0.3 * np.sin(0.2 * np.arange(60)[:, None] + np.arange(4))
    plants = [nominal]
    for name in EFFECTS:
        plants += [nominal.with_effects([Effect(name, site, SIZES[name], i)]) for site, i in places(name, joint)]
    short = 0
    for plant in plants:
        row = plant.at_rate(1000.0)
        short += is_smooth(row)
        states = [initial_state(plant, 1000.0, (0.1, 0.0, 0.0, 0.5, 0.2, -0.2), 1) for _ in range(2)]
        rows = [(np.empty((61, 9)), np.empty((61, 16))) for _ in range(2)]
        run(row, IDEAL.row(), states[0], sent, *rows[0])
        run_in(row, EVERYTHING, IDEAL.row(), states[1], sent, *rows[1])
        for mine, full in zip((states[0], *rows[0]), (states[1], *rows[1]), strict=True):
            assert np.array_equal(mine, full, equal_nan=True), plant.effects
    assert (short > 0) == (joint.drive == "torque")


def nominal(name):
    return JointPlant.from_device(load_device(name)).parameters


@pytest.mark.parametrize("sensors", [IDEAL, Sensors(link_noise=1e-3, motor_noise=1e-3, motor_quantum=1e-4)])
@pytest.mark.parametrize("name", sorted(name for name in device_names() if is_smooth(nominal(name))))
def test_the_short_kernel_of_each_device_gives_the_bits_of_the_full_one(name, sensors):
    """Beyond the stops of springs too, and for longer than the kernels remember commands and motion."""
    joint = JointPlant.from_device(load_device(name))
    row, sent = joint.at_rate(1000.0), np.zeros((250, N_COMMANDS))
    sent[:] = 0.5 * np.sin(0.2 * np.arange(len(sent))[:, None] + np.arange(N_COMMANDS))
    assert structure_of(row, sensors.row()).rest is None
    results = []
    for has in (structure_of(row, sensors.row()), EVERYTHING):
        state = initial_state(joint, 1000.0, (1.5, 0.0, 0.0, 0.5, 0.2, -0.2), 1)
        rows = np.empty((len(sent) + 1, 9)), np.empty((len(sent) + 1, 16))
        run_in(row, has, sensors.row(), state, sent, *rows)
        results.append((state, *rows))
    for short, full in zip(*results, strict=True):
        assert np.array_equal(short, full, equal_nan=True)


@pytest.mark.parametrize("slot", ["coupling", "stiffness_rate", "delay", "ripple_amplitude", "saturation", "skew"])
def test_a_joint_with_any_slot_that_short_kernels_do_not_read_is_not_smooth(slot):
    row = nominal("cubic_demo").copy()
    assert is_smooth(row)
    row[getattr(P, slot)] = 0.01
    assert not is_smooth(row)
