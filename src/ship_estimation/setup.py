# The same lines stand in the setup.py of every package: colcon builds each package from its own file alone.
from setuptools import find_packages, setup

package_name = "ship_estimation"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={package_name: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    install_requires=["setuptools", "ship_geometry", "ship_kernels", "numpy"],
    extras_require={"test": ["pytest", "hypothesis", "scipy"]},
    zip_safe=False,
    maintainer="Ship attitude team",
    maintainer_email="maintainers@example.org",
    description="Kalman steps, gates, time-ordered log, Gauss-Markov models, error budget",
    license="Apache-2.0",
)
