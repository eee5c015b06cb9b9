"""`via bench ...`: speed compared with other libraries in the same run. Each command imports only what it needs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, track
from rich.text import Text
from via_bringup.cli.console import answers, errors, table
from via_core.errors import ViaError

from via_validation.tables.page import as_json, number, verdict
from via_validation.tables.rows import Row

if TYPE_CHECKING:
    from via_validation.bench.soak import Endurance

app = typer.Typer(
    help="Measure speed, memory and endurance.",
    no_args_is_help=True,
    add_completion=False,
)

Json = Annotated[Path | None, typer.Option("--json", help="Write the rows to this file; -: only to stdout.")]
Turns = Annotated[int, typer.Option(min=1, max=1000, help="Alternating repeats; results are medians.")]
STYLES = {"ok": "green", "MISSED": "bold red"}


@app.command()
def core() -> None:
    """Reading of bags by column, compared with mcap-ros2-support and rosbags."""
    from via_validation.bench import bags

    bags.main()


@app.command()
def sim() -> None:
    """The simulator compared with MuJoCo and scipy at equal accuracy."""
    from via_validation.bench import simulator

    simulator.main()


@app.command()
def batch() -> None:
    """A thousand parameter sets of one joint at once, compared with a loop and MuJoCo's rollout."""
    from via_validation.bench import batch as parameter_sets

    parameter_sets.main()


@app.command()
def gap(turns: Annotated[int, typer.Option(min=1, max=100, help="Repeats; times are minima.")] = 3) -> None:
    """One parameter fit compared with scipy and mujoco.sysid; the diagnosis of a log ten times as long."""
    from via_validation.bench import gap as fits

    fits.main(turns)


@app.command()
def estimators(turns: Turns = 15, as_rows: Json = None) -> None:
    """Estimators compared with C++ with Eigen, padasip and numpy; full steps, memory, growth."""
    from via_validation.bench.estimators import estimator_rows

    shown("Estimators", estimator_rows(turns, errors.print), as_rows)


@app.command()
def limits(
    starts: Annotated[int, typer.Option(min=1, max=100_000, help="Random runs; a thousand take ten minutes.")] = 30,
    as_rows: Json = None,
) -> None:
    """Limits of an arm and of joints with random starts, impacts, holds, lost samples and a faulty controller."""
    from via_validation.bench.joint_limits import joint_limit_rows
    from via_validation.bench.limits import limit_rows

    joints = joint_limit_rows(track(range(starts), "runs of joints", console=errors))
    shown("Limits", [*limit_rows(track(range(starts), "runs of the arm", console=errors)), *joints], as_rows)


@app.command()
def controllers(turns: Turns = 15, as_rows: Json = None) -> None:
    """Time of one evaluation of each controller; the limit cycle on 4 flexible joints compared with numpy."""
    from via_validation.bench.controllers import controller_rows

    shown("Controllers", controller_rows(turns), as_rows)


@app.command()
def arm(
    seconds: Annotated[float, typer.Option(min=5.0, max=3600.0, help="Duration for each controller \\[s].")] = 20.0,
    as_rows: Json = None,
) -> None:
    """Controllers of an arm over DDS in real time at 1 kHz in one process: late commands and their effect."""
    from via_validation.bench.arm import arm_rows

    shown("Arm in real time", arm_rows(seconds), as_rows)


@app.command()
def hitting(as_rows: Json = None) -> None:
    """The 4-dof arm hitting walls over DDS in lockstep: three walls with three holds each. Takes some minutes."""
    from via_validation.bench.hitting import hitting_rows_over_dds

    with Progress(TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), console=errors) as bars:
        task = bars.add_task("")
        rows = hitting_rows_over_dds(
            lambda done, of, what: bars.update(task, completed=done, total=of, description=what)
        )  # fmt: skip
    shown("Hitting over DDS", rows, as_rows)


@app.command()
def node(
    seconds: Annotated[float, typer.Option(min=1.0, max=86400.0, help="Duration of the test \\[s].")] = 60.0,
    joints: Annotated[int, typer.Option(min=1, max=64, help="Joints of two transmissions.")] = 16,
    device: Annotated[str, typer.Option(help="Device of every joint.")] = "qbmove_a",
    separate: Annotated[bool, typer.Option(help="One JointState per joint instead of one for all.")] = False,
    as_rows: Json = None,
) -> None:
    """The estimator node with many joints at 1 kHz over DDS: lost estimates, CPU share, latency."""
    from via_validation.bench.node import node_rows

    shown("Estimator node", node_rows(seconds, joints, device, separate), as_rows)


