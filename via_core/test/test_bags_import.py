"""CSV recordings become bags bit by bit, or are refused with a reason that contains the number."""

import csv
import re
from pathlib import Path

import numpy as np
import pytest
import via_core
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.rosbag2 import Reader
from via_core.bags.importing import ImportReport, _nanoseconds, import_recordings
from via_core.bags.joints import joint_signals
from via_core.bags.mapping import Mapping, load_mapping, mapping_names
from via_core.bags.reader import read_bag
from via_core.bags.recording_checks import servo_response
from via_core.bags.writer import BagWriter
from via_core.devices import load_device
from via_core.errors import BagError, ImportMapError

SAMPLE = Path(via_core.__file__).parent / "samples" / "maccepavd"
WHOLE = Path(__file__).resolve().parents[2].parent / "shared" / "data" / "maccepavd"
ANOTHER_COMMAND = {"fixdamp/record/record_traj10_1.csv", "vardamp/record/record_traj2_1.csv"}
JUMP = {"constant/record/record_traj3_5.csv"}


@pytest.fixture(scope="module")
def imported(tmp_path_factory: pytest.TempPathFactory) -> ImportReport:
    return import_recordings(SAMPLE, "maccepavd", tmp_path_factory.mktemp("bags"))


def slow_table(path: Path) -> list[dict[str, float]]:
    with path.open(newline="") as file:
        return [{name: float(cell) for name, cell in row.items()} for row in csv.DictReader(file)]


def test_the_sample_carries_its_licence_and_stays_small() -> None:
    assert "Copyright (c) 2017, Fan" in (SAMPLE / "LICENSE").read_text()
    assert sum(path.stat().st_size for path in SAMPLE.rglob("*") if path.is_file()) < 600_000


def test_corrupt_runs_are_refused_for_their_own_reason(imported: ImportReport) -> None:
    assert len(imported.accepted) == 12
    assert {each.source for each in imported.refused} == ANOTHER_COMMAND | JUMP
    for each in imported.refused:
        error = next(finding for finding in each.findings if finding.severity == "error")
        assert error.check == ("angle_step" if each.source in JUMP else "servo_response")
        assert error.value > error.limit
        assert not each.bag and each.reasons[0]


def test_warnings_and_notes_are_reported(imported: ImportReport) -> None:
    spikes = [finding for each in imported.accepted for finding in each.findings if finding.check == "spikes"]
    assert len(spikes) == 12 and all(finding.severity == "warning" for finding in spikes)
    report = imported.as_dict()
    assert report["accepted"] == 12 and report["refused"] == 3
    assert [each["source"] for each in report["files"] if each["reasons"]] == [e.source for e in imported.refused]


def test_every_value_is_bit_exact(imported: ImportReport) -> None:
    for each in imported.accepted:
        bag = read_bag(each.bag)
        record = slow_table(SAMPLE / each.source)
        strategy, _, name = each.source.split("/")
        command = slow_table(SAMPLE / strategy / "command" / f"{name.removeprefix('record_').split('_')[0]}.csv")
        states, current, given_ = (
            bag[name] for name in ("/joint_states", "/maccepavd/damping_motor_current", "/maccepavd/command")
        )
        assert states.by_offset and given_.by_offset and bag.complete
        assert set(states["name"]) == {("maccepavd_shaft_joint", "maccepavd_motor_1_joint", "maccepavd_motor_2_joint")}
        exact = [[row["joint_position"], row["servo1_position"]] for row in record]
        assert states["position"][:, :2].tobytes() == np.array(exact).tobytes()
        assert np.isnan(states["position"][:, 2]).all()
        assert states["velocity"].shape[1] == states["effort"].shape[1] == 0
        assert current["data"].tolist() == [row["rege_current"] * 1e-3 for row in record]
        for field, column in (("equilibrium", "u1"), ("preset", "u2"), ("damping", "u3")):
            assert given_[field].tolist() == [row[column] for row in command]
        assert given_["sequence"].tolist() == list(range(len(command)))
        offset = int(bag.metadata["time_offset_ns"])
        assert offset == each.time_offset == max(0, -round(record[0]["header"] * 1e9))
        np.testing.assert_array_equal(states.stamp, [round(row["header"] * 1e9) + offset for row in record])
        np.testing.assert_array_equal(given_.stamp, [round(row["t"] * 1e9) + offset for row in command])


