"""A given MuJoCo model: its text, which is edited, and what MuJoCo makes of it with included files and defaults."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import pi
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Any
from xml.etree import ElementTree

import mujoco
from via_core.errors import ParameterError, one_line

from via_export.mjcf import Parts
from via_export.xml import Attributes, Element, child, element, text

CLASS = "via_export"  # defaults of new elements
ANGLES = ("ref", "range", "springref")  # of a hinge, in the unit of the file
WHOLE = "give the model saved as one file"
_KINDS = ("joint", "site", "tendon", "actuator")  # with defaults, among the elements that are written
_NO_VALUES = {  # of an element of a specification
    *("alt", "attach_body", "classname", "compiler", "frame", "id", "info", "material", "meshname", "name", "parent"),
    *("path", "plugin", "refsite", "set_frame", "signature", "slidersite", "target", "userdata"),
}


def compiled(xml: str, folder: Path | None = None) -> Any:
    """The compiled model of a text whose meshes and included files are in `folder`. Raises ParameterError."""
    try:
        if folder is None:
            return mujoco.MjModel.from_xml_string(xml)
        with NamedTemporaryFile("w", suffix=".xml", dir=folder, encoding="utf-8") as file:
            file.write(xml)
            file.flush()
            return mujoco.MjModel.from_xml_path(file.name)
    except ValueError as error:
        raise ParameterError(f"MuJoCo: {one_line(error)}") from None


def loaded(text: str, folder: Path) -> list[str]:
    """Load an edited model where its meshes are. Raises ParameterError; a note if a file cannot be put there."""
    try:
        compiled(text, folder)
    except OSError as error:
        return [f"the model was not loaded for a check, {folder}: {error.strerror}"]
    except ParameterError as error:
        raise ParameterError(f"the edited model does not load: {error}") from None
    return []


def note_on_place(path: Path) -> list[str]:
    """A note if a written model does not find its meshes or included files from where it is."""
    try:
        mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        return [f"{path} loads beside the given file, but not where it is: {one_line(error)}"]
    return []


def _read(path: Path) -> Any:
    """The specification of a model; MuJoCo knows the format of a file by its suffix .xml alone."""
    if path.suffix == ".xml":
        return mujoco.MjSpec.from_file(str(path))
    spec = mujoco.MjSpec.from_string(path.read_text(encoding="utf-8"))
    spec.modelfiledir = str(path.parent)
    return spec


def _body_and_joint(root: Element, name: str) -> tuple[Element, Element]:
    """The joint of that name and its body, possibly within frames. Raises ParameterError."""
    for body in root.iter("body"):
        for joint in _joints(body):
            if joint.get("name") == name:
                return body, joint
    raise ParameterError(f"joint '{name}' is in an included file, or made by replicate or attach: {WHOLE}")


def _joints(parent: Element) -> Iterator[Element]:
    for each in parent:
        if each.tag == "joint":
            yield each
        elif each.tag == "frame":
            yield from _joints(each)


@dataclass(frozen=True)
class GivenJoint:
    """A hinge or slide of a given model.

    number  of the joint in the compiled `model`
    """

    root: Element
    body: Element
    joint: Element
    spec: Any
    model: Any
    number: int

    @staticmethod
    def of(root: Element, path: Path, name: str) -> GivenJoint:
        """Raises ParameterError if the model of file `path` does not load, or has no such joint itself."""
        try:
            spec = _read(path)
            model = spec.compile()
        except ValueError as error:
            raise ParameterError(f"MuJoCo: {one_line(error)}") from None
        number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name)
        if number < 0:
            names = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, i) for i in range(model.njnt)]
            raise ParameterError(f"the model has no joint '{name}'; there are: {', '.join(map(str, names)) or 'none'}")
        if int(model.jnt_type[number]) not in (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)):
            raise ParameterError(f"joint '{name}' is neither a hinge nor a slide")
        return GivenJoint(root, *_body_and_joint(root, name), spec, model, number)

    @property
    def name(self) -> str:
        return str(self.joint.get("name"))

    @property
    def slides(self) -> bool:
        return int(self.model.jnt_type[self.number]) == int(mujoco.mjtJoint.mjJNT_SLIDE)

    @property
    def dof(self) -> int:
        return int(self.model.jnt_dofadr[self.number])

    @property
    def parent(self) -> Element:
        """The body, or the world, that carries the joint's body."""
        above = {id(below): each for each in self.root.iter() for below in each}
        found = above[id(self.body)]
        while found.tag not in ("body", "worldbody"):
            found = above[id(found)]
        return found

    def require_inertials(self) -> None:
        """Raise ParameterError if no body can state its own inertia."""
        if int(self.spec.compiler.inertiafromgeom) == int(mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE):
            raise ParameterError("inertias come from geoms (inertiafromgeom): no body can state its own; use 'auto'")

    def edit(self, attributes: Attributes) -> None:
        """Set attributes of the joint; angles [rad] in the unit of the file."""
        changed = element("joint", **attributes, type="slide" if self.slides else "hinge")
        self.state_angles_in_its_unit(changed)
        del changed.attrib["type"]
        self.joint.attrib.update(changed.attrib)

    def state_angles_in_its_unit(self, joint: Element) -> None:
        """Convert the angles [rad] of a new or edited hinge to the unit of the file; a slide has none."""
        if not self.spec.compiler.degree or joint.get("type") == "slide":
            return
        for key in ANGLES:
            if (value := joint.get(key)) is not None:
                joint.set(key, text([float(each) * 180.0 / pi for each in value.split()]))

    def without_defaults(self, parts: Parts) -> None:
        """Give new elements a class that undoes the defaults of the file, which would add a gear or a stiffness.

        MuJoCo writes what differs from the file's own defaults.
        """
        if "<default" not in self.spec.to_xml():
            return
        mine = self.spec.find_default(CLASS) or self.spec.add_default(CLASS, self.spec.default)
        plain = mujoco.MjSpec().default
        for kind in _KINDS:
            values, target = getattr(plain, kind), getattr(mine, kind)
            for key in dir(values):
                if not key.startswith("_") and key not in _NO_VALUES and not callable(getattr(values, key)):
                    setattr(target, key, getattr(values, key))
        self.spec.compile()
        written = ElementTree.fromstring(self.spec.to_xml())
        own = next(each for each in written.iter("default") if each.get("class") == CLASS)
        for section in self.root.iter("default"):
            for old in section.findall(f"default[@class='{CLASS}']"):
                section.remove(old)
        for each in own.iter():
            each.text = each.tail = None
        child(self.root, "default").append(own)
        bodies = (each for body in parts.bodies for each in body.iter() if each.tag in ("joint", "site"))
        for each in (*bodies, *parts.in_link, *parts.tendons, *parts.actuators):
            each.set("class", CLASS)
