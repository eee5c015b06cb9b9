"""Message definitions: text and hash of each type as stored in bags, and the type store that reads and writes it.

Standard messages come from the Jazzy type store of `rosbags`; other types from `<package>/msg/<Name>.msg` in the
prefixes of AMENT_PREFIX_PATH, in sys.prefix or in the source tree. rclpy is not needed.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path

from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import Typesdict
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.base import TypesysError
from rosbags.typesys.store import Typestore

from via_core.errors import BagError, one_line
from via_core.limits import LIMITS
from via_core.text_files import shown

_SEPARATOR = "=" * 80
NAME, TYPE = re.compile(r"[A-Za-z]\w*", re.ASCII), re.compile(r"\w+/msg/[A-Za-z]\w*", re.ASCII)
# Members of message types that logs of ros2_control hold and the Jazzy type store lacks.
_CONTROL = {
    "control_msgs/msg/InterfaceValue": "string[] interface_names\nfloat64[] values\n",
    "control_msgs/msg/DynamicJointState": (
        "std_msgs/Header header\nstring[] joint_names\ncontrol_msgs/InterfaceValue[] interface_values\n"
    ),
}


@dataclass(frozen=True)
class Definition:
    """One message type as stored in a bag.

    type_name  e.g. 'sensor_msgs/msg/JointState'
    text       the full definition with those of nested types (schema encoding 'ros2msg')
    type_hash  'RIHS01_...' (REP 2011), as in `topic_type_hash` and `type_description_hash`
    """

    type_name: str
    text: str
    type_hash: str


def typestore_of(type_name: str) -> Typestore:
    """A type store with `type_name` and its nested types. Raises BagError when no definition is found."""
    return _load(type_name)[0]


@cache
def definition_of(type_name: str) -> Definition:
    """The definition of `type_name` ('package/msg/Name'). Raises BagError when no definition is found."""
    store, texts = _load(type_name)
    nested = [f"{_SEPARATOR}\nMSG: {name.replace('/msg/', '/')}\n{texts[name]}" for name in texts if name != type_name]
    return Definition(type_name, "\n".join([texts[type_name], *nested]), store.hash_rihs01(type_name))


@lru_cache(maxsize=256)
def typestore_from_text(type_name: str, text: str) -> Typestore:
    """A type store with the types of the schema `text` of a bag only. Raises BagError when it does not parse."""
    store = get_typestore(Stores.EMPTY)
    try:
        if len(text) > LIMITS.schema:
            raise BagError(f"more than {LIMITS.schema} characters")
        found = get_types_from_msg(text, type_name)
        _require_small(found, type_name)
        store.register(found)
        store.get_msgdef(type_name)
    except Exception as error:  # rosbags parses untrusted text and runs code that it generates from it
        raise BagError(f"the definition of {shown(type_name)} is invalid: {shown(one_line(error))}") from None
    return store


def _require_small(found: Typesdict, type_name: str) -> None:
    """Raise BagError for odd names and beyond the limit of members: rosbags unrolls arrays of messages and texts."""
    counts: dict[str, int] = {}

    def count(name: str, depth: int) -> int:
        if depth > LIMITS.depth:
            raise BagError(f"types are nested more than {LIMITS.depth} deep")
        if name not in counts:
            total = 1
            for member, (kind, inner) in found[name][1] if name in found else ():
                if not NAME.fullmatch(member):
                    raise BagError(f"'{member}' is no name of a member")
                times, unrolled = 1, kind == Nodetype.ARRAY
                if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
                    (kind, inner), length = inner
                    times = max(length, 1) if unrolled and (kind == Nodetype.NAME or inner[0] == "string") else 1
                total += times * (count(inner, depth + 1) if kind == Nodetype.NAME else 1)
                if total > LIMITS.members:
                    raise BagError(f"more than {LIMITS.members} members")
            counts[name] = total
        return counts[name]

    if not all(TYPE.fullmatch(name) for name in (*found, type_name)):
        raise BagError("odd names of types")
    count(type_name, 0)


@cache
def _load(type_name: str) -> tuple[Typestore, dict[str, str]]:
    """The type store, and the texts by full type name, `type_name` first."""
    store = get_typestore(Stores.ROS2_JAZZY)
    texts: dict[str, str] = {}
    _collect(type_name, store, texts)
    return store, texts


def _collect(type_name: str, store: Typestore, texts: dict[str, str]) -> None:
    if type_name in texts:
        return
    if type_name not in store.fielddefs:
        text = _CONTROL.get(type_name) or _definition_file(type_name).read_text(encoding="utf-8")
        texts[type_name] = text.rstrip() + "\n"
        try:
            store.register(get_types_from_msg(texts[type_name], type_name))
        except TypesysError as error:
            raise BagError(f"the definition of {type_name} is invalid: {one_line(error)}") from None
    else:
        texts[type_name] = store.gendefhash(type_name, {}, 2)[0].rstrip() + "\n"
    for nested in _nested(store, type_name):
        _collect(nested, store, texts)


def _nested(store: Typestore, type_name: str) -> Iterator[str]:
    for _, description in store.fielddefs[type_name][1]:
        kind, inner = description
        if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            kind, inner = inner[0]
        if kind == Nodetype.NAME:
            yield inner


def _definition_file(type_name: str) -> Path:
    package, _, name = type_name.partition("/msg/")
    prefixes = [*filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)), sys.prefix]
    shares = [Path(prefix) / "share" for prefix in prefixes]
    source_tree = Path(__file__).resolve().parents[3]
    for folder in [*shares, source_tree]:
        candidate = folder / package / "msg" / f"{name}.msg"
        if name and candidate.is_file():
            return candidate
    raise BagError(
        f"no definition of message type '{type_name}': it is not a standard message, and no {package}/msg/{name}.msg "
        "is installed under AMENT_PREFIX_PATH"
    )
