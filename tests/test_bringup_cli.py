"""The `via` command: every subcommand on small data; errors are one line with exit code 2."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from via_bringup import cli
from via_core.bags.reader import read_bag
from via_core.bags.writer import BagWriter
from via_core.devices import device_names, load_device
from via_estimators.methods import methods_for
from via_ros.conversions import JointStateWriter

DEVICE = load_device("cubic_aa_vsa")
SAMPLES = "/joint_states"
RUNS = Path(__file__).resolve().parents[1] / "via_core" / "via_core" / "samples" / "maccepavd"


@pytest.fixture
def via(monkeypatch, capfd, tmp_path):
    """Function that runs `via` with these arguments in an empty folder and returns exit code, stdout and stderr."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("via_bringup.cli.console.answers.width", 200)

    def run(*words):
        monkeypatch.setattr(sys, "argv", ["via", *map(str, words)])
        with pytest.raises(SystemExit) as end:
            cli.main()
        out, err = capfd.readouterr()
        return end.value.code, out, err

    return run


@pytest.fixture
def started(monkeypatch):
    """Argument lists of the programs that `via` would have executed."""
    programs = []

    def execute(_interpreter, words):
        programs.append(words[words.index("-c") + 2 :])  # without the interpreter and its start-up code
        raise SystemExit(0)

    monkeypatch.setattr(os, "execv", execute)
    return programs


@pytest.fixture
def bag(tmp_path):
    """600 samples of a moving joint at 1 kHz."""
    writer = JointStateWriter(DEVICE)
    with BagWriter(tmp_path / "bag") as out:
        out.add_topic(SAMPLES, "sensor_msgs/msg/JointState")
        for k in range(600):
            time = 10**9 + k * 10**6
            writer.position[:] = np.sin(0.03 * k + np.arange(3))
            writer.effort[1:] = np.cos(0.03 * k)
            out.write(SAMPLES, serialize_message(writer.stamped(time)), log_time=time)
    return tmp_path / "bag"


def fails(answer, *complaints):
    """Check for one line on stderr and exit code 2."""
    code, _, errors = answer
    assert code == 2, answer
    assert len(errors.strip().splitlines()) == 1, errors
    assert errors.startswith("error: ")
    for complaint in complaints:
        assert complaint in errors


def test_devices_lists_all_devices(via):
    code, out, _ = via("devices")
    assert code == 0
    for name in device_names():
        assert name in out


def test_estimate_writes_all_estimates_without_rounding(via, bag, tmp_path):
    code, out, _ = via("estimate", bag, "--device", DEVICE.name, "--csv", "e.csv")
    assert code == 0
    assert any(line.split()[:3] == [DEVICE.name, "modulated_torque", "600"] for line in out.splitlines())
    lines = (tmp_path / "e.csv").read_text(encoding="utf-8").splitlines()
    assert len(lines) == 601
    assert lines[0].startswith("stamp_ns,status,stiffness,stiffness_standard_deviation,")
    assert [line.split(",")[0] for line in lines[1:3]] == ["1000000000", "1001000000"]
    assert all(np.isfinite(float(cell)) for cell in lines[-1].split(",")[2:])


@pytest.mark.parametrize(
    ("period", "words", "updated"), [(10, "come at 100 Hz", True), (1000, "in ms, not in s", False)]
)
def test_windows_of_estimators_follow_the_rate_of_the_recording(via, tmp_path, period, words, updated):
    """Three seconds at a tenth of the file's rate give estimates: a window has the same length in seconds."""
    writer = JointStateWriter(DEVICE)
    with BagWriter(tmp_path / "slow") as out:
        out.add_topic(SAMPLES, "sensor_msgs/msg/JointState")
        for k in range(300):
            time = 10**9 + k * period * 10**6
            writer.position[:] = np.sin(0.1 * k + np.arange(3))
            writer.effort[1:] = np.cos(0.1 * k)
            out.write(SAMPLES, serialize_message(writer.stamped(time)), log_time=time)
    code, out, err = via("estimate", "slow", "--device", DEVICE.name, "--csv", "e.csv")
    assert code == 0 and words in " ".join((out + err).split())
    statuses = [line.split(",")[1] for line in (tmp_path / "e.csv").read_text(encoding="utf-8").splitlines()[1:]]
    assert (statuses[40] != "WARMING_UP") == updated  # .2 s are 200 samples of the file


