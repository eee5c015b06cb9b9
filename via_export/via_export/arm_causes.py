"""What all joints of an arm feel, from a report of `via gap diagnose --arm`, written into the arm's model.

payload  a body of its own at the joint's body
body     other inertial numbers of the body that the joint moves
offset   URDF: the origin of the joint, turned back about its axis; MJCF: its `ref`. Its limits move along
gravity  MJCF: `gravity` of the options; a URDF has none
"""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pinocchio
from via_core.errors import ParameterError
from via_core.robots.models import read_robot
from via_gap.run.arm_body import BodyError
from via_gap.run.arm_cause import ArmCause
from via_gap.run.arm_gravity import Gravity
from via_gap.run.arm_offset import AngleOffset
from via_gap.run.arm_payload import Payload

from via_export.mjcf_given import GivenJoint, loaded
from via_export.payloads import PointMass
from via_export.urdf import shift_zero, vector
from via_export.xml import Attributes, Edited, Element, child, text

FORMATS = ("mjcf", "urdf")
MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
_TURNED = ("quat", "axisangle", "xyaxes", "zaxis", "euler", "diaginertia")  # of an inertial: not beside fullinertia

_ROUNDING = 1e-9  # of an inertia


def add_arm_cause(cause: ArmCause, to: str, path: Path, comment: str = "") -> str:
    """The robot of file `path` with a cause of an arm's report. Raises ViaError."""
    if to not in FORMATS:
        raise ParameterError(f"--to: causes of an arm are written to {' or '.join(FORMATS)}, got '{to}'")
    if not isinstance(cause, Gravity):
        read_robot(path).joint(cause.link)
    edited = Edited.of(path.read_text(encoding="utf-8"))
    if (edited.root.tag == "mujoco") != (to == "mjcf"):
        raise ParameterError(f"--into: {path} is {'MJCF' if edited.root.tag == 'mujoco' else 'URDF'}, not {to.upper()}")
    (_to_mjcf if to == "mjcf" else _to_urdf)(edited.root, cause, path)
    made = edited.text(comment)
    if to == "mjcf":
        loaded(made, path.parent)
    return made


def _to_urdf(root: Element, cause: ArmCause, path: Path) -> None:
    if isinstance(cause, Gravity):
        raise ParameterError("a URDF states no gravity: turn the robot's base in its world, or use --to mjcf")
    joint = next(each for each in root.iter("joint") if each.get("name") == cause.link)
    below = str(child(joint, "child").get("link"))
    if isinstance(cause, AngleOffset):
        if joint.get("type") not in ("revolute", "continuous"):
            raise ParameterError(f"joint '{cause.link}' does not turn")
        shift_zero(joint, cause.offset)
    elif isinstance(cause, Payload) and cause.mass > 0.0:
        root.extend(PointMass(f"{cause.link}_payload", cause.mass, cause.position).urdf(below))
    else:
        link = next(each for each in root.iter("link") if each.get("name") == below)
        inertial = child(link, "inertial")
        place, mass, about = (child(inertial, tag) for tag in ("origin", "mass", "inertia"))
        turned = pinocchio.rpy.rpyToMatrix(vector(place, "rpy"))
        xx, xy, xz, yy, yz, zz = (float(about.get(key) or 0.0) for key in MOMENTS)
        tensor = turned @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ turned.T
        present = pinocchio.Inertia(float(mass.get("value") or 0.0), vector(place, "xyz"), tensor)
        made = _changed(present, cause)
        place.attrib = {"xyz": text(made.lever), "rpy": "0 0 0"}
        mass.set("value", text(made.mass))
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = made.inertia
        about.attrib = {key: text(each) for key, each in zip(MOMENTS, (xx, xy, xz, yy, yz, zz), strict=True)}


def _to_mjcf(root: Element, cause: ArmCause, path: Path) -> None:
    if isinstance(cause, Gravity):
        if cause.absent:
            raise ParameterError("gravity is absent from the torques, not from the robot: its model is right")
        child(root, "option").set("gravity", text(cause.gravity))
        return
    given = GivenJoint.of(root, path, cause.link)
    model, number = given.model, given.number
    anchor = model.jnt_pos[number]
    if isinstance(cause, AngleOffset):
        angles: Attributes = {"ref": float(model.qpos0[model.jnt_qposadr[number]] + cause.offset)}
        if model.jnt_limited[number]:
            angles["range"] = model.jnt_range[number] + cause.offset
        given.edit(angles)
    elif isinstance(cause, Payload) and cause.mass > 0.0:
        given.body.append(PointMass(f"{cause.link}_payload", cause.mass, cause.position).body(anchor))
    else:
        given.require_inertials()
        k = int(model.jnt_bodyid[number])
        turned = np.zeros(9)
        mujoco.mju_quat2Mat(turned, model.body_iquat[k])
        tensor = turned.reshape(3, 3) @ np.diag(model.body_inertia[k]) @ turned.reshape(3, 3).T
        present = pinocchio.Inertia(float(model.body_mass[k]), model.body_ipos[k] - anchor, tensor)
        made, inertial = _changed(present, cause), child(given.body, "inertial")
        for key in _TURNED:
            inertial.attrib.pop(key, None)
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = made.inertia
        inertial.attrib |= {
            "pos": text(made.lever + anchor),
            "mass": text(made.mass),
            "fullinertia": text((xx, yy, zz, xy, xz, yz)),
        }


def _changed(present: pinocchio.Inertia, cause: BodyError | Payload) -> pinocchio.Inertia:
    """A body in the frame of its joint with what the cause adds. Raises ParameterError where none can be like that."""
    numbers = np.array(cause.numbers) if isinstance(cause, BodyError) else cause.moments
    total = present.toDynamicParameters() + numbers
    if total[0] > 0.0:
        found = pinocchio.Inertia.FromDynamicParameters(total)
        least, middle, most = np.linalg.eigvalsh(found.inertia)
        if least >= 0.0 and least + middle >= most * (1.0 - _ROUNDING):
            return found
    raise ParameterError(
        f"the body at {cause.link} would have {total[0]:.3g} kg or an impossible inertia: what is fixed to it "
        "is wrong as well; change these masses by hand"
    )
