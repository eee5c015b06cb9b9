"""Recordings of every format give the same numbers; units, guesses, and errors that say what to write."""

import json
import re
from math import pi
from pathlib import Path

import numpy as np
import pandas
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from scipy.io import savemat
from via_core.bags.definitions import typestore_of
from via_core.bags.importing import import_recordings
from via_core.bags.inspection import check, info
from via_core.bags.joints import StampReport, joint_signals
from via_core.bags.mapping import load_mapping
from via_core.bags.reader import read_bag
from via_core.bags.recording_checks import check_recording
from via_core.device_parts import WireColumn
from via_core.devices import load_device, parse_device
from via_core.errors import BagError, DeviceError, ImportMapError, ParameterError, SignalError
from via_core.recordings.channels import read_joint
from via_core.recordings.entries import Constants, Entries, entries_of
from via_core.recordings.guess import guess_columns, guess_time, of_joint, split_name
from via_core.recordings.mapping_text import mapping_text
from via_core.recordings.tables import is_bag, numbers, read_tables
from via_core.recordings.units import factor, is_linear, is_unit, kind
from via_core.recordings.unnamed import require_names
from via_core.signals import Signals
from via_core.wire import JOINT_STATE

N = 200
TIME = np.arange(N) * 0.004
ANGLE = 2.0 * pi / 4096 * np.rint(np.sin(3.0 * TIME) / (2.0 * pi / 4096))
SPEED, TORQUE = 3.0 * np.cos(3.0 * TIME), 2.5 * np.cos(2.0 * TIME)
DYNAMIC = "control_msgs/msg/DynamicJointState"
TRAJECTORY = "control_msgs/msg/JointTrajectoryControllerState"
DEVICE = (
    "{{name: elbow, title: t, source: [s], confidence: assumed, arrangement: rigid, drive: torque, link: "
    "{{inertia: 1.0, viscous_friction: 0.0}}, sensors: {{rate: 250.0}}, wire: {wire}}}"
)


def csv(path: Path) -> None:
    names = ["Time [ms]", "Elbow Position (deg)", "Elbow Speed (rpm)", "Elbow Torque (mNm)"]
    columns = [1e3 * TIME, np.degrees(ANGLE), SPEED * 30.0 / pi, 1e3 * TORQUE]
    lines = ["# written by a logger", ";".join(names)]
    lines += [";".join(repr(float(each)) for each in row) for row in zip(*columns, strict=True)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def parquet(path: Path) -> None:
    cells = {"stamp": (1.7e18 + 1e9 * TIME).astype(np.int64), "q": [[x] for x in ANGLE], "tau": [[x] for x in TORQUE]}
    pandas.DataFrame(cells).to_parquet(path)


def npz(path: Path) -> None:
    np.savez(path, time=TIME, qpos=ANGLE[None, :], qvel=SPEED[:, None], torque=TORQUE)


def npy(path: Path) -> None:
    np.save(path, np.rec.fromarrays([TIME, ANGLE, TORQUE], names="t,pos,effort"))


def mat(path: Path) -> None:
    savemat(
        path, {"log": {"t": TIME, "enc_counts": np.rint(ANGLE / (2.0 * pi) * 4096), "current_mA": 1e3 * TORQUE / 0.5}}
    )


def jsonl(path: Path) -> None:
    rows = zip(TIME.tolist(), ANGLE.tolist(), TORQUE.tolist(), strict=True)
    path.write_text(
        "\n".join(json.dumps({"t": t, "state": {"q": [q]}, "tau": [u]}) for t, q, u in rows), encoding="utf-8"
    )


def savetxt(path: Path) -> None:
    np.savetxt(path, np.column_stack([TIME, ANGLE, TORQUE]), header="t q tau", fmt="%.17g")


def german(path: Path) -> None:
    rows = "".join(f"{t!r};{q!r};{u!r}\n" for t, q, u in zip(*(x.tolist() for x in (TIME, ANGLE, TORQUE)), strict=True))
    path.write_text("t;pos;tau\n" + rows.replace(".", ","), encoding="utf-8")


def plain_json(path: Path) -> None:
    content = {"time": TIME.tolist(), "joints": {"elbow": {"position": ANGLE.tolist(), "effort": TORQUE.tolist()}}}
    path.write_text(json.dumps(content), encoding="utf-8")


def bag(path: Path, plugin: StoragePlugin, type_name: str = "sensor_msgs/msg/JointState") -> None:
    """Two joints per message, in the order of a driver."""
    store = typestore_of(DYNAMIC)
    types = store.types
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        topic = "/joint_states" if type_name.startswith("sensor") else "/dynamic_joint_states"
        connection = writer.add_connection(topic, type_name, typestore=store)
        for t, q, v, u in zip(TIME, ANGLE, SPEED, TORQUE, strict=True):
            stamp = 1_700_000_000 * 10**9 + round(t * 1e9)
            time = types["builtin_interfaces/msg/Time"](stamp // 10**9, stamp % 10**9)
            header, names = types["std_msgs/msg/Header"](time, ""), ["wheel", "elbow"]
            if type_name == DYNAMIC:
                of = types["control_msgs/msg/InterfaceValue"]
                values = [of(["position"], np.zeros(1)), of(["position", "velocity", "effort"], np.array([q, v, u]))]
                message = types[type_name](header, names, values)
            else:
                message = types[type_name](header, names, *(np.array([0.0, x]) for x in (q, v, u)))
            writer.write(connection, stamp, store.serialize_cdr(message, type_name))


FORMATS = {
    "run.csv": csv, "run.txt": savetxt, "comma.csv": german, "run.parquet": parquet, "run.npz": npz, "run.npy": npy,
    "run.mat": mat, "run.jsonl": jsonl,
    "run.json": plain_json, "db3": lambda path: bag(path, StoragePlugin.SQLITE3),
    "mcap": lambda path: bag(path, StoragePlugin.MCAP), "dynamic": lambda path: bag(path, StoragePlugin.MCAP, DYNAMIC),
}  # fmt: skip


def described(path: Path) -> str:
    """The device with the entries that are guessed."""
    tables = read_tables(path)
    guesses = guess_columns(tables, ["wheel", "elbow"], bag=is_bag(path))
    entries = entries_of(tables, guesses, "elbow", Constants(4096.0, 0.5), is_bag(path))
    return DEVICE.format(
        wire=json.dumps({"columns": {channel: entry for channel, (entry, _) in entries.columns.items()}})
    )


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_gives_the_same_signals(tmp_path: Path, name: str) -> None:
    FORMATS[name](tmp_path / name)
    measured, commands, _ = read_joint(tmp_path / name, parse_device(described(tmp_path / name), "d"))
    np.testing.assert_allclose(measured.time, TIME, atol=2e-9)
    np.testing.assert_allclose(measured["q"], ANGLE, atol=1e-12)
    if is_bag(tmp_path / name):  # the effort of a message acted before its stamp, the torque of a row acts after it
        assert commands is None
        np.testing.assert_allclose(measured["tau"][:, 0], TORQUE, atol=1e-12)
    else:
        assert commands is not None
        np.testing.assert_allclose(commands["external_torque"], TORQUE, atol=1e-12)
    if "q_velocity" in measured:
        np.testing.assert_allclose(measured["q_velocity"], SPEED, atol=1e-12)


@pytest.mark.parametrize("name", ["run.parquet", "dynamic"])
def test_recordings_are_checked_by_the_columns_of_their_device(tmp_path: Path, name: str) -> None:
    FORMATS[name](tmp_path / name)
    device = parse_device(described(tmp_path / name), "d")
    assert [each.text for each in check(tmp_path / name, device) if each.severity == "error"] == []
    other = parse_device(described(tmp_path / name).replace('"column": "', '"column": "no '), "d")
    assert any("no column" in each.text for each in check(tmp_path / name, other) if each.severity == "error")


def test_a_table_is_checked_only_with_its_device(tmp_path: Path) -> None:
    csv(tmp_path / "run.csv")
    with pytest.raises(BagError, match="add --device"):
        check(tmp_path / "run.csv")


@pytest.mark.parametrize("plugin", list(StoragePlugin))
def test_plain_joint_states_need_one_name_per_joint(tmp_path: Path, plugin: StoragePlugin) -> None:
    """The effort of a rigid joint is the torque of its drive; there is no second name and no sensor at the link."""
    bag(tmp_path / "run", plugin)
    device = parse_device(DEVICE.format(wire="{link: elbow, motors: [elbow]}"), "d")
    measured, _, _ = joint_signals(read_bag(tmp_path / "run"), device)
    np.testing.assert_array_equal(measured["tau"][:, 0], TORQUE)
    assert "tau_link" not in measured
    other = parse_device(DEVICE.format(wire="{}"), "d")
    with pytest.raises(Exception, match=r"write e.g. `wire: \{link: elbow, motors: \[elbow\]\}`"):
        joint_signals(read_bag(tmp_path / "run"), other)


def test_states_of_a_trajectory_controller_give_goal_and_position(tmp_path: Path) -> None:
    text = (
        "std_msgs/Header header\nstring[] joint_names\ntrajectory_msgs/JointTrajectoryPoint reference\n"
        "trajectory_msgs/JointTrajectoryPoint feedback\ntrajectory_msgs/JointTrajectoryPoint error\n"
    )
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(text, TRAJECTORY))
    types, none = store.types, np.zeros(0)
    point, still = types["trajectory_msgs/msg/JointTrajectoryPoint"], types["builtin_interfaces/msg/Duration"](0, 0)
    with Writer(tmp_path / "run", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/arm_controller/state", TRAJECTORY, typestore=store)
        for k, q in enumerate(ANGLE):
            header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](0, k * 4_000_000), "")
            goal, there, off = (point(np.array([0.0, x]), none, none, none, still) for x in (q + 0.1, q, 0.1))
            message = types[TRAJECTORY](header, ["wheel", "elbow"], goal, there, off)
            writer.write(connection, k * 4_000_000, store.serialize_cdr(message, TRAJECTORY))
    device = parse_device(described(tmp_path / "run"), "d")
    measured, commands, _ = read_joint(tmp_path / "run", device)
    np.testing.assert_array_equal(measured["q"], ANGLE)
    assert commands is not None
    np.testing.assert_array_equal(commands["equilibrium"], ANGLE + 0.1)


