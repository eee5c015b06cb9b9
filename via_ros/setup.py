from setuptools import find_packages, setup

package = "via_ros"

setup(
    name=package,
    version="0.2.0",
    description="The shared ROS code: conversions, parameters, QoS, spin, recorder and player.",
    license="Apache-2.0",
    maintainer="VIA maintainers",
    maintainer_email="maintainers@via.example.org",
    packages=find_packages(include=[package, f"{package}.*"]),
    package_data={package: ["**/*.xml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package}"]),
        (f"share/{package}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    entry_points={"console_scripts": ["player = via_ros.nodes.player:main", "recorder = via_ros.nodes.recorder:main"]},
)
