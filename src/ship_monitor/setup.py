# The same lines stand in the setup.py of every package: colcon builds each package from its own file alone.
from setuptools import find_packages, setup

package_name = "ship_monitor"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={package_name: ["py.typed", "page/static/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    install_requires=[
        "setuptools",
        "ship_bags",
        "ship_geometry",
        "ship_msgs",
        "ship_node",
        "ship_watch",
        "numpy",
        "bokeh",
        "tornado",
        "Jinja2",
        "matplotlib",
        "textual",
        "rich",
        "pyerfa",
    ],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="Ship attitude team",
    maintainer_email="maintainers@example.org",
    description="Live page, terminal view and alerts of a suite.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "monitor = ship_monitor.commands.monitor:main",
            "alerts = ship_monitor.alerts.alert_node:main",
            "monitor_terminal = ship_monitor.commands.monitor_terminal:main",
        ],
    },
)
