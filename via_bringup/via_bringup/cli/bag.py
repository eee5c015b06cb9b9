"""`via bag ...`: everything about recordings. What needs no ROS runs without it; `record` and `play` are the nodes."""

from __future__ import annotations

import json
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

from via_bringup.cli.console import answers, errors, table
from via_bringup.cli.run import become, parameters

BagPath = Annotated[Path, typer.Argument(help="Bag folder or .mcap file.")]
SEVERITIES = {"error": "bold red", "warning": "yellow", "note": "dim"}


def import_folder(
    folder: Annotated[Path, typer.Argument(help="Folder with the recordings (CSV).")],
    mapping: Annotated[str, typer.Option(help=f"Mapping file, or a shipped one: {', '.join(mapping_names())}.")],
    out: Annotated[Path, typer.Option(help="Folder for the bags, one per recording.")],
    report: Annotated[Path | None, typer.Option("--json", help="Write the full report to this file.")] = None,
) -> None:
    """Convert recordings to bags; impossible recordings are refused, each with its reason."""
    done = import_recordings(folder, mapping, out)
    if done.refused:
        listing = table("Refused", "recording", "why")
        listing.columns[1].justify = "left"
        for file in done.refused:
            listing.add_row(file.source, "; ".join(file.reasons))
        answers.print(listing)
    warnings = sum(finding.severity == "warning" for file in done.accepted for finding in file.findings)
    answers.print(
        f"{len(done.accepted)} of {len(done.files)} recordings are now bags in {out}; {warnings} warnings, "
        "kept in the bags' metadata",
    )
    if report is not None:
        report.write_text(json.dumps(done.as_dict(), indent=2) + "\n", encoding="utf-8")


def info(bag: BagPath) -> None:
    """Show what is in a bag."""
    found = info_of(bag)
    listing = table(
        f"{found.path}: {found.messages} messages, {found.duration:.3f} s, {found.size / 1e6:.2f} MB",
        "topic", "type", "messages", "rate [Hz]",
    )  # fmt: skip
    listing.columns[1].justify = "left"
    for topic in found.topics:
        listing.add_row(
            topic.name,
            topic.type_name,
            str(topic.messages),
            f"{topic.rate:.1f}" if isfinite(topic.rate) else "-",
        )
    answers.print(listing)
    for name, value in found.metadata.items():
        if value:
            answers.print(f"{name}: {value}")
    if not found.complete:
        errors.print("this bag is not whole: `via bag recover` makes one of what is there")
    for remark in found.remarks:
        errors.print(f"note: {remark}")


def check(
    bag: BagPath,
    device: Annotated[str, typer.Option(help="Also hold the joint against this device file.")] = "",
    joint_topic: Annotated[str, typer.Option(help="Topic of its joint states.")] = "/joint_states",
) -> None:
    """Look for faults in a bag; exit code 1 when one of the findings is an error."""
    findings = check_bag(bag, load_device(device) if device else None, joint_topic)
    for finding in findings:
        severity = (f"{finding.severity:>8}", SEVERITIES[finding.severity])
        answers.print(Text.assemble(severity, f" {finding.subject}: {finding.text}"))
    bad = sum(finding.severity == "error" for finding in findings)
    answers.print(f"{len(findings)} findings, {bad} errors" if findings else "nothing found")
    if bad:
        raise typer.Exit(1)


def recover(
    bag: BagPath,
    out: Annotated[Path, typer.Argument(help="New bag folder.")],
) -> None:
    """Write a complete bag from all messages that are left in a damaged one."""
    done = recover_bag(bag, out)
    for remark in done.remarks:
        errors.print(f"note: {remark}")
    answers.print(f"{sum(done.messages.values())} messages saved into {done.bag}")


def record(
    out: Annotated[Path, typer.Argument(help="New bag folder.")],
    topics: Annotated[list[str] | None, typer.Argument(help="Topics; none: all there are.")] = None,
) -> None:
    """Record topics until interrupted."""
    become("via_ros", "recorder", parameters(bag=str(out), **({"topics": topics} if topics else {})))


def play(
    bag: BagPath,
    rate: Annotated[float, typer.Option(help="Speed; 0: as fast as the listeners keep up.")] = 1.0,
    topic: Annotated[list[str] | None, typer.Option(help="Play only this topic (repeat for more).")] = None,
    listeners: Annotated[int, typer.Option(help="Listeners to wait for.")] = 1,
) -> None:
    """Play a bag in stamp order, with /clock."""
    more = {"topics": topic} if topic else {}
    become("via_ros", "player", parameters(bag=str(bag), rate=rate, subscribers=listeners, **more))
