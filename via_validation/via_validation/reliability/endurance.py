"""Endurance of the live graph: one joint at 1 kHz, with every node in a process of its own.

Simulator, controller, estimator and recorder run for the given time. Limits are missed by lost messages, memory that
grows, estimates that drift, shared memory that stays behind, and exit codes other than 0.
"""

from __future__ import annotations

import os
import re
import signal
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from via_core.bags.reader import Bag, Integers, read_bag
from via_core.devices import load_device
from via_core.signals import Array
from via_core.status import Status

from via_validation.reliability.graph import Graph, Process
from via_validation.tables.rows import Row

DEVICE = load_device("qbmove_a")
SAMPLES, COMMANDS = "/joint_states", DEVICE.command_topic
ESTIMATES, TRUTH = f"/{DEVICE.name}/stiffness", f"/{DEVICE.name}/truth/stiffness"
RECORDED = {
    SAMPLES: "sensor_msgs/msg/JointState",
    COMMANDS: "via_interfaces/msg/VsaCommand",
    ESTIMATES: "via_interfaces/msg/StiffnessEstimate",
    TRUTH: "via_interfaces/msg/StiffnessEstimate",
}
START = 600.0  # [s] time limit until every topic is recorded: kernels may have to be compiled
LOOKS = 120  # measurements of memory during a run
GROWTH = 4.0  # [MiB] that a process may grow over the second half
DRIFT = 1.25  # error in the last quarter over that in the first
MIB = 2.0**20
PAGE = os.sysconf("SC_PAGE_SIZE")
TICKS = os.sysconf("SC_CLK_TCK")  # per second of processor time
SHARED = re.compile(r"/dev/shm/(?:sem\.)?fast\S+")  # of the middleware


@dataclass(frozen=True)
class Usage:
    """What one process used.

    time      (n,) [s] since the begin of the run
    resident  (n,) [B]
    share     of a core
    code      exit code
    """

    time: Array
    resident: Array
    share: float
    code: int | None

    @property
    def growth(self) -> float:
        """Growth of the resident memory over the second half of the run [MiB], from a fitted line."""
        late = self.time >= 0.5 * self.time[-1]
        slope = np.polyfit(self.time[late], self.resident[late], 1)[0]
        return float(slope * (self.time[late][-1] - self.time[late][0]) / MIB)


@dataclass(frozen=True)
class Run:
    """One run.

    rate, seconds  of the simulator [Hz], of the run [s]
    usage          by process
    opened, left   files of shared memory that the processes mapped, and those of them that remain after their end
    late           share of the ticks that began more than a period late; NaN if the simulator did not report it
    """

    rate: float
    seconds: float
    usage: Mapping[str, Usage]
    opened: frozenset[str]
    left: frozenset[str]
    late: float
    bag: Bag


def run(folder: Path, seconds: float, rate: float, progress: Callable[[float], None] = lambda _: None) -> Run:
    """Run the graph for `seconds` in an empty folder, which then holds the bag; `progress` gets the time passed [s].

    Raises ViaError if a process ends early or the recording does not begin.
    """
    with Graph(folder) as graph:
        graph.observe_diagnostics()
        topics = ", ".join(f"'{name}:{kind}'" for name, kind in RECORDED.items())
        device = f"device:={DEVICE.name}"
        processes = {
            "recorder": graph.start("via_ros", "recorder", "bag:=bag", f"topics:=[{topics}]"),
            "estimator": graph.start("via_estimators", "estimator", device),
            "controller": graph.start("via_controllers", "excitation", device),
            "simulator": graph.start("via_sim", "simulator", device, f"rate:={rate}", "truth:=true", "listeners:=3"),
        }
        recorder = processes["recorder"]
        graph.until(lambda: all(f"recording {topic}" in recorder.errors() for topic in RECORDED), "recording", START)
        begin = time.monotonic()
        used = {name: _processor_time(each) for name, each in processes.items()}
        times: list[float] = []
        resident: dict[str, list[int]] = {name: [] for name in processes}
        opened: set[str] = set()
        while not times or times[-1] < seconds:
            graph.pause(min(seconds / LOOKS, 10.0))
            graph.all_run()
            times.append(time.monotonic() - begin)
            for name, each in processes.items():
                resident[name].append(_resident(each))
                opened |= _shared_memory(each)
            del graph.reports[:-100]  # this process must not grow either
            progress(times[-1])
        shares = {name: (_processor_time(each) - used[name]) / times[-1] for name, each in processes.items()}
        late = _late(graph)
        codes = {name: _ended(graph, each) for name, each in processes.items()}
        usage = {
            name: Usage(np.array(times), np.array(resident[name], dtype=float), shares[name], codes[name])
            for name in processes
        }
        left = frozenset(each for each in opened if Path(each).exists())
        return Run(rate, times[-1], usage, frozenset(opened), left, late, read_bag(folder / "bag"))