def test_order_is_by_stamp_with_commands_first(imported: ImportReport) -> None:
    rank = {"/maccepavd/command": 0, "/joint_states": 1, "/maccepavd/damping_motor_current": 2}
    for each in imported.accepted[:3]:
        messages = list(read_bag(each.bag).in_stamp_order())
        keys = [(message.log_time, rank[message.topic]) for message in messages]
        assert keys == sorted(keys)
        with Reader(each.bag) as reader:
            assert [connection.topic for connection, _, _ in reader.messages()] == [m.topic for m in messages]


def test_signals_of_the_imported_joint(imported: ImportReport) -> None:
    measured, commands, reports = joint_signals(read_bag(imported.accepted[0].bag), load_device("maccepavd"))
    assert set(measured.channels) == {"q", "theta"} and commands.held == {"equilibrium", "preset", "damping"}
    assert measured["theta"].shape == (len(measured), 2) and np.isnan(measured["theta"][:, 1]).all()
    assert [report.kept for report in reports] == [len(measured), len(commands)]


def test_the_complete_recording_if_available(tmp_path: Path) -> None:
    if not WHOLE.is_dir():
        pytest.skip("the whole recording is not beside this repository")
    report = import_recordings(WHOLE, "maccepavd", tmp_path)
    assert len(report.files) == 144
    first_repeats = {each.source for each in report.files if each.source.endswith("_1.csv")}
    jumps = {f"constant/record/record_traj{k}_5.csv" for k in (1, 2, 3, 4, 7, 8, 9, 10)}
    assert {each.source for each in report.refused} == first_repeats | jumps


def test_the_double_pendulum_if_available(tmp_path: Path) -> None:
    folder = WHOLE.parent / "dfki_double_pendulum"
    if not folder.is_dir():
        pytest.skip("the recordings are not beside this repository")
    report = import_recordings(folder, "dfki_double_pendulum", tmp_path)
    assert [each.bag.name for each in report.accepted] == [
        "dfki_20220812-055032-PM", "dfki_20220812-060143-PM", "dfki_20220812-061157-PM",
    ]  # fmt: skip
    rows = slow_table(folder / report.files[1].source)
    states = read_bag(report.files[1].bag)["/joint_states"]
    names = states["name"][0]
    for column, field, joint in (("pos1", "position", "shoulder_shaft"), ("vel2", "velocity", "elbow_shaft"),
                                 ("tau2", "effort", "elbow_motor_1")):  # fmt: skip
        values = states[field][:, names.index(f"dfki_{joint}_joint")]
        assert values.tolist() == [row[column] for row in rows]


def planted(folder: Path, **changes: object) -> Path:
    """A valid run of the robot, except for `changes` to its columns."""
    device = load_device("maccepavd")
    rng = np.random.default_rng(1)
    time = np.arange(300) * 0.005
    command_time = np.arange(75) * 0.02
    u1 = np.where(command_time < 0.5, 0.2, 0.8)
    servo = servo_response(time, command_time, u1, 0.2, device.motors[0].bandwidth)
    columns = {"": np.arange(300), "header": time, "joint_position": servo + 0.001 * rng.normal(size=300),
               "rege_current": np.zeros(300), "servo1_position": servo, "servo2_position": np.zeros(300),
               "servo_current": np.zeros(300)}  # fmt: skip
    columns |= changes
    record, command = folder / "planted" / "record", folder / "planted" / "command"
    record.mkdir(parents=True)
    command.mkdir()
    write_csv(record / "record_traj1_1.csv", {k: v for k, v in columns.items() if v is not None})
    write_csv(command / "traj1.csv", {"t": command_time, "u1": u1, "u2": 0 * u1, "u3": 0 * u1})
    return folder


def write_csv(path: Path, columns: dict[str, object]) -> None:
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(zip(*([repr(float(value)) for value in column] for column in columns.values())))


