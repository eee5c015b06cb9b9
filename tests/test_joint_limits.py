"""Supervisor of a joint: limits in closed loop, holding, restarts; axes against the device and the simulator."""

from dataclasses import replace

import numpy as np
import pytest
from via_controllers.contract import Controller, JointSample, Torques
from via_controllers.joint_axes import JointAxes
from via_controllers.joints.motor_references import resting
from via_controllers.supervision.arm_limits import Limit
from via_controllers.supervision.arm_supervision import Activity
from via_controllers.supervision.hold_joint import HoldJoint
from via_controllers.supervision.joint_supervision import JointSupervisor
from via_core.devices import load_device
from via_core.errors import ParameterError
from via_sim.plants import JointPlant
from via_sim.sensors import IDEAL, Sensors
from via_sim.simulate import Simulator
from via_validation.bench.joint_limits import LATE, disturbed_run, faulty_supervisor, joint_limit_rows

TICK = 1e-3  # [s]
QBMOVE, ELASTIC, CUBIC = (load_device(name) for name in ("qbmove_a", "visco_elastic_demo", "cubic_demo"))


class Loose(JointSupervisor):
    """Torque limits only."""

    def step(self, state, sample, active):
        after, answer = super().step(state, sample, active)
        _, out = self.controller.controller.step(round(sample.time / TICK), sample)
        limit = self.limits.arm.torque_limit
        return after, replace(answer, torque=np.clip(out.torque, -limit, limit))


def course(supervisor, device, duration, sensors=IDEAL, start=None, active=True):
    """Torques, q, theta, qd and thetad, (N, ..) each, of the simulated joint under a supervisor."""
    simulator, m, damping = Simulator(JointPlant.from_device(device), 1.0 / TICK, sensors), device.n_motors, 0.0
    body = simulator.init(seed=1)
    if start is not None:
        body = body.copy()
        body[: len(start)] = start
    state, rows = supervisor.init(), []
    for tick in range(round(duration / TICK)):
        measured, _ = simulator.sample(body)
        state, answer = supervisor.step(state, JointSample(tick * TICK, measured[0], measured[1 : 1 + m]), active)
        command = np.zeros(2)
        command[:m] = answer.torque
        body, _, _ = simulator.step(body, [*command, damping, 0.0])
        rows.append((answer.torque, body[0], body[1 : 1 + m].copy(), body[3], body[4 : 4 + m].copy(), answer.limited))
    return [np.array(column) for column in zip(*rows, strict=True)]


def held(device):
    return faulty_supervisor(device, 0)


def shares(supervisor, device, **more):
    """The largest torque, motor speed and deflection over their limits."""
    axes = supervisor.limits.arm
    torque, q, theta, _, speed, _ = course(supervisor, device, 1.5, **more)
    deflection = q[:, None] - theta
    return [
        float(np.abs(values / limit).max())
        for values, limit in (
            (torque, axes.torque_limit), (speed, axes.speed_limit), (deflection, axes.deflection_limit)
        )
    ]  # fmt: skip


def test_limits_hold_in_random_courses():
    """A thousand: `via bench limits --starts 1000`."""
    rows = joint_limit_rows(range(8))
    assert len(rows) == 2 * 13 and all(row.ok for row in rows if row.limit is not None), rows


@pytest.mark.parametrize(("device", "quantity"), [(ELASTIC, "speed"), (load_device("vsa2"), "deflection")])
def test_late_torques_that_are_not_stated_exceed_a_limit(device, quantity):
    """A fault that the rows above would show."""
    seeds = range(8)
    late = [disturbed_run(device, seed, faulty_supervisor(device, seed), LATE) for seed in seeds]
    assert max(getattr(each, quantity) for each in late) > 1.0


@pytest.mark.parametrize("device", [QBMOVE, ELASTIC], ids=lambda device: device.name)
def test_limits_hold_with_a_large_drive_share(device):
    for seed in range(2):
        supervisor = faulty_supervisor(device, seed, drive=0.9)
        assert disturbed_run(device, seed, supervisor).within
        assert not disturbed_run(device, seed, Loose(supervisor.supervisor)).within


