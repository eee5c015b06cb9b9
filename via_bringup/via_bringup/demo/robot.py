"""Real robot of the demo: recordings become bags, bags are played to the estimator, and the model is simulated."""

from __future__ import annotations

import re
from collections.abc import Sequence
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
from via_ros.composition import Composition
from via_ros.nodes.player import Player
from via_ros.nodes.recorder import Recorder

from via_bringup.demo.pictures import Band, Column, angles, by_strategy, estimates, gap_traces, run_in_detail
from via_bringup.demo.summary import Progress, Quantity, RefusedRecording, RobotPart, RobotRun, Traffic

DEVICE = "maccepavd"
MAPPING = "maccepavd"
WINDOW = 200  # samples in flight while a bag plays as fast as the estimator keeps up
TIMEOUT = 60.0  # [s] per step of one run
IN_DETAIL = "vardamp"  # strategy with the largest changes of damping


@dataclass(frozen=True)
class Stream:
    """One recorded estimate over a run, with its reference."""

    estimates: Estimates  # one output
    reference: Array  # (N,) commanded damping, or stiffness of the spring law

    @property
    def quantity(self) -> Quantity:
        """Weighted mean of the estimates, and of the reference with the same weights."""
        (output,) = self.estimates.outputs
        value, standard_deviation, weights = summarise(self.estimates, output)
        reference = float(weights @ self.reference) if weights.any() else float(np.mean(self.reference))
        return Quantity(value=value, standard_deviation=standard_deviation, reference=reference)

    @property
    def status(self) -> Status:
        """OK if any estimate of the run is OK, else the last status."""
        status = self.estimates.status
        return Status.OK if np.any(status == Status.OK) else Status(int(status[-1]))

    @property
    def band(self) -> Band:
        each, trusted = self.estimates, self.estimates.status == Status.OK
        return Band(each.time, each.value[:, 0], each.standard_deviation[:, 0], self.reference, trusted)


@dataclass(frozen=True)
class EvaluatedRun:
    """Summary of one run, and the signals for the pictures."""

    record: RobotRun
    gap: Gap
    damping: Stream
    stiffness: Stream
    equilibrium: Array  # (N,) [rad] commanded


def real_robot(recordings: Path, source: str, out: Path, progress: Progress) -> RobotPart:
    """Parts 1 to 3 of the demo. Writes `bags/robot`, `bags/robot_estimates` and six pictures below `out`.

    recordings  folder with the layout of the mapping
    source      its name in the summary
    """
    device = load_device(DEVICE)
    imported = import_recordings(recordings, MAPPING, out / "bags" / "robot")
    bags = [file.bag for file in imported.accepted if file.bag is not None]
    runs: list[EvaluatedRun] = []
    with Composition() as graph:
        estimator = graph.add(EstimatorNode, device=DEVICE)
        client = estimator.create_client(ResetEstimator, "~/reset")
        for number, bag in enumerate(bags):
            progress(number, len(bags), bag.name)
            if number:
                reset = client.call_async(ResetEstimator.Request())
                graph.run_until(reset.done, TIMEOUT, "resetting the estimator")
            recorded = out / "bags" / "robot_estimates" / bag.name
            traffic = _play(graph, device, bag, recorded)
            runs.append(_evaluate(device, recorded, traffic))
        progress(len(bags), len(bags), "done")
    _draw(runs, out / "pictures")
    return _part(imported, source, runs)


