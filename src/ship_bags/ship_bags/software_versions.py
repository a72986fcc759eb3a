"""Versions of the software that wrote a bag or a page: git commit of the suite, packages, Python, libraries."""

import functools
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
