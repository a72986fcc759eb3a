# The same lines stand in the setup.py of every package: colcon builds each package from its own file alone.
from setuptools import find_packages, setup

package_name = "ship_simulation"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={package_name: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    install_requires=[
        "setuptools",
        "ship_bags",
        "ship_estimation",
        "ship_geometry",
        "ship_msgs",
        "ship_stars",
        "numpy",
        "scipy",
        "PyYAML",
        "pyerfa",
        "rosbags",
    ],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="Ship attitude team",
    maintainer_email="maintainers@example.org",
    description="Simulated voyages: scenarios become bags.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "inject = ship_simulation.inject_command:main",
            "simulate = ship_simulation.simulate_command:main",
        ],
    },
)
