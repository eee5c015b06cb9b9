"""XML elements with numbers as attributes."""

from __future__ import annotations

from collections.abc import Iterable
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
