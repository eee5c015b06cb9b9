"""Signals of one joint from messages, and checks of a bag."""

from pathlib import Path

import numpy as np
import pytest
from via_core.bags.definitions import typestore_of
from via_core.bags.inspection import check, info
from via_core.bags.joints import joint_signals
from via_core.bags.reader import read_bag
from via_core.bags.writer import BagWriter
from via_core.devices import Device, load_device
from via_core.errors import BagError
from via_core.wire import EQUILIBRIUM_PRESET, JOINT_STATE, MOTOR_POSITION, MOTOR_TORQUE, VSA_COMMAND

NAN = float("nan")
EPOCH = 1_700_000_000_000_000_000  # [ns]
NAMES = ["cubic_aa_vsa_shaft_joint", "cubic_aa_vsa_motor_1_joint", "cubic_aa_vsa_motor_2_joint"]


@pytest.fixture(scope="module")
def device() -> Device:
    return load_device("cubic_aa_vsa")


def joint_state(stamp: int, position: list, velocity: list, effort: list, names: list[str]) -> bytes:
    store = typestore_of(JOINT_STATE)
    header = store.types["std_msgs/msg/Header"](
        store.types["builtin_interfaces/msg/Time"](*divmod(stamp, 10**9)), "cubic_aa_vsa"
    )
    arrays = [np.array(values, dtype=float) for values in (position, velocity, effort)]
    return bytes(store.serialize_cdr(store.types[JOINT_STATE](header, names, *arrays), JOINT_STATE))


def command(stamp: int, sequence: int, mode: int, values: tuple[float, float, float], motor: list) -> bytes:
    store = typestore_of(VSA_COMMAND)
    header = store.types["std_msgs/msg/Header"](
        store.types["builtin_interfaces/msg/Time"](*divmod(stamp, 10**9)), "cubic_aa_vsa"
    )
    message = store.types[VSA_COMMAND](header, sequence, mode, *values, np.array(motor, dtype=float))
    return bytes(store.serialize_cdr(message, VSA_COMMAND))


def write(path: Path, states: list[tuple], commands: list[tuple] = ()) -> Path:
    with BagWriter(path) as bag:
        bag.add_topic("/joint_states", JOINT_STATE)
        for k, state in enumerate(states):
            bag.write("/joint_states", joint_state(*state), k)
        if commands:
            bag.add_topic("/cubic_aa_vsa/command", VSA_COMMAND)
            for k, each in enumerate(commands):
                bag.write("/cubic_aa_vsa/command", command(*each), k)
    return path


def test_values_go_to_their_channels_and_nan_stays(tmp_path: Path, device: Device) -> None:
    states = [
        (EPOCH, [1.0, 2.0, 3.0], [], [NAN, 5.0, 6.0], NAMES),
        (EPOCH + 3, [1.5, NAN, 3.5], [], [NAN, 5.5, 6.5], NAMES),
    ]
    measured, commands, (report,) = joint_signals(read_bag(write(tmp_path / "run", states)), device)
    assert set(measured.channels) == {"q", "theta", "tau"} and commands is None
    np.testing.assert_array_equal(measured["q"], [1.0, 1.5])
    np.testing.assert_array_equal(measured["theta"], [[2.0, 3.0], [NAN, 3.5]])
    np.testing.assert_array_equal(measured["tau"], [[5.0, 6.0], [5.5, 6.5]])
    assert measured.time.tolist() == [0.0, 3e-9] and report.origin == EPOCH


def test_joints_are_found_by_name_in_every_message(tmp_path: Path, device: Device) -> None:
    turned = [NAMES[2], "somebody_elses_joint", NAMES[0], NAMES[1]]
    states = [
        (0, [1.0, 2.0, 3.0], [], [], NAMES),
        (1, [3.5, 99.0, 1.5, 2.5], [], [], turned),
        (2, [7.0], [], [], ["somebody_elses_joint"]),
        (3, [1.75], [0.5], [0.25], NAMES[:1]),
    ]
    measured, _, (report,) = joint_signals(read_bag(write(tmp_path / "run", states)), device)
    np.testing.assert_array_equal(measured["q"], [1.0, 1.5, 1.75])
    np.testing.assert_array_equal(measured["theta"], [[2.0, 3.0], [2.5, 3.5], [NAN, NAN]])
    np.testing.assert_array_equal(measured["q_velocity"], [NAN, NAN, 0.5])
    np.testing.assert_array_equal(measured["tau_link"], [NAN, NAN, 0.25])
    assert (report.messages, report.others, report.kept) == (4, 1, 3)


def test_repeated_and_backward_stamps_are_dropped_and_counted(tmp_path: Path, device: Device) -> None:
    stamps = [10, 20, 20, 30, 15, 25, 30, 40]
    states = [(stamp, [float(k)] * 3, [], [], NAMES) for k, stamp in enumerate(stamps)]
    measured, _, (report,) = joint_signals(read_bag(write(tmp_path / "run", states)), device)
    np.testing.assert_array_equal(measured["q"], [0.0, 4.0, 5.0, 6.0, 7.0])  # 10, 15, 25, 30, 40: as many as possible
    assert (report.repeated, report.backward, report.kept) == (0, 3, 5)


