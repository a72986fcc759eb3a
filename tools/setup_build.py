"""Building: compiled modules and messages, or their prebuilt wheels, and all packages by colcon."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import sysconfig
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from prebuilt import COMPILED_SUFFIX, PREBUILT, Prebuilt, find_prebuilt, package_digests
from setup_common import (
    BUILD,
    CORES,
    INSTALL,
    ROOT,
    SETUP_LOG,
    SRC,
    VENV,
    SetupError,
    last_line,
    print_progress,
    read_stamp,
    run,
    step,
    wheels_environment,
)

from wheelhouse import own_target

WHEELS_ONLY = ROOT / "tools" / "wheels_only"  # folder with packages of a Jazzy installation that have no wheel


@dataclass(frozen=True)
class Workspace:
    """The packages that are built.

    Attributes:
        prefix: prefix of a sourced Jazzy installation; empty if ROS is installed as wheels.
        digests: folder of each package, sorted by name → digest of its sources.
    """

    prefix: str
    digests: dict[Path, str]

    def compiled_packages(self, changed_only: bool) -> dict[Path, str]:
        """Return the packages with compiled parts; with ``changed_only``, those with missing or outdated parts."""
        return {
            folder: content
            for folder, content in self.digests.items()
            if is_compiled(folder)
            and not (changed_only and has_compiled_parts(folder) and read_stamp(stamp_of(folder)) == content)
        }


def read_workspace(prefix: str, tools: str) -> Workspace:
    """Return the packages of src/ and, without a Jazzy installation, the packages that are missing in the wheels.

    Args:
        prefix: prefix of a sourced Jazzy installation, or empty.
        tools: versions of the build tools, Python, machine.
    """
    lacking = [] if prefix else [path.parent for path in WHEELS_ONLY.glob("*/package.xml")]
    folders = sorted([*lacking, *(path.parent for path in SRC.glob("*/package.xml"))])
    return Workspace(prefix, package_digests(folders, tools))


def is_of_messages(folder: Path) -> bool:
    """True if a package consists of messages."""
    return (folder / "CMakeLists.txt").exists()


def is_compiled(folder: Path) -> bool:
    """True if a package has parts that need a compiler."""
    return is_of_messages(folder) or any(folder.glob("**/compiled_*.py"))


def has_compiled_parts(folder: Path) -> bool:
    """True if all compiled parts of a package exist."""
    if is_of_messages(folder):
        return (INSTALL / folder.name).is_dir()
    sources = folder.glob("**/compiled_*.py")
    return all(any(path.parent.glob(f"{path.stem}.*{COMPILED_SUFFIX}")) for path in sources)


@dataclass(frozen=True)
class CompiledParts:
    """Missing compiled parts: from prebuilt wheels, or to be compiled here.

    Attributes:
        prebuilt: prebuilt wheels that fit the sources.
        folders: folders of packages that must be compiled here.
    """

    prebuilt: list[Prebuilt]
    folders: list[Path]


def compiled_parts(wanted: dict[Path, str]) -> CompiledParts:
    """Find for each package whether a prebuilt wheel fits, or its parts must be compiled.

    Args:
        wanted: folder of each package → digest of its sources.

    Raises:
        SetupError: a part must be compiled, and there is no compiler or no header of Python.
    """
    prebuilt, unfit = find_prebuilt(ROOT / PREBUILT / own_target(), wanted)
    for line in unfit:
        print_progress(line)
    taken = {wheel.folder for wheel in prebuilt}
    left = [folder for folder in wanted if folder not in taken]
    if left:
        check_compiler(", ".join(str(folder.relative_to(ROOT)) for folder in left))
    return CompiledParts(prebuilt, left)


def check_compiler(for_what: str) -> None:
    """Raise SetupError if there is no compiler, or no header of Python."""
    version = f"{sys.version_info.major}.{sys.version_info.minor}"
    for variable, names in (("CC", ("cc", "gcc", "clang")), ("CXX", ("c++", "g++", "clang++"))):
        chosen = os.environ.get(variable, "").split()
        if not any(shutil.which(name) for name in (chosen[:1] or names)):
            raise SetupError(
                f"{for_what} must be compiled, and there is no C++ compiler ({variable}:"
                f" {' '.join(chosen[:1] or names)}): install g++, or put wheels that fit into prebuilt/ (make wheels)"
            )
    if not Path(sysconfig.get_path("include"), "Python.h").exists():
        raise SetupError(f"no Python.h for {sys.executable}: install python{version}-dev (or python3-dev)")


def compile_packages(workspace: Workspace, parts: CompiledParts) -> None:
    """Unpack the parts that are prebuilt; compile the others in parallel."""
    if parts.prebuilt:
        with step(f"compiled parts from {len(parts.prebuilt)} prebuilt wheels"):
            for wheel in parts.prebuilt:
                remove_compiled(wheel.folder)
                wheel.unpack(INSTALL)
                stamp_of(wheel.folder).write_text(workspace.digests[wheel.folder])
    if not parts.folders:
        return
    messages = [folder for folder in parts.folders if is_of_messages(folder)]
    with step("messages and compiled modules"), ThreadPoolExecutor() as pool:
        jobs = [pool.submit(compile_modules, folder) for folder in parts.folders if folder not in messages]
        if messages:
            jobs.append(pool.submit(build_messages, messages, workspace.prefix))
        for job in jobs:
            job.result()
    for folder in parts.folders:
        stamp_of(folder).write_text(workspace.digests[folder])


def remove_compiled(folder: Path) -> None:
    """Remove a package's compiled parts and generated C, which may have later times than a changed source."""
    stamp_of(folder).unlink(missing_ok=True)
    if is_of_messages(folder):
        for place in (BUILD, INSTALL):
            shutil.rmtree(place / folder.name, ignore_errors=True)
    for suffix in (COMPILED_SUFFIX, ".c", ".sha256"):
        for module in folder.glob(f"**/compiled_*{suffix}"):
            module.unlink()


