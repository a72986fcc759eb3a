# The same lines stand in the setup.py of every package: colcon builds each package from its own file alone.
from glob import glob

from setuptools import find_packages, setup

package_name = "ship_bringup"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={package_name: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
        (f"share/{package_name}/launch", glob("launch/*")),
        # examples/ of the repository has links to those: one text, and the package is built alone.
        (f"share/{package_name}/config", glob("config/*")),
        (f"share/{package_name}/layouts", glob("layouts/*")),
        (f"share/{package_name}/systemd", glob("systemd/*")),
        (f"share/{package_name}/security", glob("security/*")),
    ],
    install_requires=[
        "setuptools",
        "ship_attitude_star",
        "ship_bags",
        "ship_estimation",
        "ship_monitor",
        "ship_msgs",
        "ship_nmea",
        "ship_node",
        "ship_replay",
        "ship_watch",
        "theodolite_calib",
        "cryptography",
    ],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="Ship attitude team",
    maintainer_email="maintainers@example.org",
    description="Launch files, parameter files, layouts, policies; a suite checked and brought up without ros2 launch.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "suite = ship_bringup.commands.suite:main",
            "call = ship_bringup.commands.call:main",
            "param = ship_bringup.commands.param:main",
            "preflight = ship_bringup.commands.preflight:main",
            "policies = ship_bringup.commands.policies:main",
        ],
    },
)
