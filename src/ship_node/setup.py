# The same lines stand in the setup.py of every package: colcon builds each package from its own file alone.
from setuptools import find_packages, setup

package_name = "ship_node"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={package_name: ["py.typed", "pages/*.html.j2"]},
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
        "numpy",
        "PyYAML",
        "matplotlib",
        "Jinja2",
        "rich",
    ],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="Ship attitude team",
    maintainer_email="maintainers@example.org",
    description="Node runtime: exception handling, parameters from dataclasses, QoS, input health",
    license="Apache-2.0",
)
