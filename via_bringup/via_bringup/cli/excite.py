"""`via excite DEVICE`: the shortest motion that reaches a wanted standard deviation, as a file of commands."""

from __future__ import annotations

import json
from math import isfinite
from pathlib import Path
from typing import Annotated, Any

import typer
from via_core.command_files import columns_of, write_table
from via_core.devices import load_device
from via_core.errors import ParameterError
from via_gap.design.excite import Effort, Goal
from via_gap.design.excite_design import Designed, Settings, design
from via_gap.design.motion_file import references
from via_gap.design.observed import torque_noise_of

from via_bringup.cli.console import answers, print_table, working
from via_bringup.cli.options import DeviceName, JsonFile
from via_bringup.cli.outputs import check_files, finite, save

COVERAGE = 0.7  # of 95 % intervals, below which they are wrong


def excite(
    device: DeviceName,
    stiffness_sd: Annotated[
        str, typer.Option(help="Wanted relative standard deviation of the stiffness: 2% or 0.02; 'any': not wanted.")
    ] = "2%",
    damping_sd: Annotated[
        str, typer.Option(help="Wanted relative standard deviation of the motors' viscous friction; 'any': not wanted.")
    ] = "any",
    within: Annotated[str, typer.Option(help="limits: those of torque, speed and deflection in the file.")] = "limits",
    margin: Annotated[float, typer.Option(min=0.1, max=1.0, help="Share of the limits that the motion may use.")] = 0.9,
    max_duration: Annotated[float, typer.Option(min=1.0, max=600.0, help="Longest motion \\[s].")] = 60.0,
    preset: Annotated[
        float | None, typer.Option(help="Stiffness wanted at this preset \\[rad]; default: over the working range.")
    ] = None,
    torque_noise: Annotated[
        float | None, typer.Option(min=1e-9, help="Noise of the torque measurement \\[N m]; default: the file's.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the search.")] = 1,
    seeds: Annotated[int, typer.Option(min=2, max=1000, help="Number of simulated runs that verify it.")] = 8,
    out: Annotated[Path | None, typer.Option(help="File of commands (.csv); default: excite_<device>.csv.")] = None,
    json_file: JsonFile = None,
) -> None:
    """Design the shortest motion that reaches a standard deviation of stiffness or damping within the limits.

    The motion is verified by simulation with the device's default estimator. `via sim DEVICE --commands FILE` simulates
    the file; the node `excitation` plays it with the parameter `commands`.
    """
    described = load_device(device)
    if within != "limits":
        raise ParameterError(f"--within must be 'limits', got '{within}'")
    goal = Goal(_share(stiffness_sd, "--stiffness-sd"), _share(damping_sd, "--damping-sd"), preset)
    if goal.stiffness_sd is None and goal.damping_sd is None:
        raise ParameterError("--stiffness-sd or --damping-sd must state a wanted standard deviation")
    noise = torque_noise or torque_noise_of(described)
    path = out or Path(f"excite_{described.name}.csv")
    check_files(path, json_file)
    settings = Settings(margin, max_duration, noise, seeds, Effort(seed=seed))
    with working(f"designing a motion of {described.name}") as progress:
        found = design(described, goal, settings, lambda text: progress(text, float("nan")))
    _print(found, noise)
    commands = found.commanded.commands
    write_table(path, commands.time, columns_of(commands) | references(found.commanded.reference))
    answers.print(f"wrote {path}")
    save(json_file, json.dumps(finite(_document(found, noise)), indent=1))


def _share(text: str, option: str) -> float | None:
    """'2%' or '0.02' as .02, 'any' as None."""
    if text == "any":
        return None
    try:
        value = float(text.removesuffix("%")) / (100.0 if text.endswith("%") else 1.0)
    except ValueError:
        value = 0.0
    if not 1e-6 <= value <= 1.0:
        raise ParameterError(f"{option} must be a share such as 2% or 0.02, or 'any', got '{text}'")
    return value