@app.command()
def soak(
    method: Annotated[list[str] | None, typer.Option(help="Only this method (repeat for more).")] = None,
    device: Annotated[str, typer.Option(help="Joint; default: one that suits the method.")] = "",
    hours: Annotated[float, typer.Option(min=0.01, max=10_000.0, help="Simulated time \\[h].")] = 24.0,
    start: Annotated[float, typer.Option(min=0.0, max=1e9, help="Stamp of the first sample \\[s].")] = 0.0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of noise, dropouts and gaps.")] = 0,
    as_rows: Json = None,
    write: Annotated[Path | None, typer.Option(help="Also write soak.md into this folder.")] = None,
) -> None:
    """Simulated hours at 1 kHz: finite numbers, bounded errors and memory. A day takes minutes per method."""
    from via_core.devices import load_device
    from via_estimators.methods import METHODS, method_for

    from via_validation.bench.estimators import device_for
    from via_validation.bench.soak import soak_rows, work, write_markdown
    from via_validation.provenance import provenance
    from via_validation.side_by_side import side_by_side

    chosen = [method_for(load_device(device), name) if device else name for name in method or METHODS]
    words = ["via bench soak", f"--hours {hours:g}", *(f"--method {name}" for name in method or [])]
    words += (
        [f"--device {device}"] * bool(device) + [f"--start {start:g}"] * bool(start) + [f"--seed {seed}"] * bool(seed)
    )
    joints = [load_device(device) if device else device_for(name) for name in chosen]
    columns = (
        TextColumn("{task.description:<24}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
    )
    done: dict[int, Endurance] = {}
    tenths = [0] * len(chosen)  # last progress printed of each run, without a terminal
    with Progress(*columns, console=errors, disable=not errors.is_terminal) as bars:
        tasks = [bars.add_task(name, total=hours, start=False) for name in chosen]

        def receive(number: int, sent: float | Endurance | ViaError) -> None:
            if isinstance(sent, ViaError):
                raise sent
            if isinstance(sent, float | int):
                bars.update(tasks[number], completed=sent)
                if not errors.is_terminal and (tenth := min(int(10.0 * sent / hours), 10)) > tenths[number]:
                    tenths[number] = tenth
                    errors.print(f"{chosen[number]}: {10 * tenth} %")
                return
            done[number] = sent
            if write is not None:
                missing = [name for at, name in enumerate(chosen) if at not in done]
                write_markdown(_in_order(done), missing, provenance(" ".join(words)), write / "soak.md")

        jobs = [(work, (joint, name, hours, start, seed)) for joint, name in zip(joints, chosen, strict=True)]
        complete = side_by_side(jobs, receive, lambda number: bars.start_task(tasks[number]), lambda _: None)
    shown("Endurance", [row for run in _in_order(done) for row in soak_rows(run)], as_rows)
    if not complete:
        raise typer.Exit(130)
    if lost := [name for number, name in enumerate(chosen) if number not in done]:
        raise ViaError(f"ended early, without a result: {', '.join(lost)}")


def _in_order(done: dict[int, Endurance]) -> list[Endurance]:
    return [done[number] for number in sorted(done)]


@app.command("all")
def everything(turns: Turns = 15) -> None:
    """The most important benchmarks, one after the other."""
    core()
    sim()
    batch()
    gap()
    estimators(turns)
    controllers(turns)
    node()


def shown(title: str, rows: list[Row], as_rows: Path | None) -> None:
    """Print the rows as a table; `as_rows`: write them as JSON too, or only to stdout for '-'."""
    objects = json.dumps(as_json(rows), indent=1, allow_nan=False) + "\n"
    if as_rows == Path("-"):
        print(objects, end="")
        return
    listing = table(title, "id", "what", "quantity", "measured", "limit", "verdict")
    listing.columns[1].justify = listing.columns[2].justify = "left"
    for row in rows:
        word = verdict(row)
        what = Text.assemble(row.what, (f"\n{row.remark}", "dim") if row.remark else "")
        listing.add_row(
            row.id, what, row.quantity, number(row.ours), number(row.limit), Text(word, STYLES.get(word, ""))
        )
    answers.print(listing)
    if as_rows is not None:
        as_rows.write_text(objects, encoding="utf-8")
