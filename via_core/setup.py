from setuptools import find_packages, setup

package = "via_core"

setup(
    name=package,
    version="0.2.0",
    description="Notation, signals, spring laws, devices, weak-form kernels and bags; no ROS.",
    license="Apache-2.0",
    maintainer="VIA maintainers",
    maintainer_email="maintainers@via.example.org",
    packages=find_packages(include=[package, f"{package}.*"]),
    package_data={package: ["**/*.yaml", "**/*.csv", "**/*.urdf", "samples/*/LICENSE", "samples/*/README.md"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package}"]),
        (f"share/{package}", ["package.xml"]),
    ],
    install_requires=["setuptools", "lz4", "mcap", "pyarrow", "regex", "zstandard"],
    extras_require={"test": ["pytest", "mcap-ros2-support"]},
    zip_safe=False,
    entry_points={"numba_extensions": ["init = via_core.kernel_cache:init"]},
)
