"""Which modules and tests of the repository import which modules, read from the sources."""

from __future__ import annotations

import ast
from collections import deque
from collections.abc import Mapping
from pathlib import Path

Imports = Mapping[str, frozenset[str]]  # path -> paths of the modules of the repository that it imports


def imports_of(root: Path) -> Imports:
    """Imports of every module and test file below `root`; paths relative to it."""
    modules = {}
    for path in root.glob("via_*/via_*/**/*.py"):
        parts = path.relative_to(root).parts[1:]
        modules[".".join(parts).removesuffix(".py").removesuffix(".__init__")] = path.relative_to(root).as_posix()
    tests = [
        path.relative_to(root).as_posix() for place in ("via_*/test", "tests") for path in root.glob(f"{place}/*.py")
    ]
    modules |= {Path(path).stem: path for path in tests}  # helpers of tests are imported by their bare name
    return {path: _imported(root / path, modules) - {path} for path in modules.values()}


def _imported(path: Path, modules: Mapping[str, str]) -> frozenset[str]:
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {each.name for each in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f"{node.module}.{each.name}" for each in node.names)}
    return frozenset(modules[name] for name in names if name in modules)


def dependents(imports: Imports, module: str) -> dict[str, int]:
    """Path -> number of imports between it and `module`, for all files that depend on it; `module` itself is at 0."""
    users: dict[str, list[str]] = {}
    for path, needed in imports.items():
        for each in needed:
            users.setdefault(each, []).append(path)
    distance, todo = {module: 0}, deque([module])
    while todo:
        path = todo.popleft()
        for user in users.get(path, ()):
            if user not in distance:
                distance[user] = distance[path] + 1
                todo.append(user)
    return distance


def covering(imports: Imports, module: str) -> list[str]:
    """Test files that depend on `module`: the nearest first, those of its own package before others."""
    package = module.partition("/")[0]
    found = [
        (d, not path.startswith(package), path) for path, d in dependents(imports, module).items() if _is_test(path)
    ]
    return [path for *_, path in sorted(found)]


def _is_test(path: str) -> bool:
    return Path(path).name.startswith("test_")
