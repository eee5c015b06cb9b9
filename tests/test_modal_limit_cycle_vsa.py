"""The modal limit cycle on the simulated 4-dof arm of flexible joints, torques held for a millisecond."""

from dataclasses import replace

import numpy as np
import pytest
from via_bringup.control.arm_run import PERIOD
from via_bringup.control.limit_cycle import ARM, LEVEL, CycleCourse, cycling, in_modes, law_of, start
from via_bringup.control.limit_cycle import EQUILIBRIUM as REST
from via_controllers.contract import ArmSample
from via_controllers.modal_limit_cycle_vsa import VsaModalLimitCycle
from via_core.errors import ParameterError
from via_sim.arm import ArmState, arm_step

STILL, NO_SENSOR = np.zeros(4), np.full(4, np.nan)


def sample_of(body: ArmState) -> ArmSample:
    return ArmSample(0.0, body.q, body.velocity, body.theta, body.motor_velocity, NO_SENSOR)


def run(law: VsaModalLimitCycle, duration: float, noise: float = 0.0) -> CycleCourse:
    """The law on the arm; `noise` [N m] is the standard deviation of its torque sensors."""
    course = cycling(law, duration, torque_noise=noise)
    assert course.saturated == 0.0
    return in_modes(law, course)


@pytest.mark.parametrize("mode", [0, 1])
def test_the_cycle_on_flexible_joints(mode):
    """Number 2: H within 2e-3, leak below 1e-4, 2 % after 1.2 s, frequency within .5 %."""
    course = run(law_of(mode), 3.0)
    assert abs(course.H[0]) > 0.5
    assert np.abs(course.H[course.late]).max() < 2e-3
    assert course.leak[course.late].max() < 1e-4
    assert np.abs(course.H[round(1.2 / PERIOD) :]).max() < 0.02
    frequency, linear = course.frequencies()
    assert frequency == pytest.approx(linear, rel=5e-3)


@pytest.mark.parametrize("mode", [0, 1])
def test_noise_of_torque_sensors_stays_small(mode):
    course = run(law_of(mode), 3.0, noise=0.05)
    assert 1e-4 < course.leak[course.late].max() < 2e-3


def test_without_feed_forward_the_cycle_is_missed(monkeypatch):
    """(107) with tau_ed' = tau_ed'' = 0: the springs lag behind."""
    law = law_of(0)
    whole = VsaModalLimitCycle.reference

    def held(self, *args):
        found = whole(self, *args)
        return replace(found, rate=STILL, second=STILL)

    monkeypatch.setattr(VsaModalLimitCycle, "reference", held)
    course = run(law, 3.0)
    assert np.abs(course.H[course.late]).max() > 0.02


def test_derivatives_of_the_reference_are_those_along_the_motion():
    """Against the reference itself, followed along the simulated motion."""
    law, h = law_of(0), 1e-4

    def seen(body):
        return sample_of(body), law.cycle.at(law.cycle.init(body.q), body.q, body.velocity)

    bodies = [start(law)]
    for _ in range(2):
        bodies.append(arm_step(ARM, bodies[-1], ARM.gravity(REST), STILL, h))
    torques = [-seen(body)[1].torque for body in bodies]
    sample, motion = seen(bodies[1])
    reference = law.reference(motion, sample, law.tracking.observed(sample))
    assert reference.torque == pytest.approx(torques[1])
    rate, second = (torques[2] - torques[0]) / (2 * h), (torques[2] - 2 * torques[1] + torques[0]) / h**2
    assert reference.rate == pytest.approx(rate, abs=2e-3 * np.abs(rate).max())
    assert reference.second == pytest.approx(second, abs=2e-3 * np.abs(second).max())


def test_blind_samples_are_answered_with_nothing():
    law = law_of(0)
    sample = ArmSample(0.0, REST, STILL, REST, STILL, NO_SENSOR)
    state = law.init(sample)
    for broken in ({"theta": np.array([0.2, np.nan, 0.3, 1.2])}, {"time": np.nan}):
        after, out = law.step(state, replace(sample, **broken))
        assert after is state and np.array_equal(out.torque, STILL)


def test_what_the_law_tells_has_names():
    law = law_of(1)
    state = law.init(sample_of(start(law)))
    told = dict(zip([each.name for each in law.quantities], law.told(state), strict=True))
    assert told["z_2"] == pytest.approx(0.1, rel=0.02) and told["H"] == pytest.approx(0.5 * told["z_2"] ** 2)
    assert told["V"] == pytest.approx(0.5 * (told["H"] - LEVEL) ** 2)
    assert told["frequency_2"] > told["frequency_1"] > 0.3


@pytest.mark.parametrize("change", [{"spread": 0.0}, {"bandwidth": 0.0}])
def test_silly_parameters_are_refused(change):
    with pytest.raises(ParameterError):
        replace(law_of(0), **change)
