# The same lines stand in the setup.py of every package: colcon builds each package from its own file alone.
from setuptools import find_packages, setup

package_name = "theodolite_calib"

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
        "ship_kernels",
        "ship_msgs",
        "ship_node",
        "ship_stars",
        "numpy",
        "scipy",
    ],
    extras_require={"test": ["pytest", "PyYAML"]},
    zip_safe=False,
    maintainer="Ship attitude team",
    maintainer_email="maintainers@example.org",
    description="Theodolite pointing: calibration by beacons and stars, optical axis, targets, triangulation.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "optical_axis = theodolite_calib.nodes:optical_axis",
            "triangulation = theodolite_calib.nodes:triangulation",
            "triangulate = theodolite_calib.commands.triangulate:main",
            # They are in ship_studies now.
            "design_study = ship_bags.commands.moved:main",
            "fit_axes = ship_bags.commands.moved:main",
        ],
    },
)
