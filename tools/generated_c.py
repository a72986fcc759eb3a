"""The C files that Cython generates from compiled modules: in releases and bundles, for machines without Cython 3.1."""

import os
import subprocess
import sys
from pathlib import Path

from ship_bags.errors import BadInput

_GENERATE = (
    "import setuptools; from distutils.core import run_setup;"
    "run_setup('setup.py', ['-q', 'build_ext'], 'commandline').get_command_obj('build_ext').ensure_finalized()"
)


def generate_c(src: Path) -> list[Path]:
    """Generate C by setup.py in the source folders of packages with compiled modules; the C files are not compiled.

    Args:
        src: folder of packages as exported from a commit, without build products.

    Returns:
        Sorted paths of the generated files: C files, and for each package the digest of the sources of its C files.

    Raises:
        BadInput: a package's C cannot be generated.
    """
    made: list[Path] = []
    environment = {name: value for name, value in os.environ.items() if name != "SHIP_SUITE_IS_COMPILED"}
    for package in sorted({src / path.relative_to(src).parts[0] for path in src.rglob("compiled_*.py")}):
        command = [sys.executable, "-c", _GENERATE]
        answer = subprocess.run(command, cwd=package, env=environment, capture_output=True, text=True, check=False)
        if answer.returncode:
            last = (answer.stderr or answer.stdout).strip().splitlines()[-1]
            raise BadInput(f"{package.name}: cannot generate its C: {last}")
        made += [*package.rglob("compiled_*.c"), *package.rglob("compiled_sources.sha256")]
    return sorted(made)
