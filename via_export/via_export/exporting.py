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

import mujoco
from via_core.devices import Device
from via_core.errors import ParameterError
from via_sim.effects import Effect

from via_export import bam, isaaclab, mjcf, mjcf_into, ros2_control, sdf, urdf
from via_export.slots import FORMATS, TITLES, Loss, losses
from via_export.target import Target
from via_export.xml import Edited

BESIDE = ("mjcf", "urdf", "sdf", "bam")  # formats that can be written into a given file
SUFFIXES = {"mjcf": ".xml", "urdf": ".urdf", "sdf": ".sdf", "isaaclab": ".py", "bam": ".json", "ros2_control": ".xacro"}


@dataclass(frozen=True)
class Export:
    """A file for another simulator.

    text        content of the file
    losses      what the format does not hold, with substitutes and costs
    notes       what remains to be done by hand in a given model
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
    comment = _comment(target, lost)
    name = joint or device.link_joint
    if into is not None:
        text, notes = _into(target, to, Path(into), name, comment, supply)
        return Export(to, target, text, lost, tuple(notes), link=name)
    writers = {"mjcf": mjcf.write, "urdf": urdf.write, "sdf": sdf.write, "ros2_control": ros2_control.write}
    if to == "isaaclab":
        text = isaaclab.write(target, comment, joint)
    elif to == "bam":
        text = bam.write(target, supply)
    else:
        text = writers[to](target, comment)
    parameters = ros2_control.parameters(target) if to == "ros2_control" else ""
    return Export(to, target, text, lost, parameters=parameters)


def _comment(target: Target, lost: Sequence[Loss]) -> str:
    """Head of a file: where it comes from, and what it lacks."""
    what = [f"{effect.name} at {effect.site}" for effect in target.effects]
    added = f" with {', '.join(what)}" if what else ", without effects"
    lines = [f"Device {target.device.name}{added}; written by via export."]
    return "\n".join(lines + [f"Lost: {loss}" for loss in lost])


def _into(target: Target, to: str, path: Path, name: str, comment: str, supply: float | None) -> tuple[str, list[str]]:
    try:
        source = path.read_text(encoding="utf-8")
        if to == "bam":
            given = json.loads(source)
            if not isinstance(given, dict):
                raise ParameterError(f"{path}: a parameter file of BAM is a mapping")
            return bam.write(target, supply, given), []
        edited = Edited.of(source)
        root = edited.root
        if to == "mjcf":
            notes = mjcf_into.into(root, target, name, _compiled(path))
        else:
            notes = urdf.into(root, target, name, path) if to == "urdf" else sdf.into(root, target, name)
    except OSError as error:
        raise ParameterError(f"{path}: cannot be read: {error.strerror}") from None
    except (ParseError, json.JSONDecodeError, UnicodeDecodeError) as error:
        raise ParameterError(f"{path}: {error}") from None
    except ValueError as error:
        raise ParameterError(f"{path}: {error}") from None
    return edited.text(comment), notes


def _compiled(path: Path) -> mujoco.MjModel:
    try:
        return mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise ParameterError(f"{path}: MuJoCo: {' '.join(str(error).split())}") from None
