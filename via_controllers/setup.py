from setuptools import find_packages, setup

package = "via_controllers"

setup(
    name=package,
    version="0.1.0",
    description="Control and excitation laws, one per file, and their nodes.",
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
        "console_scripts": [
            "excitation = via_controllers.nodes.excitation:main",
            "modal_limit_cycle = via_controllers.nodes.modal_limit_cycle:main",
            "bang_bang = via_controllers.nodes.bang_bang:main",
            "bang_bang_joint = via_controllers.nodes.bang_bang_joint:main",
            "equilibrium_preset = via_controllers.nodes.equilibrium_preset:main",
            "max_velocity = via_controllers.nodes.max_velocity:main",
            # X_controllers.nodes.bang_bang:main",
            "hopping = via_controllers.nodes.hopping:main",
        ]
    },
)
