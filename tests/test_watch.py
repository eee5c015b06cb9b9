"""`via watch`: what it shows of a live graph, and its counts of samples against planted ones."""

from __future__ import annotations

import re
import socket
import subprocess
import sys
import time
from importlib.util import find_spec
from urllib.error import HTTPError
from urllib.request import urlopen

import numpy as np
import psutil
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rich.console import Console
from sensor_msgs.msg import JointState
from via_bringup.cli.ros import web
from via_bringup.cli.ros.watch import shown
from via_bringup.cli.ros.watched import SPAN, Samples, Watched
from via_bringup.cli.ros.web import Page, viewer
from via_core.errors import ViaError
from via_core.wire import SECOND
from via_interfaces.msg import DampingEstimate, Effect, EffectHypothesis, GapStatus, StiffnessEstimate
from via_ros import qos
from via_ros.conversions import set_stamp

STEP = 10_000_000  # [ns] between samples


def _cause(name: str, probability: float) -> EffectHypothesis:
    return EffectHypothesis(effect=Effect(name=name), probability=probability)


CAUSES = [_cause("backlash", 0.9), *3 * [_cause("x", 0.03)]]


@pytest.fixture
def robot(graph):
    """A node that publishes samples of two joints, estimates and a gap of the first, and a warning."""
    node = graph.node("robot")
    samples = node.create_publisher(JointState, "/joint_states", qos.SAMPLES)
    stiffness = node.create_publisher(StiffnessEstimate, "/elbow/stiffness", qos.SAMPLES)
    other = node.create_publisher(StiffnessEstimate, "/elbow/residual/stiffness", qos.SAMPLES)
    damping = node.create_publisher(DampingEstimate, "/elbow/damping", qos.SAMPLES)
    truth = node.create_publisher(StiffnessEstimate, "/elbow/truth/stiffness", qos.SAMPLES)
    gap = node.create_publisher(GapStatus, "/elbow/gap", qos.CONTROL)
    reports = node.create_publisher(DiagnosticArray, "/diagnostics", qos.CONTROL)
    node.k = 0

    def publish() -> None:
        node.k += 1
        if node.k % 40 == 0:  # one sample of 40 is missing
            return
        stamp = node.k * STEP
        for names in (["elbow_shaft_joint", "elbow_motor_1_joint"], ["wrist_shaft_joint"]):
            message = JointState(name=names, position=[0.0] * len(names))
            set_stamp(message.header.stamp, stamp)
            samples.publish(message)
        for publisher, message in (
            (stiffness, StiffnessEstimate(method="modulated_torque", value=6.25, standard_deviation=0.1)),
            (other, StiffnessEstimate(method="residual", value=float("nan"), status=1)),
            (damping, DampingEstimate(method="modulated_torque", value=0.3, standard_deviation=0.01)),
            (truth, StiffnessEstimate(method="truth", value=6.0)),
            (gap, GapStatus(residual_ratio=2.5, verdict="effect", hypotheses=CAUSES)),
        ):  # fmt: skip
            message.header.frame_id = "elbow"
            publisher.publish(message)
        reports.publish(
            DiagnosticArray(
                status=[
                    DiagnosticStatus(
                        level=DiagnosticStatus.WARN, name="simulator: realtime", message="2 drivers: /a, /b"
                    ),
                    DiagnosticStatus(level=DiagnosticStatus.OK, name="estimator: elbow", message="OK"),
                ]
            )
        )

    node.create_timer(0.005, publish)
    return node


def seen(graph, robot) -> Watched:
    """What is known of the robot as soon as everything has been heard."""
    watched = Watched(graph.node("watcher"))
    graph.executor.remove_node(watched.node)  # it takes messages without an executor

    def complete() -> bool:
        watched.look()
        return (
            watched.samples.get("wrist", Samples()).gaps > 0 and len(watched.newest) == 4 and bool(watched.warnings())
        )

    graph.until(complete)
    return watched


def rows(text: str) -> dict[str, str]:
    return {line.split()[0]: line for line in text.splitlines() if line.strip()}


def test_the_table_shows_rates_estimates_gap_causes_and_warnings(graph, robot):
    watched = seen(graph, robot)
    console = Console(width=200, record=True, file=open("/dev/null", "w"))  # noqa: SIM115
    console.print(shown(watched))
    text = console.export_text()
    elbow = rows(text)["elbow"]
    assert "6.25 ± 0.196" in elbow and "0.3 ± 0.0196" in elbow and "modulated_torque" in elbow and " OK " in elbow
    assert "2.5 x noise, effect" in elbow and "backlash 90 %, x 3 %, 2 more" in elbow
    assert "±" not in rows(text)["residual"] and "WARMING_UP" in rows(text)["residual"]
    assert rows(text)["wrist"].count(" - ") >= 5 and "Hz" in rows(text)["wrist"]
    assert "simulator: realtime: 2 drivers: /a, /b" in text
    assert "truth" not in text and "estimator: elbow" not in text
    console.print(shown(watched, ["wrist"]))
    assert "elbow_" not in console.export_text()


