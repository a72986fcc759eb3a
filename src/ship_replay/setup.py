# The same lines stand in the setup.py of every package: colcon builds each package from its own file alone.
from setuptools import find_packages, setup

package_name = "ship_replay"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={package_name: ["py.typed", "report/*.html.j2"]},
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
        "ship_simulation",
        "ship_watch",
        "theodolite_calib",
        "numpy",
        "scipy",
        "PyYAML",
        "rich",
        "matplotlib",
        "Jinja2",
        "mcap",
        "rosbags",
    ],
    extras_require={"cluster": ["distributed"], "test": ["pytest"]},
    zip_safe=False,
    maintainer="Ship attitude team",
    maintainer_email="maintainers@example.org",
    description="Suites offline: replay, verify, evaluate, report, calibrate, check before the voyage.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "replay = ship_replay.commands.replay:main",
            "evaluate = ship_replay.commands.evaluate:main",
            "report = ship_replay.commands.report:main",
            "compare = ship_replay.commands.compare:main",
            "campaign = ship_studies.campaign.campaign_command:main",
            "stanford = ship_replay.commands.stanford:main",
            "check_config = ship_replay.commands.check_config:main",
            "smooth = ship_replay.commands.smooth:main",
            "axis_sightings = ship_studies.axis_fit.axis_sightings_command:main",
            "calibrate_installation = ship_studies.installation.calibrate_installation_command:main",
            "identify_noise = ship_studies.ins_noise.identify_noise_command:main",
            # Where bags and scenarios were before they had packages of their own.
            "record = ship_bags.commands.moved:main",
            "play = ship_bags.commands.moved:main",
            "import_nmea = ship_bags.commands.moved:main",
            "simulate = ship_bags.commands.moved:main",
        ],
    },
)
