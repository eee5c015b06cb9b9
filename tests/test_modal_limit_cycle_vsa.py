"""The modal limit cycle on the simulated 4-dof arm of flexible joints, torques held for a millisecond."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from via_controllers.contract import ArmSample
from via_controllers.modal_limit_cycle import ModalLimitCycle, ModalMotion
from via_controllers.modal_limit_cycle_vsa import VsaModalLimitCycle
from via_controllers.modal_transform import first_basis
from via_core.errors import ParameterError
from via_core.vsa_arms import load_vsa_arm
from via_sim.arm import ArmState, arm_step, loaded_state

ARM = load_vsa_arm("reference_4dof")
REST, STILL = np.array([0.2, 0.4, 0.3, 1.2]), np.zeros(4)
K = np.diag([100.0, 100.0, 60.0, 60.0])  # of the springs at rest
LEVEL, PERIOD, NO_SENSOR = 0.02, 1e-3, np.full(4, np.nan)


@dataclass(frozen=True)
class Course:
    """What a run of the law on the arm was like, N samples."""

    H: np.ndarray  # (N,) H / H_d - 1
    leak: np.ndarray  # (N,) the largest of the other modes, over mode k's amplitude
    z: np.ndarray  # (N,) mode k
    eigenvalue: np.ndarray  # (N,) mode k's
    saturated: bool

    @property
    def late(self) -> slice:
        return slice(len(self.H) // 2, None)

    def frequencies(self) -> tuple[float, float]:
        """Of z_k's upward zeros, and sqrt(mean lambda_k) / 2 pi over the same cycles [Hz]; late half."""
        z, values = self.z[self.late], self.eigenvalue[self.late]
        up = np.flatnonzero((z[:-1] < 0.0) & (z[1:] >= 0.0))
        zeros = (up + z[up] / (z[up] - z[up + 1])) * PERIOD
        return 1.0 / float(np.diff(zeros).mean()), float(np.sqrt(values[up[0] : up[-1]].mean())) / (2.0 * np.pi)


def law_of(mode: int) -> VsaModalLimitCycle:
    return VsaModalLimitCycle(ModalLimitCycle(ARM, REST, K, mode, 0.7, 3.0, LEVEL), bandwidth=100.0)


def start(law: VsaModalLimitCycle) -> ArmState:
    """Half of the cycle's amplitude beside the equilibrium, at rest, the springs as the law wants them."""
    cycle = law.cycle
    z = np.zeros(4)
    z[cycle.mode] = 0.1
    q = REST + first_basis(ARM.inertia(REST), K).W @ z
    motion, h = cycle.at(cycle.init(q), q, STILL), 1e-5
    ahead, behind = (cycle.at(motion.basis, q, s * motion.acceleration).torque for s in (h, -h))
    return loaded_state(ARM, q, STILL, -motion.torque, -(ahead - behind) / (2.0 * h))


def sample_of(body: ArmState, time: float = 0.0, told: np.ndarray = NO_SENSOR) -> ArmSample:
    return ArmSample(time, body.q, body.velocity, body.theta, body.motor_velocity, told)


def run(law: VsaModalLimitCycle, duration: float, noise: float = 0.0) -> Course:
    """The law on the arm; `noise` [N m] is the standard deviation of its torque sensors."""
    random, body = np.random.default_rng(1), start(law)
    state, motions, saturated = law.init(sample_of(body)), list[ModalMotion](), False
    for tick in range(round(duration / PERIOD)):
        told = NO_SENSOR
        if noise:
            told = ARM.spring_state(body.q - body.theta)[0] + random.normal(0.0, noise, 4)
        state, out = law.step(state, sample_of(body, tick * PERIOD, told))
        motions.append(state)
        saturated |= out.saturated
        body = arm_step(ARM, body, out.torque, STILL, PERIOD, substeps=2)
    z = np.array([motion.z for motion in motions])
    k = law.cycle.mode
    return Course(
        H=np.array([motion.H for motion in motions]) / LEVEL - 1.0,
        leak=np.abs(np.delete(z, k, axis=1)).max(axis=1) / np.sqrt(2.0 * LEVEL),
        z=z[:, k],
        eigenvalue=np.array([motion.basis.eigenvalues[k] for motion in motions]),
        saturated=saturated,
    )


@pytest.mark.parametrize("mode", [0, 1])
def test_the_cycle_on_flexible_joints(mode):
    """Number 2: H within 2e-3, leak below 1e-4, 2 % after 1.2 s, frequency within .5 %."""
    course = run(law_of(mode), 3.0)
    assert abs(course.H[0]) > 0.5 and not course.saturated
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