def test_the_deflection_limit_holds_without_other_limits():
    """A motor without a speed limit, driven as far as its controller can."""
    axes = JointAxes(CUBIC)
    supervisor = faulty_supervisor(CUBIC, 1)
    supervisor = JointSupervisor.of(replace(supervisor.controller.controller, limit=5.0 * axes.torque_limit), axes)
    torque, _, deflection = shares(supervisor, CUBIC, sensors=Sensors.of_device(CUBIC))
    assert torque <= 1.0 and 0.7 < deflection <= 1.0
    assert shares(Loose(supervisor.supervisor), CUBIC)[2] > 1.0


@pytest.mark.parametrize(("device", "damping"), [(QBMOVE, 0.0), (ELASTIC, 0.5), (load_device("vsa2"), 0.0)])
def test_loads_are_those_of_the_simulator(device, damping):
    """Accelerations over a hundredth of a millisecond, with motors running."""
    quick = 1e-5
    axes, simulator = JointAxes(device, damping), Simulator(JointPlant.from_device(device), 1.0 / quick, IDEAL)
    m = device.n_motors
    q, theta, velocity, speed = 0.2, np.array([0.35, -0.1])[:m], 0.7, np.array([-0.6, 0.4])[:m]
    before = simulator.init(seed=1).copy()
    before[0], before[1 : 1 + m], before[3], before[4 : 4 + m] = q, theta, velocity, speed
    command = np.zeros(2)
    command[:m] = 0.1
    after, _, _ = simulator.step(before, [*command, damping, 0.0])
    tau_e, acceleration = axes.loads(np.full(m, q), np.full(m, velocity), theta, speed)
    assert (after[3] - velocity) / quick == pytest.approx(acceleration[0], rel=2e-3)
    dry = np.array([motor.coulomb_friction for motor in device.motors]) * np.sign(speed)
    motors = (0.1 + tau_e - axes.motor_friction * speed - dry) / axes.motor_inertia
    assert (after[4 : 4 + m] - speed) / quick == pytest.approx(motors, rel=2e-3, abs=1e-2)


@pytest.mark.parametrize("name", ["qbmove_a", "visco_elastic_demo", "vsa2", "edinburgh_vsa", "maccepavd"])
def test_springs_of_axes_are_those_of_the_device(name):
    """Also for spring laws that depend on a motor angle, with torque motors in place of servos."""
    device, motor = load_device(name), ELASTIC.motors[0]
    device = device.model_copy(update={"drive": "torque", "motors": (motor,) * device.n_motors})
    axes, random = JointAxes(device), np.random.default_rng(0)
    k, stop = device.n_transmissions, min(spring.max_deflection for spring in device.springs)
    for q in random.uniform(-0.5, 0.5, 20):
        theta = q + random.uniform(-stop, stop, axes.n)
        for each, expected in (
            (axes.spring_torque, device.torque_each),
            (axes.spring_stiffness, device.stiffness_each),
        ):
            assert each(q, theta)[:k] == pytest.approx(expected(q, theta), rel=1e-12)
            assert not each(q, theta)[k:].any()
    beyond = np.full(axes.n, 2.0 * stop)
    if device.arrangement == "flexible":
        assert axes.spring_torque(0.0, beyond) == pytest.approx(device.torque_each(0.0, np.array([stop])))


@pytest.mark.parametrize(("device", "preset"), [(QBMOVE, 0.4), (ELASTIC, 0.0), (CUBIC, 0.5)])
def test_a_joint_in_motion_comes_to_rest_where_it_was(device, preset):
    """With its preset, although its motors were at another equilibrium."""
    theta = device.motor_angles(0.3, preset)
    start = np.array([0.2, *theta, *np.zeros(2 - len(theta)), 1.0])
    _, q, motors, velocity, _, _ = course(held(device), device, 4.0, start=start, active=False)
    assert abs(velocity[-1]) < 0.01 and q[-1] == pytest.approx(0.2, abs=0.02)
    assert np.ptp(motors[-1]) == pytest.approx(np.ptp(theta), abs=0.02)


