from glob import glob

from setuptools import find_packages, setup

package = "via_bringup"

setup(
    name=package,
    version="0.2.0",
    description="Launch files, parameter files, the demo and the via command.",
    license="Apache-2.0",
    maintainer="VIA maintainers",
    maintainer_email="maintainers@via.example.org",
    packages=find_packages(include=[package, f"{package}.*"]),
    package_data={package: ["**/*.yaml", "**/*.html", "**/*.csv", "**/*.txt", "**/*.md", "**/*.cpp"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package}"]),
        (f"share/{package}", ["package.xml"]),
        ("bin", ["bin/via"]),
        (f"share/{package}/launch", sorted(glob("launch/*.launch.py"))),
        (f"share/{package}/security", sorted(glob("security/*.xml"))),
        (f"share/{package}/config", sorted(glob("config/*.yaml"))),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"], "view": ["rerun-sdk"]},
    zip_safe=False,
    entry_points={"console_scripts": ["via = via_bringup.cli:main"]},
)
