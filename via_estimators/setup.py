from setuptools import find_packages, setup

package = "via_estimators"

setup(
    name=package,
    version="0.1.0",
    description="Estimators of stiffness, damping and motor parameters, one algorithm per file, and their node.",
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
    entry_points={"console_scripts": ["estimator = via_estimators.nodes.estimator:main"]},
)
