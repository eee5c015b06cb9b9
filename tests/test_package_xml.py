"""package.xml and setup.py of each package declare exactly the packages that its Python files import."""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = sorted(path.parent for path in ROOT.glob("via_*/package.xml"))
PYTHON_PACKAGES = [package for package in PACKAGES if (package / "setup.py").is_file()]

# import name -> rosdep key; an import that is in neither table is a ROS package, whose name is its key
ROSDEP = {
    "PIL": "python3-pil",
    "casadi": "casadi-pip",
    "hypothesis": "python3-hypothesis",
    "jinja2": "python3-jinja2",
    "matplotlib": "python3-matplotlib",
    "mujoco": "python3-mujoco-pip",
    "numba": "python3-numba",
    "numpy": "python3-numpy",
    "pandas": "python3-pandas",
    "pint": "python3-pint",
    "psutil": "python3-psutil",
    "pydantic": "python3-pydantic",
    "pytest": "python3-pytest",
    "rich": "python3-rich",
    "rosbags": "python3-rosbags-pip",
    "scipy": "python3-scipy",
    "typer": "python3-typer",
    "yaml": "python3-yaml",
}
# import name -> name on PyPI, where no rosdep key is known: setup.py declares it and a comment in package.xml names it
PYPI = {
    "distributed": "distributed",
    "filterpy": "filterpy",
    "llvmlite": "llvmlite",
    "lz4": "lz4",
    "markupsafe": "markupsafe",
    "mcap": "mcap",
    "mcap_ros2": "mcap-ros2-support",
    "padasip": "padasip",
    "regex": "regex",
    "pyarrow": "pyarrow",
    "rerun": "rerun-sdk",
    "threadpoolctl": "threadpoolctl",
    "zstandard": "zstandard",
}

# package -> what its imports need for the features that it uses, without declaring it
OPTIONAL = {"via_gap": {"cryptography"}}  # distributed.security.Security.temporary


def imports(files: list[Path]) -> Iterator[str]:
    """Top-level names of all absolute imports in `files`."""
    for file in files:
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                yield from (each.name.partition(".")[0] for each in node.names)
            elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
                yield node.module.partition(".")[0]


def imported(package: Path) -> tuple[set[str], set[str]]:
    """Foreign imports of the installed files, and those that only the tests need."""
    files = [file for file in package.rglob("*.py") if file != package / "setup.py"]
    tests = [file for file in files if file.relative_to(package).parts[0] == "test"]
    helpers = {file.stem for file in ROOT.glob("via_*/test/*.py")}
    known = sys.stdlib_module_names | {package.name} | helpers
    installed = set(imports([file for file in files if file not in tests])) - known
    return installed, set(imports(tests)) - known - installed


def declared_keys(package: Path, *tags: str) -> set[str]:
    root = ElementTree.parse(package / "package.xml").getroot()
    return {(element.text or "").strip() for tag in tags for element in root.iter(tag)}


def declared_distributions(package: Path) -> tuple[set[str], set[str]]:
    """What setup.py requires to run, also for its other extras, and extras_require['test'], without versions."""
    tree = ast.parse((package / "setup.py").read_text(encoding="utf-8"))
    call = next(node for node in ast.walk(tree) if isinstance(node, ast.Call) and ast.unparse(node.func) == "setup")
    values = {each.arg: each.value for each in call.keywords}
    extras = ast.literal_eval(values["extras_require"])
    test = set(extras.pop("test")) - {"pytest"}
    run = {*ast.literal_eval(values["install_requires"]), *chain.from_iterable(extras.values())} - {"setuptools"}
    return {each.partition("==")[0] for each in run}, test


def keys(modules: set[str]) -> set[str]:
    return {ROSDEP.get(module, module) for module in modules if module not in PYPI}


def distributions(modules: set[str]) -> set[str]:
    return {PYPI[module] for module in modules if module in PYPI}


@pytest.mark.parametrize("package", PYTHON_PACKAGES, ids=lambda package: package.name)
def test_package_xml_declares_exactly_the_imports(package: Path) -> None:
    installed, only_tests = imported(package)
    assert declared_keys(package, "depend", "exec_depend") == keys(installed)
    assert declared_keys(package, "test_depend") == keys(only_tests | {"pytest"})


@pytest.mark.parametrize("package", PYTHON_PACKAGES, ids=lambda package: package.name)
def test_setup_py_declares_the_imports_from_pypi(package: Path) -> None:
    installed, only_tests = imported(package)
    needed = distributions(installed) | OPTIONAL.get(package.name, set())
    assert declared_distributions(package) == (needed, distributions(only_tests))
    text = (package / "package.xml").read_text(encoding="utf-8")
    comments = " ".join(part.partition("-->")[0] for part in text.split("<!--")[1:])
    assert all(name in comments for name in needed | distributions(only_tests))


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.name)
def test_maintainer_and_licence_are_accepted_by_ros_tools(package: Path) -> None:
    parser = pytest.importorskip("catkin_pkg.package")
    warnings: list[str] = []
    parsed = parser.parse_package(str(package / "package.xml"), warnings=warnings)
    assert not warnings
    assert [each.email for each in parsed.maintainers] == ["maintainers@via.example.org"]
    # bloom reads the licence from the package's own folder, so each package carries a copy
    assert [str(each) for each in parsed.licenses] == ["Apache-2.0"]
    assert [each.file for each in parsed.licenses] == ["LICENSE"]
    assert (package / "LICENSE").read_bytes() == (ROOT / "LICENSE").read_bytes()
