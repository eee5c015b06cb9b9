"""Effects of another package for the commands: a module or a file that adds kinds to the catalogue.

load_own("seal_friction.py")     # docs/guides/effect.md writes one
load_own("lab.joint_effects")    # an installed module, or one of the current folder
load_all(loaded())               # in another process, given the names
"""

from __future__ import annotations

import importlib
import importlib.util
import sys
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType

from via_core.errors import ParameterError

from via_sim.catalogue import EFFECTS
from via_sim.catalogue.kinds import EffectKind

_LOADED: list[str] = []


def loaded() -> tuple[str, ...]:
    """Names that `load_own` has loaded in this process, files by their whole paths."""
    return tuple(_LOADED)


def load_all(names: Iterable[str]) -> None:
    """Load those of some names that this process has not loaded. Raises ParameterError as `load_own`."""
    for name in names:
        if name not in _LOADED:
            load_own(name)


def load_own(name: str) -> tuple[str, ...]:
    """Import a module, or a Python file by its path; names of the effects that it added to the catalogue.

    The code is executed, so it runs with the rights of the caller. Raises ParameterError in one line if it cannot be
    imported, adds no effect, replaces one, or adds one that cannot be an effect.
    """
    before = dict(EFFECTS)
    try:
        _imported(name)
        added = tuple(each for each in EFFECTS if each not in before)
        replaced = [each for each, kind in before.items() if EFFECTS.get(each) is not kind]
        if replaced:
            raise ParameterError(f"{name}: replaces the effect '{replaced[0]}' of the catalogue; choose another name")
        for each in added:
            _require_kind(name, each)
        if not added:
            raise ParameterError(
                f"{name}: adds no effect; write EFFECTS[kind.name] = kind, as docs/guides/effect.md does"
            )
    except ParameterError:
        EFFECTS.clear()
        EFFECTS.update(before)
        raise
    _LOADED.append(str(Path(name).resolve()) if _is_file(name) else name)
    return added


def _is_file(name: str) -> bool:
    return Path(name).suffix == ".py" or len(Path(name).parts) > 1


def _imported(name: str) -> ModuleType:
    path = Path(name)
    if _is_file(name) and not path.is_file():
        raise ParameterError(f"{name}: no such file")
    try:
        if not _is_file(name):
            sys.path.insert(0, str(Path.cwd()))
            try:
                return importlib.import_module(name)
            finally:
                sys.path.remove(str(Path.cwd()))
        spec = importlib.util.spec_from_file_location(path.stem, path)
        if spec is None or spec.loader is None:
            raise ParameterError(f"{name}: is no Python file")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module
    except ParameterError:
        raise
    except Exception as error:  # of the module: any
        raise ParameterError(f"{name}: cannot be imported: {_where(error, path)}{_line(error)}") from None


def _require_kind(name: str, key: str) -> None:
    kind = EFFECTS[key]
    if not isinstance(kind, EffectKind):
        raise ParameterError(f"{name}: EFFECTS['{key}'] is {type(kind).__name__}, not EffectKind")
    if kind.name != key:
        raise ParameterError(f"{name}: EFFECTS['{key}'] has the name '{kind.name}'")
    if kind.slots or kind.terms:
        raise ParameterError(
            f"{name}: '{key}' has slots or terms of its own, which kernels take from files of via_sim/catalogue alone"
        )


def _where(error: Exception, path: Path) -> str:
    """Line of the file, or of the module's file, in which an error was raised."""
    found = error.lineno if isinstance(error, SyntaxError) else None
    trace = error.__traceback__
    while trace is not None:
        file = Path(trace.tb_frame.f_code.co_filename)
        if file.stem == path.stem and file != Path(__file__):
            found = trace.tb_lineno
        trace = trace.tb_next
    return f"line {found}: " if found is not None else ""


def _line(error: Exception) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())[:160]}"
