"""From a bag to sample rows: stamp order, exact times, commands by stamp, errors."""

import numpy as np
import pytest
from via_core.bags.definitions import typestore_of
from via_core.bags.reader import read_bag
from via_core.bags.writer import BagWriter
from via_core.devices import load_device
from via_core.errors import BagError
from via_core.status import Status
from via_core.wire import EQUILIBRIUM_PRESET, JOINT_STATE, MOTOR_POSITION, VSA_COMMAND
from via_estimators.methods import estimator_for
from via_estimators.rows import estimate_bag, sample_rows

DEVICE = load_device("maccepavd")
EPOCH = 1_700_000_000_123_456_789  # [ns]
MS = 1_000_000  # [ns]


def header(store, stamp):
    time = store.types["builtin_interfaces/msg/Time"](*divmod(stamp, 10**9))
    return store.types["std_msgs/msg/Header"](time, "maccepavd")


def written(path, samples, commands=(), link=DEVICE.link_joint):
    """A bag of samples (stamp, q, theta_1) and commands (stamp, mode, equilibrium, preset, damping), in this order."""
    states, orders = typestore_of(JOINT_STATE), typestore_of(VSA_COMMAND)
    with BagWriter(path) as bag:
        bag.add_topic("/joint_states", JOINT_STATE)
        for stamp, q, theta in samples:
            names, position = [link, DEVICE.motor_joints[0]], np.array([q, theta])
            message = states.types[JOINT_STATE](header(states, stamp), names, position, np.empty(0), np.empty(0))
            bag.write("/joint_states", bytes(states.serialize_cdr(message, JOINT_STATE)), stamp)
        if commands:
            bag.add_topic(DEVICE.command_topic, VSA_COMMAND)
        for stamp, mode, *values in commands:
            message = orders.types[VSA_COMMAND](header(orders, stamp), 0, mode, *values, np.empty(0))
            bag.write(DEVICE.command_topic, bytes(orders.serialize_cdr(message, VSA_COMMAND)), stamp)
    return read_bag(path)


def test_samples_come_in_stamp_order_with_exact_times_bad_ones_included(tmp_path):
    stamps = [EPOCH, EPOCH + 20 * MS, EPOCH + 10 * MS, EPOCH + 20 * MS, EPOCH + 30 * MS + 1]
    bag = written(tmp_path / "bag", [(stamp, float(k), np.nan) for k, stamp in enumerate(stamps)])
    stamp, rows, damping = sample_rows(bag, DEVICE, ("q", "theta_1", "equilibrium"))
    assert stamp.tolist() == sorted(stamps)
    np.testing.assert_array_equal(rows[:, 0], [0.0, 0.01, 0.02, 0.02, 30_000_001 / 1e9])
    np.testing.assert_array_equal(rows[:, 1], [0.0, 2.0, 1.0, 3.0, 4.0])
    assert np.isnan(rows[:, 2:]).all() and np.isnan(damping).all()
    _, estimates = estimate_bag(bag, DEVICE, estimator_for(DEVICE))
    assert np.flatnonzero(estimates.status == Status.BAD_SAMPLE).tolist() == [3]


def test_a_command_applies_from_its_stamp(tmp_path):
    samples = [(EPOCH + 10 * MS * k, 0.0, 0.0) for k in range(6)]
    commands = [
        (EPOCH + 10 * MS, EQUILIBRIUM_PRESET, 1.0, 0.5, 0.1),
        (EPOCH + 25 * MS, EQUILIBRIUM_PRESET, 2.0, 0.6, 0.2),
        (EPOCH + 26 * MS, EQUILIBRIUM_PRESET, np.nan, 0.6, 0.3),  # cannot be followed
        (EPOCH + 27 * MS, MOTOR_POSITION, 7.0, 7.0, 0.4),  # another mode
        (EPOCH + 50 * MS, EQUILIBRIUM_PRESET, 3.0, 0.7, 0.5),
    ]
    bag = written(tmp_path / "bag", samples, commands)
    _, rows, damping = sample_rows(bag, DEVICE, ("equilibrium", "preset"))
    np.testing.assert_array_equal(rows[:, 1], [np.nan, 1.0, 1.0, 2.0, 2.0, 3.0])
    np.testing.assert_array_equal(rows[:, 2], [np.nan, 0.5, 0.5, 0.6, 0.6, 0.7])
    np.testing.assert_array_equal(damping, [np.nan, 0.1, 0.1, 0.2, 0.2, 0.5])


def test_a_bag_without_the_device_raises(tmp_path):
    other = written(tmp_path / "other", [(EPOCH, 0.0, 0.0)], link="elbow")
    with pytest.raises(BagError, match="no joint 'maccepavd_shaft_joint' of device 'maccepavd' on /joint_states"):
        sample_rows(other, DEVICE, ("q",))
    bag = written(tmp_path / "bag", [(EPOCH, 0.0, 0.0)], [(EPOCH, EQUILIBRIUM_PRESET, 0.0, 0.0, 0.0)])
    with pytest.raises(BagError, match="is via_interfaces/msg/VsaCommand, not sensor_msgs/msg/JointState"):
        sample_rows(bag, DEVICE, ("q",), DEVICE.command_topic)
    with pytest.raises(BagError, match="/elsewhere"):
        sample_rows(bag, DEVICE, ("q",), "/elsewhere")
    with pytest.raises(BagError, match="has no column 'theta_9'"):
        sample_rows(bag, DEVICE, ("q", "theta_9"))
