# The same lines stand in the setup.py of every package: colcon builds each package from its own file alone.
# This one compiles modules besides.
from Cython.Build import cythonize
from setuptools import Extension, find_packages, setup

package_name = "ship_geometry"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    # Without contraction of products and sums the results are the same on every processor.
    ext_modules=cythonize(
        [
            Extension(
                f"ship_geometry.compiled_{name}",
                [f"ship_geometry/compiled_{name}.py"],
                extra_compile_args=["-O3", "-ffp-contract=off"],
            )
            for name in ("angles", "lights", "mounts", "polynomials", "refraction", "rotations", "shapes", "tables")
        ],
        quiet=True,  # colcon reads what this file prints
    ),
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
