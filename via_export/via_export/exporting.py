"""Export of a device with effects to a format of another simulator.

made = export(load_device("xl330"), load_effects("repair.yaml"), "mjcf")
made.text                    # the file
for loss in made.losses: print(loss)
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import ParseError

from via_core.devices import Device
from via_core.errors import ParameterError
from via_sim.effects import Effect

from via_export import bam, isaaclab, mjcf, mjcf_into, ros2_control, sdf, urdf
from via_export.mjcf_given import compiled, loaded
from via_export.slots import FORMATS, TITLES, Loss, losses
from via_export.target import Target
from via_export.xml import Edited

BESIDE = ("mjcf", "urdf", "sdf", "bam")  # formats that can be written into a given file
ROOTS = {"mujoco": "mjcf", "robot": "urdf", "sdf": "sdf"}  # root elements


@dataclass(frozen=True)
class Export:
    """A file for another simulator.

    text        content of the file
    losses      what the format does not hold, with substitutes and costs
    notes       what is assumed, and of a given model: what is replaced, and what remains to be done by hand
    parameters  YAML beside the file: of ros2_control its limits and gains
    """

    format: str
    target: Target
    text: str
    losses: tuple[Loss, ...]
    notes: tuple[str, ...] = ()
    parameters: str = ""
    link: str = ""  # name of the joint in a given model


def export(
    device: Device,
    effects: Sequence[Effect] = (),
    to: str = "mjcf",
    into: str | Path | None = None,
    joint: str = "",
    supply: float | None = None,
) -> Export:
    """The device with effects as a file of format `to`.

    into    file that is read and edited, of the same format; without it a model of the joint alone is made
    joint   name of the joint in `into`; default: that of the device
    supply  [V] of a position drive, for BAM

    Raises ParameterError for an unknown format, effects that do not fit, or a given file without that joint.
    """
    if to not in FORMATS:
        raise ParameterError(f"--to: must be one of {', '.join(FORMATS)}, got '{to}'")
    if into is not None and to not in BESIDE:
        raise ParameterError(f"--into: {TITLES[to]} is written as a fragment; formats with --into: {', '.join(BESIDE)}")
    target = Target.of(device, effects)
    lost = losses(target, to)
    name = joint or device.link_joint
    if into is not None:
        text, found = _into(target, to, Path(into), name, lost, supply)
        return Export(to, target, text, lost, tuple(found), link=name)
    found = _assumed(target, to)
    comment = _comment(target, lost, found)
    writers = {"mjcf": mjcf.write, "urdf": urdf.write, "sdf": sdf.write, "ros2_control": ros2_control.write}
    if to == "isaaclab":
        text = isaaclab.write(target, comment, joint)
    elif to == "bam":
        text = bam.write(target, supply)
    else:
        text = writers[to](target, comment)
    if to == "mjcf":
        compiled(text)
    parameters = ros2_control.parameters(target) if to == "ros2_control" else ""
    return Export(to, target, text, lost, tuple(found), parameters=parameters)


def _assumed(target: Target, to: str) -> list[str]:
    """What a model of the joint alone assumes. A link with gravity or with levers turns."""
    turns = target.device.link.gravity_torque != 0.0 or target.depends_on_preset
    if to not in ROOTS.values() or turns:
        return []
    return [
        "the joint is written as one that turns; if it slides (m, N, kg for rad, N m, kg m^2), write it into its robot"
    ]


def _comment(target: Target, lost: Sequence[Loss], found: Sequence[str]) -> str:
    """Head of a file: where it comes from, what it lacks, and notes."""
    what = [f"{effect.name} at {effect.site}" for effect in target.effects]
    added = f" with {', '.join(what)}" if what else ", without effects"
    lines = [f"Device {target.device.name}{added}; written by via export."]
    return "\n".join(lines + [f"Lost: {loss}" for loss in lost] + [f"Note: {note}" for note in found])


def _into(
    target: Target, to: str, path: Path, name: str, lost: Sequence[Loss], supply: float | None
) -> tuple[str, list[str]]:
    try:
        source = path.read_text(encoding="utf-8")
        if to == "bam":
            given = json.loads(source)
            if not isinstance(given, dict):
                raise ParameterError("a parameter file of BAM is a mapping")
            return bam.write(target, supply, given), []
        edited = Edited.of(source)
        root = edited.root
        if (kind := ROOTS.get(root.tag)) != to:
            remedy = f"it is {kind.upper()}: use --to {kind}" if kind else f"its root is <{root.tag}>"
            raise ParameterError(f"not {to.upper()}; {remedy}")
        if to == "mjcf":
            found = mjcf_into.into(root, target, name, path)
        else:
            found = urdf.into(root, target, name, path) if to == "urdf" else sdf.into(root, target, name)
        text = edited.text(_comment(target, lost, found))
        if to == "mjcf":
            found += loaded(text, path.parent)
    except OSError as error:
        raise ParameterError(f"{path}: cannot be read: {error.strerror}") from None
    except (ParseError, ValueError, ParameterError) as error:
        raise ParameterError(f"{path}: {error}") from None
    return text, found
