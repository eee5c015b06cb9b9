"""`via bench ...`: speed compared with other libraries in the same run. Each command imports only what it needs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, track
from via_bringup.cli.console import errors

from via_validation.commands.bench_arm import arm, joints
from via_validation.commands.bench_realtime import node, realtime
from via_validation.commands.bench_soak import soak
from via_validation.commands.row_table import Json, shown

app = typer.Typer(
    help="Measure speed, memory and endurance.",
    no_args_is_help=True,
    add_completion=False,
)

Turns = Annotated[int, typer.Option(min=1, max=1000, help="Alternating repeats; results are medians.")]


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
    write: Annotated[Path | None, typer.Option(help="Also write limits.md into this folder.")] = None,
) -> None:
    """Limits of an arm and of joints: random starts, impacts, holds, lost samples, faulty controllers and estimates."""
    from via_validation.bench.adaptive_limits import adaptive_limit_rows
    from via_validation.bench.joint_limits import joint_limit_rows
    from via_validation.bench.limits import limit_rows, write_markdown

    adaptive = adaptive_limit_rows(track(range(starts), "runs with estimates", console=errors))
    joints = joint_limit_rows(track(range(starts), "runs of joints", console=errors))
    rows = [*limit_rows(track(range(starts), "runs of the arm", console=errors)), *adaptive, *joints]
    shown("Limits", rows, as_rows)
    if write is not None:
        write_markdown(rows, f"via bench limits --starts {starts}", write / "limits.md")


@app.command()
def controllers(turns: Turns = 15, as_rows: Json = None) -> None:
    """Time of one evaluation of each controller; the limit cycle on 4 flexible joints compared with numpy."""
    from via_validation.bench.controllers import controller_rows

    shown("Controllers", controller_rows(turns), as_rows)


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


app.command()(arm)
app.command()(joints)
app.command()(node)
app.command()(realtime)
app.command()(soak)


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