@pytest.mark.parametrize(
    ("unit", "value", "of"),
    [("deg", pi / 180, "angle"), ("rpm", pi / 30, "speed"), ("mm", 1e-3, "angle"), ("in", 0.0254, "angle"),
     ("N", 1.0, "torque"),
     ("lbf", 4.4482216152605, "torque"), ("mNm", 1e-3, "torque"), ("kgf cm", 0.0980665, "torque"),
     ("lbft", 1.3558179483314, "torque"),
     ("mA", 1e-3, "current"),
     ("lb", 0.45359237, ""), ("Hz", 1.0, ""), ("percent", 0.01, ""), ("degC", 274.15, ""), ("us", 1e-6, "time"),
     ("°/s", pi / 180, "speed")],
)  # fmt: skip
def test_units_in_si(unit: str, value: float, of: str) -> None:
    assert factor(unit) == pytest.approx(value, rel=1e-12) and kind(unit) == of


def test_counts_currents_and_lengths() -> None:
    assert factor("counts", 4096.0) == 2.0 * pi / 4096.0 and kind("counts/s") == "speed"
    with pytest.raises(ParameterError, match="counts_per_turn: 4096"):
        factor("ticks")
    assert is_linear("mm") and is_linear("N") and not is_linear("deg")
    assert not is_unit("9**9**9**9") and not is_unit("banana") and not is_unit("x" * 200)
    with pytest.raises(DeviceError, match="needs torque_constant"):
        parse_device(DEVICE.format(wire="{columns: {tau_1: {column: i, unit: A}}}"), "d")
    with pytest.raises(DeviceError, match="'deg' is no unit of torque"):
        parse_device(DEVICE.format(wire="{columns: {tau_1: {column: i, unit: deg}}}"), "d")


