"""Faulty channels on simulated joints: no estimator calls their samples OK, and `via bag check` names the fault."""

from dataclasses import replace

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from via_core.bags.inspection import check
from via_core.bags.writer import BagWriter
from via_core.devices import load_device
from via_core.signals import Signals
from via_core.status import Status
from via_estimators.contract import rows_of
from via_estimators.methods import estimator_for, methods_for
from via_ros.conversions import JointStateWriter
from via_sim.plants import JointPlant
from via_sim.sensors import Sensors
from via_sim.simulate import InitialConditions, simulate

DURATION, ONSET = 8.0, 2.0  # [s]; onset of a fault that begins during the recording
RATE = 1000.0
MOTOR, DAMPER = load_device("cubic_demo"), load_device("compact_vpda")


def moved(device):
    """Measured signals of the device under torques of several tones."""
    time = np.arange(int(RATE * DURATION) + 1) / RATE
    tones = [np.sin(2.0 * np.pi * f * time + a) for f, a in ((0.7, 0.0), (1.9, 0.0), (1.1, 0.0), (2.3, 1.0))]
    if device.n_motors:
        size = np.clip(2.0 * time, 0.0, 1.0) * 0.1 * float(device.spring_laws[0].torque(1.5))
        torque = np.column_stack(
            [size * (1.0 + 0.6 * tones[0] + 0.3 * tones[1]), -size * (1.0 + 0.6 * tones[2] + 0.3 * tones[3])]
        )
        commands = Signals(time, {"motor": torque}, {"motor": "N m"}, frozenset({"motor"}))
    else:
        channels = {"external_torque": 4.0 * tones[0] + 2.0 * tones[1], "damping": np.full(len(time), 0.5)}
        commands = Signals(time, channels, {"external_torque": "N m", "damping": "-"}, frozenset(channels))
    sensors = replace(Sensors.of_device(device), velocity_noise=0.005)
    return simulate(
        JointPlant.from_device(device), commands, DURATION, RATE, sensors, InitialConditions(seed=3)
    ).measured


SIGNALS = {device.name: moved(device) for device in (MOTOR, DAMPER)}


def column(name, change):
    """A fault that applies `change` to column `name` ('tau_1') or to all columns of a channel ('tau')."""
    channel, _, number = name.rpartition("_") if name[-1].isdigit() else (name, "", "")

    def apply(channels):
        values = channels[channel].copy()
        at = (slice(None), int(number) - 1) if number else ...
        values[at] = change(values[at])
        return {**channels, channel: values}

    return apply


def freeze(values):
    onset = int(ONSET * RATE)
    return np.concatenate([values[:onset], np.broadcast_to(values[onset], values[onset:].shape)])


FAULTS = {
    MOTOR.name: {
        "sign of a torque": (column("tau_1", np.negative), "wrong sign of tau_1"),
        "sign of both torques": (column("tau", np.negative), "wrong sign of tau_1, tau_2"),
        "exchanged": (column("tau", lambda tau: tau[:, ::-1]), "tau_1 and tau_2 are exchanged"),
        "no torque": (column("tau", np.zeros_like), "zero throughout"),
        "frozen torque": (column("tau_2", freeze), "tau_2: one number repeated"),
        "frozen motor encoder": (column("theta_1", freeze), "theta_1: one number repeated"),
        "frozen link encoder": (column("q", freeze), "q: one number repeated"),
        "sign of the link angle": (column("q", np.negative), "wrong sign of q"),
        "N mm": (column("tau", lambda tau: 1e3 * tau), "in N mm"),
    },
    DAMPER.name: {
        "sign": (column("tau_link", np.negative), "wrong sign of tau_link"),
        "no torque": (column("tau_link", np.zeros_like), "zero throughout"),
        "frozen torque": (column("tau_link", freeze), "tau_link: one number repeated"),
        "frozen encoder": (column("q", freeze), "q: one number repeated"),
        "N mm": (column("tau_link", lambda tau: 1e3 * tau), "in N mm"),
    },
}
CASES = [(device, name) for device in (MOTOR, DAMPER) for name in FAULTS[device.name]]