def test_estimate_takes_several_devices_and_methods(via, tmp_path):
    devices = [load_device(f"{name}={DEVICE.name}") for name in ("left", "right")]
    with BagWriter(tmp_path / "two") as out:
        out.add_topic(SAMPLES, "sensor_msgs/msg/JointState")
        for k in range(700):
            for at, writer in enumerate(map(JointStateWriter, devices)):
                writer.position[:] = np.sin(0.03 * k + at + np.arange(3))
                writer.effort[1:] = np.cos(0.03 * k)
                out.write(SAMPLES, serialize_message(writer.stamped(k * 10**6)), log_time=k * 10**6)
    named = [word for device in devices for word in ("--device", f"{device.name}={DEVICE.name}")]
    code, out, _ = via("estimate", "two", *named, "--method", "all", "--csv", "e.csv")
    assert code == 0
    rows = [line.split() for line in out.splitlines()]
    written = {file.name for file in tmp_path.glob("e_*.csv")}
    for device in devices:
        for method in methods_for(DEVICE):
            assert [device.name, method, "700"] in [row[:3] for row in rows]
            assert f"e_{device.name}_{method}.csv" in written
    assert len(written) == 2 * len(methods_for(DEVICE))
    files = [tmp_path / f"e_{device.name}_modulated_torque.csv" for device in devices]
    assert files[0].read_text() != files[1].read_text()


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (("bag", "--device", DEVICE.name, "--device", DEVICE.name), "is given twice"),
        (("bag", "--device", DEVICE.name, "--method", "link_impedance"), "is not driven by a position servo"),
        (("nowhere", "--device", DEVICE.name), "nowhere: cannot be read: no such file or folder"),
        (("[/b]:smile:", "--device", DEVICE.name), "[/b]:smile:: cannot be read: no such file or folder"),
        (("x" * 300, "--device", DEVICE.name), "File name too long"),
        (("bag", "--device", "nobody"), "no device 'nobody'; there are: "),
        (("bag", "--device", "maccepavd"), "no joint 'maccepavd_shaft_joint'"),
        (("bag", "--device", DEVICE.name, "--method", "magic"), "no method 'magic'; there are: "),
        (("bag", "--device", DEVICE.name, "--joint-topic", "/x"), "no topic /x in bag; there are: /joint_states"),
        (("bag", "--device", DEVICE.name, "--csv", "/dev/full"), "cannot write /dev/full: No space left on device"),
        (("bag", "--device", DEVICE.name, "--csv", "nowhere/e.csv"), "there is no folder nowhere"),
    ],
)
def test_errors_of_estimate(via, bag, words, complaint):
    fails(via("estimate", *words), complaint)


def test_info_prints_topics_and_metadata_literally(via, tmp_path):
    name = "[red]ünï 😀"
    with BagWriter(tmp_path / name, {"title": "[/b] :smile:"}) as out:
        out.add_topic("/x", "std_msgs/msg/String")
        out.write("/x", b"\0\1\0\0\2\0\0\0a\0", 5)
    code, out, errors = via("bag", "info", name)
    assert (code, errors) == (0, "")
    assert f"{name}: 1 messages" in out
    assert "title: [/b] :smile:" in out
    assert "std_msgs/msg/String" in out


def test_info_of_an_incomplete_bag_recommends_recover(via, bag):
    (bag / "bag_0.mcap").write_bytes((bag / "bag_0.mcap").read_bytes()[:-400])
    code, out, errors = via("bag", "info", "bag")
    assert code == 0 and "joint_states" in out
    assert "via bag recover" in errors


