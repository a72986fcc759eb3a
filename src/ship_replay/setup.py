from setuptools import find_packages, setup

package_name = "ship_replay"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={package_name: ["play_profile.xml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    install_requires=[
        "setuptools",
        "numpy",
        "scipy",
        "PyYAML",
        "mcap",
        "mcap-ros2-support",
        "rosbags",
        "pynmea2",
        "rich",
        "matplotlib",
    ],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="Ship attitude team",
    maintainer_email="maintainers@example.org",
    description="Bags: simulate, replay, play, record, evaluate, import.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "simulate = ship_replay.simulate_command:main",
            "replay = ship_replay.replay_command:main",
            "play = ship_replay.play_command:main",
            "record = ship_replay.record_command:main",
            "evaluate = ship_replay.evaluate_command:main",
            "check_config = ship_replay.check_config_command:main",
            "axis_sightings = ship_replay.axis_sightings_command:main",
            "calibrate_installation = ship_replay.calibrate_installation_command:main",
            "import_nmea = ship_replay.import_nmea_command:main",
        ],
    },
)
