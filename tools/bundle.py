"""``make bundle``: one tar with the tracked files of HEAD and all wheels of its lock, for a setup without a network.

``make release`` leaves out the wheels. Bundle and release contain the C files that Cython generates from the compiled
modules. The same commit, Python, machine and wheels give the same bytes. Uncommitted changes are not included.

Exit code 0 done; 2 bad input, or a wheel is not available.
"""

import argparse
import os
import platform
import re
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path

from packaging.requirements import Requirement
from packaging.tags import platform_tags

from generated_c import generate_c
from ship_bags.command_line import EXIT_DONE, CommandParser, run_command
from ship_bags.errors import BadInput
from wheelhouse import (
    LOCK,
    NETWORK_SIGNS,
    SUMS,
    WHEELS,
    checksum_text,
    pin_of_requirement,
    pin_of_wheel,
    sha256,
    target,
)

ROOT = Path(__file__).resolve().parents[1]
PYTHONS = ("3.10", "3.11", "3.12")
_FIXED_TIME_S = 946_684_800  # 2000-01-01, because times in a zip begin in 1980
OWN_PYTHON = f"{sys.version_info.major}.{sys.version_info.minor}"


def main() -> int:
    """Create the tar."""
    parser = CommandParser(prog="bundle", description=__doc__.splitlines()[0].partition(": ")[2])
    parser.add_argument("--for", dest="python", default=OWN_PYTHON, choices=PYTHONS, help=f"Python ({OWN_PYTHON})")
    parser.add_argument("--out", type=Path, default=ROOT / "out", metavar="DIR", help="folder for the tar (out/)")
    parser.add_argument("--no-wheels", action="store_true", help="a release: sources for colcon, without wheels")
    return run_command(parser, _bundle, None)


def _bundle(options: argparse.Namespace) -> int:
    commit, time_s = _git("log", "-1", "--format=%H %ct").decode().split()
    changed = len(_git("status", "--porcelain", "--untracked-files=no").splitlines())
    if changed:
        print(f"bundle: {changed} files differ from HEAD: the tar has the versions of HEAD", flush=True)
    name = f"ship_suite-{commit[:12]}"
    options.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=options.out) as work:
        part = Path(work).resolve() / "part.tar"
        _git("-c", "tar.umask=0022", "archive", "--format=tar", f"--prefix={name}/", f"--output={part}", "HEAD")
        with tarfile.open(part) as archive:
            sources = [entry for entry in archive if entry.name.startswith(f"{name}/src/")]
            archive.extractall(part.parent, sources, filter="data")
        files = {path: path.relative_to(part.parent) for path in generate_c(part.parent / name / "src")}
        path, holds = options.out / f"{name}.tar", "no wheels"
        if not options.no_wheels:
            folder = target(options.python, platform.machine())
            lock = _git("show", f"HEAD:{LOCK}")
            wheels = _download(pins(lock.decode(), options.python), options.python, part.parent / folder)
            (part.parent / folder / SUMS).write_text(checksum_text(lock, wheels))
            files |= {file: Path(name, WHEELS, folder, file.name) for file in (part.parent / folder / SUMS, *wheels)}
            path, holds = options.out / f"{name}-{folder}.tar", f"{len(wheels)} wheels for {folder}"
        _append(part, files, int(time_s))
        part.replace(path)
    print(f"bundle: {path}: {path.stat().st_size / 1e6:.0f} MB, {holds}")
    print(f"bundle: sha256 {sha256(path)}")
    return EXIT_DONE


def _git(*arguments: str) -> bytes:
    """Return the output of a git command in this checkout."""
    try:
        answer = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, check=False)
    except FileNotFoundError:
        raise BadInput("git is not installed: a bundle is made from a git checkout") from None
    if answer.returncode:
        raise BadInput(f"{ROOT}: {answer.stderr.decode().strip()}: a bundle is made from a git checkout")
    return answer.stdout


def pins(lock: str, python: str) -> list[str]:
    """Return the lines of a lock that apply to a Python version, for example 3.12, without their conditions."""
    lines = [line for line in lock.splitlines() if re.match(r"[A-Za-z0-9]", line)]
    wanted = [(line, Requirement(line).marker) for line in lines]
    return [
        pin_of_requirement(line) for line, marker in wanted if not marker or marker.evaluate({"python_version": python})
    ]


def _download(wanted: list[str], python: str, folder: Path) -> list[Path]:
    """Download the wheel of each pin, or build it from a downloaded source; return the wheels sorted by name."""
    print(f"bundle: {len(wanted)} wheels for Python {python}, a minute or two", flush=True)
    folder.mkdir()
    platforms = [option for tag in platform_tags() for option in ("--platform", tag)]
    _pip("download", f"--python-version={python}", "--implementation=cp", *platforms, "--dest", str(folder), *wanted)
    for source in sorted({*folder.iterdir()} - {*folder.glob("*.whl")}):
        _pip("wheel", "--no-cache-dir", "--wheel-dir", str(folder), str(source))
        source.unlink()
    wheels = sorted(folder.glob("*.whl"))
    if sorted(pin_of_wheel(path.name) for path in wheels) != sorted(wanted):
        odd = set(wanted).symmetric_difference(pin_of_wheel(path.name) for path in wheels)
        raise BadInput(f"wheels and {LOCK} do not agree: {', '.join(sorted(odd))}")
    return wheels


def _pip(command: str, *arguments: str) -> None:
    """Run pip; wheels built from sources are reproducible, due to the pinned setuptools and fixed times."""
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", command, "--quiet", "--no-input", "--no-deps"]
    answer = subprocess.run(
        [*pip, "--prefer-binary", "--no-build-isolation", *arguments],
        env={**os.environ, "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1", "SOURCE_DATE_EPOCH": str(_FIXED_TIME_S)},
        umask=0o022,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    if answer.returncode:
        if any(sign in answer.stdout for sign in NETWORK_SIGNS):
            raise BadInput("pip cannot reach the package index: connect to the network or set pip's proxy or index")
        errors = [line for line in answer.stdout.splitlines() if line.startswith("ERROR")] or [answer.stdout]
        raise BadInput(f"pip {command}: {errors[-1]}")


def _append(tar: Path, files: dict[Path, Path], time_s: int) -> None:
    """Append files to a tar at the given paths, with fixed owner and time."""
    with tarfile.open(tar, "a", format=tarfile.GNU_FORMAT) as archive:
        for path, place in files.items():
            entry = tarfile.TarInfo(str(place))
            entry.size, entry.mtime, entry.mode = path.stat().st_size, time_s, 0o644
            entry.uname = entry.gname = "root"
            with path.open("rb") as content:
                archive.addfile(entry, content)


if __name__ == "__main__":
    raise SystemExit(main())
