# The same lines stand in the setup.py of every package: colcon builds each package from its own file alone.
from setuptools import find_packages, setup

package_name = "ship_bags"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={package_name: ["py.typed", "live/dds_profile.xml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    install_requires=[
        "setuptools",
        "ship_geometry",
        "ship_msgs",
        "numpy",
        "scipy",
        "PyYAML",
        "mcap",
        "rosbags",
        "zstandard",
        "pynmea2",
        "lz4",
    ],
    extras_require={"test": ["pytest", "mcap-ros2-support"], "parquet": ["pyarrow"]},
    zip_safe=False,
    maintainer="Ship attitude team",
    maintainer_email="maintainers@example.org",
    description="Bags: read, write, recover, record, play; import of ship logs; export of tables.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "record = ship_bags.commands.record:main",
            "play = ship_bags.commands.play:main",
            "import_nmea = ship_bags.commands.import_nmea:main",
            "export = ship_bags.commands.export:main",
            "info = ship_bags.commands.info:main",
        ],
    },
)
