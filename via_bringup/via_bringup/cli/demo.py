"""`via demo`: run the demo with a progress display and print a summary."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn
from rich.text import Text

from via_bringup.cli.console import answers, print_table, working
from via_bringup.cli.outputs import check_folder


def demo(
    scene: Annotated[
        str, typer.Argument(help="limit-cycle, hitting, hopper or throw: run only this controller scene.")
    ] = "",
    out: Annotated[
        Path | None, typer.Option(help="Output folder; default: out/demo, or out/<scene>.", show_default=False)
    ] = None,
    recordings: Annotated[
        Path | None,
        typer.Option(help="Folder with MACCEPA-VD recordings; default: ../shared/data/maccepavd, else the sample."),
    ] = None,
    duration: Annotated[
        float, typer.Option(min=2.0, max=600.0, help="Duration \\[s]; a scene runs at most 10.")
    ] = 10.0,
) -> None:
    """Run the demo: a real robot's recordings and a simulated joint, shown on one page; or one controller scene."""
    if scene:
        from via_bringup.demo.scenes import run_scene  # imports ROS, which `via demo --help` does not need

        folder = out or Path("out") / scene
        check_folder(folder)
        with working(f"scene {scene}") as show:
            written = run_scene(scene, folder, min(duration, 10.0), show)
        for path in written:
            answers.print(str(path))
        return
    from via_bringup.demo.run import run_demo

    out = out or Path("out/demo")
    columns = (
        TextColumn("{task.description:<16}"),
        BarColumn(),
        TextColumn("{task.fields[step]}"),
        TimeElapsedColumn(),
    )
    with Progress(*columns) as bars:
        tasks: dict[str, TaskID] = {}

        def progress(part: str, done: float, total: float, step: str) -> None:
            if part not in tasks:
                tasks[part] = bars.add_task(part, total=total, step="")
            bars.update(tasks[part], completed=done, total=total, step=step)

        summary = run_demo(out, recordings, duration, progress)

    robot, live = summary.robot, summary.live
    if robot.refused:
        title = f"Refused recordings: {len(robot.refused)} of {len(robot.refused) + robot.accepted}"
        refused = ((file.file, "; ".join(file.reasons)) for file in robot.refused)
        print_table(title, ("recording", "reason"), refused, texts=("reason",))
    rows = [
        (strategy, str(sum(run.strategy == strategy for run in robot.runs)), f"{value:.3f}")
        for strategy, value in robot.nrmse_by_strategy.items()
    ]
    rows.append(("all", str(len(robot.runs)), f"{robot.nrmse:.3f}"))
    print_table("Error of the simulated angle", ("damping strategy", "runs", "NRMSE"), rows)
    lost = live.traffic.lost + live.replay.lost
    stiffness = (
        "the joint moved too little for an estimate of stiffness, since commands came late"
        if live.stiffness_error is None
        else f"median stiffness error {100 * live.stiffness_error:.2g} %"
    )
    answers.print(
        f"real robot: {robot.accepted} runs replayed, {robot.lost} messages lost; the 95 % interval of the damping "
        f"contains the commanded damping in {100 * robot.damping_coverage:.0f} % of the runs\n"
        f"simulated joint: {live.samples} samples at {live.rate:.0f} Hz, {lost} messages lost, "
        f"{live.late_ticks} late ticks; live and replayed estimates "
        f"{'are identical bit for bit' if live.bit_identical else 'DIFFER'}; "
        f"{stiffness}\n"
        f"diagnosis of the robot's recordings: {summary.diagnosis.headline}",
        soft_wrap=True,
    )
    answers.print(
        Text.assemble((str(out / "index.html"), "bold"), f" shows the results; {out / 'summary.json'} has all numbers")
    )
