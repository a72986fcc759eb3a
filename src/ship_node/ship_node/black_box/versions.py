"""Versions of software that results depend on, for the black box: suite, Python and some libraries."""

import platform
from collections.abc import Iterable
from importlib import metadata
from typing import Any

SUITE_PACKAGES = "ship_msgs", "ship_kernels", "ship_geometry", "ship_estimation", "ship_stars", "ship_node"
"""Packages of the suite that determine the results of nodes; ``ship_bags`` only transports numbers."""

LIBRARIES = "numpy", "rclpy", "mcap"
"""Libraries whose versions a black box contains."""


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
