"""Simulated joint of the demo: simulator, controller, estimator and recorder in closed loop, and a replay."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from via_controllers.nodes.single import NODES
from via_core.bags.joints import joint_signals
from via_core.bags.reader import Bag, read_bag
from via_core.devices import Device, load_device
from via_core.metrics import WIDTH_95, coverage
from via_core.signals import Array
from via_core.status import Status
from via_estimators.nodes.estimator import EstimatorNode
from via_ros.composition import Composition
from via_ros.nodes.player import Player
from via_ros.nodes.recorder import Recorder
from via_sim.nodes.simulator import SimulatorNode

from via_bringup.demo.pictures import Band, live_joint
from via_bringup.demo.summary import LivePart, Progress, Traffic

DEVICE = "cubic_demo"
RATE = 1000.0  # [Hz]
SEED = 1
WINDOW = 200  # samples in flight during the replay
TIMEOUT = 60.0  # [s] in addition to the run itself
COMPARED = {  # message fields in which live and replayed estimates are compared, by topic
    "stiffness": "value standard_deviation transmission_value transmission_standard_deviation status sequence",
    "motor": "inertia inertia_standard_deviation damping damping_standard_deviation status sequence",
}


def live(out: Path, duration: float, progress: Progress) -> LivePart:
    """Part 4 of the demo, `duration` [s] long. Writes `bags/live`, `bags/live_replayed` and a picture below `out`."""
    device = load_device(DEVICE)
    recorded, replayed = out / "bags" / "live", out / "bags" / "live_replayed"
    late = _run_live(device, recorded, duration, progress)
    _replay(device, recorded, replayed, progress)
    first, second = read_bag(recorded), read_bag(replayed)
    return _summary(device, first, second, late, out / "pictures" / "live.png")


def _run_live(device: Device, bag: Path, duration: float, progress: Progress) -> int:
    """Record a live run. Returns the number of ticks that started late."""
    name = device.name
    topics = [
        "/joint_states:sensor_msgs/msg/JointState",
        f"{device.command_topic}:via_interfaces/msg/VsaCommand",
        f"/{name}/stiffness:via_interfaces/msg/StiffnessEstimate",
        f"/{name}/motor:via_interfaces/msg/MotorEstimate",
        f"/{name}/truth/stiffness:via_interfaces/msg/StiffnessEstimate",
    ]
    # Topics with one message per tick. The controller may skip outdated samples.
    every_tick = ("/joint_states", f"/{name}/stiffness", f"/{name}/motor", f"/{name}/truth/stiffness")
    with Composition() as graph:
        graph.add(EstimatorNode, device=name)
        graph.add(NODES["excitation"], device=name, told_every=100)  # its ControlState has no subscriber here
        recorder = graph.add(Recorder, bag=str(bag), topics=topics)
        simulator = graph.add(
            SimulatorNode,
            device=name,
            mode="realtime",
            rate=RATE,
            seed=SEED,
            truth=True,
            duration=duration,
            listeners=3,
        )

        def done() -> bool:
            progress(recorder.counts["/joint_states"].messages / RATE, duration, "live")
            return simulator.finished.done()

        graph.run_until(done, duration + TIMEOUT, "the live run")
        expected = round(duration * RATE) + 1
        graph.run_until(
            lambda: all(recorder.counts[topic].messages >= expected for topic in every_tick),
            TIMEOUT,
            f"recording {expected} messages on each of {', '.join(every_tick)}",
        )
        return simulator.late_ticks


def _replay(device: Device, bag: Path, replayed: Path, progress: Progress) -> None:
    """Play the samples of a live run to a new estimator as fast as it keeps up, and record its estimates."""
    name = device.name
    answers = [f"/{name}/stiffness", f"/{name}/motor"]
    samples = len(read_bag(bag, ["/joint_states"]).topic("/joint_states"))
    topics = [
        "/joint_states:sensor_msgs/msg/JointState",
        f"{answers[0]}:via_interfaces/msg/StiffnessEstimate",
        f"{answers[1]}:via_interfaces/msg/MotorEstimate",
    ]
    with Composition() as graph:
        graph.add(EstimatorNode, device=name)
        recorder = graph.add(Recorder, bag=str(replayed), topics=topics)
        player = graph.add(
            Player, bag=str(bag), topics=["/joint_states"], rate=0.0, subscribers=2, answers=answers, window=WINDOW
        )

        def done() -> bool:
            progress(recorder.counts["/joint_states"].messages, samples, "replay")
            return player.finished.done() and all(count.messages >= samples for count in recorder.counts.values())

        graph.run_until(done, TIMEOUT + samples / RATE, f"replaying {samples} samples")


def same_bits(device: Device, first: Bag, second: Bag) -> bool:
    """Whether the estimates of a device are bit-identical in two bags: stamps and the fields in COMPARED."""
    for topic, names in COMPARED.items():
        one, other = first[f"/{device.name}/{topic}"], second[f"/{device.name}/{topic}"]
        if not np.array_equal(one.stamp, other.stamp):
            return False
        if any(one[name].tobytes() != other[name].tobytes() for name in names.split()):
            return False
    return True


def _traffic(device: Device, bag: Bag, sent: int) -> Traffic:
    """Recorded messages out of `sent` samples, and gaps in the sequence numbers of all topics that have them."""
    samples, estimates = bag["/joint_states"], bag[f"/{device.name}/stiffness"]
    numbered = [columns["sequence"] for columns in map(bag.__getitem__, bag.topics) if "sequence" in columns.fields]
    missing = sum(int(each[-1]) - int(each[0]) + 1 - len(each) for each in numbered)
    return Traffic(
        samples=sent, samples_recorded=len(samples), estimates_recorded=len(estimates), numbers_missing=missing
    )


def true_stiffness(device: Device, bag: Bag) -> Array:
    """True stiffness (N,) [N m/rad] of the joint at the stamps of its estimates."""
    truth = bag[f"/{device.name}/truth/stiffness"]
    return np.asarray(truth["value"][np.searchsorted(truth.stamp, bag[f"/{device.name}/stiffness"].stamp)])


def _accuracy(true: Array, value: Array, standard_deviation: Array) -> tuple[float | None, float | None]:
    """Median relative error, and share of 95 % intervals that contain the truth; None without estimates."""
    if not len(value):
        return None, None
    return float(np.median(np.abs(value - true) / true)), coverage(true, value, standard_deviation, WIDTH_95)


def _summary(device: Device, first: Bag, second: Bag, late: int, picture: Path) -> LivePart:
    measured, _, _ = joint_signals(first, device)
    estimates, truth = first[f"/{device.name}/stiffness"], first[f"/{device.name}/truth/stiffness"]
    time = (estimates.stamp - estimates.stamp[0]) * 1e-9
    value, standard_deviation = estimates["value"], estimates["standard_deviation"]
    trusted = estimates["status"] == Status.OK
    true = true_stiffness(device, first)
    error, covered = _accuracy(true[trusted], value[trusted], standard_deviation[trusted])
    live_joint(
        measured.time, measured["q"], measured["theta"], Band(time, value, standard_deviation, true, trusted), picture
    )
    return LivePart(
        device=device.name,
        samples=len(measured),
        rate=RATE,
        duration=float(measured.time[-1] - measured.time[0]),
        late_ticks=late,
        traffic=_traffic(device, first, int(truth["sequence"][-1]) + 1),  # the simulator's tick count
        replay=_traffic(device, second, len(measured)),
        bit_identical=same_bits(device, first, second),
        ok=float(np.mean(trusted)),
        stiffness_error=error,
        stiffness_coverage=covered,
        bag="bags/live",
    )
