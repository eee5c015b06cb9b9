"""The default estimator on qbmove_a, whose torque noise exceeds the spring torques: link equation, payload, contact."""

from dataclasses import replace

import numpy as np
import pytest
from via_core.devices import load_device
from via_core.signals import Signals
from via_core.status import Status
from via_estimators.methods import estimator_for
from via_sim.plants import JointPlant
from via_sim.sensors import Sensors
from via_sim.simulate import InitialConditions, simulate
from via_validation.compare.experiment import LEVELS, RATE, motion_of, seen_by_estimators

DEVICE, LEVEL, DURATION = load_device("qbmove_a"), LEVELS[2], 12.0
SENSORS = Sensors(link_quantum=LEVEL.quantum, motor_quantum=LEVEL.quantum, torque_noise=LEVEL.torque_noise)


@pytest.fixture(scope="module")
def torques():
    return motion_of(DEVICE, True, DURATION).torques


def run(torques, force=lambda t: 0.0 * t, **link):
    """Relative errors and standard deviations after 4 s, where OK; `link` replaces entries of the device's link."""
    time = torques.time
    commands = Signals(
        time, {"motor": torques["motor"], "external_torque": force(time)}, {"motor": "N m", "external_torque": "N m"},
        frozenset({"motor", "external_torque"}),
    )  # fmt: skip
    plant = JointPlant.from_device(DEVICE.model_copy(update={"link": DEVICE.link.model_copy(update=link)}))
    found = simulate(plant, commands, DURATION, RATE, SENSORS, InitialConditions(seed=3))
    estimates = estimator_for(seen_by_estimators(DEVICE, LEVEL)).run(found.measured)
    value, sd = estimates.column("stiffness")
    truth = found.truth["stiffness"]
    good = (estimates.status == Status.OK) & (estimates.time > 4.0)
    assert good.sum() > 0.6 * RATE * (DURATION - 4.0)
    size = np.sqrt(np.mean(truth[good] ** 2))
    return (value - truth)[good] / size, sd[good] / size


def test_the_link_equation_makes_the_default_precise(torques):
    """The motor equations alone determine this stiffness to 4 to 6 %."""
    error, sd = run(torques)
    assert np.sqrt(np.mean(error**2)) < 0.025 and np.sqrt(np.mean(sd**2)) < 0.025
    assert np.mean(np.abs(error) <= 1.96 * sd) > 0.85


@pytest.mark.parametrize(
    "link",
    [{"inertia": 0.003}, {"inertia": 0.0024, "gravity_torque": 0.03, "gravity_angle": 0.4}, {"coulomb_friction": 0.02}],
    ids=["payload", "payload with gravity", "dry friction"],
)
def test_a_payload_or_friction_that_no_file_declares_does_not_bias_the_stiffness(torques, link):
    error, sd = run(torques, **link)
    assert np.sqrt(np.mean(error**2)) < 0.04
    assert np.mean(np.abs(error) <= 1.96 * sd) > 0.85


@pytest.mark.parametrize("size", [0.01, 0.3])
def test_a_hand_on_the_link_is_in_the_interval(torques, size):
    """Pushes of up to `size` [N m] for half of the time; the springs exert about .03 N m."""
    error, sd = run(torques, lambda t: size * np.maximum(np.sin(2.2 * t), 0.0) * np.sin(5.0 * t))
    assert np.mean(np.abs(error) <= 1.96 * sd) > 0.85


def test_the_link_equation_does_not_replace_that_of_the_motors(torques):
    """All link numbers of the file 30 % too small: the scale comes from the torques."""
    estimator = estimator_for(seen_by_estimators(DEVICE, LEVEL))
    base = estimator.parameters
    wrong = estimator.with_parameters(
        replace(
            base, link_inertia_prior=0.7 * base.link_inertia_prior, link_damping_prior=0.7 * base.link_damping_prior
        )
    )
    commands = Signals(torques.time, {"motor": torques["motor"]}, {"motor": "N m"}, frozenset({"motor"}))
    found = simulate(JointPlant.from_device(DEVICE), commands, DURATION, RATE, SENSORS, InitialConditions(seed=3))
    first, second = (each.run(found.measured).column("stiffness") for each in (estimator, wrong))
    assert np.all(np.abs(first[0] - second[0])[8000:] < 0.5 * first[1][8000:])
