"""`via watch`: what it shows of a live graph, and its counts of samples against planted ones."""

from __future__ import annotations

import subprocess
import time

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rich.console import Console
from sensor_msgs.msg import JointState
from via_bringup.cli.ros.watch import shown
from via_bringup.cli.ros.watched import SPAN, Samples, Watched
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


def rows(text: str) -> dict[str, str]:
    return {line.split()[0]: line for line in text.splitlines() if line.strip()}


def test_the_table_shows_rates_estimates_gap_causes_and_warnings(graph, robot):
    watched = Watched(graph.node("watcher"))
    graph.executor.remove_node(watched.node)  # it takes messages without an executor

    def complete() -> bool:
        watched.look()
        return (
            watched.samples.get("wrist", Samples()).gaps > 0 and len(watched.newest) == 4 and bool(watched.warnings())
        )

    graph.until(complete)
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
