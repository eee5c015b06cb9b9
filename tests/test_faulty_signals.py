"""Faulty channels on simulated joints: no estimator calls their samples OK, and `via bag check` names the fault."""

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from ros_messages import CommandWriter
from via_core.bags.inspection import check
from via_core.bags.writer import BagWriter
from via_core.devices import load_device
from via_core.signals import Signals
from via_core.status import Status
from via_estimators.contract import rows_of
from via_estimators.methods import estimator_for, methods_for
from via_interfaces.msg import VsaCommand
from via_ros.conversions import Command, JointStateWriter
from via_validation.compare.faults import LATE, faults_of, moved, with_fault

MOTOR, DAMPER, SERVO = DEVICES = tuple(load_device(name) for name in ("cubic_demo", "compact_vpda", "maccepavd"))
CASES = [(device, name) for device in DEVICES for name in faults_of(device)]


@pytest.fixture(name="signals", scope="module")
def _signals():
    """Signals of each simulated device."""
    return {device.name: moved(device) for device in DEVICES}


@pytest.mark.parametrize(
    ("device", "method"), [(device, method) for device in DEVICES for method in methods_for(device)],
    ids=lambda each: each if isinstance(each, str) else each.name,
)  # fmt: skip
def test_no_method_calls_a_faulty_sample_ok(device, method, signals):
    estimator, measured = estimator_for(device, method), signals[device.name]
    sound = estimator.run(measured)
    late = sound.time > LATE
    assert np.mean(sound.status[late] == Status.OK) > 0.85 and Status.IMPLAUSIBLE not in sound.status
    for name, fault in faults_of(device).items():
        state, estimates = estimator.run_rows(rows_of(with_fault(measured, fault), estimator.inputs))
        late = estimates.time > fault.onset + LATE
        assert np.mean(estimates.status[late] == Status.OK) <= 0.05, name
        if estimates.status[-1] == Status.IMPLAUSIBLE:
            assert fault.words in estimator.fault(state), name


@pytest.mark.parametrize("name", ["link encoder frozen", "link angle reversed"])
def test_a_spring_that_may_change_does_not_explain_a_wrong_link_angle(name):
    """The light link of qbmove_a: a load factor free to vary within a second explains both faults."""
    device = load_device("qbmove_a")
    fault = faults_of(device)[name]
    estimates = estimator_for(device).run(with_fault(moved(device), fault))
    late = estimates.time > fault.onset + LATE
    assert np.mean(estimates.status[late] == Status.OK) <= 0.05


def test_a_repaired_channel_is_estimated_anew(signals):
    """After a fault the memory holds impossible rows: the estimator starts again, and its interval holds."""
    measured = signals[MOTOR.name]
    channels = {**measured.channels, "tau": np.where(np.abs(measured.time[:, None] - 2.0) < 0.5, 0.0, measured["tau"])}
    estimates = estimator_for(MOTOR).run(Signals(measured.time, channels, measured.units, measured.held))
    assert np.all(estimates.status[(estimates.time > 2.5) & (estimates.time < 5.0)] == Status.IMPLAUSIBLE)
    plain = estimator_for(MOTOR).run(measured)
    late = estimates.time > 7.0
    assert np.mean(estimates.status[late] == Status.OK) > 0.75  # outside the range visited since
    off = np.abs(estimates.column("stiffness")[0] - plain.column("stiffness")[0])[late]
    assert np.all(off < 3.0 * estimates.column("stiffness")[1][late])


def record_commands(device, measured, bag):
    commander = CommandWriter(device)
    bag.add_topic(device.command_topic, "via_interfaces/msg/VsaCommand")
    for k in range(0, len(measured), 4):
        stamp = 10**9 + round(1e9 * measured.time[k])
        angles = measured["equilibrium"][k], measured["preset"][k]
        command = Command(VsaCommand.EQUILIBRIUM_PRESET, *angles, 0.0, np.empty(0))
        bag.write(device.command_topic, serialize_message(commander.numbered(stamp, command)), stamp)


@pytest.mark.parametrize("change", ["step", "sine"])
def test_a_spring_that_changes_is_no_fault(change):
    """x 1.5 within a comparison, or 30 % at .5 Hz: tau is what the motor equation of the changed spring requires."""
    t = np.arange(6000) * 1e-3
    scale = np.where(t < 3.1, 1.0, 1.5) if change == "step" else 1.0 + 0.3 * np.sin(np.pi * t)
    q, theta = 0.3 * np.sin(5.0 * t), np.column_stack([0.7 + 0.2 * np.sin(7.0 * t), -0.7 + 0.2 * np.sin(9.0 * t)])
    motors, springs = MOTOR.motors, MOTOR.springs
    speed, bend = np.gradient(theta, t, axis=0), np.gradient(np.gradient(theta, t, axis=0), t, axis=0)
    tau = np.column_stack(
        [motors[i].inertia * bend[:, i] + motors[i].viscous_friction * speed[:, i]
         - scale * springs[i].torque(q - theta[:, i]) for i in range(2)]
    )  # fmt: skip
    measured = Signals(t, {"q": q, "theta": theta, "tau": tau}, {"q": "rad", "theta": "rad", "tau": "N m"})
    assert Status.IMPLAUSIBLE not in estimator_for(MOTOR).run(measured).status


def recorded(device, measured, folder):
    writer = JointStateWriter(device)
    with BagWriter(folder) as bag:
        bag.add_topic("/joint_states", "sensor_msgs/msg/JointState")
        if device.drive == "servo":
            record_commands(device, measured, bag)
        theta = measured.channels.get("theta", np.empty((len(measured), 0)))
        for k in range(len(measured)):
            writer.position[:] = [measured["q"][k], *theta[k]]
            if device.drive == "torque" and device.n_motors:
                writer.effort[1:] = measured["tau"][k]
            elif not device.n_motors:
                writer.effort[0] = measured["tau_link"][k]
            stamp = 10**9 + round(1e9 * measured.time[k])
            bag.write("/joint_states", serialize_message(writer.stamped(stamp)), stamp)
    return folder


@pytest.mark.parametrize(("device", "name"), CASES, ids=[f"{device.name}, {name}" for device, name in CASES])
def test_the_check_of_a_bag_names_the_fault(device, name, tmp_path, signals):
    found = check(recorded(device, with_fault(signals[device.name], faults_of(device)[name]), tmp_path / "bag"), device)
    errors = [each for each in found if each.check == "implausible"]
    assert len(errors) == 1 and errors[0].severity == "error"
    assert faults_of(device)[name].words in errors[0].text


def test_the_check_of_a_sound_bag_with_lost_samples_reports_their_number(tmp_path, signals):
    measured = signals[MOTOR.name]
    kept = np.random.default_rng(5).random(len(measured)) > 0.1
    channels = {name: values[kept] for name, values in measured.channels.items()}
    found = check(recorded(MOTOR, Signals(measured.time[kept], channels, measured.units), tmp_path / "bag"), MOTOR)
    assert [each.check for each in found if each.severity != "note"] == ["missing"]
    lost = next(each for each in found if each.check == "missing")
    assert lost.value == pytest.approx(np.mean(~kept), abs=0.002)
