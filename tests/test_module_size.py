"""No module of a package is longer, or imports more of the project, than a reader can keep in view."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MODULES = {
    ".".join(file.relative_to(package.parent).with_suffix("").parts): file
    for package in sorted(ROOT.glob("via_*/via_*"))
    for file in sorted(package.rglob("*.py"))
}
MOST_LINES, MOST_IMPORTS = 400, {"via_gap": 12}  # elsewhere 15
MOST_PARAMETERS = 6
COMPILED = {"bare", "compiled", "inlined", "njit", "_compiled"}  # decorators of kernels, whose arrays go in one by one


def project_imports(file: Path) -> set[str]:
    """Modules of the project that `file` imports, also within functions; all names of one module count once."""
    found = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {each.name for each in node.names if each.name.startswith("via_")}
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and (node.module or "").startswith("via_"):
            modules = {f"{node.module}.{each.name}" for each in node.names}
            found |= {name if name in MODULES else str(node.module) for name in modules}
    return found


def crowded(tree: ast.AST) -> list[str]:
    """Functions with more parameters than MOST_PARAMETERS, without kernels and commands (whose options they are)."""
    found = []
    for node in ast.walk(tree):
        if not isinstance(node, ast.FunctionDef):
            continue
        every = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
        own = [each for each in every if each.arg not in ("self", "cls")]
        decorators = {name for each in node.decorator_list for name in ast.unparse(each).replace("(", ".").split(".")}
        options = any("typer" in ast.unparse(each.annotation) for each in own if each.annotation)
        if len(own) > MOST_PARAMETERS and not decorators & COMPILED and not options:
            found.append(node.name)
    return found


def test_the_modules_are_found() -> None:
    assert {"via_sim.joint.kernel", "via_core.springs", "via_bringup.cli.__init__"} <= MODULES.keys()
    assert "via_core.signals" in project_imports(MODULES["via_sim.simulate"])


@pytest.mark.parametrize("name", MODULES)
def test_a_module_is_short_and_imports_few_others(name: str) -> None:
    assert len(MODULES[name].read_text(encoding="utf-8").splitlines()) <= MOST_LINES
    assert len(project_imports(MODULES[name])) <= MOST_IMPORTS.get(name.partition(".")[0], 15)


def test_a_seventh_parameter_is_noticed() -> None:
    plain = "def f(self, a, b, c, d, e, f, *, g): ..."
    assert crowded(ast.parse(plain)) == ["f"]
    assert crowded(ast.parse(f"@njit(cache=True)\n{plain}")) == crowded(ast.parse(plain.replace(", *, g", ""))) == []


@pytest.mark.parametrize("name", MODULES)
def test_a_function_has_few_parameters(name: str) -> None:
    assert crowded(ast.parse(MODULES[name].read_text(encoding="utf-8"))) == []
