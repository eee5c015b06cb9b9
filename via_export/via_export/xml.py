"""XML elements with numbers as attributes."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from xml.etree import ElementTree

Element = ElementTree.Element
Value = str | float | bool | Iterable[float]
Attributes = dict[str, Value]


def number(value: float) -> str:
    """Ten significant digits."""
    return f"{value + 0.0:.10g}"  # no -0


def text(value: Value) -> str:
    """An attribute's text: numbers in ten digits, vectors separated by spaces."""
    if isinstance(value, str):
        return value
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return number(float(value))
    return " ".join(number(each) for each in value)


def element(tag: str, *children: Element, **attributes: Value) -> Element:
    """An element; an underscore at the end of a name (`class_`) is removed."""
    made = ElementTree.Element(tag, {name.rstrip("_"): text(value) for name, value in attributes.items()})
    made.extend(children)
    return made


def leaf(tag: str, content: Value) -> Element:
    """An element with text."""
    made = ElementTree.Element(tag)
    made.text = text(content)
    return made


def child(parent: Element, tag: str) -> Element:
    """The first child with this tag, made if there is none."""
    found = parent.find(tag)
    if found is None:
        found = element(tag)
        parent.append(found)
    return found


def joint_named(root: Element, name: str, part: str) -> Element:
    """The joint of this name that has a child `part`. Raises ValueError with the names of all such joints."""
    found = {str(each.get("name")): each for each in root.iter("joint") if each.find(part) is not None}
    if name not in found:
        raise ValueError(f"no joint '{name}'; there are: {', '.join(found) or 'none'}")
    return found[name]


def document(root: Element, comment: str = "", declaration: bool = False) -> str:
    """Indented XML; `comment` follows the root's start."""
    ElementTree.indent(root)
    if comment:
        note = ElementTree.Comment(f" {comment.replace('--', '- -')} ")
        note.tail = root.text
        root.insert(0, note)
    head = '<?xml version="1.0"?>\n' if declaration else ""
    return head + ElementTree.tostring(root, encoding="unicode") + "\n"


def parsed(source: str) -> Element:
    """The root of an XML text, comments included. Raises ElementTree.ParseError."""
    return ElementTree.fromstring(source, ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True)))


@dataclass(frozen=True)
class Edited:
    """An XML file that is edited: what does not change keeps its place, its indentation and its comments.

    present  elements of the source, which keeps them alive: they are known by their identity
    """

    source: str
    root: Element
    present: tuple[Element, ...]

    @staticmethod
    def of(source: str) -> Edited:
        """Raises ElementTree.ParseError."""
        root = parsed(source)
        return Edited(source, root, tuple(root.iter()))

    def text(self, comment: str) -> str:
        """The file with new elements indented like their neighbours; `comment` follows the root's start."""
        _lay_out(self.root, set(map(id, self.present)), "\n")
        note = ElementTree.Comment(f" {comment.replace('--', '- -')} ")
        note.tail = self.root.text if _is_break(self.root.text) else "\n"
        self.root.insert(0, note)
        made = ElementTree.tostring(self.root, encoding="unicode")
        if 2 * self.source.count(" />") < self.source.count("/>"):  # the style of the source
            made = re.sub(r"(<!--.*?-->)| />", lambda found: found[1] or "/>", made, flags=re.DOTALL)
        plain = re.sub(r"<!--.*?-->", lambda found: " " * len(found[0]), self.source, flags=re.DOTALL)
        begin = re.search(r"<[A-Za-z_]", plain)
        head = self.source[: begin.start()] if begin else ""
        return head + made + self.source[plain.rindex(">") + 1 :]


def _is_break(text: str | None) -> bool:
    return text is not None and "\n" in text and not text.strip()


def _lay_out(parent: Element, known: set[int], own: str) -> None:
    """Put new children of an element on lines of their own; `own` is the line end and indentation before it."""
    children = list(parent)
    present = id(parent) in known and _is_break(parent.text)
    inner = "\n" + str(parent.text).rsplit("\n", 1)[1] if present else own + "  "
    for child in children:
        _lay_out(child, known, inner)
    if all(id(child) in known for child in children):
        return
    if not present and not (parent.text or "").strip():
        parent.text = inner
    for child, following in zip(children, [*children[1:], None], strict=True):
        if following is None:
            child.tail = own
        elif id(child) not in known or id(following) not in known:
            child.tail = inner
