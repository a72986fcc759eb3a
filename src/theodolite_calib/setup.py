# The same lines stand in the setup.py of every package: colcon builds each package from its own file alone.
# This one compiles modules besides, unless tools/setup_build.py does it, for all packages at once.
import os

from setuptools import Extension, find_packages, setup

package_name = "theodolite_calib"

COMPILED = ("filter.compiled_points", "filter.compiled_rows", "measured.compiled_cubics")
SHARED_MODULE = "ship_geometry.compiled_shared"
# Without contraction of products and sums the results are the same on every processor.
FLAGS = ["-O3", "-g0", "-ffp-contract=off"]


def compiled_modules():
    if os.environ.get("SHIP_SUITE_IS_COMPILED"):
        return []
    from Cython.Build import cythonize

    sources = {name: f"{package_name}/{name.replace('.', '/')}.py" for name in COMPILED}
    modules = [
        Extension(f"{package_name}.{name}", [source], extra_compile_args=FLAGS) for name, source in sources.items()
    ]
    return cythonize(
        modules,
        shared_utility_qualified_name=SHARED_MODULE,
        nthreads=len(os.sched_getaffinity(0)),
        quiet=True,  # colcon reads what this file prints
    )


setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={package_name: ["design/page.html"]},
    ext_modules=compiled_modules(),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    install_requires=["setuptools", "numpy", "scipy", "PyYAML", "matplotlib"],
    extras_require={"build": ["Cython>=3.1"], "test": ["pytest"]},
    zip_safe=False,
    maintainer="Ship attitude team",
    maintainer_email="maintainers@example.org",
    description="Theodolite pointing: axis errors, lines of sight, image, optical axis, calibration.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "design_study = theodolite_calib.design.design_study_command:main",
            "fit_axes = theodolite_calib.axis_fit.fit_axes_command:main",
            "optical_axis = theodolite_calib.ros.nodes:optical_axis",
            "triangulation = theodolite_calib.ros.nodes:triangulation",
            "triangulate = theodolite_calib.triangulation.triangulate_command:main",
        ],
    },
)
