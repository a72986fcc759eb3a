# The same lines stand in the setup.py of every package: colcon builds each package from its own file alone.
# This one compiles three modules besides.
from Cython.Build import cythonize
from setuptools import Extension, find_packages, setup

package_name = "theodolite_calib"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={package_name: ["design/page.html"]},
    # Without contraction of products and sums the results are the same on every processor.
    ext_modules=cythonize(
        [
            Extension(
                f"theodolite_calib.{name}",
                [f"theodolite_calib/{name.replace('.', '/')}.py"],
                extra_compile_args=["-O3", "-ffp-contract=off"],
            )
            for name in ("filter.compiled_points", "filter.compiled_rows", "measured.compiled_cubics")
        ],
        quiet=True,  # colcon reads what this file prints
    ),
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