def only_report(folder: Path, out: Path):
    (report,) = import_recordings(folder, "maccepavd", out).files
    return report


def test_a_planted_run_is_accepted_without_findings(tmp_path: Path) -> None:
    report = only_report(planted(tmp_path / "in"), tmp_path / "out")
    assert report.accepted and report.findings == ()
    assert (report.samples, report.commands, report.time_offset) == (300, 75, 0)


@pytest.mark.parametrize(("size", "refused"), [(0.02, False), (0.3, True)])
def test_an_angle_step_is_refused_above_the_physical_limit(tmp_path: Path, size: float, refused: bool) -> None:
    time = np.arange(300) * 0.005
    angle = 0.3 * np.sin(4 * time) + size * (time > 0.7)
    report = only_report(planted(tmp_path / "in", joint_position=angle), tmp_path / "out")
    assert report.accepted is not refused
    if refused:
        (error,) = report.findings
        assert error.check == "angle_step" and error.value == pytest.approx(size, abs=0.02)
        assert "at 0.695 s" in error.text


def test_one_angle_step_of_a_joint_at_rest_is_refused(tmp_path: Path) -> None:
    angle = 0.2 * (np.arange(300) > 140)
    report = only_report(planted(tmp_path / "in", joint_position=angle), tmp_path / "out")
    assert [finding.check for finding in report.findings] == ["angle_step"] and not report.accepted


def test_an_impact_is_not_an_angle_step(tmp_path: Path) -> None:
    time = np.arange(300) * 0.005
    bounce = 0.5 - np.abs(10.0 * (time - 0.7)).clip(max=1.0)  # speed turns from 10 to -10 rad/s within one sample
    assert only_report(planted(tmp_path / "in", joint_position=bounce), tmp_path / "out").accepted


def test_a_servo_off_its_command_is_refused(tmp_path: Path) -> None:
    time = np.arange(300) * 0.005
    other = np.where(time < 0.5, 0.2, 0.75)
    report = only_report(planted(tmp_path / "in", servo1_position=other), tmp_path / "out")
    assert not report.accepted and "recorded under another command" in report.reasons[0]
    assert report.findings[0].value == pytest.approx(0.05, abs=0.01)


def test_spikes_and_stale_stretches_are_warnings_with_their_share(tmp_path: Path) -> None:
    device = load_device("maccepavd")
    time = np.arange(300) * 0.005
    command_time = np.arange(75) * 0.02
    servo = servo_response(time, command_time, np.where(command_time < 0.5, 0.2, 0.8), 0.2, device.motors[0].bandwidth)
    servo[[20, 50, 250]] = 3.0
    servo[100:112] = servo[100]
    report = only_report(planted(tmp_path / "in", servo1_position=servo), tmp_path / "out")
    found = {finding.check: finding.value for finding in report.findings}
    assert report.accepted and set(found) == {"spikes", "stale"}
    assert found["spikes"] >= 3 / 300 and found["stale"] == pytest.approx(12 / 300)


@pytest.mark.parametrize(
    ("changes", "check", "accepted"),
    [
        ({"header": np.r_[np.arange(299), np.nan] * 0.005}, "stamps", True),
        ({"header": np.r_[np.arange(200), np.arange(100)] * 0.005}, "stamps", False),
        # less than two seconds in all: the link of this run is its servo, which the check of motion would refuse
        ({"header": np.arange(300) * 0.005 + 0.4 * (np.arange(300) > 150)}, "gap", True),
        ({"rege_current": np.r_[np.zeros(299), np.inf]}, "infinite", False),
        ({"rege_current": np.r_[np.zeros(299), np.nan]}, "not_measured", True),
        ({"joint_position": np.full(300, np.nan)}, "not_measured", False),
    ],
)
def test_stamps_and_missing_values(tmp_path: Path, changes: dict, check: str, accepted: bool) -> None:
    report = only_report(planted(tmp_path / "in", **changes), tmp_path / "out")
    assert report.accepted is accepted
    assert check in {finding.check for finding in report.findings}


