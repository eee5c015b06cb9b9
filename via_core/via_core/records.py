"""Files of records: entries that refuse unknown keys, files that VIA ships, and errors in words of this project."""

from __future__ import annotations

import re
from collections.abc import Hashable
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, ValidatorFunctionWrapHandler

from via_core.errors import ParameterError, ViaError
from via_core.text_files import read_text, read_yaml

NAME = r"^[a-z][a-z0-9_]*$"  # of devices and their parts
Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Positive = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0.0)]
NotNegative = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0.0)]
Text = Annotated[str, Field(min_length=1)]
# Pydantic puts the tag of a union into the path of an error; none of these tags is a key.
_TAGS = {
    *("torque", "servo", "linear", "two_stage"),
    *("cubic", "odd_polynomial", "sinh", "exponential", "four_bar", "maccepa", "two_lever"),
}
SHOWN = 80  # characters of a value


class Record(BaseModel):
    """An immutable record, such as an entry of a file, that refuses unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid", serialize_by_alias=True)


class Described(Record):
    """What a file describes, where its numbers come from, and how reliable they are."""

    name: Annotated[str, Field(pattern=NAME)]
    title: Text
    source: Annotated[tuple[Text, ...], Field(min_length=1)]
    confidence: Literal["measured", "published", "identified", "copied", "assumed"]
    remark: str = ""


Kind = TypeVar("Kind", bound=Record)


# ---- files


class _Loader(yaml.SafeLoader):
    """A SafeLoader that refuses duplicate keys and reads 1e-4 as a number (YAML 1.1 reads it as text)."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen: set[Hashable] = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if key in seen:
                raise yaml.constructor.ConstructorError(
                    "", node.start_mark, f"duplicate key '{key}'", key_node.start_mark
                )
            seen.add(key)
        return super().construct_mapping(node, deep)


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"^[-+]?[0-9][0-9_]*(?:\.[0-9_]*)?[eE][-+]?[0-9]+$"), list("-+0123456789")
)


def shipped_names(folder: str) -> tuple[str, ...]:
    """Names of the YAML files that VIA ships in a folder of via_core, sorted."""
    return tuple(sorted(path.stem for path in _shipped(folder).glob("*.yaml")))


def is_path(name_or_path: str | Path) -> bool:
    """Whether this is the path of a YAML file rather than the name of a shipped one."""
    return isinstance(name_or_path, Path) or re.search(r"[/\\]|\.ya?ml$", name_or_path) is not None


def read_record(kind: type[Kind], name_or_path: str | Path, folder: str, error: type[ViaError]) -> tuple[Path, Kind]:
    """Path and content of a YAML file, shipped in `folder` under this name or your own.

    Raises `error` in one line: no such name, unreadable file, bad YAML, or an invalid key or value.
    """
    if is_path(name_or_path):
        path, file = Path(name_or_path), str(name_or_path)
    else:
        names = shipped_names(folder)
        if name_or_path not in names:
            what = folder.rpartition("_")[2].removesuffix("s")  # 'vsa_arms' holds arms
            raise error(f"no {what} '{name_or_path}'; there are: {', '.join(names)}")
        file = f"{name_or_path}.yaml"
        path = _shipped(folder) / file
    return path, parse_record(kind, read_text(path, error, file), file, error)


def parse_record(kind: type[Kind], text: str, file: str, error: type[ViaError]) -> Kind:
    """The record in a YAML `text`; `file` is the name in errors. Raises `error`."""
    try:
        return kind.model_validate(read_yaml(text, file, error, _Loader))
    except ValidationError as wrong:
        raise error(f"{file}: {problems(wrong)}") from None


def _shipped(folder: str) -> Path:
    return Path(str(resources.files("via_core").joinpath(folder)))


# ---- errors


def refused(value: Any, build: ValidatorFunctionWrapHandler) -> Any:
    """What `build` makes of an entry; numbers that its class refuses together become a problem of the file."""
    try:
        return build(value)
    except ParameterError as error:
        raise ValueError(str(error)) from None


def problems(error: ValidationError, most: int = 20) -> str:
    """The first `most` problems on one line; keys and values of a file may hold line breaks."""
    found = error.errors()
    more = f"; and {len(found) - most} more" if len(found) > most else ""
    return " ".join("; ".join(_problem(each) for each in found[:most]).splitlines()) + more


def _problem(problem: Any) -> str:
    """One problem as 'dotted.key: what is allowed, got value'."""
    key = ".".join(str(part) for i, part in enumerate(problem["loc"]) if i == 0 or part not in _TAGS)
    text = problem["msg"].removeprefix("Value error, ").replace("Input should be", "must be")
    if problem["type"] == "missing":
        return f"{key}: is missing"
    if problem["type"] == "union_tag_not_found":
        return f"{key}.{problem['ctx']['discriminator'].strip(chr(39))}: is missing"
    if problem["type"] == "union_tag_invalid":
        context = problem["ctx"]
        which = context["discriminator"].strip("'")
        return f"{key}.{which}: must be one of {context['expected_tags']}, got '{context['tag']}'"
    if problem["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
        return f"{key}: is no known key"
    if problem["type"] == "string_pattern_mismatch" and problem["ctx"]["pattern"] == NAME:
        text = "must be of lower case letters, digits and _, and begin with a letter"
    if problem["type"] in ("model_type", "model_attributes_type", "dataclass_type"):
        text = "must be a mapping of keys"
    if problem["type"] in ("value_error", "json_invalid"):
        return f"{key}: {text}" if key else text
    value = repr(problem["input"])
    return f"{key + ': ' if key else ''}{text}, got {value if len(value) <= SHOWN else value[: SHOWN - 3] + '...'}"
