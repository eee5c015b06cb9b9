"""`via watch`: rates, estimates, gaps and warnings of all joints in the terminal, twice a second, or in a browser."""

from __future__ import annotations

import time
from math import isfinite
from typing import Annotated, Any

import typer
from diagnostic_msgs.msg import DiagnosticStatus
from rich.console import Group
from rich.live import Live
from rich.table import Table
from rich.text import Text
from via_core.metrics import WIDTH_95
from via_core.status import Status

from via_bringup.cli.console import answers, table
from via_bringup.cli.ros.session import session
from via_bringup.cli.ros.watched import FORGET, Watched
from via_bringup.cli.ros.web import PERIOD as LOOK
from via_bringup.cli.ros.web import Page, viewer

PERIOD = 0.5  # [s] between two displays
MOST_CAUSES = 2  # that are shown
STYLES = {Status.OK: "green", Status.IMPLAUSIBLE: "bold red"}  # others are yellow


def watch(
    joints: Annotated[list[str] | None, typer.Argument(help="Joints to show; default: all.")] = None,
    joint_topic: Annotated[str, typer.Option(help="Topic of the joint states.")] = "/joint_states",
    once: Annotated[
        float, typer.Option(min=0.0, max=3600.0, help="Print one table after this time \\[s] and end; 0: until Ctrl-C.")
    ] = 0.0,
    web: Annotated[bool, typer.Option("--web", help="Plot in a browser instead; needs rerun: make view.")] = False,
    port: Annotated[
        int, typer.Option(min=1024, max=65534, help="Port of the page; its data take the next one.")
    ] = 9090,
) -> None:
    """Show rate, stiffness, damping, status, gap and causes of every joint, and the warnings of all nodes, live."""
    with session() as now:
        watched = Watched(now.node, joint_topic)
        if web:
            with viewer(port) as (address, stream):
                answers.print(f"open {address}")
                page = Page(stream)
                while True:
                    watched.look()
                    page.show(watched, joints)
                    now.pause(LOOK)
        if once or not answers.is_terminal:
            began = printed = time.monotonic()
            while True:
                now.pause(PERIOD / 5)
                watched.look()
                if time.monotonic() - printed >= (once or 1.0):
                    printed = time.monotonic()
                    answers.print(shown(watched, joints))
                    if once and printed - began >= once:
                        return
        with Live(console=answers, screen=True, auto_refresh=False) as live:
            while True:
                watched.look()
                live.update(shown(watched, joints), refresh=True)
                now.pause(PERIOD)


def shown(watched: Watched, joints: list[str] | None = None) -> Group:
    """The table of all joints, or of these, and the warnings below it."""
    numbers, texts = ("stiffness [N m/rad]", "damping [N m s/rad]"), ("status", "gap", "causes")
    made = table("", "joint", "samples", "gaps", "method", *numbers, *texts, texts=texts)
    names = [each for each in watched.joints() if not joints or each in joints]
    for name in names:
        _add(made, watched, name)
    found = [_warning(each) for each in watched.warnings()]
    if not names:
        found.insert(0, Text("no joint yet: nothing publishes joint states or estimates", "yellow"))
    return Group(made, *found)


def _add(made: Table, watched: Watched, name: str) -> None:
    """Add the rows of a joint: one per method."""
    samples, gap, now = watched.samples.get(name), watched.gap(name), time.monotonic()
    stopped = samples is not None and now - samples.last > FORGET
    rate = "-" if samples is None else "stopped" if stopped else _number(samples.rate, " Hz")
    first = [name, rate, "-" if samples is None else str(samples.gaps)]
    last = [_gap(gap), _causes(gap)]
    for method, estimates in (watched.estimates(name) or {"-": {}}).items():
        status = Text("-")
        for each in estimates.values():
            known = Status(each.status) if each.status in set(Status) else None
            style = STYLES.get(known, "yellow") if known is not None else "bold red"
            status = Text(known.name if known is not None else f"unknown status {each.status}", style)
        made.add_row(*first, method, _band(estimates.get("stiffness")), _band(estimates.get("damping")), status, *last)
        first, last = ["", "", ""], ["", ""]


def _band(estimate: Any) -> str:
    """Value and half the width of its 95 % interval."""
    if estimate is None or not isfinite(estimate.value):
        return "-"
    return f"{_number(estimate.value)} ± {_number(WIDTH_95 * estimate.standard_deviation)}"


def _gap(gap: Any) -> str:
    if gap is None:
        return "-"
    if gap.status != Status.OK:
        return Status(gap.status).name if gap.status in set(Status) else "unknown status"
    return f"{_number(gap.residual_ratio)} x noise" + (f", {gap.verdict}" if gap.verdict else "")


def _causes(gap: Any) -> str:
    """The leading causes and their probabilities."""
    if gap is None or not gap.hypotheses:
        return "-"
    named = [f"{each.effect.name} {100.0 * each.probability:.0f} %" for each in gap.hypotheses[:MOST_CAUSES]]
    more = len(gap.hypotheses) - len(named)
    return ", ".join(named) + (f", {more} more" if more else "")


def _warning(status: DiagnosticStatus) -> Text:
    severe = status.level != DiagnosticStatus.WARN
    return Text(f"{status.name}: {status.message}", "bold red" if severe else "yellow")


def _number(value: float, unit: str = "") -> str:
    return f"{value:.4g}{unit}" if isfinite(value) else "-"
