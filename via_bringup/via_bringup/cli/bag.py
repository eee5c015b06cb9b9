"""`via bag ...`: recordings. Only `record` and `play` need ROS: they run the nodes `recorder` and `player`."""

from __future__ import annotations

import json
from collections import Counter
from math import isfinite
from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text
from via_core.bags.importing import import_recordings
from via_core.bags.inspection import check as check_bag
from via_core.bags.inspection import info as info_of
from via_core.bags.mapping import mapping_names
from via_core.bags.recovery import recover as recover_bag
from via_core.devices import load_device
from via_core.text_files import write_text

from via_bringup.cli.console import answers, errors, print_table, working
from via_bringup.cli.outputs import check_files, check_folder
from via_bringup.cli.run import execute_node, ros_arguments

BagPath = Annotated[Path, typer.Argument(help="Bag folder or .mcap file.")]
SEVERITIES = {"error": "bold red", "warning": "yellow", "note": "dim"}


def import_folder(
    folder: Annotated[Path, typer.Argument(help="Folder with the recordings.")],
    mapping: Annotated[str, typer.Option(help=f"Mapping file or shipped mapping: {', '.join(mapping_names())}.")],
    out: Annotated[Path, typer.Option(help="Output folder, with one bag per recording.")],
    report: Annotated[Path | None, typer.Option("--json", help="Write the full report to this file.")] = None,
) -> None:
    """Convert recordings to bags; refuse unusable ones and list the reasons."""
    check_folder(out)
    check_files(report)
    with working(f"importing {folder}"):
        imported = import_recordings(folder, mapping, out)
    if imported.refused:
        rows = ((file.source, "; ".join(file.reasons)) for file in imported.refused)
        print_table("Refused", ("recording", "reason"), rows, texts=("reason",))
    warnings = Counter(
        (finding.check, finding.subject) for file in imported.accepted for finding in file.findings
        if finding.severity == "warning"
    )  # fmt: skip
    for (check_name, subject), count in warnings.items():
        first = next(
            f for file in imported.accepted for f in file.findings if (f.check, f.subject) == (check_name, subject)
        )
        answers.print(f"warning in {count} recordings: {subject}: {first.text}", soft_wrap=True)
    answers.print(
        f"{len(imported.accepted)} of {len(imported.files)} recordings are now bags in {out}; "
        f"their metadata lists {warnings.total()} warnings"
    )
    if report is not None:
        write_text(report, json.dumps(imported.as_dict(), indent=2) + "\n")


def info(bag: BagPath) -> None:
    """Show the topics and metadata of a bag."""
    found = info_of(bag)
    title = f"{found.path}: {found.messages} messages, {found.duration:.3f} s, {found.size / 1e6:.2f} MB"
    rows = (
        (each.name, each.type_name, str(each.messages), f"{each.rate:.1f}" if isfinite(each.rate) else "-")
        for each in found.topics
    )
    print_table(title, ("topic", "type", "messages", "rate [Hz]"), rows, texts=("type",))
    for name, value in found.metadata.items():
        if value:
            answers.print(f"{name}: {value}")
    if not found.complete:
        errors.print("this bag is incomplete; `via bag recover` writes its readable messages to a new bag")
    for remark in found.remarks:
        errors.print(f"note: {remark}")


def check(
    bag: Annotated[Path, typer.Argument(help="Bag folder or .mcap file; with --device also a table.")],
    device: Annotated[str, typer.Option(help="Device name or path to its YAML: also check the joint against it.")] = "",
    joint_topic: Annotated[str, typer.Option(help="Topic of the joint states.")] = "/joint_states",
) -> None:
    """Check a recording for faults; the exit code is 1 if any finding is an error."""
    findings = check_bag(bag, load_device(device) if device else None, joint_topic)
    for finding in findings:
        severity = (f"{finding.severity:>8}", SEVERITIES[finding.severity])
        answers.print(Text.assemble(severity, f" {finding.subject}: {finding.text}"))
    failures = sum(finding.severity == "error" for finding in findings)
    answers.print(f"{len(findings)} findings, {failures} errors" if findings else "no findings")
    if failures:
        raise typer.Exit(1)


def recover(bag: BagPath, out: Annotated[Path, typer.Argument(help="New bag folder.")]) -> None:
    """Write all readable messages of a damaged bag to a new bag."""
    check_folder(out)
    recovered = recover_bag(bag, out)
    for remark in recovered.remarks:
        errors.print(f"note: {remark}")
    answers.print(f"{sum(recovered.messages.values())} messages saved into {recovered.bag}")


def record(
    out: Annotated[Path, typer.Argument(help="New bag folder.")],
    topics: Annotated[list[str] | None, typer.Argument(help="Topics to record; default: all.")] = None,
    max_bag_duration: Annotated[
        float, typer.Option(min=1.0, max=1e9, help="Duration \\[s] of one file of the bag.")
    ] = 60.0,
) -> None:
    """Record topics until interrupted, also those that appear later; a line names each topic at its first message."""
    check_folder(out)
    more = {"topics": topics} if topics else {}
    execute_node("via_ros", "recorder", ros_arguments(bag=str(out), max_bag_duration=max_bag_duration, **more))


def play(
    bag: BagPath,
    rate: Annotated[float, typer.Option(help="Playback speed; 0: as fast as the subscribers keep up.")] = 1.0,
    topic: Annotated[list[str] | None, typer.Option(help="Topic to play (repeat for several); default: all.")] = None,
    listeners: Annotated[int, typer.Option(help="Subscribers to wait for on each sample topic; 0: start at once.")] = 1,
) -> None:
    """Play a bag in time stamp order and publish /clock. Gives up after 20 s without a listener; see --listeners."""
    more = {"topics": topic} if topic else {}
    execute_node("via_ros", "player", ros_arguments(bag=str(bag), rate=rate, subscribers=listeners, **more))
