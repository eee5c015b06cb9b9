"""A simulator, a controller, an estimator and a recorder in processes of their own, and what the peer hears of them.

The simulator ticks in real time; its stamps are those of the system clock, so that the time of a kill can be compared
with stamps, however slow the machine is.
"""

from __future__ import annotations

import numpy as np
from sensor_msgs.msg import JointState
from via_core.bags.reader import Bag, read_bag
from via_core.devices import load_device
from via_core.errors import ViaError
from via_core.status import Status
from via_interfaces.msg import StiffnessEstimate, VsaCommand
from via_ros.conversions import nanoseconds

from via_validation.reliability.fault import expect
from via_validation.reliability.graph import Graph, Process

DEVICE = load_device("qbmove_a")
RATE = 250.0  # [Hz]
WITHIN = 20_000_000  # [ns] until motors are passive without a controller
CHUNK = 150_000_000  # [ns] of messages that a killed recorder may lose: two flushes and a late timer
SAMPLES, ESTIMATES = "/joint_states", f"/{DEVICE.name}/stiffness"
COMMANDS, TRUTH = DEVICE.command_topic, f"/{DEVICE.name}/truth/stiffness"
LATE = 0.5  # [s] of stamps within which a message must be recorded
RECORDED = {
    SAMPLES: "sensor_msgs/msg/JointState",
    COMMANDS: "via_interfaces/msg/VsaCommand",
    ESTIMATES: "via_interfaces/msg/StiffnessEstimate",
}
LISTENERS = 4  # of samples: peer, controller, estimator, recorder
SD, SHARE = 4.0, 0.15  # as of `stream`


