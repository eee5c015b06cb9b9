from setuptools import find_packages, setup

package = "via_gap"

setup(
    name=package,
    version="0.2.0",
    description="The gap between a simulated and a real joint: measured, reported.",
    license="Apache-2.0",
    maintainer="VIA maintainers",
    maintainer_email="maintainers@via.example.org",
    packages=find_packages(include=[package, f"{package}.*"]),
    package_data={package: ["selection/*.yaml", "report/*.yaml", "report/*.json", "rendering/page.*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package}"]),
        (f"share/{package}", ["package.xml"]),
    ],
    install_requires=["setuptools", "cryptography", "distributed", "markupsafe", "threadpoolctl"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    entry_points={"console_scripts": ["gap_monitor = via_gap.nodes.monitor:main"]},
)