def test_names_are_split_into_words_and_units() -> None:
    assert split_name("q1_deg") == (["q", "1"], "deg")
    assert split_name("MotorCurrent [mA]") == (["motor", "current"], "mA")
    assert split_name("elbow_torque_Nm") == (["elbow", "torque"], "N m")
    assert split_name("tau[1]") == (["tau", "1"], "")
    assert split_name("vel_deg_per_s")[1] == "deg/s"
    assert split_name("j1_speed_deg_s") == (["j", "1", "speed"], "deg/s")
    assert split_name("x_vel_mm_s")[1] == "mm/s"
    assert split_name("ElbowSpeed_dps") == (["elbow", "speed"], "dps") and factor("dps") == pytest.approx(pi / 180.0)
    assert split_name("ElbowAngleDeg") == (["elbow", "angle"], "deg")
    assert split_name("MotorSpeed")[1] == ""


@pytest.mark.parametrize(("scale", "unit"), [(1.0, "s"), (1e3, "ms"), (1e6, "us"), (1e9, "ns")])
def test_the_unit_of_time_follows_from_the_steps(scale: float, unit: str) -> None:
    frame = pandas.DataFrame({"row": np.arange(N), "t": scale * TIME, "q": ANGLE})
    time = guess_time(frame)
    assert time is not None and (time.column, time.unit) == ("t", unit) and time.rate == pytest.approx(250.0)


def test_joints_are_found_by_name_and_by_number() -> None:
    frame = pandas.DataFrame({"t": TIME, **{f"{what}_{k}": ANGLE * k for what in ("q", "tau") for k in (1, 2, 3)}})
    guesses = guess_columns({"": frame}, ["base", "elbow", "wrist"])
    assert {quantity: each.column for quantity, each in of_joint(guesses, "elbow").items()} == {
        "position": "q_2", "torque": "tau_2",
    }  # fmt: skip
    with pytest.raises(SignalError, match="choose with --joint from: base, elbow, wrist"):
        of_joint(guesses, "hand")


LEG = pandas.DataFrame({"stamp_us": 1e6 * TIME, "HFE enc (deg)": 0.0 * ANGLE, "KFE enc (deg)": ANGLE,
                        "KFE vel (rpm)": ANGLE, "KFE trq (mNm)": ANGLE})  # fmt: skip


def test_a_column_with_a_word_that_only_one_joint_of_the_model_has_is_its_own() -> None:
    joints = ["FL_HFE", "FL_KFE"]
    guesses = guess_columns({"": LEG}, joints)
    assert {guess.column[:3]: guess.joint for guess in guesses} == {"HFE": "FL_HFE", "KFE": "FL_KFE"}
    assert of_joint(guesses, "FL_KFE")["position"].column == "KFE enc (deg)"
    # With several legs the word belongs to several joints; a joint whose whole name is there needs no word.
    assert {each.joint for each in guess_columns({"": LEG}, [*joints, "FR_HFE", "FR_KFE"])} == {""}
    whole = LEG.rename(columns=lambda name: name.replace("KFE", "FL_KFE"))
    wrist = whole.assign(**{"FL wrist enc (deg)": ANGLE})
    assert {each.column: each.joint for each in guess_columns({"": wrist}, ["FL_KFE"])}["FL wrist enc (deg)"] == ""


def test_the_word_that_differs_between_positions_is_the_joint_without_a_model() -> None:
    assert [guess.joint for guess in guess_columns({"": LEG})] == ["HFE", "KFE", "KFE", "KFE"]
    two_signals = LEG.rename(columns=lambda name: name.replace("HFE", "raw").replace("KFE", "filtered"))
    guesses = guess_columns({"": two_signals})
    assert {guess.joint for guess in guesses} == {""}
    (remark, _) = entries_of({"": two_signals}, guesses, "").remarks
    assert remark.startswith("several columns look like the position: raw enc (deg), filtered enc (deg); 'raw")


def test_several_torques_are_remarked_and_the_short_word_for_effort_is_known() -> None:
    time = 1e-2 * np.arange(50.0)
    wave = np.sin(time)
    tables = {"": pandas.DataFrame({"time": time, "pos": wave, "eff": wave, "tau_est": 2.0 * wave})}
    found = entries_of(tables, guess_columns(tables), "")
    assert found.columns["external_torque"][0]["column"] == "eff"
    assert found.remarks[0].startswith("several columns look like the torque: eff, tau_est; 'eff' is used")


def test_remarks_name_the_columns_of_the_joint_that_the_recording_calls_otherwise() -> None:
    time = 1e-2 * np.arange(50.0)
    columns = {f"m{k}_{what}": np.sin(time + k) for k in (1, 2) for what in ("pos", "temp")}
    tables = {"": pandas.DataFrame({"time": time, **columns})}
    (left,) = entries_of(tables, guess_columns(tables), "elbow", Constants(joint="1")).remarks
    assert left == "columns not used: m1_temp"


def test_columns_of_a_temperature_a_duty_and_a_rate_are_not_the_motion() -> None:
    others = {"winding_temp_degC": 36.5 + 0.0 * TIME, "duty_percent": 50.0 * ANGLE, "loop_Hz": 500.0 + ANGLE}
    frame = pandas.DataFrame({"t": TIME, "act_pos_deg": ANGLE, **others})
    assert {guess.column for guess in guess_columns({"": frame}) if guess.quantity} == {"act_pos_deg"}


def test_nested_names_show_their_joints_without_a_model() -> None:
    joints = ("elbow_joint", "wrist_joint")
    names = [f"/joint_states/{joint}/{what}" for what in ("position", "effort") for joint in joints]
    goals = [f"/controller/reference/positions/{joint}" for joint in joints]
    frame = pandas.DataFrame({"__time": TIME, **dict.fromkeys((*names, *goals), ANGLE), "/joint_states/seq": ANGLE})
    found = {guess.column: guess.joint for guess in guess_columns({"": frame})}
    assert [found[name] for name in (*names, *goals)] == [*joints] * 3
    assert found["/joint_states/seq"] == ""


def test_degrees_are_recognised_by_the_limits_of_the_joint() -> None:
    frame = pandas.DataFrame({"t": TIME, "elbow": 2.0 * TIME, "elbow_pos": np.degrees(ANGLE)})
    (guess,) = (g for g in guess_columns({"": frame}, ["elbow"], {"elbow": (-1.5, 1.5)}) if g.quantity == "position")
    assert guess.unit == "deg" and "limits" in guess.reason


