# The same lines stand in the setup.py of every package: colcon builds each package from its own file alone.
# This one compiles modules besides, unless tools/setup_build.py does it, for all packages at once.
import hashlib
import os
from pathlib import Path

from setuptools import Extension, find_packages, setup
from setuptools.command.build_ext import build_ext

package_name = "ship_kernels"

COMPILED = (
    "compiled_arrays",
    "compiled_checks",
    "compiled_innovations",
    "compiled_kalman",
    "compiled_pointing",
    "compiled_rotations",
    "compiled_stars",
    "compiled_tracks",
)
SHARED_MODULE = "ship_kernels.compiled_shared"
CYTHON = 3, 1  # the oldest that takes these sources
# Without contraction of products and sums the results are the same on every processor.
FLAGS = ["-O3", "-g0", "-ffp-contract=off"]


# Digest of the sources from which the C next to them was generated.
STAMP = Path(package_name, "compiled_sources.sha256")


def modules(ending):
    paths = {name: f"{package_name}/{name.replace('.', '/')}{ending}" for name in COMPILED}
    return [Extension(f"{package_name}.{name}", [path], extra_compile_args=FLAGS) for name, path in paths.items()]


def shared_module():
    """Return the module with the functions that all compiled modules share: generated and compiled once."""
    return Extension(SHARED_MODULE, ["ship_kernels/compiled_shared.c"], extra_compile_args=FLAGS)


def digest_of_sources():
    sources = sorted([*Path(package_name).rglob("compiled_*.py"), *Path(package_name).rglob("compiled_*.pxd")])
    return hashlib.sha256(b"\0".join(path.read_bytes() for path in sources)).hexdigest()


class CompiledModules(build_ext):
    """Decides how modules are compiled when they are: colcon reads this file before, for names and dependencies."""

    def finalize_options(self):
        if self.distribution.ext_modules:
            self.distribution.ext_modules = compiled_modules()
        super().finalize_options()


def compiled_modules():
    """Return modules of Cython; where that is missing or older, of the generated C of a release or a bundle."""
    try:
        import Cython
        from Cython.Build import cythonize
    except ImportError:
        return generated_modules("none is here")
    if tuple(map(int, Cython.__version__.split(".")[:2])) < CYTHON:
        return generated_modules(f"{Cython.__version__} is here")
    made = cythonize(
        [*modules(".py"), shared_module()],
        shared_utility_qualified_name=SHARED_MODULE,
        nthreads=len(os.sched_getaffinity(0)),
        quiet=True,  # colcon reads what this file prints
    )
    STAMP.write_text(digest_of_sources())
    return made


def generated_modules(why):
    found = [*modules(".c"), shared_module()]
    is_there = all(os.path.exists(source) for module in found for source in module.sources)
    if not (is_there and STAMP.exists() and STAMP.read_text() == digest_of_sources()):
        raise SystemExit(
            f"{package_name}: Cython 3.1 or newer is needed and {why}: install it with pip, or build from a release or "
            "bundle, which brings the generated C"
        )
    return found


setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={package_name: ["py.typed"]},
    ext_modules=[] if os.environ.get("SHIP_SUITE_IS_COMPILED") else [*modules(".py"), shared_module()],
    cmdclass={"build_ext": CompiledModules},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    install_requires=["setuptools", "numpy"],
    extras_require={"build": ["Cython>=3.1"], "test": ["pytest", "scipy"]},
    zip_safe=False,
    maintainer="Ship attitude team",
    maintainer_email="maintainers@example.org",
    description="Compiled arithmetic of the suite: rotations, tracks, stars, pointing, Kalman steps, innovations.",
    license="Apache-2.0",
)
