"""Effects files: a YAML list of effects; written files give the same effects when read.

- effect: coulomb_friction
  site: motor
  motor: 1
  parameters: {torque: 0.02}     # [N m], 0 to 1000
  intervals: {torque: [0.018, 0.022]}     # 95 %, for the reader; the simulator ignores them
- effect: torque_gain
  site: motor
  motor: 0                       # both motors alike; required at a motor or transmission
  parameters: {gain: 0.95}
- effect: device_numbers         # factors on numbers of the device file, fitted with the effects
  site: device
  parameters: {link inertia: 1.03}
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Any

import yaml
from via_core.errors import ParameterError
from via_core.text_files import read_text, read_yaml, replace_text

from via_sim.catalogue import EFFECTS
from via_sim.effects import PAIRED, Effect

KEYS = ("effect", "site", "motor", "joint", "parameters", "intervals")
Intervals = Mapping[str, tuple[float, float]]


def load_effects(path: str | Path) -> tuple[Effect, ...]:
    """The effects of a file. Raises ParameterError with file, entry, key and allowed range."""
    return parse_effects(read_text(path, ParameterError), str(path))


def parse_effects(text: str, file: str) -> tuple[Effect, ...]:
    """The effects in YAML `text`; `file` is the name in errors."""
    content = read_yaml(text, file, ParameterError)
    if content is None:
        return ()
    if not isinstance(content, list):
        raise ParameterError(f"{file}: an effects file is a list of effects, got {type(content).__name__}")
    return tuple(_effect(entry, f"{file}: entry {number}") for number, entry in enumerate(content, 1))


def effects_text(effects: Sequence[Effect], intervals: Sequence[Intervals] = ()) -> str:
    """YAML of an effects file; `intervals` belong to the first effects."""
    entries = []
    for effect, ranges in zip_longest(effects, intervals):
        entry: dict[str, Any] = {"effect": effect.name, "site": effect.site}
        if effect.motor or effect.site in PAIRED:
            entry["motor"] = effect.motor
        if effect.joint:
            entry["joint"] = effect.joint
        entry["parameters"] = dict(effect.parameters)
        if ranges:
            entry["intervals"] = {name: list(ends) for name, ends in ranges.items()}
        entries.append(entry)
    return yaml.safe_dump(entries, sort_keys=False)


def save_effects(path: str | Path, effects: Sequence[Effect], intervals: Sequence[Intervals] = ()) -> None:
    """Write `effects` atomically. Raises ParameterError where the file cannot be written."""
    replace_text(Path(path), effects_text(effects, intervals), ParameterError)


def _effect(entry: object, where: str) -> Effect:
    if not isinstance(entry, dict):
        raise ParameterError(f"{where}: must be a mapping with {', '.join(KEYS)}, got {entry!r}")
    for key in entry:
        if key not in KEYS:
            raise ParameterError(f"{where}: {key}: unknown key; choose from {', '.join(KEYS)}")
    for key in ("effect", "site"):
        if not isinstance(entry.get(key), str):
            raise ParameterError(f"{where}: {key}: must be {_choices(key, entry)}, got {entry.get(key)!r}")
    if entry["effect"] in EFFECTS and entry["site"] in PAIRED and "motor" not in entry:
        raise ParameterError(f"{where}: motor: is missing at site '{entry['site']}', must be 1, 2 or 0 (both)")
    parameters = entry.get("parameters", {})
    if not isinstance(parameters, dict):
        raise ParameterError(f"{where}: parameters: must be a mapping of names to numbers, got {parameters!r}")
    try:
        numbers = {name: _number(value) for name, value in parameters.items()}
        return Effect(entry["effect"], entry["site"], numbers, entry.get("motor", 0), entry.get("joint", "") or "")
    except ParameterError as error:
        raise ParameterError(f"{where}: {error}") from None


def _choices(key: str, entry: dict[str, Any]) -> str:
    """What the effect or site of an entry may be."""
    kind = EFFECTS.get(str(entry.get("effect")))
    names = sorted(EFFECTS) if key == "effect" else kind.sites if kind else ["a site of the effect"]
    return " or ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def _number(value: object) -> Any:
    """Text of a number as a number: YAML 1.1 parses 1e-3 as text. Other values are refused by the effect."""
    if isinstance(value, str):
        try:
            return float(value)
        except ValueError:
            return value
    return value