def compile_modules(folder: Path) -> None:
    """Compile the modules of a package into its source folder, where colcon finds them."""
    remove_compiled(folder)
    temporary = BUILD / "compiled" / folder.name
    command = [str(VENV / "bin" / "python"), "setup.py", "-q", "build_ext", "--inplace", "--parallel", str(CORES)]
    try:
        run([*command, "--build-temp", str(temporary)], wheels_environment(), folder)
    except subprocess.CalledProcessError as error:
        raise SetupError(f"{folder.name}: {first_error(error.output)}") from error


def build_messages(folders: list[Path], prefix: str) -> None:
    """Build the message packages.

    C++ code is not generated if ROS is installed as wheels, because no node of the suite needs this code.
    """
    for folder in folders:
        remove_compiled(folder)
    colcon("messages", folders, [] if prefix else ["-DSHIP_MSGS_CPP=OFF"])


def build_packages(workspace: Workspace) -> None:
    """Install the Python packages by colcon with symlinks: executables, entry points, shared files."""
    with step("packages"):
        colcon("packages", [folder for folder in workspace.digests if not is_of_messages(folder)], [])


def colcon(log: str, folders: list[Path], cmake_arguments: list[str]) -> None:
    """Run colcon for some packages, without compiling modules (see :func:`compile_modules`).

    Two calls may run at the same time, for different packages and with separate folders below log/.
    """
    paths = " ".join(str(folder.relative_to(ROOT)) for folder in folders)
    command = (
        f"source tools/env.sh && exec colcon --log-base log/{log} build --symlink-install --paths {paths}"
        ' --event-handlers console_cohesion+ --cmake-args -G Ninja "-DPython3_EXECUTABLE=$VIRTUAL_ENV/bin/python" '
        + " ".join(cmake_arguments)
    )
    # Without MAKEFLAGS colcon adds a load limit, due to which a busy machine compiles one file at a time.
    env = {**os.environ, "MAKEFLAGS": f"-j{CORES + 1}", "SHIP_SUITE_IS_COMPILED": "1"}
    try:
        run(["bash", "-c", command], env)
    except subprocess.CalledProcessError as error:
        raise SetupError(f"colcon build failed: {first_error(error.output)}") from error


def stamp_of(folder: Path) -> Path:
    """Return the file with the digest of the sources of a package's compiled parts."""
    return BUILD / f".stamp_{folder.name}"


def first_error(output: str) -> str:
    """Return a line of a build's output that reports an error, or else the last line, and the name of the log."""
    # Signs of rosidl, Cython, a compiler, CMake, other programs. A line about build.ninja appears whenever the build
    # folder is empty; it is not an error.
    signs = (r"^\s*Error processing", r"^\S+\.(py|pxd):\d+:\d+: ", r": error:", r"CMake Error", r"[Ee]rror|Failed")
    lines = [line.strip() for line in output.splitlines() if "loading 'build.ninja'" not in line]
    found = (line for sign in signs for line in lines if re.search(sign, line))
    first = next(found, last_line(output))
    return f"{first} (all of it in {SETUP_LOG.relative_to(ROOT)})"


def prepare_build() -> None:
    """Create build/ and install/; remove these folders first if a colcon call outside setup made them."""
    if (BUILD.exists() or INSTALL.exists()) and not (BUILD / ".by_setup").exists():
        print_progress("removing build/ and install/ of another colcon call: not compatible with symlinks")
        shutil.rmtree(BUILD, ignore_errors=True)
        shutil.rmtree(INSTALL, ignore_errors=True)
    BUILD.mkdir(exist_ok=True)
    INSTALL.mkdir(exist_ok=True)
    (BUILD / ".by_setup").touch()
    (BUILD / "COLCON_IGNORE").touch()
    # colcon's marker files; two calls that start at the same time would read each other's empty files.
    (BUILD / ".built_by").write_text("colcon\n")
    (INSTALL / ".colcon_install_layout").write_text("isolated\n")