def test_a_command_far_from_the_position_is_a_torque() -> None:
    for command, channel in ((ANGLE + 0.05, "equilibrium"), (30.0 * SPEED, "external_torque")):
        tables = {"": pandas.DataFrame({"time": TIME, "qpos": ANGLE, "ctrl": command})}
        entry, _ = entries_of(tables, guess_columns(tables), "").columns[channel]
        assert "measured" not in entry


def test_a_small_command_is_no_goal() -> None:
    """It is near a small position, but the position changes much more than it and does not follow it."""
    for command, channel in (
        (0.02 * np.cos(2.0 * TIME), "external_torque"),
        (0.02 * ANGLE, "external_torque"),
        (np.zeros(N), "external_torque"),
        (0.8 * np.roll(ANGLE, -10) + 0.05, "equilibrium"),
        (np.full(N, ANGLE[-1]), "equilibrium"),
    ):
        tables = {"": pandas.DataFrame({"time": TIME, "qpos": ANGLE, "u": command})}
        assert channel in entries_of(tables, guess_columns(tables), "").columns


def test_the_actuator_of_the_model_decides_what_a_command_is() -> None:
    tables = {"": pandas.DataFrame({"time": TIME, "qpos": ANGLE, "ctrl": ANGLE + 0.05})}
    torque = entries_of(tables, guess_columns(tables), "", Constants(drive="torque", gear=50.0)).columns
    assert torque["external_torque"][0] == {"column": "ctrl", "scale": 50.0}
    tables = {"": pandas.DataFrame({"time": TIME, "qpos": ANGLE, "ctrl": 0.5 * SPEED})}
    assert "equilibrium" in entries_of(tables, guess_columns(tables), "", Constants(drive="position")).columns
    tables = {"": pandas.DataFrame({"time": TIME, "qpos": ANGLE, "torque_cmd": TORQUE})}
    named = entries_of(tables, guess_columns(tables), "", Constants(drive="torque", gear=50.0)).columns
    assert "scale" not in named["external_torque"][0]


@pytest.mark.parametrize("name", ["secnsec", "header", "zone", "matlab"])
def test_stamps_of_ros_and_with_a_zone_are_times(tmp_path: Path, name: str) -> None:
    nanoseconds = 1_700_000_000_998_000_000 + 4_000_000 * np.arange(N)
    seconds, rest, path = nanoseconds // 10**9, nanoseconds % 10**9, tmp_path / "run.csv"
    columns: dict[str, object] = {"sec": seconds, "nanosec": rest}
    if name == "header":
        columns = {"header.stamp.sec": seconds, "header.stamp.nanosec": rest}
    if name == "zone":
        columns = {"timestamp": [f"{each.isoformat()}+01:00" for each in pandas.to_datetime(nanoseconds)]}
    if name == "matlab":
        path = path.with_suffix(".mat")
        savemat(path, {**columns, "q": ANGLE})
    else:
        pandas.DataFrame({**columns, "q": ANGLE}).to_csv(path, index=False)
    (frame,) = read_tables(path).values()
    found = guess_time(frame)
    assert found is not None and found.unit == "ns" and found.rate == pytest.approx(250.0, rel=1e-3)
    time = numbers(frame, found.column)
    np.testing.assert_allclose(1e-9 * (time - time[0]), TIME, atol=1e-6)
    assert list(frame.columns) == [found.column, "q"] or name == "matlab"


def test_an_effort_is_measured_and_a_command_is_not() -> None:
    for name, measured in (("effort", True), ("cmd_torque", False)):
        tables = {"": pandas.DataFrame({"time": TIME, "position": ANGLE, name: TORQUE})}
        entry, _ = entries_of(tables, guess_columns(tables), "").columns["external_torque"]
        assert WireColumn(**entry).measured == measured


def test_a_mapping_is_written_that_imports_the_file(tmp_path: Path) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    for name, make in (("run1.csv", csv), ("run2.mat", mat)):
        make(folder / name)
        tables = read_tables(folder / name)
        guesses = guess_columns(tables, ["elbow"])
        time = guess_time(tables[""])
        assert time is not None
        text = mapping_text(folder / name, time, guesses, Constants(4096.0, 0.5), joint="elbow")
        (tmp_path / "map.yaml").write_text(text, encoding="utf-8")
        (report,) = import_recordings(folder, tmp_path / "map.yaml", tmp_path / "out").files
        assert report.accepted, report.reasons
        states = read_bag(report.bag or "")["/joint_states"]
        np.testing.assert_allclose(states["position"][:, 0], ANGLE, atol=1e-12)
        # A row has the torque from its stamp on, a message the torque until its stamp.
        np.testing.assert_allclose(states["effort"][1:, 0], TORQUE[:-1], atol=1e-12)
        assert np.isnan(states["effort"][0, 0])


def test_a_table_and_its_bag_have_the_same_torque_at_the_same_time(tmp_path: Path) -> None:
    pandas.DataFrame({"t": TIME, "pos": ANGLE, "torque": TORQUE}).to_csv(tmp_path / "run.csv", index=False)
    tables = read_tables(tmp_path / "run.csv")
    guesses, time = guess_columns(tables), guess_time(tables[""])
    assert time is not None
    text = mapping_text(tmp_path / "run.csv", time, guesses, Constants(), joint="elbow")
    (tmp_path / "map.yaml").write_text(text, encoding="utf-8")
    (report,) = import_recordings(tmp_path, tmp_path / "map.yaml", tmp_path / "out").files
    columns = {channel: entry for channel, (entry, _) in entries_of(tables, guesses, "").columns.items()}
    described = [
        parse_device(DEVICE.format(wire=json.dumps({"link": "elbow", "motors": ["elbow"], "columns": entries})), "d")
        for entries in (columns, {})
    ]
    of_table = read_joint(tmp_path / "run.csv", described[0]).commands
    assert of_table is not None and report.bag is not None
    of_bag = joint_signals(read_bag(report.bag), described[1]).measured
    between = of_bag.time[1:] - 0.5 * (TIME[1] - TIME[0])  # a torque of the bag acts in the interval that ends
    np.testing.assert_allclose(of_table.resample(between)["external_torque"], of_bag["tau"][1:, 0], atol=1e-12)


