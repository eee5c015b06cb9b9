import ast
from pathlib import Path

from setuptools import find_packages, setup

package = "via_controllers"


def controllers():
    """Names in CONTROLLERS of methods.py, parsed instead of imported: its dependencies may not be installed yet."""
    tree = ast.parse(Path(package, "methods.py").read_text(encoding="utf-8"))
    tables = [node.value for node in tree.body if isinstance(node, ast.AnnAssign) and node.target.id == "CONTROLLERS"]
    return [ast.literal_eval(key) for key in tables[0].keys]


setup(
    name=package,
    version="0.2.0",
    description="Controllers of joints and arms, one per file, and their nodes.",
    license="Apache-2.0",
    maintainer="VIA maintainers",
    maintainer_email="maintainers@via.example.org",
    packages=find_packages(include=[package, f"{package}.*"]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package}"]),
        (f"share/{package}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    entry_points={
        "console_scripts": [f"{name} = via_controllers.nodes.single:{name}" for name in controllers()],
    },
)
