"""Effects files: a YAML list of effects, read with one-line errors and written so that reading gives the same effects.

- effect: coulomb_friction
  site: motor
  motor: 1
  parameters: {torque: 0.02}     # [N m], 0 to 1000
  intervals: {torque: [0.018, 0.022]}     # 95 %, for whoever reads the file; the simulator needs none
- effect: torque_gain
  site: motor
  motor: 0                       # both motors alike; at a motor or transmission the number is never left out
  parameters: {gain: 0.95}
- effect: device_numbers         # what the effects were fitted with: factors on numbers of the device file
  site: device
  parameters: {link inertia: 1.03}
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Any

import yaml
from via_core.errors import ParameterError

from via_sim.catalogue import EFFECTS
from via_sim.effects import PAIRED, Effect

KEYS = ("effect", "site", "motor", "joint", "parameters", "intervals")
Intervals = Mapping[str, tuple[float, float]]


def load_effects(path: str | Path) -> tuple[Effect, ...]:
    """The effects of a file. Raises ParameterError naming file, entry, key and allowed range."""
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ParameterError(
            f"{path}: cannot be read: {getattr(error, 'strerror', None) or 'not UTF-8 text'}"
        ) from None
    return parse_effects(text, str(path))


def parse_effects(text: str, file: str) -> tuple[Effect, ...]:
    """The effects that YAML `text` lists; `file` is the name that errors show."""
    try:
        content = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        mark = getattr(error, "problem_mark", None)
        line = f" line {mark.line + 1}" if mark is not None else ""
        raise ParameterError(f"{file}:{line} {getattr(error, 'problem', None) or 'not YAML'}") from None
    if content is None:
        return ()
    if not isinstance(content, list):
        raise ParameterError(f"{file}: an effects file is a list of effects, got {type(content).__name__}")
    return tuple(_effect(entry, f"{file}: entry {number}") for number, entry in enumerate(content, 1))


def effects_text(effects: Sequence[Effect], intervals: Sequence[Intervals] = ()) -> str:
    """The YAML of an effects file; `intervals` of the parameters of the first effects, as they are known."""
    entries = []
    for effect, known in zip_longest(effects, intervals):
        entry: dict[str, Any] = {"effect": effect.name, "site": effect.site}
        if effect.motor or effect.site in PAIRED:
            entry["motor"] = effect.motor
        if effect.joint:
            entry["joint"] = effect.joint
        entry["parameters"] = dict(effect.parameters)
        if known:
            entry["intervals"] = {name: list(ends) for name, ends in known.items()}
        entries.append(entry)
    return yaml.safe_dump(entries, sort_keys=False)


def save_effects(path: str | Path, effects: Sequence[Effect], intervals: Sequence[Intervals] = ()) -> None:
    """Write `effects`, whole or not at all. Raises ParameterError where the file cannot be written."""
    target = Path(path)
    draft = target.with_name(f".{target.name}.{os.getpid()}")
    try:
        draft.write_text(effects_text(effects, intervals), encoding="utf-8")
        draft.replace(target)
    except OSError as error:
        draft.unlink(missing_ok=True)
        raise ParameterError(f"{path}: cannot be written: {error.strerror}") from None


def _effect(entry: object, where: str) -> Effect:
    if not isinstance(entry, dict):
        raise ParameterError(f"{where}: must be a mapping with {', '.join(KEYS)}, got {entry!r}")
    for key in entry:
        if key not in KEYS:
            raise ParameterError(f"{where}: {key}: is no known key; there are {', '.join(KEYS)}")
    for key in ("effect", "site"):
        if not isinstance(entry.get(key), str):
            raise ParameterError(f"{where}: {key}: must be a name, got {entry.get(key)!r}")
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


def _number(value: object) -> Any:
    """YAML 1.1 takes 1e-3 for text; what reads as a number is one, the rest is refused by the effect."""
    if isinstance(value, str):
        try:
            return float(value)
        except ValueError:
            return value
    return value
