"""Virtual environment of setup, and the pinned wheels in it."""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import subprocess
import sys
import sysconfig
from dataclasses import dataclass
from pathlib import Path

from prebuilt import digest
from setup_common import (
    BUILD,
    INSTALL,
    ROOT,
    SETUP_LOG,
    VENV,
    SetupError,
    last_line,
    print_progress,
    read_stamp,
    run,
    step,
    wheels_environment,
)

from wheelhouse import NETWORK_SIGNS, hashed_requirements, own_wheels, pin_of_requirement

ROS_PREFIX_FILE = VENV / ".ros_prefix"  # prefix of the sourced Jazzy installation; absent with wheels

BUILD_TOOLS, PYTHON, ALL_OTHER = "ROS and build wheels", "python wheels", "all other wheels"
SECTIONS_OF_GROUPS = {BUILD_TOOLS: ("ros", "build"), PYTHON: ("python",), ALL_OTHER: ("all",)}
"""Group of wheels → sections of requirements.lock in the group."""

SPACE_NEEDED_GB = {BUILD_TOOLS: 0.5, PYTHON: 0.7, ALL_OTHER: 0.6}
"""Free disk space needed by each group, GB; 0.9 GB of the first two groups and 0.4 GB of the last group stay in use."""


def ros_prefix() -> str:
    """Return the prefix of a sourced Jazzy installation that this Python can use, or an empty text."""
    if os.environ.get("ROS_DISTRO") != "jazzy":
        return ""
    probe = "import rclpy, os; from ament_index_python import get_package_prefix as p; print(p('rclpy'))"
    answer = subprocess.run([sys.executable, "-c", probe], capture_output=True, text=True, check=False)
    return answer.stdout.strip().splitlines()[-1] if answer.returncode == 0 and answer.stdout.strip() else ""


def check_machine(groups: list[Group]) -> None:
    """Raise an error of one line if the machine cannot run the setup.

    Args:
        groups: the wheels still to be installed, which need disk space.
    """
    version = f"{sys.version_info.major}.{sys.version_info.minor}"
    if not (3, 10) <= sys.version_info[:2] <= (3, 12):
        raise SetupError(f"Python {version} is not supported: install Python 3.10, 3.11 or 3.12")
    if importlib.util.find_spec("venv") is None or importlib.util.find_spec("ensurepip") is None:
        raise SetupError(f"{sys.executable} has no venv module: install python{version}-venv (or python3-venv)")
    free_gb, needed_gb = shutil.disk_usage(ROOT).free / 1e9, sum(SPACE_NEEDED_GB[group.name] for group in groups)
    if free_gb < needed_gb:
        raise SetupError(f"{free_gb:.1f} GB free in {ROOT}, {needed_gb:.1f} GB needed: free some space")


def make_venv(prefix: str) -> None:
    """Create the virtual environment; remove files built for an older environment."""
    if VENV.exists():
        print_progress("removing an older or incomplete .venv")
        shutil.rmtree(VENV)
    shutil.rmtree(BUILD, ignore_errors=True)
    shutil.rmtree(INSTALL, ignore_errors=True)
    over = f" over {prefix}" if prefix else ""
    with step(f"virtual environment with Python {sys.version.split()[0]}{over}"):
        options = ["--system-site-packages"] if prefix else []
        command = [sys.executable, "-m", "venv", *options, str(VENV)]
        answer = subprocess.run(command, capture_output=True, text=True, check=False)
    if answer.returncode != 0:
        raise SetupError(f"python -m venv failed: {last_line(answer.stdout + answer.stderr)}")
    (VENV / "COLCON_IGNORE").touch()
    (VENV / ".gitignore").write_text("*\n")
    if prefix:
        ROS_PREFIX_FILE.write_text(prefix)
    (VENV / ".python").write_text(sys.executable)


@dataclass(frozen=True)
class Group:
    """Wheels that are installed together.

    Attributes:
        name: name of the group.
        lines: requirements from the lock.
        venv: digest of the virtual environment.
    """

    name: str
    lines: list[str]
    venv: str

    @property
    def stamp(self) -> Path:
        """File with the digest of the installed wheels; missing during an installation."""
        return VENV / f".stamp_{self.name.replace(' ', '_')}"

    @property
    def digest(self) -> str:
        """Digest of the wheels to be installed."""
        return digest(self.venv, *self.lines)

    @property
    def is_installed(self) -> bool:
        """True if the installed wheels equal the wheels of the lock."""
        return read_stamp(self.stamp) == self.digest


