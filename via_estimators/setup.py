import ast
from pathlib import Path

from setuptools import find_packages, setup

package = "via_estimators"


def methods():
    """Names in the registry, read and not imported: what it needs may not be installed yet."""
    names = []
    for file, table in (("methods.py", "METHODS"), ("peers.py", "PEERS")):
        tree = ast.parse(Path(package, file).read_text(encoding="utf-8"))
        tables = [node.value for node in tree.body if isinstance(node, ast.AnnAssign) and node.target.id == table]
        names += [ast.literal_eval(key) for key in tables[0].keys if key is not None]  # None: ** of another table
    return names


setup(
    name=package,
    version="0.2.0",
    description="Estimators of stiffness, damping and motor parameters, one algorithm per file, and their nodes.",
    license="Apache-2.0",
    maintainer="VIA maintainers",
    maintainer_email="maintainers@via.example.org",
    packages=find_packages(include=[package, f"{package}.*"]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package}"]),
        (f"share/{package}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest", "filterpy"]},
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "estimator = via_estimators.nodes.estimator:main",
            "estimator_bank = via_estimators.nodes.estimator:bank",
            "payload = via_estimators.nodes.payload:main",
            "dynamic_joint_states = via_estimators.nodes.dynamic_joint_states:main",
            *(f"{method} = via_estimators.nodes.single:{method}" for method in methods()),
        ]
    },
)
