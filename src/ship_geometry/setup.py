# The same lines stand in the setup.py of every package: colcon builds each package from its own file alone.
# This one compiles modules besides, unless tools/setup_build.py does it, for all packages at once.
import os

from setuptools import Extension, find_packages, setup

package_name = "ship_geometry"

COMPILED = (
    "compiled_angles",
    "compiled_lights",
    "compiled_mounts",
    "compiled_polynomials",
    "compiled_refraction",
    "compiled_rotations",
    "compiled_shapes",
    "compiled_tables",
)
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
    # What all of them share, which is generated and compiled once.
    modules.append(Extension(SHARED_MODULE, ["ship_geometry/compiled_shared.c"], extra_compile_args=FLAGS))
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
    ext_modules=compiled_modules(),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    install_requires=["setuptools", "numpy", "scipy", "pyerfa", "astropy-iers-data"],
    extras_require={"build": ["Cython>=3.1"], "test": ["pytest"]},
    zip_safe=False,
    maintainer="Ship attitude team",
    maintainer_email="maintainers@example.org",
    description="Frames, rotations and their covariance, time scales, Earth and refraction. Knows nothing of ROS.",
    license="Apache-2.0",
)