class Lab:
    """The processes by name: `simulator`, `controller`, `estimator`, `recorder`; all run and the motors are driven."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        graph.observe_diagnostics()
        self.samples = graph.hear(JointState, SAMPLES)
        self.estimates = graph.hear(StiffnessEstimate, ESTIMATES)
        self.commands = graph.hear(VsaCommand, COMMANDS)
        self._truths = graph.hear(StiffnessEstimate, TRUTH)
        self.recorder, self.estimator, self.controller = (
            self.start_recorder(), self.start_estimator(), self.start_controller(),
        )  # fmt: skip
        self.simulator = self.start_simulator()
        graph.until(
            lambda: all(f"recording {topic}" in self.recorder.errors() for topic in RECORDED), "recording", 600.0
        )
        self.goes_on("at the start")
        self._fault = 0  # samples before the fault

    # ---- processes

    def start_simulator(self, listeners: int = LISTENERS) -> Process:
        """A simulator, which waits for that many listeners."""
        return self.graph.start(
            "via_sim", "simulator", f"device:={DEVICE.name}", f"rate:={RATE}", "truth:=true", f"listeners:={listeners}"
        )

    def start_controller(self, name: str = "") -> Process:
        """A controller that excites the joint."""
        return self.graph.start("via_controllers", "excitation", f"device:={DEVICE.name}", name=name)

    def start_estimator(self) -> Process:
        """An estimator."""
        return self.graph.start("via_estimators", "estimator", f"device:={DEVICE.name}")

    def start_recorder(self, bag: str = "bag") -> Process:
        """A recorder of samples, commands and estimates."""
        topics = [f"'{name}:{kind}'" for name, kind in RECORDED.items()]
        return self.graph.start("via_ros", "recorder", f"bag:={bag}", f"topics:=[{', '.join(topics)}]")

    # ---- what is heard

    def stamp(self) -> int:
        """[ns] of the last sample."""
        return nanoseconds(self.samples[-1].header.stamp)

    def torque(self) -> float:
        """[N m] largest torque during the tick before the last sample."""
        return float(np.abs(self.samples[-1].effort[1:]).max())

    def goes_on(self, when: str, *dead: Process) -> None:
        """Wait for driven samples and estimates from now on; processes beside the `dead` ones must run."""
        samples, estimates = len(self.samples), len(self.estimates)
        self.graph.until(
            lambda: len(self.samples) > samples + 50 and len(self.estimates) > estimates + 50 and self.torque() > 0.0,
            f"torque and estimates {when}", 600.0,
        )  # fmt: skip
        self.graph.all_run(*dead)

    def passes(self, seconds: float) -> None:
        """Wait until stamps are so much later."""
        end = self.stamp() + round(1e9 * seconds)
        self.graph.until(lambda: self.stamp() > end, "samples")

    def torque_after(self, time: int) -> float:
        """[ms] from `time` [ns] to the last tick with a torque; raises MissedError beyond 20 ms."""
        self.graph.until(lambda: self.stamp() > time + 10 * WITHIN, "later samples")
        driven = [
            nanoseconds(each.header.stamp)
            for each in self.samples
            if any(each.effort[1:]) and nanoseconds(each.header.stamp) <= time + 10 * WITHIN
        ]
        after = 1e-6 * (max(driven) - time)
        expect(after <= 1e-6 * WITHIN, f"torque until {after:.1f} ms after the fault")
        return after

    def backward(self) -> int:
        """Number of samples since the fault with a stamp before that of the one before: of another simulator."""
        stamps = [nanoseconds(each.header.stamp) for each in self.samples[self._fault :]]
        return int((np.diff(stamps) < 0).sum())

    def begin(self) -> None:
        """The fault comes now."""
        self._fault = len(self.samples)

    def largest_gap(self) -> float:
        """[ms] largest step between the stamps of two samples, from the last one before the fault on."""
        stamps = [nanoseconds(each.header.stamp) for each in self.samples[self._fault - 1 :]]
        return 1e-6 * float(np.diff(stamps).max())

    def wrong(self) -> str:
        """How many estimates were OK; raises MissedError if one of them was wrong."""
        truth = {nanoseconds(each.header.stamp): each.value for each in self._truths}
        ok = [each for each in self.estimates if each.status == Status.OK and nanoseconds(each.header.stamp) in truth]
        wrong = 0
        for each in ok:
            true = truth[nanoseconds(each.header.stamp)]
            error = abs(each.value - true)
            wrong += error > SD * each.standard_deviation and error > SHARE * true
        expect(not wrong, f"{wrong} of {len(ok)} OK estimates are wrong")
        return f"{len(ok)} OK estimates, none wrong"

    # ---- the bag

    def end_recorder(self) -> Bag:
        """The bag after an orderly end of the recorder; it must be complete and have every sample heard meanwhile."""
        last = self.stamp()
        self.passes(LATE)
        self.recorder.signal(2)
        self.graph.until(lambda: self.recorder.code is not None, "the end of the recorder")
        expect(
            self.recorder.code == 0, f"the recorder ended with {self.recorder.code}: {self.recorder.errors()[-200:]}"
        )
        bag = read_bag(self.graph.folder / "bag")
        expect(bag.complete, f"the bag is not complete: {'; '.join(bag.remarks)}")
        self.recorded(bag, last)
        return bag

    def recorded(self, bag: Bag, until: int | None = None) -> str:
        """How much is in the bag; raises MissedError if a message before `until` [ns] is missing, else the last one."""
        counts = []
        for topic, heard in ((SAMPLES, self.samples), (ESTIMATES, self.estimates), (COMMANDS, self.commands)):
            stamps, each_heard = set(bag[topic].stamp.tolist()), [nanoseconds(each.header.stamp) for each in heard]
            last = max(stamps) if until is None else until
            missing = [each for each in each_heard if min(stamps) <= each <= last and each not in stamps]
            counts.append(f"{len(stamps)} on {topic}")
            after = 1e-6 * (missing[0] - nanoseconds(self.samples[self._fault - 1].header.stamp)) if missing else 0.0
            lost = f"{len(missing)} of {len(each_heard)} messages on {topic} are missing in the bag"
            expect(not missing, f"{lost}, the first one {after:.0f} ms after the fault")
        return f"none missing in the bag: {', '.join(counts)}"


def ends(graph: Graph, process: Process, code: int) -> None:
    """Wait for the end of a process with this exit code."""
    graph.until(lambda: process.code is not None, f"the end of {process.label}")
    if process.code != code:
        raise ViaError(f"{process.label} ended with {process.code} in place of {code}: {process.errors()[-200:]}")
