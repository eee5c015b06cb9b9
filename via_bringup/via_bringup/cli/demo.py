"""`via demo`: the main job, with progress on the terminal and a page at the end."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn
from rich.text import Text

from via_bringup.cli.console import answers, table


def demo(
    scene: Annotated[
        str, typer.Argument(help="limit-cycle, hitting, hopper or throw: that motion alone; else the main job.")
    ] = "",
    out: Annotated[
        Path | None, typer.Option(help="Folder for what is made; else out/demo, or out/<scene>.", show_default=False)
    ] = None,
    recordings: Annotated[
        Path | None,
        typer.Option(help="Folder of real MACCEPA-VD runs; else the data set beside the repo, or the sample."),
    ] = None,
    duration: Annotated[float, typer.Option(min=2.0, max=600.0, help="Length of the live run \\[s].")] = 10.0,
) -> None:
    """A real robot's log and a simulated joint, from bags over DDS to one page; or a scene of a controller."""
    if scene:
        from via_bringup.demo.scenes import play  # loads ROS, which `via --help` need not wait for

        folder = out or Path("out") / scene
        for made in play(scene, folder, min(duration, 10.0)):
            answers.print(str(made))
        return
    from via_bringup.demo.run import run_demo

    out = out or Path("out/demo")
    columns = (
        TextColumn("{task.description:<16}"),
        BarColumn(),
        TextColumn("{task.fields[what]}"),
        TimeElapsedColumn(),
    )
    with Progress(*columns) as bars:
        tasks: dict[str, TaskID] = {}

        def progress(part: str, done: float, of: float, what: str) -> None:
            if part not in tasks:
                tasks[part] = bars.add_task(part, total=of, what="")
            bars.update(tasks[part], completed=done, total=of, what=what)

        summary = run_demo(out, recordings, duration, progress)

    robot, live = summary.robot, summary.live
    if robot.refused:
        refused = table(
            f"Refused recordings: {len(robot.refused)} of {len(robot.refused) + robot.accepted}", "recording", "why"
        )
        refused.columns[1].justify = "left"
        for file in robot.refused:
            refused.add_row(file.file, "; ".join(file.reasons))
        answers.print(refused)
    gap = table("Simulated against real joint angle", "damping strategy", "runs", "NRMSE")
    for strategy, value in robot.nrmse_by_strategy.items():
        gap.add_row(strategy, str(sum(run.strategy == strategy for run in robot.runs)), f"{value:.3f}")
    gap.add_row("all", str(len(robot.runs)), f"{robot.nrmse:.3f}")
    answers.print(gap)
    lost = live.traffic.lost + live.replay.lost
    answers.print(
        f"real robot: {robot.accepted} runs replayed, {robot.lost} messages lost; the 95 % interval of the damping "
        f"holds what the published map makes of the command in {100 * robot.damping_coverage:.0f} % of them\n"
        f"simulated joint: {live.samples} samples at {live.rate:.0f} Hz, {lost} messages lost, "
        f"{live.late_ticks} late ticks; live and replayed estimates "
        f"{'are identical bit for bit' if live.bit_identical else 'DIFFER'}; median stiffness error "
        f"{100 * live.stiffness_error:.2g} %\n"
        f"diagnosis of the robot's recordings: {summary.diagnosis.headline}",
        soft_wrap=True,
    )
    answers.print(
        Text.assemble((str(out / "index.html"), "bold"), f" shows it all; {out / 'summary.json'} has the figures")
    )