def test_commands_use_zero_order_hold_and_the_channels_of_their_mode(tmp_path: Path, device: Device) -> None:
    states = [(k * 10, [0.0] * 3, [], [], NAMES) for k in range(5)]
    commands = [
        (-5 + 5, 0, EQUILIBRIUM_PRESET, (0.1, 0.2, 0.3), []),
        (20, 1, MOTOR_TORQUE, (NAN, NAN, 0.4), [1.0, -1.0]),
        (30, 2, EQUILIBRIUM_PRESET, (0.5, 0.6, 0.7), []),
    ]
    _, given, (_, report) = joint_signals(read_bag(write(tmp_path / "run", states, commands)), device)
    assert given.held == set(given.channels) and given.units["motor"] == "N m" and report.kept == 3
    np.testing.assert_array_equal(given["equilibrium"], [0.1, NAN, 0.5])
    np.testing.assert_array_equal(given["damping"], [0.3, 0.4, 0.7])
    np.testing.assert_array_equal(given["motor"], [[NAN, NAN], [1.0, -1.0], [NAN, NAN]])
    mixed = [*commands, (40, 3, MOTOR_POSITION, (NAN, NAN, 0.0), [1.0, 2.0])]
    with pytest.raises(BagError, match="mixes motor positions and motor torques"):
        joint_signals(read_bag(write(tmp_path / "mixed", states, mixed)), device)


def test_a_bag_of_another_robot_gives_an_error_with_its_joints(tmp_path: Path, device: Device) -> None:
    path = write(tmp_path / "run", [(0, [1.0], [], [], ["elbow"])])
    with pytest.raises(BagError, match=r"no joint 'cubic_aa_vsa_shaft_joint' .* there are: elbow"):
        joint_signals(read_bag(path), device)
    (finding,) = [each for each in check(path, device) if each.severity == "error"]
    assert finding.check == "joint" and "elbow" in finding.text


def test_check_finds_planted_errors(tmp_path: Path, device: Device) -> None:
    stamps = np.arange(400) * 1_000_000
    stamps[200:] += 50_000_000  # a gap
    stamps[100] = stamps[99]  # repeated
    stamps[300] = stamps[298] - 1  # backward
    quantum = 0.0015
    q = np.rint(0.2 * np.sin(np.arange(400) / 30) / quantum) * quantum
    states = [(int(t), [x, 0.0, NAN if k % 4 == 0 else 1.0], [], [], NAMES) for k, (t, x) in enumerate(zip(stamps, q))]
    commands = [(k * 10_000_000, s, EQUILIBRIUM_PRESET, (0.0, 0.0, 0.0), []) for k, s in enumerate([0, 1, 4, 5, 0, 1])]
    path = write(tmp_path / "run", states, commands)
    found = {(each.check, each.subject): each for each in check(path, device)}
    joints, commanded = "/joint_states", "/cubic_aa_vsa/command"
    assert found["repeated", joints].value == 1 / 400
    assert found["backward", joints].value == 1 / 400
    assert found["rate", joints].value == pytest.approx(1000.0)
    assert found["gap", joints].value == pytest.approx(0.051)
    assert found["quantised", joints].value == pytest.approx(quantum)
    assert found["not_measured", joints].value == pytest.approx(0.25) and NAMES[2] in found["not_measured", joints].text
    assert found["lost", commanded].value == 2 and found["restarted", commanded].value == 1
    assert not any(each.severity == "error" for each in found.values())


def test_check_reports_an_impossible_angle_step(tmp_path: Path, device: Device) -> None:
    q = 0.1 * np.sin(np.arange(400) / 30) + 0.2 * (np.arange(400) > 250)
    path = write(tmp_path / "run", [(k * 1_000_000, [x, x, x], [], [], NAMES) for k, x in enumerate(q)])
    (error,) = [each for each in check(path, device) if each.severity == "error"]
    assert error.check == "angle_step" and "0.250 s" in error.text


def test_info_counts(tmp_path: Path) -> None:
    states = [(EPOCH + k * 2_000_000, [0.0], [], [], ["a"]) for k in range(11)]
    path = write(tmp_path / "run", states)
    summary = info(path)
    (topic,) = summary.topics
    assert (summary.messages, summary.complete, topic.messages, topic.type_name) == (11, True, 11, JOINT_STATE)
    assert (topic.first, topic.last, topic.rate) == (EPOCH, EPOCH + 20_000_000, pytest.approx(500.0))
    assert summary.size == (path / "run_0.mcap").stat().st_size and summary.duration == pytest.approx(10e-9)
    assert info(path / "run_0.mcap").messages == 11