def with_fault(device, name):
    measured = SIGNALS[device.name]
    channels = FAULTS[device.name][name][0](dict(measured.channels)) if name else measured.channels
    return Signals(measured.time, channels, measured.units, measured.held)


@pytest.mark.parametrize(
    ("device", "method"), [(device, method) for device in (MOTOR, DAMPER) for method in methods_for(device)],
    ids=lambda each: each if isinstance(each, str) else each.name,
)  # fmt: skip
def test_no_method_calls_a_faulty_sample_ok(device, method):
    estimator = estimator_for(device, method)
    sound = estimator.run(with_fault(device, ""))
    late = sound.time > 2.0
    assert np.mean(sound.status[late] == Status.OK) > 0.85 and Status.IMPLAUSIBLE not in sound.status
    for name, (_, words) in FAULTS[device.name].items():
        state, estimates = estimator.run_rows(rows_of(with_fault(device, name), estimator.inputs))
        late = estimates.time > (ONSET + 2.0 if "frozen" in name else 2.0)
        assert np.mean(estimates.status[late] == Status.OK) <= 0.05, name
        if estimates.status[-1] == Status.IMPLAUSIBLE:
            assert words in estimator.fault(state), name


def test_a_repaired_channel_is_estimated_anew():
    """After a fault the memory holds impossible rows: the estimator starts again, and its interval holds."""
    measured = SIGNALS[MOTOR.name]
    channels = {**measured.channels, "tau": np.where(np.abs(measured.time[:, None] - 2.0) < 0.5, 0.0, measured["tau"])}
    estimates = estimator_for(MOTOR).run(Signals(measured.time, channels, measured.units, measured.held))
    assert np.all(estimates.status[(estimates.time > 2.5) & (estimates.time < 5.0)] == Status.IMPLAUSIBLE)
    plain = estimator_for(MOTOR).run(measured)
    late = estimates.time > 7.0
    assert np.mean(estimates.status[late] == Status.OK) > 0.75  # outside the range visited since
    off = np.abs(estimates.column("stiffness")[0] - plain.column("stiffness")[0])[late]
    assert np.all(off < 3.0 * estimates.column("stiffness")[1][late])


def recorded(device, measured, folder):
    writer = JointStateWriter(device)
    with BagWriter(folder) as bag:
        bag.add_topic("/joint_states", "sensor_msgs/msg/JointState")
        theta = measured.channels.get("theta", np.empty((len(measured), 0)))
        for k in range(len(measured)):
            writer.position[:] = [measured["q"][k], *theta[k]]
            if device.n_motors:
                writer.effort[1:] = measured["tau"][k]
            else:
                writer.effort[0] = measured["tau_link"][k]
            stamp = 10**9 + round(1e9 * measured.time[k])
            bag.write("/joint_states", serialize_message(writer.stamped(stamp)), stamp)
    return folder


@pytest.mark.parametrize(("device", "name"), CASES, ids=[f"{device.name}, {name}" for device, name in CASES])
def test_the_check_of_a_bag_names_the_fault(device, name, tmp_path):
    found = check(recorded(device, with_fault(device, name), tmp_path / "bag"), device)
    errors = [each for each in found if each.check == "implausible"]
    assert len(errors) == 1 and errors[0].severity == "error"
    assert FAULTS[device.name][name][1] in errors[0].text


def test_the_check_of_a_sound_bag_with_lost_samples_reports_their_number(tmp_path):
    measured = SIGNALS[MOTOR.name]
    kept = np.random.default_rng(5).random(len(measured)) > 0.1
    channels = {name: values[kept] for name, values in measured.channels.items()}
    found = check(recorded(MOTOR, Signals(measured.time[kept], channels, measured.units), tmp_path / "bag"), MOTOR)
    assert [each.check for each in found if each.severity != "note"] == ["missing"]
    lost = next(each for each in found if each.check == "missing")
    assert lost.value == pytest.approx(np.mean(~kept), abs=0.002)
