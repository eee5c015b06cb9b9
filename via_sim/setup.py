from setuptools import find_packages, setup

package = "via_sim"

setup(
    name=package,
    version="0.2.0",
    description="Plants of variable impedance joints, effects, integrators and the simulator node.",
    license="Apache-2.0",
    maintainer="VIA maintainers",
    maintainer_email="maintainers@via.example.org",
    packages=find_packages(include=[package, f"{package}.*"]),
    package_data={package: ["**/*.yaml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package}"]),
        (f"share/{package}", ["package.xml"]),
    ],
    install_requires=["setuptools", "llvmlite"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "simulator = via_sim.nodes.simulator:main",
            "arm_simulator = via_sim.nodes.arm_simulator:main",
            "hopper_simulator = via_sim.nodes.hopper_simulator:main",
        ]
    },
)
