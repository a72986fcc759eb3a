# The same lines stand in the setup.py of every package: colcon builds each package from its own file alone.
from setuptools import find_packages, setup

package_name = "ship_nmea"

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
        "ship_node",
        "pynmea2",
        "pyserial",
    ],
    extras_require={"test": ["pytest", "numpy"]},
    zip_safe=False,
    maintainer="Ship attitude team",
    maintainer_email="maintainers@example.org",
    description="NMEA 0183 live: out to bridge and logger, in from instruments.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "nmea_in = ship_nmea.instruments.nmea_in:main",
            "nmea_out = ship_nmea.out.nmea_out:main",
        ],
    },
)
