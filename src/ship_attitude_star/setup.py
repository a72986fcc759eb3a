# The same lines stand in the setup.py of every package: colcon builds each package from its own file alone.
from setuptools import find_packages, setup

package_name = "ship_attitude_star"

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
    ],
    extras_require={"test": ["pytest", "scipy"]},
    zip_safe=False,
    maintainer="Ship attitude team",
    maintainer_email="maintainers@example.org",
    description="Ship attitude from an INS and star sensors: installation error model, fusion, node.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "ship_attitude = ship_attitude_star.nodes:ship_attitude",
            "star_attitude = ship_attitude_star.nodes:star_attitude",
            # They are in ship_studies now.
            "layout_study = ship_bags.commands.moved:main",
        ],
    },
)
