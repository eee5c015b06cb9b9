"""`via bench realtime`, the closed loop at 1 kHz beside plain rclpy, and `via bench node`, many joints in one node."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from via_bringup.cli.console import working

from via_validation.commands.row_table import Json, shown

PAGE = "realtime.md"


def realtime(
    seconds: Annotated[float, typer.Option(min=2.0, max=86400.0, help="Duration of each of the 5 runs \\[s].")] = 60.0,
    as_rows: Json = None,
    write: Annotated[Path | None, typer.Option(help=f"Also write {PAGE} into this folder.")] = None,
) -> None:
    """The closed loop at 1 kHz in one process and in four, beside plain rclpy: late ticks, round trips, processor time.

    Real-time scheduling, affinity and locked memory are requested. The exit code is 1 if a limit is missed.
    """
    from via_validation.bench.realtime import page
    from via_validation.bench.realtime import rows as rows_of
    from via_validation.provenance import provenance

    source = provenance(f"via bench realtime --seconds {seconds:g}")
    with working("starting") as show:
        loops, node = rows_of.measured(seconds, show)
    rows = [*rows_of.rows(loops), *node]
    if write is not None:
        page.write(loops, rows, source, write / PAGE)
    shown("Real time", rows, as_rows)
    if any(row.ok is False for row in rows):
        raise typer.Exit(1)


def node(
    seconds: Annotated[float, typer.Option(min=1.0, max=86400.0, help="Duration of the test \\[s].")] = 60.0,
    joints: Annotated[int, typer.Option(min=1, max=64, help="Joints of two transmissions.")] = 16,
    device: Annotated[str, typer.Option(help="Device of every joint.")] = "qbmove_a",
    separate: Annotated[bool, typer.Option(help="One JointState per joint instead of one for all.")] = False,
    as_rows: Json = None,
) -> None:
    """The estimator node with many joints at 1 kHz over DDS: lost estimates, CPU share, latency."""
    from via_validation.bench.node import node_rows

    with working("starting the node") as show:
        rows = node_rows(seconds, joints, device, separate, show)
    shown("Estimator node", rows, as_rows)