def _print(found: Designed, torque_noise: float) -> None:
    device, goal, checked = found.problem.device, found.problem.goal, found.verification
    title = f"{device.name}: motion of {found.duration:.3g} s, verified with {checked.seeds} runs of {checked.method}"
    figures = (
        ("stiffness", goal.stiffness_sd, found.candidate.stiffness_sd, checked.stiffness_sd, checked.stiffness_scatter,
         checked.coverage),
        ("viscous friction of the motors", goal.damping_sd, found.candidate.damping_sd, checked.damping_sd,
         checked.damping_scatter, checked.damping_coverage),
    )  # fmt: skip
    rows = (
        (name, "any" if wanted is None else _percent(wanted), *map(_percent, shares), f"{100.0 * coverage:.0f} %")
        for name, wanted, *shares, coverage in figures
    )
    columns = ("quantity", "wanted sd", "predicted sd", "stated sd", "scatter", "coverage of 95 %")
    print_table(title, columns, rows)
    answers.print(
        "predicted: from noise alone; stated: by the estimator, which also allows for springs that change and for "
        "effects that its equation lacks",
        soft_wrap=True,
    )
    series = found.candidate.series
    presets = found.problem.presets
    where = f"presets {presets[0]:.3g} to {presets[-1]:.3g} rad" if len(presets) > 1 else f"preset {presets[0]:.3g} rad"
    answers.print(f"stiffness: root mean square over {where}" if device.n_motors == 2 else "stiffness: where visited")
    answers.print(f"base frequency {series.frequency:.3g} Hz, mean preset {series.mean:.3g} rad")
    used = ", ".join(f"{name} {100.0 * share:.0f} %" for name, share in checked.used.items())
    answers.print(f"use of the limits (100 %: all that the margin allows): {used}")
    if not found.reached:
        cause = f"the limits of {' and '.join(found.binding)}" if found.binding else "the duration"
        answers.print(
            f"not reached: the best motion of {found.duration:.3g} s states {_percent(checked.stiffness_sd)} for the "
            f"stiffness and {_percent(checked.damping_sd)} for the friction; {cause} and the noise bound it",
            soft_wrap=True,
        )
    if min(checked.coverage, checked.damping_coverage) < COVERAGE:
        answers.print(
            f"the intervals of {checked.method} do not cover its errors: its equation lacks an effect of this joint",
            soft_wrap=True,
        )
    compared = found.comparison
    if compared is not None and compared.presets:
        first, second = _seconds(compared.designed, compared.within), _seconds(compared.default, compared.within)
        ratio = compared.default / compared.designed if isfinite(compared.designed) else float("nan")
        times = f", {ratio:.2g} times as long" if isfinite(ratio) else ""
        answers.print(
            f"at the {compared.presets} presets that the default excitation also visits, the estimator states the "
            f"wanted values after {first}; with the default excitation after {second}{times}",
            soft_wrap=True,
        )
    elif compared is not None:
        answers.print("the default excitation visits none of these presets")
    answers.print(f"assumed noise of torques: {torque_noise:.2g} N m; angles as the device file states")


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %" if isfinite(share) else "never OK"


def _seconds(time: float, within: float) -> str:
    return f"{time:.3g} s" if isfinite(time) else f"more than {within:.3g} s"


def _document(found: Designed, torque_noise: float) -> dict[str, Any]:
    """The results as plain data."""
    return {
        "device": found.problem.device.name, "duration": found.duration, "reached": found.reached,
        "wanted": vars(found.problem.goal), "torque_noise": torque_noise, "binding": list(found.binding),
        "predicted": {
            "stiffness_sd": found.candidate.stiffness_sd, "damping_sd": found.candidate.damping_sd,
        },
        "verification": vars(found.verification),
        "comparison": None if found.comparison is None else vars(found.comparison),
    }  # fmt: skip