def test_the_command_prints_one_table(graph, robot):
    process = subprocess.Popen(["via", "watch", "--once", "4"], stdout=subprocess.PIPE, text=True)
    graph.until(lambda: process.poll() is not None, 90.0)
    assert process.stdout is not None
    assert "modulated_torque" in process.stdout.read() and process.returncode == 0


def test_the_page_gets_estimates_with_bands_samples_gaps_causes_and_warnings(graph, robot, tmp_path):
    rerun = pytest.importorskip("rerun", reason="needs make view")
    watched, stream = seen(graph, robot), rerun.RecordingStream("test")
    stream.save(tmp_path / "page.rrd")
    page = Page(stream)
    for _ in range(3):
        page.show(watched, ["elbow"])
    stream.disconnect()
    printed = subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", "print", "-vvv", tmp_path / "page.rrd"], capture_output=True, text=True
    ).stdout
    sent: dict[str, str] = {}  # data by path
    for chunk in printed.split("\nChunk(")[1:]:
        head, _, data = chunk.partition("\n")
        if "SeriesLines" not in data:
            sent[head.split(" - ")[1]] = sent.get(head.split(" - ")[1], "") + data

    def numbers(path: str) -> list[float]:
        return [
            float(each) for each in re.findall(r"[-+.\w]+", re.findall(r"\[([^][]*)\] *│ │$", sent[path], re.M)[-1])
        ]

    assert numbers("/elbow/stiffness/modulated_torque") == pytest.approx([6.054, 6.25, 6.446], abs=1e-3)
    assert numbers("/elbow/damping/modulated_torque") == pytest.approx([0.2804, 0.3, 0.3196], abs=1e-3)
    assert np.isnan(numbers("/elbow/stiffness/residual")).all()  # it is warming up
    assert numbers("/elbow/gap") == [2.5]
    texts = sent["/elbow"] + sent["/warnings"]
    for text in (
        "stiffness/modulated_torque: OK", "stiffness/residual: WARMING_UP", "gap: effect, backlash 90 %, x 3 %",
        "simulator: realtime: 2 drivers: /a, /b",
    ):  # fmt: skip
        assert texts.count(text) == 1  # however often it was shown
    assert not [path for path in sent if "wrist" in path or "truth" in path]


def test_the_server_of_the_page_is_reached_from_this_host_only_and_the_page_connects_to_nothing_else(domain):
    pytest.importorskip("rerun", reason="needs make view")
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    own = psutil.Process()
    before = own.children(recursive=True)
    with viewer(port) as (address, _):
        content = b""
        while b"wasm" not in content:  # until the server behind has started
            try:
                with urlopen(address) as answer:
                    content, policy = answer.read(), answer.headers["Content-Security-Policy"]
            except HTTPError:
                time.sleep(0.1)
        processes = [own, *(each for each in own.children(recursive=True) if each not in before)]
        listening = {
            each.laddr for one in processes for each in one.net_connections("tcp") if each.status == psutil.CONN_LISTEN
        }
        assert {port, port + 1} <= {each.port for each in listening} and {each.ip for each in listening} == {
            "127.0.0.1"
        }
    directives = dict(each.strip().split(" ", 1) for each in policy.split(";"))
    assert directives["connect-src"] == f"'self' http://127.0.0.1:{port + 1}"
    assert not {each for each in directives["default-src"].split() if "http" in each or "*" in each}
    assert not [each for each in processes[1:] if each.is_running() and each.status() != psutil.STATUS_ZOMBIE]


def test_a_port_in_use_and_a_missing_viewer_are_told_in_one_line(monkeypatch):
    with socket.create_server(("127.0.0.1", 0)) as used:
        port = used.getsockname()[1]
        if find_spec("rerun") is not None:
            with pytest.raises(ViaError, match=f"port {port} is in use; choose another one with --port"), viewer(port):
                pass
        monkeypatch.setattr(web, "find_spec", lambda _: None)
        with pytest.raises(ViaError, match="make view"), viewer(port):
            pass


def test_rate_and_gaps_are_those_that_were_planted():
    random, step, samples = np.random.default_rng(4), SECOND // 1000, Samples()
    kept = np.sort(random.choice(10_000, 9_900, replace=False))
    missing_runs = int(np.sum(np.diff(kept) > 1))
    for part in np.array_split(kept, 40):
        samples.take((part * step).tolist(), time.monotonic())
    assert samples.gaps == missing_runs > 50
    in_span = np.sum(kept[-1] - kept <= SPAN // step) - 1
    assert samples.rate == pytest.approx(in_span * SECOND / (samples.stamps[-1] - samples.stamps[0]))
    assert 980.0 < samples.rate < 1000.0


def test_memory_stays_bounded_and_a_clock_that_runs_back_starts_anew():
    samples = Samples()
    for k in range(0, 60_000, 500):
        samples.take([(k + i) * SECOND // 1000 for i in range(500)], 0.0)
        assert len(samples.stamps) <= 2001
    samples.take([0, SECOND // 1000], 0.0)
    assert samples.stamps == [0, SECOND // 1000] and samples.gaps == 0