def test_an_interval_belongs_to_an_effort(tmp_path: Path) -> None:
    (tmp_path / "m.yaml").write_text(
        "title: t\nsource: [s]\nrecordings:\n  pattern: run.csv\n  bag: b\n  time: {column: t, unit: s}\n"
        "  joints: [{column: q, joint: a, quantity: position, unit: rad, interval: begins}]\n", encoding="utf-8",
    )  # fmt: skip
    with pytest.raises(ImportMapError, match="interval belongs to an effort, got quantity position"):
        load_mapping(tmp_path / "m.yaml")


def test_numbers_of_columns_are_those_of_the_motors_of_a_device(tmp_path: Path) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    names = ("q", "theta_1", "theta_2", "tau_1", "tau_2")
    columns = {"time": TIME, **{name: (k + 1.0) * 0.1 * ANGLE for k, name in enumerate(names)}}
    pandas.DataFrame({**columns, "motor_1": TORQUE}).to_csv(folder / "run.csv", index=False)
    tables = read_tables(folder / "run.csv")
    time = guess_time(tables[""])
    assert time is not None
    text = mapping_text(folder / "run.csv", time, guess_columns(tables), Constants(), "cubic_demo")
    (tmp_path / "map.yaml").write_text(text, encoding="utf-8")
    (report,) = import_recordings(folder, tmp_path / "map.yaml", tmp_path / "out").files
    assert report.bag, report.reasons
    states = read_bag(report.bag)["/joint_states"]
    found = dict(zip(states["name"][0], zip(states["position"][5], states["effort"][5])))
    shaft, first, second = (f"cubic_demo_{part}_joint" for part in ("shaft", "motor_1", "motor_2"))
    assert found[shaft][0] == pytest.approx(columns["q"][5])
    assert found[first] == pytest.approx((columns["theta_1"][5], columns["tau_1"][5]))
    assert found[second] == pytest.approx((columns["theta_2"][5], columns["tau_2"][5]))


@pytest.mark.parametrize(
    ("scale", "unit"), [(1.0, "rad/s"), (180.0 / pi, "deg/s"), (30.0 / pi, "rpm"), (0.5 / pi, "turn/s")]
)
def test_the_unit_of_a_speed_follows_from_the_change_of_the_position(scale: float, unit: str) -> None:
    noise = np.random.default_rng(0).normal(0.0, 0.3, N)
    frame = pandas.DataFrame({"t": TIME, "pos": ANGLE, "vel": scale * (SPEED + noise)})
    found = {guess.column: guess for guess in guess_columns({"": frame})}
    assert (found["vel"].quantity, found["vel"].unit) == ("velocity", unit)


def test_a_speed_that_is_not_the_change_of_the_position_is_pointed_out() -> None:
    for wrong in (-SPEED, 3.0 * SPEED):
        tables = {"": pandas.DataFrame({"t": TIME, "pos": ANGLE, "vel": wrong})}
        (guess,) = (each for each in guess_columns(tables) if each.column == "vel")
        assert guess.unit == "rad/s" and "check" in guess.reason


def test_the_end_of_a_name_that_looks_like_seconds_is_no_unit_of_a_speed() -> None:
    frame = pandas.DataFrame({"t": TIME, "pos": ANGLE, "vel_s": ANGLE})
    found = {guess.column: (guess.quantity, guess.unit) for guess in guess_columns({"": frame})}
    assert found["vel_s"] == ("velocity", "rad/s")