def _play(graph: Composition, device: Device, bag: Path, recorded: Path) -> Traffic:
    """Play one bag to the estimator, and record samples, commands and estimates."""
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
    graph.run_until(player.finished.done, TIMEOUT, f"playing {bag.name}")
    graph.run_until(
        lambda: counts["/joint_states"].messages == counts[estimates].messages == samples,
        TIMEOUT,
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


def _evaluate(device: Device, recorded: Path, traffic: Traffic) -> EvaluatedRun:
    """Compare the estimates with command and spring law, and the simulated angle with the measured one."""
    parts = re.fullmatch(r"([a-z]+)_traj(\d+)_(\d+)", recorded.name)
    assert parts is not None  # the mapping defines this name
    bag = read_bag(recorded)
    measured, commands, _ = joint_signals(bag, device)
    assert commands is not None  # the import refuses recordings without commands
    commanded = commands.resample(measured.time)
    damping = _stream(
        bag, f"/{device.name}/damping", device.link.viscous_friction + device.damping_of(commanded["damping"])
    )
    model = simulated_log(device, measured, commands)
    # The logged servo angles are wrong while the servos move.
    stiffness_of_model = device.stiffness(measured["q"], model.select(["theta"]).resample(measured.time)["theta"])
    stiffness = _stream(bag, f"/{device.name}/stiffness", stiffness_of_model)
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
    return EvaluatedRun(record, gap, damping, stiffness, commanded["equilibrium"])


def _stream(bag: Bag, topic: str, reference: Array) -> Stream:
    """Recorded estimates of a topic, one per sample."""
    columns = bag[topic]
    time = (columns.stamp - columns.stamp[0]) / 1e9
    value, standard_deviation = columns["value"][:, None], columns["standard_deviation"][:, None]
    output = topic.rpartition("/")[2]
    return Stream(Estimates(time, columns["status"], value, standard_deviation, (output,)), reference)


def _draw(runs: Sequence[EvaluatedRun], pictures: Path) -> None:
    of = _grouped(runs)
    middle = {name: sorted(each, key=lambda run: run.record.nrmse)[len(each) // 2] for name, each in of.items()}
    gap_traces({_name(run): run.gap for run in middle.values()}, pictures / "gap.png")
    errors = {
        name: Column(np.array([run.record.nrmse for run in each]), None, pooled([run.gap for run in each]))
        for name, each in of.items()
    }
    by_strategy(errors, "NRMSE of the simulated angle [-]", "pooled", pictures / "nrmse.png")
    damping = {name: _damping_column([run.record.damping for run in each]) for name, each in of.items()}
    weighted = "commanded, averaged with the same weights"
    by_strategy(damping, "damping [N m s/rad]", weighted, pictures / "damping.png")
    shown = middle.get(IN_DETAIL, runs[0])
    title, bands = f"{_name(shown)}, real robot", (shown.damping.band, shown.stiffness.band)
    run_in_detail(title, shown.gap, shown.equilibrium, *bands, pictures / "run.png")
    estimates(*bands, pictures / "joint.png")
    angles(shown.gap, pictures / "model.png")


def _grouped(runs: Sequence[EvaluatedRun]) -> dict[str, list[EvaluatedRun]]:
    strategies = sorted({run.record.strategy for run in runs})
    return {name: [run for run in runs if run.record.strategy == name] for name in strategies}


def _name(run: EvaluatedRun) -> str:
    return f"{run.record.strategy} {run.record.trajectory}.{run.record.repeat}"


def _damping_column(runs: Sequence[Quantity]) -> Column:
    value, sd, reference = np.array([(q.value, q.standard_deviation, q.reference) for q in runs]).T
    return Column(value, sd, float(np.mean(reference)))


def _part(imported: ImportReport, source: str, runs: Sequence[EvaluatedRun]) -> RobotPart:
    covered = [run.record.damping.covered for run in runs]
    return RobotPart(
        source=source,
        accepted=len(imported.accepted),
        refused=[RefusedRecording(file=file.source, reasons=list(file.reasons)) for file in imported.refused],
        warnings=sum(finding.severity == "warning" for file in imported.accepted for finding in file.findings),
        runs=[run.record for run in runs],
        nrmse=pooled([run.gap for run in runs]),
        nrmse_by_strategy={name: pooled([run.gap for run in each]) for name, each in _grouped(runs).items()},
        damping_coverage=float(np.mean(covered)),
        lost=sum(run.record.traffic.lost for run in runs),
    )
