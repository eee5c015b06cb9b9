from setuptools import find_packages, setup

package = "via_export"

setup(
    name=package,
    version="0.2.0",
    description="Export of devices and effects to MuJoCo, URDF, SDF, Isaac Lab, BAM and ros2_control.",
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
)