def test_a_missing_ignored_column_is_no_error_and_a_foreign_header_says_what_to_write(tmp_path: Path) -> None:
    rows = "".join(f"{t},{q}\n" for t, q in zip(TIME, ANGLE, strict=True))
    (tmp_path / "run.csv").write_text(f"t,pos\n{rows}", encoding="utf-8")
    mapping = (
        "title: t\nsource: [s]\nrecordings:\n  pattern: run.csv\n  bag: b\n  time: {column: t, unit: s}\n"
        "  joints: [{column: POS, joint: a, quantity: position, unit: deg}]\n  ignore: {noise: not used}\n"
    )
    (tmp_path / "m.yaml").write_text(mapping.replace("POS", "pos"), encoding="utf-8")
    assert import_recordings(tmp_path, tmp_path / "m.yaml", tmp_path / "out").files[0].accepted
    (tmp_path / "m.yaml").write_text(mapping.replace("POS", "angle"), encoding="utf-8")
    with pytest.raises(ImportMapError, match=r"missing columns: 'angle'; the file has: 't', 'pos'; `via bag map"):
        import_recordings(tmp_path, tmp_path / "m.yaml", tmp_path / "out2")
    (tmp_path / "n.yaml").write_text(
        mapping.replace("POS", "pos").replace("joint: a", "joint: motor_2") + "device: d.yaml\n", encoding="utf-8"
    )
    (tmp_path / "d.yaml").write_text(DEVICE.format(wire="{}"), encoding="utf-8")
    with pytest.raises(ImportMapError, match="rigid joint 'elbow' has 1 drive, write motor_1"):
        import_recordings(tmp_path, tmp_path / "n.yaml", tmp_path / "out3")


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.csv", b"", "is empty"),
        ("a.csv", b"t,q\n0,1,2\n", "line 2 has 3 columns, its header 2"),
        ("a.csv", b"t,q\n0,1\n# start\n1,2\n2\n", "line 5 has 1 columns, its header 2"),
        ("a.csv", b"q" * 200_000, "a.csv: the header cannot be read: field larger than"),
        ("a.csv", b"\xff\xfe", "not UTF-8"),
        ("a.csv", "Zeit,Winkel [\u00b0]\n0,1\n".encode("latin-1"), "iconv -f latin1 -t utf-8 .*a.csv > .*a_utf8.csv"),
        ("a.bag", b"#ROSBAG V2.0\n", "is a bag of ROS 1; convert it: rosbags-convert --src .*a.bag --dst .*a$"),
        ("a.mat", b"nonsense", "cannot be read"),
        ("a.json", b"[1, 2]", "neither a list of records nor an object of arrays"),
        ("a.json", b"[" * 100_000, "cannot be read"),
        ("a.npz", b"PK\x03\x04no zip", "cannot be read"),
        ("a.parquet", b"PAR1", "cannot be read"),
        ("a.xlsx", b"", "unknown format '.xlsx'"),
    ],
)
def test_unreadable_files_give_one_line(tmp_path: Path, name: str, content: bytes, words: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(SignalError, match=words) as error:
        read_tables(tmp_path / name)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("rows", ["", ",.1,.2,.3\n"])
def test_a_recording_without_a_time_gives_one_line(tmp_path: Path, rows: str) -> None:
    (tmp_path / "a.csv").write_text("time,q,theta_1,tau_1\n" + rows, encoding="utf-8")
    with pytest.raises(SignalError, match=r"a\.csv: no row has a time; write one row"):
        read_joint(tmp_path / "a.csv", load_device("visco_elastic_demo"))


def test_a_channel_of_motors_without_a_number_is_that_of_the_first(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("time,q,theta,tau\n0,.1,.2,.3\n.01,.4,.5,.6\n", encoding="utf-8")
    found = read_joint(tmp_path / "a.csv", load_device("visco_elastic_demo")).measured
    assert found["theta"].tolist() == [[0.2], [0.5]] and found["tau"].tolist() == [[0.3], [0.6]]


@pytest.mark.parametrize(("name", "remedy"), [("a.csv", "sed -i '1i NAME1;NAME2;NAME3' "), ("a.npy", "numpy.savez(")])
def test_columns_without_names_need_names(tmp_path: Path, name: str, remedy: str) -> None:
    file, table = tmp_path / name, np.stack([TIME, ANGLE, TORQUE], axis=1)
    np.savetxt(file, table, delimiter=";") if name == "a.csv" else np.save(file, table)
    with pytest.raises(SignalError, match=f"{name}: its 3 columns have no names such .*{re.escape(remedy)}") as error:
        read_joint(file, parse_device(DEVICE.format(wire="{}"), "d"))
    assert "\n" not in str(error.value)
    # A device file may refer to columns by their numbers.
    columns = "{columns: {time: 'column[0]', q: 'column[1]', external_torque: 'column[2]'}}"
    found = read_joint(file, parse_device(DEVICE.format(wire=columns), "d"))
    np.testing.assert_allclose(found.measured["q"], ANGLE)


def test_numbers_name_the_cell_that_is_none(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("t,q\n0,1\n1,\n2,two\n", encoding="utf-8")
    with pytest.raises(SignalError, match="line 4, column 'q': 'two' is not a number"):
        numbers(read_tables(tmp_path / "a.csv")[""], "q")
    (tmp_path / "b.csv").write_text("t,pos\n0,1\n1,2\n", encoding="utf-8")
    device = parse_device(DEVICE.format(wire="{columns: {q: angle}}"), "d")
    with pytest.raises(
        SignalError, match=r"no column 'angle', which wire.columns of 'elbow' names as q; there are: t, pos"
    ):
        read_joint(tmp_path / "b.csv", device)


@pytest.mark.parametrize(
    ("names", "below"),
    [
        (["time", "position", "torque"], "s, deg, mNm\n0,Nan,1000\n# a comment\n0.5,90,-\n"),
        (['"time [s]"', '"position [deg]"', '"torque [mNm]"'], "0,,1000\n0.5,90,NULL\n"),
        (["time", "position", "torque"], "[s];[deg];[mNm]\n0,0;None;1000\n0,5;90;null\n"),
    ],
)
def test_units_below_names_comments_and_missing_cells(tmp_path: Path, names: list[str], below: str) -> None:
    delimiter = ";" if ";" in below else ","
    (tmp_path / "a.csv").write_text(delimiter.join(names) + "\n" + below, encoding="utf-8")
    frame = read_tables(tmp_path / "a.csv")[""]
    assert list(frame.columns) == ["time [s]", "position [deg]", "torque [mNm]"]
    np.testing.assert_array_equal(numbers(frame, "time [s]"), [0.0, 0.5])
    np.testing.assert_array_equal(numbers(frame, "position [deg]"), [np.nan, 90.0])
    np.testing.assert_array_equal(numbers(frame, "torque [mNm]"), [1000.0, np.nan])


def test_a_quoted_name_may_contain_the_delimiter(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text('"time, s","position, deg"\n0,1\n1,"2"\n', encoding="utf-8")
    frame = read_tables(tmp_path / "a.csv")[""]
    assert list(frame.columns) == ["time, s", "position, deg"] and list(frame["position, deg"]) == [1, 2]


def test_a_line_of_words_that_are_no_units_is_no_line_of_units(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("mode,state\nidle,on\nrun,on\n", encoding="utf-8")
    frame = read_tables(tmp_path / "a.csv")[""]
    assert list(frame.columns) == ["mode", "state"] and len(frame) == 2


def test_messages_without_a_stamp_have_their_times_of_recording(tmp_path: Path) -> None:
    store = typestore_of(JOINT_STATE)
    types = store.types
    with Writer(tmp_path / "run", version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        topic = bag.add_connection("/joint_states", JOINT_STATE, typestore=store)
        for k in range(N):
            header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](0, 0), "")
            state = types[JOINT_STATE](header, ["elbow"], ANGLE[[k]], np.zeros(0), TORQUE[[k]])
            bag.write(topic, round(1e9 * TIME[k]) + 10**18, store.serialize_cdr(state, JOINT_STATE))
    device = parse_device(DEVICE.format(wire="{link: elbow, motors: [elbow]}"), "d")
    measured, _, _ = joint_signals(read_bag(tmp_path / "run"), device)
    np.testing.assert_allclose(measured.time, TIME, atol=1e-9)
    assert "unset" in {each.check for each in check(tmp_path / "run", device)}


def test_a_summary_states_the_size_of_a_bag_in_sqlite3(tmp_path: Path) -> None:
    bag(tmp_path / "run", StoragePlugin.SQLITE3)
    (file,) = (tmp_path / "run").glob("*.db3")
    assert info(tmp_path / "run").size == file.stat().st_size > 10_000


@pytest.mark.parametrize(
    ("factor", "severity", "words"),
    [(1.0, "", ""), (1.1, "", ""), (0.1, "warning", "come at"), (1e-3, "error", "in ms, not in s")],
)
def test_another_rate_than_that_of_the_file_is_reported(factor: float, severity: str, words: str) -> None:
    device = load_device("qbmove_a")
    time = np.arange(400) / (factor * device.sensors.rate)
    time[200:] += 0.3  # lost samples do not matter
    signals = Signals(time, {"q": 0.1 * np.sin(5.0 * time)}, {"q": "rad"})
    found = [each for each in check_recording(signals, None, device) if each.check == "rate"]
    assert [each.severity for each in found] == ([severity] if severity else [])
    assert all(words in each.text for each in found)


@pytest.mark.parametrize(("goal", "unread"), [("goal", ("goal", "load")), ("equilibrium", ())])
def test_columns_that_may_hold_the_commands_are_listed_where_there_are_none(
    tmp_path: Path, goal: str, unread: tuple[str, ...]
) -> None:
    path = tmp_path / "run.csv"
    frame = pandas.DataFrame({"time": TIME, "q": ANGLE, goal: ANGLE, "load": 0.0})
    frame.to_csv(path, index=False)
    device = load_device("xl330")
    report = read_joint(path, device).reports[0]
    assert report.unread == unread
    said = [each.text for each in check(path, device) if each.check == "commands"]
    assert said == ([f"no commands were recorded{report.hint}"] if unread else [])
    assert not unread or "columns not read: goal, load: `via bag map`" in report.hint


def test_a_hint_lists_a_few_columns() -> None:
    report = StampReport("", 0, 1, 0, 0, 0, 1, unread=tuple("abcdefghij"))
    assert "a, b, c, d, e, f, g, h and 2 more" in report.hint


MIT = pandas.DataFrame({"t": TIME, "q": ANGLE, "qd": SPEED, "tau_ff": 0.3 * TORQUE, "tau_est": TORQUE,
                        "q_des": ANGLE + 0.1, "qd_des": SPEED, "kp": 20.0, "kd": 0.5})  # fmt: skip


def entries(frame: pandas.DataFrame) -> Entries:
    return entries_of({"": frame}, guess_columns({"": frame}), "")


@pytest.mark.parametrize(
    "names",
    [
        {},
        {"q_des": "p_des", "qd_des": "v_des", "tau_ff": "t_ff", "q": "position", "qd": "velocity", "tau_est": "torque"},
        {"q_des": "cmd_q", "qd_des": "cmd_dq", "tau_ff": "cmd_tau", "kp": "cmd_kp", "kd": "cmd_kd", "qd": "dq"},
        {"tau_ff": "feed_forward_torque", "kp": "Kp", "kd": "Kd", "q_des": "qDes", "qd_des": "qdDes"},
    ],
)
def test_a_measured_torque_outranks_a_feed_forward_which_is_no_torque_beside_gains(names: dict[str, str]) -> None:
    log = MIT.rename(columns=names)
    name = {each: names.get(each, each) for each in MIT.columns}
    found = entries(log)
    assert found.columns["external_torque"][0] == {"column": name["tau_est"], "measured": True}
    assert "equilibrium" not in found.columns and f"the goals '{name['q_des']}' are not all" in found.remarks[0]
    pure = log.drop(columns=[name["qd_des"], name["tau_ff"]])  # goals of a position drive
    assert entries(pure).columns["equilibrium"][0]["column"] == name["q_des"]
    assert not any(remark.startswith("several") for remark in found.remarks)
    formula = "{kp} * ({q_des} - {q}) + {kd} * ({qd_des} - {qd}) + {tau_ff}".format(**name)
    with pytest.raises(SignalError) as error:
        entries(log.drop(columns=name["tau_est"]))
    assert formula in str(error.value) and "add a column with it, 'tau'" in str(error.value)
    whole = entries(log.drop(columns=name["tau_est"]).assign(tau=log.eval(formula)))  # what the error says
    assert whole.columns["external_torque"][0]["column"] == "tau"


def test_a_feed_forward_is_the_torque_where_gains_are_zero_and_a_part_of_it_where_they_are_not_known() -> None:
    log = MIT.drop(columns="tau_est")
    found = entries(log.assign(kp=0.0, kd=0.0)).columns["external_torque"]
    assert found[0] == {"column": "tau_ff"} and "gains beside it are 0" in found[1]
    hidden = entries(log.drop(columns=["kp", "kd", "qd_des"]))
    assert "external_torque" not in hidden.columns and "equilibrium" in hidden.columns
    assert "'tau_ff' is a feed-forward, a part of the torque of the drive: not used" in hidden.remarks[0]
    with pytest.raises(SignalError, match=r"'tau_ff' is a feed-forward.* add a column with the whole torque, 'tau'"):
        entries(log[["t", "q", "tau_ff"]])
    total = entries(log.assign(tau_cmd=TORQUE))
    assert total.columns["external_torque"][0] == {"column": "tau_cmd"} and "not used" in total.remarks[0]
    goals = entries(log.assign(tau_ff=0.0, qd_des=0.0)).columns  # a position drive
    assert "external_torque" not in goals and "equilibrium" in goals


def test_a_gain_of_a_position_loop_is_no_position_and_a_mapping_names_what_it_leaves_out(tmp_path: Path) -> None:
    frame = pandas.DataFrame({"t": TIME, "pos_kp": 20.0, "pos": ANGLE, "vel_ff": SPEED})
    assert {each.column for each in guess_columns({"": frame}) if each.quantity} == {"pos"}
    MIT.to_csv(tmp_path / "a.csv", index=False)
    time = guess_time(MIT)
    assert time is not None
    text = mapping_text(tmp_path / "a.csv", time, guess_columns({"": MIT}), Constants())
    assert "tau_ff: a feed-forward, which no message holds" in text and "kp: a kp, which no message holds" in text


TURNING = 2.0 * TIME * 40.0 + ANGLE  # 10 turns


@pytest.mark.parametrize(
    ("columns", "unit"),
    [
        ({"q": TURNING, "qd [rad/s]": 80.0 + SPEED}, "rad"),
        ({"q": np.degrees(TURNING), "qd [rad/s]": 80.0 + SPEED}, "deg"),
        ({"q": TURNING, "qd": (80.0 + SPEED) * 30.0 / pi}, "rad"),  # only rad and rpm fit each other
        ({"q": np.degrees(ANGLE) / 10.0, "qd": SPEED / 10.0}, "deg"),  # small, but its speed is in rad/s
        ({"q": 80.0 + ANGLE}, "rad"),
        ({"q": np.degrees(ANGLE[100:160]) - 50.0}, "deg"),
        ({"q": np.degrees(TURNING) % 360.0}, "deg"),
    ],
)
def test_the_unit_of_an_angle_follows_from_speed_steps_and_turns_before_its_size(
    columns: dict[str, np.ndarray], unit: str
) -> None:
    frame = pandas.DataFrame({"t": TIME[: len(columns["q"])], **columns, "q_des": columns["q"]})
    found = {each.column: each for each in guess_columns({"": frame})}
    assert found["q"].unit == found["q_des"].unit == unit
    assert not entries(frame.assign(tau=1.0)).remarks[:-1]


def test_an_angle_that_only_its_size_shows_is_remarked() -> None:
    for limits, unit, other in ((None, "deg", "rad"), ((-np.inf, np.inf), "rad", "deg")):
        frame = pandas.DataFrame({"t": TIME, "q": TURNING, "qd": 80.0 + SPEED, "tau": TORQUE})
        guesses = guess_columns({"": frame}, ["wheel"], {} if limits is None else {"": limits})
        found = entries_of({"": frame}, guesses, "wheel")
        assert found.columns["q"][0].get("unit", "rad") == unit
        assert found.columns["q_velocity"][0].get("unit", "rad/s") == f"{unit}/s"
        (remark,) = found.remarks
        assert "'q' states no unit: up to 64" in remark and f"call it 'q [{other}]'" in remark
        renamed = frame.rename(columns={"q": f"q [{other}]"})
        assert not entries_of({"": renamed}, guess_columns({"": renamed}), "").remarks


def test_a_column_of_no_channel_is_refused() -> None:
    with pytest.raises(DeviceError, match=r"columns.torque: no such channel; there are: .*external_torque.*tau"):
        parse_device(DEVICE.format(wire="{columns: {q: pos, torque: trq}}"), "d")
    assert parse_device(DEVICE.format(wire="{columns: {q: pos, theta_1: m, tau_1: trq, time: t}}"), "d")


def test_a_first_row_of_values_and_text_is_no_header_and_a_matrix_has_no_names(tmp_path: Path) -> None:
    rows = [f"{k},0,,elbow,{q},{u}\n" for k, (q, u) in enumerate(zip(ANGLE, TORQUE, strict=True))]  # a topic's echo
    (tmp_path / "echo.csv").write_text("".join(rows), encoding="utf-8")
    savemat(tmp_path / "log.mat", {"log": np.stack([TIME, ANGLE, TORQUE], axis=1)})
    for name, remedy in (("echo.csv", "sed -i '1i NAME1,"), ("log.mat", "save('run.mat', 'time'")):
        with pytest.raises(SignalError, match=re.escape(remedy)):
            require_names(tmp_path / name, read_tables(tmp_path / name))
    require_names("a.csv", {"": pandas.DataFrame({"position[0]": ANGLE, "position[1]": ANGLE})})
    require_names("a.csv", {"": pandas.DataFrame({"0": TIME, "pos": ANGLE})})


def test_structures_of_simulink_have_the_labels_of_their_signals_and_times_are_no_signals(tmp_path: Path) -> None:
    signals = np.zeros(2, dtype=[("values", "O"), ("label", "O")])
    signals[:] = [(ANGLE[:, None], "q"), (TORQUE[:, None], "tau")]
    savemat(tmp_path / "scope.mat", {"ScopeData": {"time": TIME[:, None], "signals": signals}})
    series = {name: {"Time": TIME, "Data": each} for name, each in (("q", ANGLE), ("tau", TORQUE))}
    savemat(tmp_path / "series.mat", {"data": series})
    for name, torque in (("scope.mat", "ScopeData.signals.tau.values"), ("series.mat", "data.tau.Data")):
        tables = read_tables(tmp_path / name)
        found = entries_of(tables, guess_columns(tables), "").columns
        assert found["external_torque"][0]["column"] == torque and "q" in found["q"][0]["column"]


def test_a_drive_in_counts_has_a_speed_of_its_own_unit_and_a_large_current_is_remarked() -> None:
    log = {"timestamp": TIME, "present_position": np.rint(652 * ANGLE + 2048), "present_velocity": np.rint(41 * SPEED),
           "present_current": np.rint(300 * TORQUE)}  # fmt: skip
    tables = {"": pandas.DataFrame(log)}
    found = entries_of(tables, guess_columns(tables), "", Constants(counts_per_turn=4096, torque_constant=1.0))
    assert "q_velocity" not in found.columns
    current, left = found.remarks
    assert "if it is in mA, call it 'present_current [mA]'" in current and left == "columns not used: present_velocity"
    assert entries_of(tables, guess_columns(tables), "", Constants(4096, 1.0)).columns["external_torque"]


@pytest.mark.parametrize(
    "columns",
    ["{}", "{time: 'time (ms)', q: 'q [deg]', tau_1: 'tau_1 [mNm]'}", "{q: {column: 'q [deg]', unit: deg}}"],
    ids=["no entries", "names", "unit stated"],
)
def test_units_in_brackets_count(tmp_path: Path, columns: str) -> None:
    """With and without an entry for the column; whoever states a scale has converted it."""
    table = pandas.DataFrame({"time (ms)": 1e3 * TIME, "q [deg]": np.degrees(ANGLE), "tau_1 [mNm]": 1e3 * TORQUE})
    table.to_csv(tmp_path / "log.csv", index=False)
    read = read_joint(tmp_path / "log.csv", parse_device(DEVICE.format(wire=f"{{columns: {columns}}}"), "elbow"))
    np.testing.assert_allclose(read.measured.time, TIME, atol=1e-12)
    np.testing.assert_allclose(read.measured["q"], ANGLE, atol=1e-12)
    np.testing.assert_allclose(read.measured["tau"][:, 0], TORQUE, atol=1e-12)
    assert WireColumn.model_validate({"column": "q [deg]", "scale": 2.0}).factor == 2.0
    assert WireColumn.model_validate("q [0]").unit is None
