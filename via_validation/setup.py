from setuptools import find_packages, setup

package = "via_validation"

setup(
    name=package,
    version="0.2.0",
    description="Proof of the suite: second simulator, sealed benchmark, tables, comparison, benchmarks, real robots.",
    license="Apache-2.0",
    maintainer="VIA maintainers",
    maintainer_email="maintainers@via.example.org",
    packages=find_packages(include=[package, f"{package}.*"]),
    package_data={package: ["**/*.yaml", "**/*.html", "**/*.csv", "**/*.txt", "**/*.md", "**/*.cpp", "**/*.c"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package}"]),
        (f"share/{package}", ["package.xml"]),
    ],
    install_requires=["setuptools", "filterpy", "llvmlite", "mcap", "mcap-ros2-support", "padasip"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    entry_points={"via.commands": ["validation = via_validation.commands:COMMANDS"]},
)
