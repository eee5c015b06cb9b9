"""Summary and checks of a bag."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from via_core.bags.container import files_of
from via_core.bags.findings import Finding
from via_core.bags.joints import StampReport, joint_signals
from via_core.bags.losses import NOTABLE, losses
from via_core.bags.reader import Bag, Columns, Topic, read_bag
from via_core.bags.recording_checks import GAP_PERIODS, check_recording, check_samples
from via_core.devices import Device
from via_core.errors import BagError, SignalError
from via_core.recordings.channels import read_joint
from via_core.recordings.tables import is_table
from via_core.signals import Array, Signals
from via_core.wire import JOINT_STATE, VSA_COMMAND

MOST_SHOWN = 3  # findings of one kind reported one by one; the rest are counted


@dataclass(frozen=True)
class TopicInfo:
    """One topic: first and last stamp [ns]; rate [Hz] from the median period, NaN below two messages."""

    name: str
    type_name: str
    messages: int
    first: int
    last: int
    rate: float


@dataclass(frozen=True)
class BagInfo:
    """Summary of a bag: size [bytes] on disk, duration [s] from first to last log time."""

    path: Path
    size: int
    messages: int
    duration: float
    topics: tuple[TopicInfo, ...]
    metadata: Mapping[str, str]
    complete: bool
    remarks: tuple[str, ...]


def info(path: str | Path) -> BagInfo:
    """Summary of a bag, MCAP or sqlite3. Raises BagError when nothing can be read."""
    bag = read_bag(path)
    times = [topic.log_time for topic in bag.topics.values() if len(topic)]
    duration = (
        (max(int(each.max()) for each in times) - min(int(each.min()) for each in times)) * 1e-9 if times else 0.0
    )
    databases = sorted(bag.path.glob("*.db3")) if bag.path.is_dir() else ()
    size = sum(file.stat().st_size for file in (*files_of(bag.path), *databases))
    topics = tuple(_topic_info(topic) for _, topic in sorted(bag.topics.items()))
    return BagInfo(bag.path, size, len(bag), duration, topics, bag.metadata, bag.complete, bag.remarks)


def _topic_info(topic: Topic) -> TopicInfo:
    stamp = topic.stamp
    first, last = (int(stamp.min()), int(stamp.max())) if len(topic) else (0, 0)
    period = float(np.median(np.diff(stamp))) if len(topic) > 1 else np.nan
    return TopicInfo(topic.name, topic.type_name, len(topic), first, last, 1e9 / period if period > 0.0 else np.nan)


def check(path: str | Path, device: Device | None = None, joint_topic: str = "/joint_states") -> list[Finding]:
    """Problems of a recording that affect estimation; with a `device` also missing or implausible signals of it.

    A table is checked as the recording of its device. Raises BagError when nothing can be read from `path`.
    """
    if is_table(Path(path)):
        return _check_table(Path(path), device)
    bag = read_bag(path)
    findings = [Finding("warning", "file", bag.path.name, remark, 1.0) for remark in bag.remarks]
    for name in sorted(bag.topics):
        findings += _check_topic(bag, name)
    if device is not None:
        findings += _check_joint(bag, device, joint_topic)
    return findings


def _check_table(path: Path, device: Device | None) -> list[Finding]:
    if device is None:
        raise BagError(f"{path.name} is no bag but a table: add --device, whose wire.columns say what its columns hold")
    try:
        measured, commands, reports = read_joint(path, device)
    except SignalError as error:
        return [Finding("error", "joint", device.name, str(error), 1.0)]
    found = [*_dropped(reports[0], "time"), *check_samples(measured.time, {"q": measured["q"]}), *_turns(reports)]
    if commands is None:
        found.append(Finding("note", "commands", "joint", f"no commands were recorded{reports[0].hint}", 0.0))
    return [*found, *check_recording(measured, commands, device)]


def _dropped(report: StampReport, subject: str) -> list[Finding]:
    """Findings on rows of a table without use because of their stamps."""
    counts = (("repeated", report.repeated, "repeat another one"), ("backward", report.backward, "are out of order"))
    text = "{} of {} stamps {}; their rows are left out"
    return [
        Finding("warning", check_name, subject, text.format(bad, report.messages, what), bad / report.messages, 0.0)
        for check_name, bad, what in counts
        if bad
    ]


def _turns(reports: Iterable[StampReport]) -> list[Finding]:
    """Notes on angles that started again after a turn."""
    return [
        Finding("note", "turn", channel, f"passes the end of its turn {count} times; read as continuous", float(count))
        for report in reports
        for channel, count in report.passed.items()
    ]


def _check_topic(bag: Bag, name: str) -> list[Finding]:
    try:
        columns = bag[name]
    except BagError as error:
        return [Finding("error", "content", name, str(error), 1.0)]
    if len(columns) == 0:
        return [Finding("warning", "empty", name, "no messages", 0.0)]
    findings = [Finding("warning", "content", name, text, 1.0) for text in columns.left_out[:MOST_SHOWN]]
    if len(columns.left_out) > MOST_SHOWN:
        text = f"{len(columns.left_out)} messages in all are skipped for such reasons"
        findings.append(Finding("warning", "content", name, text, float(len(columns.left_out))))
    if bag.topic(name).unset:
        text = "no message has a stamp: the publisher left them at zero; times of recording are used, which jitter"
        findings.append(Finding("warning", "unset", name, text, 1.0, 0.0))
    findings += _timing(columns) + _losses(columns)
    if columns.type_name in (JOINT_STATE, VSA_COMMAND):
        findings += _values(columns)
    return findings


def _timing(columns: Columns) -> list[Finding]:
    """Findings on order, rate, jitter and gaps of the stamps."""
    topic, stamp = columns.topic, columns.stamp
    findings = []
    step = np.diff(stamp)
    for check_name, bad, what in (
        ("repeated", int(np.count_nonzero(step == 0)), "repeat the previous stamp"),
        ("backward", int(np.count_nonzero(step < 0)), "have an earlier stamp than the previous message"),
    ):
        if bad:
            text = f"{bad} of {len(stamp)} messages {what}"
            findings.append(Finding("warning", check_name, topic, text, bad / len(stamp), 0.0))
    forward = step[step > 0] * 1e-9
    if len(forward) < 2:
        return findings
    period = float(np.median(forward))
    jitter = float(np.percentile(np.abs(forward - period), 95))
    text = f"{1.0 / period:.1f} Hz, period {period * 1e3:.3f} ms, 95 % within {jitter * 1e3:.3f} ms of it"
    findings.append(Finding("note", "rate", topic, text, 1.0 / period))
    gaps = forward[forward > GAP_PERIODS * period]
    if len(gaps):
        text = f"{len(gaps)} gaps, the longest {gaps.max():.4f} s, at a usual period of {period:.4f} s"
        findings.append(Finding("warning", "gap", topic, text, float(gaps.max()), GAP_PERIODS * period))
    missing = losses(np.concatenate([[0.0], np.cumsum(forward)]))
    if missing is not None:
        text = (
            f"about {missing.lost} messages are missing by their stamps, {missing.share:.1%} of all, up to "
            f"{missing.longest} in a row"
        )
        findings.append(Finding("warning", "missing", topic, text, missing.share, NOTABLE))
    return findings


def _losses(columns: Columns) -> list[Finding]:
    """Messages missing according to their sequence numbers."""
    if "sequence" not in columns.fields:
        return []
    step = np.diff(columns["sequence"].astype(np.int64))
    lost = int(step[step > 1].sum() - np.count_nonzero(step > 1))
    findings = []
    if lost:
        text = f"{lost} messages are missing according to their sequence numbers"
        findings.append(Finding("warning", "lost", columns.topic, text, float(lost), 0.0))
    restarts = int(np.count_nonzero(step < 0))
    if restarts:
        text = f"the sequence starts again {restarts} times: the publisher was restarted, or there were two"
        findings.append(Finding("warning", "restarted", columns.topic, text, float(restarts), 0.0))
    return findings


def _values(columns: Columns) -> list[Finding]:
    """Missing values, infinite values, and quantisation of positions."""
    findings = []
    for label, values in _series(columns):
        share = float(np.isnan(values).mean())
        if 0.0 < share < 1.0:
            text = f"{label}: {share:.1%} of the values are NaN"
            findings.append(Finding("warning", "not_measured", columns.topic, text, share))
        infinite = int(np.count_nonzero(np.isinf(values)))
        if infinite:
            text = f"{label}: {infinite} values are infinite"
            findings.append(Finding("error", "infinite", columns.topic, text, float(infinite), 0.0))
        with np.errstate(over="ignore"):
            steps = np.abs(np.diff(values[np.isfinite(values)]))
        moved = steps[steps > 1e-9]
        if columns.type_name == JOINT_STATE and "position" in label and len(moved) > 10:
            quantum = float(moved.min())
            with np.errstate(over="ignore", invalid="ignore"):  # huge values overflow
                multiples = moved / quantum
                off = float(np.abs(multiples - np.rint(multiples)).max())
            if quantum > 1e-5 and off < 0.05:
                text = f"{label}: measured in steps of {quantum:.6f} rad"
                findings.append(Finding("note", "quantised", columns.topic, text, quantum))
    return findings


def _series(columns: Columns) -> list[tuple[str, Array]]:
    """All numeric series with their names; series of joints only where all messages name the same joints."""
    series: list[tuple[str, Array]] = []
    names = columns["name"][0] if "name" in columns.fields else ()
    for field, values in columns.fields.items():
        if values.dtype != np.float64:
            continue
        if values.ndim == 1:
            series.append((field, values))
        elif all(each == names for each in columns.fields.get("name", ())):
            labels = names if len(names) == values.shape[1] else range(values.shape[1])
            series += [(f"{field} of {label}", values[:, k]) for k, label in enumerate(labels)]
    return series


def _check_joint(bag: Bag, device: Device, joint_topic: str) -> list[Finding]:
    try:
        if device.wire.topics_of_columns:
            measured, commands, reports = read_joint(bag.path, device)
        else:
            measured, commands, reports = joint_signals(bag, device, joint_topic)
    except (BagError, SignalError) as error:
        return [Finding("error", "joint", device.name, str(error), 1.0)]
    findings = []
    for report in reports:
        if report.others:
            text = f"{report.others} of {report.messages} messages are of other joints"
            findings.append(Finding("note", "others", report.topic, text, float(report.others)))
    findings += _turns(reports)
    commanded = commands is not None and "external_torque" in commands
    return findings + _check_channels(measured, device, commanded) + list(check_recording(measured, commands, device))


def _check_channels(measured: Signals, device: Device, commanded: bool) -> list[Finding]:
    """Signals that an estimator or a diagnosis of this device needs and that are missing or constant.

    commanded  the torque of the drive of a rigid joint was recorded as a command
    """
    findings = []
    needed = {"q": ("angle", "link")}
    if device.drive == "torque" and device.n_motors:
        needed |= {"theta": ("angle", "motor"), "tau": ("effort", "motor")}
    elif device.drive == "torque" and device.damper is None and not commanded:
        needed |= {"tau": ("effort", "the drive")}
    for channel, (what, whose) in needed.items():
        columns = measured[channel].reshape(len(measured), -1) if channel in measured else np.empty((len(measured), 0))
        for i in range(device.n_motors if whose == "motor" else 1):
            name = f"{whose} {i + 1}" if whose == "motor" else whose
            column = columns[:, i] if i < columns.shape[1] else np.full(len(measured), np.nan)
            if not np.isfinite(column).any():
                text = f"the {what} of {name} is in no message that names the link: publish both in one message"
                findings.append(Finding("warning", "channel", device.name, text, 1.0))
            elif len(column) > 1 and np.all(column == column[0]):
                text = f"the {what} of {name} is {column[0]:g} in all messages; check that it is measured"
                findings.append(Finding("warning", "channel", device.name, text, 1.0))
    return findings