def lines_to_install(lock: dict[str, list[str]], sections: tuple[str, ...], prefix: str) -> list[str]:
    """Return the lines of some sections of the lock; with a sourced ROS, without the lines of ROS and its numpy."""
    lines = [line for name in sections for line in lock[name]]
    return [line for line in lines if not (prefix and line.startswith(("ros-", "numpy==")))]


def requirements(lines: list[str]) -> tuple[list[str], list[str]]:
    """Return lines for pip, and pip's options for the location of the wheels.

    For wheels from the package index, the lines are from requirements.lock. For wheels from a bundle, the lines have
    hashes.
    """
    bundled = own_wheels(ROOT)
    if not bundled:
        return lines, ["--prefer-binary"]
    hashed = hashed_requirements(bundled)
    chosen = [hashed[pin_of_requirement(line)] for line in lines if pin_of_requirement(line) in hashed]
    return chosen, ["--isolated", "--no-index", "--no-cache-dir", "--find-links", str(bundled), "--require-hashes"]


def install_wheels(group: Group, lines: list[str], place: list[str], prefix: str) -> None:
    """Install pinned wheels without resolving, because the lock contains all dependencies.

    Args:
        group: the wheels.
        lines: requirements for pip.
        place: pip's options for the location of the wheels.
        prefix: prefix of a sourced Jazzy installation, or empty.
    """
    group.stamp.unlink(missing_ok=True)
    chosen = group.stamp.with_suffix(".txt")
    chosen.write_text("\n".join(lines) + "\n")
    pip = [str(VENV / "bin" / "python"), "-m", "pip", "--disable-pip-version-check", "install", "--no-input", *place]
    if prefix:
        pip.append("--ignore-installed")  # a system package of the same name may be changed or removed at any time
    elif group.name == ALL_OTHER:
        pip.append("--force-reinstall")  # an earlier call may have been interrupted
    env = wheels_environment()
    if "--no-index" in place:
        env["PIP_CONFIG_FILE"] = os.devnull  # the user's file may name an index or other wheels
    with step(f"{group.name}, {len(lines)}"):
        try:
            run([*pip, "--no-deps", "--no-compile", "-r", str(chosen)], env)
        except subprocess.CalledProcessError as error:
            raise SetupError(f"{why_not_installed(error.output)}; then run make setup again") from error
        if group.name == BUILD_TOOLS and not prefix:
            repair_paths()
    group.stamp.write_text(group.digest)


def why_not_installed(output: str) -> str:
    """Return the reason in pip's output, in one line."""
    if any(sign in output for sign in NETWORK_SIGNS):
        return "pip cannot reach the package index: connect to the network, set pip's proxy or index, or use a bundle"
    if "No space left" in output:
        return "no space left: free some space"
    unfit = re.search(r"No matching distribution found for (\S+)", output)
    if unfit and own_wheels(ROOT):
        return f"the wheel of {unfit[1]} does not fit this machine: make the bundle on a similar or older one"
    return f"{last_line(output, 'ERROR')} (all of it in {SETUP_LOG.relative_to(ROOT)})"


def site_packages() -> Path:
    """Return the folder with the wheels' modules."""
    return VENV / "lib" / f"python{sys.version_info.major}.{sys.version_info.minor}" / "site-packages"


def byte_compile() -> None:
    """Compile the wheels' modules to byte code on all cores, except tests and modules that only setup uses."""
    without = ["-x", r"site-packages[/\\](.*[/\\])?(tests?|testing|pip|setuptools|Cython|docutils)[/\\]"]
    command = [str(VENV / "bin" / "python"), "-m", "compileall", "-q", "-j", "0", *without, str(site_packages())]
    with step("byte code of the wheels"):
        subprocess.run(
            command, env=wheels_environment(), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=False
        )


def repair_paths() -> None:
    """Replace paths of the build machine by paths of this machine in the CMake and ament files of ROS wheels.

    Without this replacement, colcon cannot find Python's and numpy's headers when it builds messages.
    """
    tag = f"{sys.version_info.major}.{sys.version_info.minor}"
    theirs = f"/opt/python/cp{tag.replace('.', '')}-cp{tag.replace('.', '')}"
    numpy_headers = site_packages() / "numpy" / "_core" / "include"
    replacements = (
        (f"{theirs}/include/python{tag}", sysconfig.get_path("include")),
        (f"{theirs}/lib/python{tag}/site-packages/numpy/_core/include", str(numpy_headers)),
        (theirs, str(VENV)),
    )
    for path in (VENV / "share").rglob("*"):
        if not path.is_file() or path.is_symlink():
            continue
        content = path.read_bytes()
        if theirs.encode() not in content:
            continue
        for old, new in replacements:
            content = content.replace(old.encode(), new.encode())
        path.write_bytes(content)