@pytest.mark.parametrize("command", [("info",), ("check",), ("recover", "out")])
def test_files_that_are_not_bags_are_errors(via, tmp_path, command):
    (tmp_path / "text.mcap").write_text("not a bag", encoding="utf-8")
    (tmp_path / "empty.mcap").touch()
    name, *more = command
    fails(via("bag", name, "text.mcap", *more), "is not an MCAP file")
    fails(via("bag", name, "empty.mcap", *more), "is empty")
    fails(via("bag", name, ".", *more), "")
    assert not (tmp_path / "out").exists()


def test_check_finds_no_error_in_a_valid_bag(via, bag):
    code, out, _ = via("bag", "check", "bag", "--device", DEVICE.name)
    assert code == 0
    assert "note /joint_states: 1000.0 Hz" in out


def test_check_returns_1_if_the_bag_does_not_contain_the_device(via, bag):
    code, out, errors = via("bag", "check", "bag", "--device", "maccepavd")
    assert (code, errors) == (1, "")
    assert "error maccepavd: no joint" in out


def test_recover_writes_a_complete_bag_and_overwrites_none(via, bag, tmp_path):
    (bag / "bag_0.mcap").write_bytes((bag / "bag_0.mcap").read_bytes()[:-2000])
    code, out, errors = via("bag", "recover", "bag", "saved")
    assert code == 0
    assert "messages saved into saved" in out and "note: " in errors
    assert read_bag(tmp_path / "saved").complete
    fails(via("bag", "recover", "bag", "saved"), "saved exists already")
    fails(via("bag", "recover", "bag", "/dev/null/x"), "cannot write into /dev/null/x")


def test_import_lists_refused_recordings_and_writes_a_report(via, tmp_path):
    for name in ("record/record_traj1_3.csv", "record/record_traj2_3.csv", "command/traj1.csv"):
        (tmp_path / "in" / "constant" / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(RUNS / "constant" / name, tmp_path / "in" / "constant" / name)
    words = ("bag", "import", "in", "--mapping", "maccepavd", "--out", "bags")
    code, out, _ = via(*words, "--json", "report.json")
    assert code == 0
    assert "1 of 2 recordings are now bags in bags" in out
    assert "commands" in out and "traj2" in out  # its commands are missing
    report = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    assert (report["accepted"], report["refused"]) == (1, 1)
    assert read_bag(tmp_path / "bags" / report["files"][0]["bag"]).complete
    fails(via(*words), "exists already")
    shutil.rmtree(tmp_path / "bags")
    fails(via(*words, "--json", "nowhere/report.json"), "nowhere/report.json: there is no folder nowhere")


@pytest.mark.parametrize(
    ("folder", "mapping", "complaint"),
    [
        ("nowhere", "maccepavd", "no folder nowhere"),
        (".", "maccepavd", "no file in . matches"),
        (".", "nobodys", "no mapping 'nobodys'; there are: "),
        (".", "./nowhere.yaml", "cannot be read"),
    ],
)
def test_errors_of_import(via, folder, mapping, complaint):
    fails(via("bag", "import", folder, "--mapping", mapping, "--out", "bags"), complaint)


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (("gap", "diagnose", "absent", "--device", DEVICE.name, "--json", "nowhere/r.json"), "no folder nowhere"),
        (
            ("gap", "diagnose", "absent", "--device", DEVICE.name, "--effects-out", "."),
            "cannot write .: it is a folder",
        ),
        (("gap", "render", "absent", "--html", "nowhere/p.html"), "no folder nowhere"),
        (("gap", "simulate", "absent", "--device", DEVICE.name, "--json", "nowhere/s.json"), "no folder nowhere"),
        (("gap", "propose", "absent", "--out", "nowhere/m.csv"), "no folder nowhere"),
        (("gap", "fleet", "absent", "--device", DEVICE.name, "--results", "file/x"), "file is a file"),
        (("estimate", "absent", "--device", DEVICE.name, "--csv", "nowhere/e.csv"), "no folder nowhere"),
        (("observe", DEVICE.name, "--json", "nowhere/o.json"), "no folder nowhere"),
        (("excite", DEVICE.name, "--out", "nowhere/m.csv"), "no folder nowhere"),
        (("sim", DEVICE.name, "--commands", "absent.csv", "--record", "nowhere/l.csv"), "no folder nowhere"),
        (("bag", "import", "absent", "--mapping", "maccepavd", "--out", "file/x"), "file is a file"),
        (("bag", "record", "file/x"), "file is a file"),
        (("demo", "throw", "--out", "file/x"), "file is a file"),
    ],
)
def test_output_paths_are_checked_before_the_work_begins(via, tmp_path, words, complaint):
    """The inputs do not exist either, or the work would take seconds: the output is complained about first."""
    (tmp_path / "file").touch()
    fails(via(*words), "cannot write", complaint)