def test_gravity_is_compensated_while_a_joint_is_held():
    device = load_device("vsa2")
    theta = device.motor_angles(resting(device, 0.5, 0.4), 0.4)
    assert abs(theta.mean() - 0.5) > 0.1
    _, q, motors, _, _, _ = course(held(device), device, 1.0, start=np.array([0.5, *theta]), active=False)
    assert q == pytest.approx(0.5, abs=1e-3)
    assert motors[-1] == pytest.approx(theta, abs=1e-3)


def test_without_a_rest_angle_the_motors_are_held():
    """Beyond the springs' load: the motors hold their angles."""
    heavy = load_device("vsa2").model_copy(
        update={"link": load_device("vsa2").link.model_copy(update={"gravity_torque": 1e3})}
    )
    supervisor = held(heavy)
    state, answer = supervisor.step(supervisor.init(), JointSample(0.0, 1.0, np.array([0.9, 0.8])), False)
    assert state.inner.inner.theta == pytest.approx([0.9, 0.8])
    assert np.isfinite(answer.torque).all() and answer.activity is Activity.HOLDING


class Counting(Controller[int]):
    """Counts its samples."""

    quantities = ()

    def observe(self, state):
        return np.empty(0)

    def init(self):
        return 0

    def step(self, state, sample):
        return state + 1, Torques(np.full(2, 1e-3), False)


def test_controllers_and_velocities_restart_when_their_state_is_outdated():
    begun = [10]
    supervisor = JointSupervisor.of(Counting(), JointAxes(QBMOVE), initial=lambda: begun[0])
    state, seen = supervisor.init(), []

    def at(time, q, active=True):
        nonlocal state
        state, answer = supervisor.step(state, JointSample(time, q, np.zeros(2)), active)
        seen.append((answer.activity, state.inner.inner if answer.activity is Activity.ACTIVE else None))

    at(0.000, 0.0)
    at(0.001, 0.001)
    assert 0.0 < state.velocities[0] < 1.0 and not state.velocities[1:].any()
    at(0.002, np.nan)
    assert state.time == 0.001  # unchanged
    at(0.003, 0.003)
    begun[0] = 20
    state = supervisor.updated(state, lambda inner: inner + 100)
    at(0.004, 0.004)
    at(0.050, 0.004)  # a gap
    assert not state.velocities.any()
    at(0.051, 0.004, active=False)
    state = supervisor.updated(state, lambda inner: inner + 100)  # no effect: the controller is not active
    at(0.052, 0.004)
    at(0.040, 0.004)  # backward
    active, passive, holding = Activity.ACTIVE, Activity.PASSIVE, Activity.HOLDING
    assert seen == [
        (active, 11), (active, 12), (passive, None), (active, 13), (active, 114), (active, 21), (holding, None),
        (active, 21), (active, 21),
    ]  # fmt: skip


def test_supervision_does_not_change_the_controller():
    """Away from the limits, torques and quantities are the same."""
    supervisor = JointSupervisor.of(Counting(), JointAxes(QBMOVE))
    _state, answer = supervisor.step(supervisor.init(), JointSample(0.0, 0.1, np.array([0.1, 0.1])), True)
    assert answer.torque.tolist() == [1e-3, 1e-3] and answer.limited == Limit.NONE


@pytest.mark.parametrize(
    "silly",
    [
        lambda: JointAxes(load_device("maccepavd")),
        lambda: JointAxes(load_device("compact_vpda")),
        lambda: HoldJoint(JointAxes(QBMOVE), damping=0.0),
        lambda: HoldJoint(JointAxes(QBMOVE), bandwidth=np.nan),
        lambda: JointSupervisor(JointSupervisor.of(Counting(), JointAxes(QBMOVE)).supervisor, 0.0),
    ],
)
def test_invalid_arguments_are_refused(silly):
    with pytest.raises(ParameterError):
        silly()
