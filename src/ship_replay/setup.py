# The same lines stand in the setup.py of every package: colcon builds each package from its own file alone.
from setuptools import find_packages, setup

package_name = "ship_replay"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={package_name: ["py.typed", "*/*.html.j2"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    install_requires=[
        "setuptools",
        "ship_attitude_star",
        "ship_bags",
        "ship_estimation",
        "ship_geometry",
        "ship_msgs",
        "ship_node",
        "ship_stars",
        "ship_watch",
        "theodolite_calib",
        "numpy",
        "scipy",
        "PyYAML",
        "rich",
        "matplotlib",
    ],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="Ship attitude team",
    maintainer_email="maintainers@example.org",
    description="Suites offline: replay, smooth, verify, evaluate, report, compare, check before the voyage.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "replay = ship_replay.commands.replay:main",
            "evaluate = ship_replay.commands.evaluate:main",
            "report = ship_replay.commands.report:main",
            "compare = ship_replay.commands.compare:main",
            "stanford = ship_replay.commands.stanford:main",
            "check_config = ship_replay.commands.check_config:main",
            "smooth = ship_replay.commands.smooth:main",
            # They are in ship_studies now.
            "campaign = ship_bags.commands.moved:main",
            "axis_sightings = ship_bags.commands.moved:main",
            "calibrate_installation = ship_bags.commands.moved:main",
            "identify_noise = ship_bags.commands.moved:main",
        ],
    },
)
