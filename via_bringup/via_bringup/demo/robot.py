"""The demo's real robot: recordings into bags, bags over DDS into the estimator, the same commands into the model."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from via_core.bags.importing import ImportReport, import_recordings
from via_core.bags.joints import joint_signals
from via_core.bags.reader import Bag, read_bag
from via_core.devices import Device, load_device
from via_core.signals import Array
from via_core.status import Status
from via_estimators.contract import Estimates, summarise
from via_estimators.nodes.estimator import EstimatorNode
from via_gap.logs.replay import Gap, gap_to, pooled, simulated_log
from via_interfaces.srv import ResetEstimator
from via_ros.nodes.player import Player
from via_ros.nodes.recorder import Recorder

from via_bringup.composition import Composition
from via_bringup.demo.pictures import Band, Column, Trace, by_strategy, gap_traces, run_in_detail
from via_bringup.demo.summary import Quantity, RefusedRecording, RobotPart, RobotRun, Traffic

DEVICE = "maccepavd"
MAPPING = "maccepavd"
WINDOW = 200  # samples on their way at a time while a bag plays as fast as the estimator keeps up
PATIENCE = 60.0  # [s] for anything one run may take
IN_DETAIL = "vardamp"  # the strategy whose damping changes most
Progress = Callable[[int, int, str], None]  # done, of how many, what


@dataclass(frozen=True)
class Stream:
    """One recorded estimate over a run, and what it is held against."""

    estimates: Estimates  # one output
    reference: Array  # (N,) commanded damping, or the law's stiffness

    @property
    def quantity(self) -> Quantity:
        """The run in one number, and the reference averaged with the same weights."""
        (output,) = self.estimates.outputs
        value, deviation, weights = summarise(self.estimates, output)
        reference = float(weights @ self.reference) if weights.any() else float(np.mean(self.reference))
        return Quantity(value=value, standard_deviation=deviation, reference=reference)

    @property
    def status(self) -> Status:
        """OK where any estimate of the run is, else the last status."""
        seen = self.estimates.status
        return Status.OK if np.any(seen == Status.OK) else Status(int(seen[-1]))

    @property
    def band(self) -> Band:
        each = self.estimates
        return Band(
            each.time, each.value[:, 0], each.standard_deviation[:, 0], self.reference, each.status == Status.OK
        )


@dataclass(frozen=True)
class JudgedRun:
    """One run: its line of the summary, and what the pictures need."""

    record: RobotRun
    gap: Gap
    damping: Stream
    stiffness: Stream
    equilibrium: Array  # (N,) [rad] commanded


def real_robot(recordings: Path, source: str, out: Path, progress: Progress) -> RobotPart:
    """Parts 1 to 3 of the demo; writes `bags/robot`, `bags/robot_estimates` and four pictures below `out`.

    recordings  folder laid out as the mapping says
    source      what to call it
    """
    device = load_device(DEVICE)
    imported = import_recordings(recordings, MAPPING, out / "bags" / "robot")
    bags = [file.bag for file in imported.accepted if file.bag is not None]
    runs: list[JudgedRun] = []
    with Composition() as graph:
        estimator = graph.add(EstimatorNode, device=DEVICE)
        client = estimator.create_client(ResetEstimator, "~/reset")
        for number, bag in enumerate(bags):
            progress(number, len(bags), bag.name)
            if number:
                asked = client.call_async(ResetEstimator.Request())
                graph.run_until(asked.done, PATIENCE, "resetting the estimator")
            recorded = out / "bags" / "robot_estimates" / bag.name
            traffic = _play(graph, device, bag, recorded)
            runs.append(_judged(device, recorded, traffic))
        progress(len(bags), len(bags), "done")
    _draw(runs, out / "pictures")
    return _part(imported, source, runs)


def _play(graph: Composition, device: Device, bag: Path, recorded: Path) -> Traffic:
    """Play one bag into the estimator and record samples, commands and estimates."""
    estimates = f"/{device.name}/damping"
    topics = [
        "/joint_states:sensor_msgs/msg/JointState",
        f"{device.command_topic}:via_interfaces/msg/VsaCommand",
        f"/{device.name}/stiffness:via_interfaces/msg/StiffnessEstimate",
        f"{estimates}:via_interfaces/msg/DampingEstimate",
    ]
    recorder = graph.add(Recorder, bag=str(recorded), topics=topics)
    player = graph.add(
        Player,
        bag=str(bag),
        topics=["/joint_states", device.command_topic],
        rate=0.0,
        subscribers=2,
        answers=[estimates],
        window=WINDOW,
    )
    samples = len(read_bag(bag, ["/joint_states"]).topic("/joint_states"))
    counts = recorder.counts
    graph.run_until(player.finished.done, PATIENCE, f"playing {bag.name}")
    graph.run_until(
        lambda: counts["/joint_states"].messages == counts[estimates].messages == samples,
        PATIENCE,
        f"recording all {samples} estimates of {bag.name}",
    )
    graph.remove(player)
    graph.remove(recorder)
    return Traffic(
        samples=samples,
        samples_recorded=counts["/joint_states"].messages,
        estimates_recorded=counts[estimates].messages,
        numbers_missing=sum(count.lost for count in counts.values()),
    )


def _judged(device: Device, recorded: Path, traffic: Traffic) -> JudgedRun:
    """Estimates against command and spring law, simulation against the robot."""
    parts = re.fullmatch(r"([a-z]+)_traj(\d+)_(\d+)", recorded.name)
    assert parts is not None  # the mapping names bags so
    bag = read_bag(recorded)
    measured, commands, _ = joint_signals(bag, device)
    assert commands is not None  # the import refuses recordings without commands
    held = commands.resample(measured.time)
    damping = _stream(bag, f"/{device.name}/damping", device.link.viscous_friction + device.damping_of(held["damping"]))
    model = simulated_log(device, measured, commands)
    servos = model.select(["theta"]).resample(measured.time)["theta"]  # the logged ones are wrong while they slew
    law = device.stiffness(measured["q"], servos)
    stiffness = _stream(bag, f"/{device.name}/stiffness", law)
    gap = gap_to(model, measured)
    record = RobotRun(
        strategy=parts[1],
        trajectory=int(parts[2]),
        repeat=int(parts[3]),
        status=damping.status.name,
        damping=damping.quantity,
        stiffness=stiffness.quantity,
        nrmse=gap.nrmse,
        traffic=traffic,
        bag=f"bags/robot_estimates/{recorded.name}",
    )
    return JudgedRun(record, gap, damping, stiffness, held["equilibrium"])


def _stream(bag: Bag, topic: str, reference: Array) -> Stream:
    """The estimates of a topic, one per sample."""
    columns = bag[topic]
    estimates = Estimates(
        (columns.stamp - columns.stamp[0]) / 1e9,
        columns["status"],
        columns["value"][:, None],
        columns["standard_deviation"][:, None],
        (topic.rpartition("/")[2],),
    )
    return Stream(estimates, reference)


def _draw(runs: Sequence[JudgedRun], pictures: Path) -> None:
    strategies = sorted({run.record.strategy for run in runs})
    of = {name: [run for run in runs if run.record.strategy == name] for name in strategies}
    middle = {name: sorted(each, key=lambda run: run.record.nrmse)[len(each) // 2] for name, each in of.items()}
    gap_traces([_trace(name, run) for name, run in middle.items()], pictures / "gap.png")
    by_strategy(
        {name: _gap_column(each) for name, each in of.items()},
        "NRMSE of the simulated angle [-]",
        "pooled",
        pictures / "nrmse.png",
    )
    by_strategy(
        {name: _damping_column(each) for name, each in of.items()},
        "damping [N m s/rad]",
        "commanded, weighted as the estimates are",
        pictures / "damping.png",
    )
    shown = middle.get(IN_DETAIL, runs[0])
    run_in_detail(
        f"{shown.record.strategy} {shown.record.trajectory}.{shown.record.repeat}, real robot",
        shown.gap.time - shown.gap.time[0],
        shown.gap.measured,
        shown.equilibrium,
        shown.damping.band,
        shown.stiffness.band,
        pictures / "run.png",
    )


def _trace(strategy: str, run: JudgedRun) -> Trace:
    gap, record = run.gap, run.record
    title = f"{strategy} {record.trajectory}.{record.repeat}"
    return Trace(title, gap.time - gap.time[0], gap.measured, gap.simulated, gap.nrmse)


def _gap_column(runs: Sequence[JudgedRun]) -> Column:
    return Column(np.array([run.record.nrmse for run in runs]), None, pooled([run.gap for run in runs]))


def _damping_column(runs: Sequence[JudgedRun]) -> Column:
    each = [run.record.damping for run in runs]
    return Column(
        np.array([q.value for q in each]),
        np.array([q.standard_deviation for q in each]),
        float(np.mean([q.reference for q in each])),
    )


def _part(imported: ImportReport, source: str, runs: Sequence[JudgedRun]) -> RobotPart:
    strategies = sorted({run.record.strategy for run in runs})
    covered = [run.record.damping.covered for run in runs]
    return RobotPart(
        source=source,
        accepted=len(imported.accepted),
        refused=[RefusedRecording(file=file.source, reasons=list(file.reasons)) for file in imported.refused],
        warnings=sum(finding.severity == "warning" for file in imported.accepted for finding in file.findings),
        runs=[run.record for run in runs],
        nrmse=pooled([run.gap for run in runs]),
        nrmse_by_strategy={
            name: pooled([run.gap for run in runs if run.record.strategy == name]) for name in strategies
        },
        damping_coverage=float(np.mean(covered)),
        lost=sum(run.record.traffic.lost for run in runs),
    )
