"""`via device new`: a device file from a robot's model, from a recording, from both, or from questions."""

from __future__ import annotations

import re
import sys
from math import tau
from pathlib import Path
from typing import Annotated, Any

import typer
from via_core.devices import parse_device
from via_core.errors import ParameterError, ViaError
from via_core.recordings.entries import Constants
from via_core.recordings.units import factor
from via_core.robots.description import GUESS, RATE, Description, Number, device_name, guess_gains
from via_core.text_files import write_text
from via_gap.run.describe import describe

from via_bringup.cli.console import answers, errors
from via_bringup.cli.options import CountsPerTurn, TorqueConstant
from via_bringup.cli.outputs import check_new


def new(
    model: Annotated[Path | None, typer.Argument(help="URDF or MJCF file of the robot.")] = None,
    joint: Annotated[str, typer.Option(help="Joint of the model or the recording; default: the only one.")] = "",
    log: Annotated[
        Path | None, typer.Option(help="Recording of the joint, of any format that `via bag map` reads.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="File to write; default: JOINT.yaml, in lower case.")] = None,
    at: Annotated[
        list[str] | None, typer.Option(help="Angle of another joint, JOINT=RAD (repeat for several).")
    ] = None,
    counts_per_turn: CountsPerTurn = None,
    torque_constant: TorqueConstant = None,
    log_joint: Annotated[
        str, typer.Option(help="Name or number of the joint in the recording, if the model has another name.")
    ] = "",
) -> None:
    """Write a commented device file from a model (URDF, MJCF), a recording, both, or the answers to questions.

    The file states the origin and the tolerance of every number. `via gap diagnose LOG --device FILE` uses it as it is.
    """
    described = Description("joint", joint or "joint", _command())
    if model is None and log is None:
        if not _on_terminal():
            raise ViaError("nothing to describe: give a URDF or MJCF file, --log FILE, or run it in a terminal")
        _ask(described)
    else:
        described = describe(
            described.command,
            model,
            joint,
            log,
            _angles(at or []),
            Constants(counts_per_turn, torque_constant, log_joint),
        )
    target = out or Path(f"{described.name}.yaml")
    check_new(target)
    parse_device(described.text(), str(target))
    write_text(target, described.text())
    for remark in described.remarks:
        errors.print(f"note: {remark}", soft_wrap=True)
    for name, number in described.numbers.items():
        answers.print(
            f"{number.origin:>8} {name} {number.value:.4g} {described.unit(name)}: {number.note}", soft_wrap=True
        )
    answers.print(f"wrote {target}")
    answers.print(f"next: via gap diagnose {log or 'LOG'} --device {target}", soft_wrap=True)


def _angles(texts: list[str]) -> dict[str, float]:
    found = {}
    for text in texts:
        name, _, value = text.rpartition("=")
        try:
            found[name] = float(value)
        except ValueError:
            name = ""
        if not name:
            raise ViaError(f"--at {text}: write JOINT=ANGLE with the angle in rad, e.g. --at elbow=1.57")
    return found


def _command() -> str:
    return " ".join(["via", *sys.argv[1:]]) if len(sys.argv) > 1 and "device" in sys.argv else "via device new"


# ---- questions


def _on_terminal() -> bool:
    """Whether a person can answer questions."""
    return sys.stdin.isatty()


def _ask(described: Description) -> None:
    """Fill in the answers of a person; units may be written: 300 g, 20 cm, 12 oz in."""
    described.joint = typer.prompt("Name of the joint in messages and logs", default="elbow")
    described.name = device_name(described.joint)
    described.sources.append("answers to questions")
    numbers = described.numbers

    def state(name: str, question: str, unit: str, default: str, tolerance: float | None = None) -> None:
        numbers[name] = Number(_amount(question, unit, default), "stated", "by you", tolerance)

    mass = _amount("Mass that the joint moves", "kg", "1 kg")
    length = _amount("Distance of its centre from the axis", "m", "0.2 m")
    rotor = _amount("Inertia of the rotor at the joint (motor times gear squared; 0 if unknown)", "kg m^2", "0")
    inertia, about = mass * length**2 + rotor, f"{mass:g} kg at {length:g} m, rotor {rotor:g}"
    numbers["inertia"] = Number(inertia, "stated", about, 0.3)
    vertical = typer.confirm("Does it move in a vertical plane, angle 0 hanging down?", default=True)
    weight = mass * length * 9.80665 if vertical else 0.0
    numbers["gravity_torque"] = Number(weight, "stated", "mass times distance times 9.80665", 0.1)
    state("viscous_friction", "Viscous friction (0 if unknown)", "N m s/rad", "0", 0.3)
    state("coulomb_friction", "Dry friction (0 if unknown)", "N m", "0", 0.3)
    if typer.confirm("Do logs have goals of a position drive instead of torques?", default=False):
        described.drive = "position"
        guess_gains(described)
        state("kp", "Proportional gain at the joint", "N m/rad", f"{numbers['kp'].value:.3g}", GUESS)
        state("kd", "Derivative gain at the joint", "N m s/rad", f"{numbers['kd'].value:.3g}", GUESS)
    state("rate", "Samples per second", "1/s", f"{RATE:g}")
    counts = _amount("Counts of the encoder per turn of the joint (0 if unknown)", "", "0")
    if counts > 0.0:
        numbers["link_quantum"] = Number(tau / counts, "stated", f"{counts:g} counts per turn")


def _amount(question: str, unit: str, default: str) -> float:
    """A number in SI; another unit may follow it."""
    while True:
        text: Any = typer.prompt(f"{question} [{unit or 'number'}]", default=default)
        match = re.fullmatch(r"\s*([-+]?[0-9.]+(?:[eE][-+]?\d+)?)\s*(.*?)\s*", text)
        try:
            if match is None:
                raise ParameterError(f"'{text}' is no number")
            value = float(match[1]) * (factor(match[2]) if match[2] else 1.0)
            if value >= 0.0:
                return value
            errors.print("must be 0 or more")
        except (ParameterError, ValueError) as error:
            errors.print(str(error))