@pytest.mark.parametrize("content", ["{}", "[1", '{"schema": 3}', "null"])
def test_a_file_that_is_no_report_is_refused_in_words(via, tmp_path, content):
    (tmp_path / "report.json").write_text(content)
    answer = via("gap", "render", "report.json")
    fails(answer, "report.json: not a gap report")
    assert not {"pydantic", "type=", "https:", "validation error"} & set(answer[2].replace("[", " ").split())


def test_record_play_sim_and_run_execute_their_nodes(via, started):
    assert via("bag", "record", "ünï 😀", "/x", "--max-bag-duration", "5")[0] == 0
    given = ('bag:="ünï 😀"', "max_bag_duration:=5.0", 'topics:=["/x"]')
    chosen = [word for each in given for word in ("-p", each)]
    assert started[-1][1:] == ["--ros-args", *chosen, "--ros-args", "--enclave", "/via/recorder"]
    assert via("bag", "play", "bag", "--rate", "0", "--topic", "/x", "--listeners", "2")[0] == 0
    assert started[-1][2:8] == ["-p", 'bag:="bag"', "-p", "rate:=0.0", "-p", "subscribers:=2"]
    assert via("sim", "maccepavd", "--rate", "500")[0] == 0
    assert Path(started[-1][0]).parts[-3:] == ("lib", "via_sim", "simulator")
    assert 'device:="maccepavd"' in started[-1] and "rate:=500.0" in started[-1]
    assert via("run", "via_ros", "player", "--ros-args", "-p", "bag:=x")[0] == 0
    assert started[-1][1:] == ["--ros-args", "-p", "bag:=x", "--ros-args", "--enclave", "/via/player"]


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (("sim", "nobody"), "no device 'nobody'"),
        (("sim", "./nowhere.yaml"), "nowhere.yaml"),
        (("sim", "maccepavd", "--effects", "nowhere.yaml"), "nowhere.yaml: cannot be read"),
        (("sim", "maccepavd", "--effects", "bad.yaml"), "bad.yaml: entry 1: effect: must be one of coulomb_friction"),
        (("run", "via_ros", "nothing"), "no executable 'nothing'; it has: "),
        (("run", "nobodys", "nothing"), "package 'nobodys' is not in the sourced workspace"),
    ],
)
def test_wrong_arguments_are_reported_before_a_node_starts(via, started, tmp_path, words, complaint):
    (tmp_path / "bad.yaml").write_text("- {effect: rust, site: motor}\n", encoding="utf-8")
    fails(via(*words), complaint)
    assert not started


def test_names_outside_ascii_reach_ros_unchanged(domain, tmp_path):
    """The YAML parser of ROS does not join surrogate pairs of escapes."""
    done = subprocess.run(
        ["via", "bag", "play", "ünï 😀"], cwd=tmp_path, capture_output=True, text=True, timeout=600, check=False
    )
    assert (done.returncode, done.stderr.strip()) == (2, "error: no bag at ünï 😀")


