"""What pydantic found wrong with a file, in words of this project: key, what is allowed, and the value."""

from __future__ import annotations

from typing import Any

from pydantic import ValidationError

# Pydantic puts the tag of a union into the path of an error; none of these tags is a key.
_TAGS = {
    *("torque", "servo", "linear", "two_stage"),
    *("cubic", "odd_polynomial", "sinh", "exponential", "four_bar", "maccepa", "two_lever"),
}
NAME = r"^[a-z][a-z0-9_]*$"  # of devices and their parts
SHOWN = 80  # characters of a value


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
    if problem["type"] == "extra_forbidden":
        return f"{key}: is no known key"
    if problem["type"] == "string_pattern_mismatch" and problem["ctx"]["pattern"] == NAME:
        text = "must be of lower case letters, digits and _, and begin with a letter"
    if problem["type"] in ("model_type", "model_attributes_type", "dataclass_type"):
        text = "must be a mapping of keys"
    if problem["type"] in ("value_error", "json_invalid"):
        return f"{key}: {text}" if key else text
    value = repr(problem["input"])
    return f"{key + ': ' if key else ''}{text}, got {value if len(value) <= SHOWN else value[: SHOWN - 3] + '...'}"