def rows(run: Run) -> list[Row]:
    """What was measured, with limits."""
    settings = f"{DEVICE.name}, {run.rate:g} Hz, {run.seconds:.0f} s, four processes"

    def row(name: str, what: str, quantity: str, ours: float, limit: float | None = None) -> Row:
        return Row(f"endurance.{name}", what, quantity, None, float(ours), limit, settings)

    samples, estimates, commands = (run.bag[topic].stamp for topic in (SAMPLES, ESTIMATES, COMMANDS))
    steps = np.diff(samples) * 1e-6  # [ms]
    first, last = _errors(run.bag)
    return [
        row("samples", "samples recorded", "count", len(samples)),
        row("lost.bag", "remarks on the bag: messages that are missing", "count", len(run.bag.remarks), 0.0),
        row("lost.estimates", "estimates missing by sequence number", "count", _missing(run.bag, ESTIMATES), 0.0),
        row("lost.commands", "commands missing by sequence number", "count", _missing(run.bag, COMMANDS), 0.0),
        row("lost.samples", "samples without an estimate", "count", _unanswered(samples, estimates), 0.0),
        row("unanswered", "samples without a command", "share of samples [%]",
            100.0 * _unanswered(samples, commands) / len(samples)),
        row("late", "ticks of the simulator late by more than a period", "share of ticks [%]", 100.0 * run.late),
        row("gap", "largest step between the stamps of two samples", "time [ms]", steps.max()),
        row("error.first", "RMS error of OK estimates, first quarter", "share of the stiffness [%]", 100.0 * first),
        row("error.last", "the same, last quarter", "share of the stiffness [%]", 100.0 * last, 100.0 * DRIFT * first),
        row("shm.left", "files of shared memory left behind", "count", len(run.left), 0.0),
        row("shm.opened", "files of shared memory opened", "count", len(run.opened)),
        *(row(f"memory.{name}", f"growth of the {name} over the second half", "memory [MiB]", each.growth, GROWTH)
          for name, each in run.usage.items()),
        *(row(f"resident.{name}", f"memory of the {name} at the end", "memory [MiB]", each.resident[-1] / MIB)
          for name, each in run.usage.items()),
        *(row(f"cpu.{name}", f"processor time of the {name}", "share of a core [%]", 100.0 * each.share)
          for name, each in run.usage.items()),
        *(row(f"code.{name}", f"{name} that ended with an error", "count", float(each.code != 0), 0.0)
          for name, each in run.usage.items()),
    ]  # fmt: skip


def _missing(bag: Bag, topic: str) -> int:
    """Messages that the sequence numbers of a topic skip."""
    sequence = np.sort(bag[topic]["sequence"].astype(np.int64))
    return int(sequence[-1] - sequence[0] + 1 - len(np.unique(sequence)))


def _unanswered(samples: Integers, answers: Integers) -> int:
    """Samples between the first and the last answer that no answer has the stamp of."""
    within = samples[(samples >= answers.min()) & (samples <= answers.max())]
    return int(np.count_nonzero(~np.isin(within, answers)))


def _errors(bag: Bag) -> tuple[float, float]:
    """RMS error of the OK estimates over the RMS of the true stiffness, in the first and in the last quarter."""
    estimates, truth = bag[ESTIMATES], bag[TRUTH]
    _, at, of = np.intersect1d(estimates.stamp, truth.stamp, return_indices=True)
    good = estimates["status"][at] == Status.OK
    stamp, value, true = estimates.stamp[at][good], estimates["value"][at][good], truth["value"][of][good]
    edges = np.quantile(estimates.stamp, [0.25, 0.75])
    return tuple(
        float(np.sqrt(np.mean((value[part] - true[part]) ** 2) / np.mean(true[part] ** 2))) if part.any() else np.nan
        for part in (stamp <= edges[0], stamp >= edges[1])
    )  # type: ignore[return-value]


def _ended(graph: Graph, process: Process) -> int | None:
    """Exit code after SIGINT; raises ViaError if the process does not end."""
    process.signal(signal.SIGINT)
    graph.until(lambda: process.code is not None, f"the end of {process.label}")
    return process.code


def _late(graph: Graph) -> float:
    for status in reversed(graph.reports):
        values = {each.key: each.value for each in status.values}
        if "late ticks" in values:
            return int(values["late ticks"]) / max(int(values["ticks"]), 1)
    return float("nan")


def _resident(process: Process) -> int:
    """Resident memory [B]."""
    return int(Path(f"/proc/{process.pid}/statm").read_text().split()[1]) * PAGE


def _processor_time(process: Process) -> float:
    """Processor time of all threads [s]."""
    fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


def _shared_memory(process: Process) -> set[str]:
    """Files of shared memory of the middleware that the process maps."""
    return set(SHARED.findall(Path(f"/proc/{process.pid}/maps").read_text()))