def test_bad_stamps_are_left_out_of_the_bag_and_counted(tmp_path: Path) -> None:
    header = np.arange(300) * 0.005
    header[150] = header[148]
    report = only_report(planted(tmp_path / "in", header=header), tmp_path / "out")
    assert report.samples == 299 and report.findings[0].text.startswith("1 of 300 stamps")
    assert len(read_bag(report.bag)["/joint_states"]) == 299


def test_unknown_and_missing_columns_are_both_named(tmp_path: Path) -> None:
    folder = planted(tmp_path / "in", joint_position=None, joint_angle=np.zeros(300))
    with pytest.raises(ImportMapError, match=r"unknown columns: 'joint_angle'; missing columns: 'joint_position'"):
        import_recordings(folder, "maccepavd", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_one_file_with_other_columns_is_refused_and_the_rest_imported(tmp_path: Path) -> None:
    folder = planted(tmp_path / "in")
    (folder / "planted" / "record" / "record_traj1_2.csv").write_text("time;angle\n0;1\n")
    good, bad = import_recordings(folder, "maccepavd", tmp_path / "out").files
    assert good.accepted and not bad.accepted
    assert "missing columns" in bad.reasons[0] and "unknown columns: 'time;angle'" in bad.reasons[0]


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("", "is empty"),
        (",header,joint_position,rege_current,servo1_position,servo2_position,servo_current\n1,2\n", "line 2 has 2"),
        (",header,joint_position,rege_current,servo1_position,servo2_position,servo_current\n" + "1," * 6 + "x\n", ""),
        (",header,joint_position,rege_current,servo1_position,servo2_position,servo_current\n0,0,two,0,0,0,0\n",
         "line 2, column 'joint_position': 'two' is not a number"),
        (",header,joint_position,rege_current,servo1_position,servo2_position,servo_current\n", "only 0 samples"),
    ],
)  # fmt: skip
def test_damaged_tables_are_refused_one_by_one(tmp_path: Path, content: str, reason: str) -> None:
    folder = planted(tmp_path / "in")
    (folder / "planted" / "record" / "record_traj1_2.csv").write_text(content)
    good, bad = import_recordings(folder, "maccepavd", tmp_path / "out").files
    assert good.accepted and not bad.accepted and reason in bad.reasons[0]


def test_missing_commands_are_a_reason(tmp_path: Path) -> None:
    folder = planted(tmp_path / "in")
    (folder / "planted" / "command" / "traj1.csv").unlink()
    assert "its commands planted/command/traj1.csv are missing" in only_report(folder, tmp_path / "out").reasons


