"""`via observe DEVICE [LOG]`: which quantities signals and motion determine, how well, and what is missing."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table
from via_core.devices import Device, load_device
from via_estimators.joint_equations import Unknown
from via_gap.design.observed import Observed, declared_noise, observe_default, observe_log, torque_noise_of
from via_gap.logs.log import read_log

from via_bringup.cli.console import answers, table, working
from via_bringup.cli.options import DeviceName, JsonFile
from via_bringup.cli.outputs import check_files, finite, save

WELL = 0.05  # relative standard deviation up to which a quantity is determined well
ROUGHLY = 0.3  # and roughly


def observe(
    device: DeviceName,
    log: Annotated[Path | None, typer.Argument(help="Bag folder, .mcap or .csv file; default: a simulation.")] = None,
    joint_topic: Annotated[str, typer.Option(help="Topic of the joint states.")] = "/joint_states",
    torque_noise: Annotated[
        float | None,
        typer.Option(min=1e-9, help="Without a log: noise of torque sensors \\[N m]; default: the file's."),
    ] = None,
    json_file: JsonFile = None,
) -> None:
    """Show which quantities of a joint the signals and the motion determine, how well, and what is missing.

    Without a log, the device's default motion is simulated, and one column per signal set is shown.
    """
    check_files(json_file)
    described = load_device(device)
    if log is not None:
        read = read_log(log, described, joint_topic)
        found, motion = [observe_log(read)], log.name
        answers.print(_of_log(described, motion, found[0]))
    else:
        with working(f"simulating the default motion of {described.name}"):
            default, found = observe_default(described, torque_noise)
        motion = default.name
        answers.print(_of_sets(described, motion, found))
    for each in found:
        _print_gaps(each, len(found) > 1)
    _print_assumptions(described, log is not None, torque_noise)
    save(json_file, json.dumps(_document(described, motion, found), indent=1))


def _of_log(device: Device, motion: str, observed: Observed) -> Table:
    """One row per quantity."""
    title = f"{device.name}, {motion}: standard deviation from the signals ({observed.title})"
    shown = table(title, "quantity", "value in the file", "unit", "from the log", "others from the file", "determined")
    for each in observed.information.unknowns:
        alone, helped = observed.information.standard_deviation(each.name), observed.information.with_file(each.name)
        shown.add_row(
            each.name, f"{each.value:.4g}", each.unit, _cell(each, alone), _cell(each, helped), _word(each, alone)
        )
    return shown


def _of_sets(device: Device, motion: str, sets: list[Observed]) -> Table:
    """One column per signal set."""
    title = f"{device.name}, {motion}: standard deviation by signal set"
    shown = table(title, "quantity", "value in the file", "unit", *(each.title for each in sets))
    unknowns = {each.name: each for observed in sets for each in observed.information.unknowns}
    for name, unknown in unknowns.items():
        cells = []
        for observed in sets:
            known = any(each.name == name for each in observed.information.unknowns)
            cells.append(_cell(unknown, observed.information.standard_deviation(name)) if known else "-")
        shown.add_row(name, f"{unknown.value:.4g}", unknown.unit, *cells)
    shown.add_section()
    shown.add_row("rank", "", "", *(f"{o.information.rank} of {len(o.information.unknowns)}" for o in sets))
    shown.add_row("condition number", "", "", *(f"{o.information.condition:.1g}" for o in sets))
    return shown


def _print_gaps(observed: Observed, titled: bool) -> None:
    information = observed.information
    if not titled:
        answers.print(
            f"rank {information.rank} of {len(information.unknowns)}, condition number {information.condition:.1g}, "
            f"{information.windows} windows"
        )
    if observed.remedies and titled:
        answers.print(f"{observed.title}:")
    for sentence in observed.remedies:
        answers.print(f"  - {sentence}", soft_wrap=True)


def _print_assumptions(device: Device, logged: bool, torque_noise: float | None) -> None:
    """What the numbers rest on."""
    if logged:
        answers.print("noise: estimated from the log itself")
    else:
        stated = torque_noise or torque_noise_of(device)
        source = "as given" if torque_noise else "by the device file" if device.sensors.torque_noise else "assumed"
        noise = declared_noise(device)
        answers.print(
            f"noise: angles {noise['q']:.2g} rad (encoder step / sqrt 12), torques {stated:.2g} N m ({source})"
        )
    scale = 100.0 * device.tolerances.torque_scale
    answers.print(
        f"not shown by any motion: the scale of torque sensors; the device file states {scale:g} % for it. "
        f"'-': no equation contains the quantity; 'no': its standard deviation exceeds its size",
        soft_wrap=True,
    )


def _cell(unknown: Unknown, sd: float) -> str:
    """Relative to the value; absolute where that is 0; 'no' for more than the quantity's size."""
    if sd > unknown.size:
        return "no"
    return f"{100.0 * sd / abs(unknown.value):.2g} %" if unknown.value != 0.0 else f"{sd:.1g} {unknown.unit}"


def _word(unknown: Unknown, sd: float) -> str:
    share = sd / (abs(unknown.value) or unknown.size)
    return "well" if share <= WELL else "roughly" if share <= ROUGHLY else "no"


def _document(device: Device, motion: str, sets: list[Observed]) -> dict[str, Any]:
    """The results as plain data."""
    return {
        "device": device.name,
        "motion": motion,
        "signal_sets": [
            {
                "title": each.title,
                "channels": list(each.channels),
                "rank": each.information.rank,
                "condition": finite(each.information.condition),
                "windows": each.information.windows,
                "misfit": each.information.misfit,
                "remedies": list(each.remedies),
                "quantities": [
                    {
                        "name": unknown.name, "value": unknown.value, "unit": unknown.unit, "size": unknown.size,
                        "standard_deviation": each.information.standard_deviation(unknown.name),
                        "standard_deviation_with_file": each.information.with_file(unknown.name),
                    }
                    for unknown in each.information.unknowns
                ],
            }
            for each in sets
        ],
    }  # fmt: skip
