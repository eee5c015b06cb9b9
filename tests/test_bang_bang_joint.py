"""The single-joint bang-bang law on simulated joints: a regular cycle at the joint's own frequency, sensors and all."""

from dataclasses import replace

import numpy as np
import pytest
from via_controllers.bang_bang_joint import JointBangBang, hanging
from via_controllers.contract import JointSample
from via_core.devices import load_device
from via_core.errors import ParameterError
from via_sim.plants import JointPlant
from via_sim.sensors import Sensors
from via_sim.simulate import Simulator
from via_validation.control.cycles import Cycles, relative_sd

RATE = 1000.0
ELASTIC, ANTAGONISTIC = load_device("visco_elastic_demo"), load_device("cubic_demo")
LAWS = {
    "flexible": JointBangBang(ELASTIC, 0.2, 0.0, 0.03, 0.1, 60.0, 500.0),
    "antagonistic": JointBangBang(ANTAGONISTIC, 0.1, 0.7, 0.03, 0.1, 60.0, 500.0),
}


def swings(law: JointBangBang, push: float, duration: float = 6.0) -> tuple[np.ndarray, np.ndarray]:
    """Time [s] and q [rad] with `push` [N m] on the link for a tenth of a second, seen through the device's sensors."""
    device = law.device
    plant = JointPlant.from_device(device)
    simulator = Simulator(plant, RATE, Sensors.of_device(device))
    m = device.n_motors
    body, state = simulator.init(seed=1), law.init()
    seen = []
    for tick in range(round(duration * RATE)):
        measured, _ = simulator.sample(body)
        state, out = law.step(state, JointSample(tick / RATE, measured[0], measured[1 : 1 + m]))
        torque = np.zeros(2)
        torque[:m] = out.torque
        load = push if 1.0 < tick / RATE < 1.1 else 0.0
        body, _, _ = simulator.step(body, [*torque, 0.0, load])
        seen.append(body[0])
    return np.arange(len(seen)) / RATE, np.array(seen)


@pytest.mark.parametrize("name", LAWS)
def test_a_pushed_joint_swings_regularly_at_its_own_frequency(name):
    law = LAWS[name]
    time, q = swings(law, 1.0)
    theta = law.device.motor_angles(law.equilibrium, law.preset)
    late = time > 3.0
    cycles = Cycles(time[late], q[late], hanging(law.device, theta, law.equilibrium))
    assert len(cycles.periods) >= 4
    assert relative_sd(cycles.periods) < 1e-2 and relative_sd(cycles.swings) < 2e-2
    assert cycles.swings.mean() > 2.0 * law.amplitude
    linear = np.sqrt(float(law.device.stiffness(law.equilibrium, theta)) / law.device.link.inertia) / (2.0 * np.pi)
    assert 0.95 < 1.0 / cycles.periods.mean() / linear < 1.25


@pytest.mark.parametrize("name", LAWS)
def test_without_a_push_it_rests_at_its_reference(name):
    """It starts at zero; a reference elsewhere would be a push of its own."""
    _, q = swings(replace(LAWS[name], equilibrium=0.0), 0.0, 2.0)
    assert np.abs(q).max() < 2e-3


def test_it_hangs_where_gravity_and_springs_agree():
    device = load_device("vsa2")
    theta = device.motor_angles(0.4, 0.6)
    q = hanging(device, theta, 0.4)
    assert 0.5 * np.sin(q) + device.torque_each(q, theta).sum() == pytest.approx(0.0, abs=1e-12)
    assert 0.0 < q < 0.4


def test_at_rest_motors_carry_the_springs_and_nothing_switches():
    law = LAWS["antagonistic"]
    theta = law.device.motor_angles(0.1, 0.7)
    state, out = law.step(law.init(), JointSample(0.0, 0.1, theta))
    assert state.switch == 0 and out.torque == pytest.approx(-law.device.torque_each(0.1, theta))


def test_blind_samples_are_answered_with_nothing():
    law = LAWS["antagonistic"]
    state, _ = law.step(law.init(), JointSample(0.0, 0.3, np.zeros(2)))
    after, out = law.step(state, JointSample(1e-3, np.nan, np.zeros(2)))
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
def test_silly_laws_are_refused(change):
    with pytest.raises(ParameterError):
        replace(LAWS["flexible"], **change)