def test_an_interrupted_import_leaves_finished_bags_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write = BagWriter.write
    calls = []

    def interrupted(self: BagWriter, *args: object, **kwargs: object) -> None:
        calls.append(args)
        if len(calls) == 1800:
            raise KeyboardInterrupt
        write(self, *args, **kwargs)

    monkeypatch.setattr(BagWriter, "write", interrupted)
    with pytest.raises(KeyboardInterrupt):
        import_recordings(SAMPLE, "maccepavd", tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["constant_traj1_3", "constant_traj2_3"]
    assert all(read_bag(path).complete for path in tmp_path.iterdir())
    monkeypatch.setattr(BagWriter, "write", write)
    with pytest.raises(BagError, match="constant_traj1_3 exists already"):
        import_recordings(SAMPLE, "maccepavd", tmp_path)


def test_remains_of_a_killed_import_are_removed(tmp_path: Path) -> None:
    left = tmp_path / "out" / ".importing" / "planted_traj1_1"
    left.mkdir(parents=True)
    (left / "planted_traj1_1_0.mcap.active").write_bytes(b"begun")
    report = only_report(planted(tmp_path / "in"), tmp_path / "out")
    assert read_bag(report.bag).complete
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["planted_traj1_1"]


def test_nothing_to_import_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(ImportMapError, match="no file in"):
        import_recordings(tmp_path, "maccepavd", tmp_path / "out")
    with pytest.raises(ImportMapError, match="no folder"):
        import_recordings(tmp_path / "nowhere", "maccepavd", tmp_path / "out")
    with pytest.raises(ImportMapError, match="no mapping 'nobody'"):
        import_recordings(tmp_path, "nobody", tmp_path / "out")


def test_shipped_mappings_load_and_wrong_ones_name_the_key(tmp_path: Path) -> None:
    assert {"maccepavd", "dfki_double_pendulum"} <= set(mapping_names())
    whole = load_mapping("maccepavd").model_dump(exclude_none=True)
    cases = [
        ({"recordings": {**whole["recordings"], "time": {"column": "header", "unit": "rad"}}}, "recordings.time.unit"),
        ({"recordings": {**whole["recordings"], "bag": "{nobody}"}}, "no plain name of a group of recordings.pattern"),
        ({"recordings": {**whole["recordings"], "pattern": "("}}, "not a regular expression"),
        ({"recordings": {**whole["recordings"], "ignore": {"header": "twice"}}}, "mapped twice: 'header'"),
        ({"device": None}, "needs a device"),
        ({"colour": "red"}, "colour"),
    ]
    for change, words in cases:
        path = tmp_path / "wrong.yaml"
        path.write_text(yaml.safe_dump(yaml.safe_load(yaml.safe_dump(_plain({**whole, **change})))))
        with pytest.raises(ImportMapError, match=r"wrong\.yaml") as error:
            load_mapping(path)
        assert words in str(error.value)
        assert not re.search("Value error|Input should|Field required|Extra inputs", str(error.value))
    (tmp_path / "wrong.yaml").write_text("a: [")
    with pytest.raises(ImportMapError, match="line 1 expected the node content"):
        load_mapping(tmp_path / "wrong.yaml")


def _plain(value: object) -> object:
    if isinstance(value, dict):
        return {key: _plain(each) for key, each in value.items() if each is not None or key == "device"}
    return [_plain(each) for each in value] if isinstance(value, list | tuple) else value


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32), start=st.integers(-(10**10), 10**18), missing=st.sets(st.integers(0, 149)))
def test_two_joints_of_a_robot_without_device_file(
    tmp_path_factory: pytest.TempPathFactory, seed: int, start: int, missing: set[int]
) -> None:
    bits = np.random.default_rng(seed).integers(0, 2**63, size=150, dtype=np.uint64)
    values = bits.view(np.float64).copy()
    values[~np.isfinite(values)] = 5e-324
    values[sorted(missing)] = np.nan
    values = values.reshape(50, 3)
    folder = tmp_path_factory.mktemp("in")
    mapping = Mapping.model_validate(
        {
            "title": "planted", "source": ["this test"],
            "recordings": {
                "pattern": r"(?P<run>\w+)\.csv", "bag": "{run}", "time": {"column": "t", "unit": "s"},
                "joints": [{"column": "a", "joint": "one", "quantity": "position", "unit": "rad"},
                           {"column": "b", "joint": "two", "quantity": "effort", "unit": "N m"}],
                "scalars": [{"column": "c", "topic": "/extra", "unit": "V"}],
            },
        }
    )  # fmt: skip
    time = start * 1e-9 + np.arange(len(values)) * 0.01
    write_csv(folder / "run.csv", {"t": time, **dict(zip("abc", values.T))})
    (report,) = import_recordings(folder, mapping, folder / "out").files
    if not report.accepted:
        assert np.isnan(values).all(axis=0).any()
        return
    bag = read_bag(report.bag)
    states = bag["/joint_states"]
    assert states["position"][:, 0].tobytes() == values[:, 0].tobytes()
    assert states["effort"][:, 1].tobytes() == values[:, 1].tobytes()
    assert np.isnan(states["position"][:, 1]).all() and np.isnan(states["effort"][:, 0]).all()
    np.testing.assert_array_equal(bag["/extra"]["data"], values[:, 2])
    assert states.stamp[0] >= 0 and np.all(np.diff(states.stamp) > 0)


def test_nanoseconds_of_epoch_times_keep_their_precision() -> None:
    time = np.array([-0.0017590522766113281, 0.0, 1700000000.1234567, 1e-9])
    expected = [-1759052, 0, 1700000000 * 10**9 + round((1700000000.1234567 - 1700000000) * 1e9), 1]
    assert _nanoseconds(time).tolist() == expected
