"""Bang-bang control of simulated joints with sensors: a regular cycle at the joint's natural frequency."""

from dataclasses import replace

import numpy as np
import pytest
from via_controllers.contract import JointSample
from via_controllers.joints.bang_bang_joint import JointBangBang, hanging
from via_core.devices import load_device
from via_core.errors import ParameterError
from via_sim.plants import JointPlant
from via_sim.sensors import Sensors
from via_sim.simulate import Simulator
from via_validation.control.cycles import Cycles, relative_sd

RATE = 1000.0
ELASTIC, ANTAGONISTIC = load_device("visco_elastic_demo"), load_device("cubic_demo")
CONTROLLERS = {
    "flexible": JointBangBang(ELASTIC, 0.2, 0.0, 0.03, 0.1, 60.0, 500.0),
    "antagonistic": JointBangBang(ANTAGONISTIC, 0.1, 0.7, 0.03, 0.1, 60.0, 500.0),
}


def swings(controller: JointBangBang, push: float, duration: float = 6.0) -> tuple[np.ndarray, np.ndarray]:
    """Time [s] and q [rad] with `push` [N m] on the link for a tenth of a second, seen through the device's sensors."""
    device = controller.device
    plant = JointPlant.from_device(device)
    simulator = Simulator(plant, RATE, Sensors.of_device(device))
    m = device.n_motors
    body, state = simulator.init(seed=1), controller.init()
    seen = []
    for tick in range(round(duration * RATE)):
        measured, _ = simulator.sample(body)
        state, out = controller.step(state, JointSample(tick / RATE, measured[0], measured[1 : 1 + m]))
        torque = np.zeros(2)
        torque[:m] = out.torque
        load = push if 1.0 < tick / RATE < 1.1 else 0.0
        body, _, _ = simulator.step(body, [*torque, 0.0, load])
        seen.append(body[0])
    return np.arange(len(seen)) / RATE, np.array(seen)


@pytest.mark.parametrize("name", CONTROLLERS)
def test_a_pushed_joint_oscillates_regularly_at_its_natural_frequency(name):
    controller = CONTROLLERS[name]
    time, q = swings(controller, 1.0)
    theta = controller.device.motor_angles(controller.equilibrium, controller.preset)
    late = time > 3.0
    cycles = Cycles(time[late], q[late], hanging(controller.device, theta, controller.equilibrium))
    assert len(cycles.periods) >= 4
    assert relative_sd(cycles.periods) < 1e-2 and relative_sd(cycles.swings) < 2e-2
    assert cycles.swings.mean() > 2.0 * controller.amplitude
    stiffness = float(controller.device.stiffness(controller.equilibrium, theta))
    linear = np.sqrt(stiffness / controller.device.link.inertia) / (2.0 * np.pi)
    assert 0.95 < 1.0 / cycles.periods.mean() / linear < 1.25


@pytest.mark.parametrize("name", CONTROLLERS)
def test_without_a_push_it_rests_at_its_reference(name):
    """It starts at zero; another reference would act as a push."""
    _, q = swings(replace(CONTROLLERS[name], equilibrium=0.0), 0.0, 2.0)
    assert np.abs(q).max() < 2e-3


def test_it_hangs_where_gravity_and_springs_balance():
    device = load_device("vsa2")
    theta = device.motor_angles(0.4, 0.6)
    q = hanging(device, theta, 0.4)
    assert 0.5 * np.sin(q) + device.torque_each(q, theta).sum() == pytest.approx(0.0, abs=1e-12)
    assert 0.0 < q < 0.4


def test_without_a_rest_within_reach_of_the_springs_the_joint_is_refused():
    device = load_device("vsa2")
    pulled_away = device.model_copy(
        update={"link": device.link.model_copy(update={"gravity_torque": 500.0, "gravity_angle": 2.5})}
    )
    for refused, theta in ((pulled_away, pulled_away.motor_angles(0.4, 0.6)), (device, device.motor_angles(2.0, 0.6))):
        with pytest.raises(ParameterError, match="no rest"):
            hanging(refused, theta, 0.4)


def test_at_rest_motors_carry_the_springs_and_nothing_switches():
    controller = CONTROLLERS["antagonistic"]
    theta = controller.device.motor_angles(0.1, 0.7)
    state, out = controller.step(controller.init(), JointSample(0.0, 0.1, theta))
    assert state.switch == 0 and out.torque == pytest.approx(-controller.device.torque_each(0.1, theta))


def test_invalid_samples_give_zero_torque():
    controller = CONTROLLERS["antagonistic"]
    state, _ = controller.step(controller.init(), JointSample(0.0, 0.3, np.zeros(2)))
    after, out = controller.step(state, JointSample(1e-3, np.nan, np.zeros(2)))
    assert after is state and out.torque.tolist() == [0.0, 0.0]


@pytest.mark.parametrize(
    "change",
    [
        {"amplitude": -1.0},
        {"threshold": np.nan},
        {"bandwidth": 0.0},
        {"device": load_device("maccepavd")},
        {"device": load_device("compact_vpda")},
    ],
)
def test_invalid_parameters_are_refused(change):
    with pytest.raises(ParameterError):
        replace(CONTROLLERS["flexible"], **change)