def test_demo_refuses_a_live_run_of_zero_duration(via):
    code, _, errors = via("demo", "--duration", "0")
    assert code == 2
    assert "Traceback" not in errors and "--duration" in errors


def process(words, **options):
    return subprocess.run(["via", *words], stderr=subprocess.PIPE, timeout=600, check=False, **options)


def test_a_closed_pipe_and_a_full_disk_give_no_traceback():
    read, write = os.pipe()
    os.close(read)
    closed = process(["devices"], stdout=write)
    os.close(write)
    assert b"Traceback" not in closed.stderr
    with open("/dev/full", "w", encoding="utf-8") as full:
        done = process(["devices"], stdout=full)
    assert done.returncode != 0
    assert b"Traceback" not in done.stderr and b"No space left on device" in done.stderr


def test_file_names_that_are_not_unicode_are_printed_escaped(tmp_path):
    name = b"b\xff"
    with BagWriter(tmp_path / "b") as out:
        out.add_topic("/x", "std_msgs/msg/String")
    out.path.rename(tmp_path / os.fsdecode(name))
    done = process(["bag", "info", name], cwd=tmp_path, stdout=subprocess.PIPE)
    assert (done.returncode, done.stderr) == (0, b"")
    assert rb"b\udcff: 0 messages" in done.stdout


def test_an_interrupt_while_modules_load_gives_no_traceback(tmp_path):
    """A stub of `via_bringup.cli` sends the interrupt while it is imported."""
    (tmp_path / "via_bringup").mkdir()
    (tmp_path / "via_bringup" / "__init__.py").touch()
    (tmp_path / "via_bringup" / "cli.py").write_text("import os\nos.kill(os.getpid(), 2)\n", encoding="utf-8")
    command = Path(__file__).resolve().parents[1] / "via_bringup" / "bin" / "via"
    done = subprocess.run(
        [sys.executable, command],
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        capture_output=True,
        timeout=600,
        check=False,
    )
    assert (done.returncode, done.stderr) == (130, b"interrupted\n")


@pytest.mark.parametrize(
    ("commands", "options", "complaint"),
    [
        ("time,motor_1,motor_2\n0,0,0\n1e9,0,0\n", (), "more than 5000000 samples"),
        (
            "time,motor_1,motor_2\n0,0,0\n1,0,0\n",
            ("--rate", "1e12"),
            "rate must lie in (0, 1e+06] Hz, got 1000000000000",
        ),
        ("time,motor_1,motor_2\n0,0,0\n1,0,0\n", ("--rate", "nan"), "rate must lie in"),
        ("time,motor_1,motor_2\n0,0,0\n1e308,0,0\n", (), "duration must be finite"),
    ],
)
def test_absurd_times_and_rates_are_refused(via, tmp_path, commands, options, complaint):
    (tmp_path / "c.csv").write_text(commands)
    code, _, errors = via("sim", "cubic_demo", "--commands", "c.csv", *options)
    assert code == 2 and complaint in errors and errors.count("\n") == 1


def test_names_in_files_do_not_control_the_terminal(via, tmp_path):
    with BagWriter(tmp_path / "bag", {"title\x1b[2J": "\x1b]0;owned\x07"}) as bag:
        bag.add_topic("/a\x1b[31mb", "std_msgs/msg/Float64")
        bag.write("/a\x1b[31mb", bytes(12), 1)
    for words in (("bag", "info", "bag"), ("bag", "check", "bag"), ("bag", "info", "no\x1b[2J.mcap")):
        _, out, errors = via(*words)
        assert "\x1b[31m" not in out + errors and "\x1b[2J" not in out + errors and "\x07" not in out + errors
    assert "\u241b[2J" in errors


def test_a_node_is_found_on_this_host_only(via, started, monkeypatch):
    monkeypatch.delenv("ROS_AUTOMATIC_DISCOVERY_RANGE")
    via("run", "via_sim", "simulator")
    assert os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
    via("run", "via_sim", "simulator")
    assert os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "SUBNET" and len(started) == 2
