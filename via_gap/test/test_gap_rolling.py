"""The rolling window against a bag of the same messages: the same signals, the same report, bit by bit."""

import numpy as np
from gap_logs import flexible
from via_core.bags.joints import joint_channels, recorded
from via_core.bags.reader import Columns
from via_core.wire import JOINT_STATE, SECOND, VSA_COMMAND
from via_gap.logs.rolling import RollingLog, columns_of

DEVICE = flexible()
EPOCH = 1_700_000_000 * SECOND
MILLISECOND = 1_000_000


def row(k):
    return np.array([0.1 * k, np.nan, np.nan, 0.2 * k, np.nan, 0.3 * k])  # q, two unknown, theta, unknown, tau


def filled(stamps, span, commands=()):
    rolling = RollingLog(DEVICE, span)
    for stamp, torque in commands:
        rolling.command(stamp, 2, 0.0, 0.0, 0.5, np.array([torque]))
    for k, stamp in enumerate(stamps):
        rolling.sample(stamp, row(k))
    return rolling


def as_read(stamps, commands):
    """What the reader of bags makes of the same messages."""
    stamps, count = np.array(stamps), len(stamps)
    names = np.empty(count, dtype=object)
    names[:] = [(DEVICE.link_joint, *DEVICE.motor_joints)] * count
    rows = np.array([row(k) for k in range(count)])
    fields = {"name": names, "position": rows[:, [0, 3]], "velocity": rows[:, [1, 4]], "effort": rows[:, [2, 5]]}
    states = Columns("/joint_states", JOINT_STATE, stamps, stamps, fields, True)
    channels, present = joint_channels(states, DEVICE)
    time = np.array([stamp for stamp, _ in commands])
    ones = np.ones(len(commands))
    fields = {"mode": 2 * ones, "equilibrium": 0 * ones, "preset": 0 * ones, "damping": 0.5 * ones}
    fields["motor"] = np.array([[torque] for _, torque in commands])
    return recorded(states, channels, present, Columns("/c", VSA_COMMAND, time, time, fields, True), DEVICE)


def same(ours, theirs):
    np.testing.assert_array_equal(ours.time, theirs.time)
    assert ours.channels.keys() == theirs.channels.keys()
    assert (dict(ours.units), ours.held) == (dict(theirs.units), theirs.held)
    for name, values in ours.channels.items():
        np.testing.assert_array_equal(values, theirs[name])


def test_late_and_repeated_samples_are_what_a_bag_makes_of_them():
    rng = np.random.default_rng(5)
    steps = rng.choice([-3, 0, 1, 1, 1, 2, 40], 3000)
    stamps = [EPOCH + MILLISECOND * int(each) for each in np.maximum(np.cumsum(steps), 0)]
    commands = [(EPOCH + MILLISECOND * (25 * k - 60), 0.1 * k) for k in range(200)]
    log = filled(stamps, 600.0, commands).log("live")
    read = as_read(stamps, commands[2:])  # those before the one that holds in the first sample say nothing
    same(log.measured, read.measured)
    same(log.commands, read.commands)
    assert log.dropped == (sum(r.repeated for r in read.reports), sum(r.backward for r in read.reports))
    assert min(log.dropped) > 100


def test_the_window_rolls_and_keeps_the_command_that_holds_at_its_beginning():
    stamps = [EPOCH + MILLISECOND * k for k in range(9000)]
    commands = [(EPOCH + 700 * MILLISECOND * k, float(k)) for k in range(12)]
    rolling = filled(stamps, 2.0, commands)
    assert (len(rolling), rolling.duration) == (2001, 2.0)
    log = rolling.log("live", 1.0)
    assert (len(log.measured), log.duration) == (1001, 1.0)
    assert (log.measured["q"][0], log.measured["q"][-1]) == (row(7999)[0], row(8999)[0])
    np.testing.assert_allclose(log.commands.time, [7.7 - 7.999])
    assert log.commands["motor"][0, 0] == 11.0


def test_a_clock_set_back_begins_a_new_window_and_a_late_sample_does_not():
    rolling = filled([EPOCH + MILLISECOND * k for k in range(3000)], 10.0)
    rolling.sample(EPOCH + 2990 * MILLISECOND, row(0))
    assert (len(rolling), rolling.restarts) == (3001, 0)
    rolling.sample(EPOCH, row(0))
    assert (len(rolling), rolling.restarts, rolling.newest) == (1, 1, EPOCH)
    assert rolling.log("live") is None


def test_the_first_stretch_after_a_long_pause_is_the_window():
    rolling = filled([EPOCH, EPOCH + SECOND, EPOCH + 100 * SECOND], 5.0)
    assert len(rolling) == 1


def test_columns_are_the_link_and_every_motor():
    assert columns_of(DEVICE) == ("q", "q_velocity", "tau_link", "theta_1", "theta_velocity_1", "tau_1")
