"""The versions of everything that must be the same for the same bits: a black box holds them."""

import platform
from collections.abc import Iterable
from importlib import metadata
from typing import Any

SUITE_PACKAGES = "ship_msgs", "ship_geometry", "ship_estimation", "ship_node"
"""Packages of the suite whose code every node's numbers go through; ``ship_bags`` only carries them."""

LIBRARIES = "numpy", "rclpy", "mcap"
"""Libraries whose versions a box holds."""


def versions(own_package: str, type_hashes: dict[str, str]) -> dict[str, Any]:
    """The versions of everything that must be the same for the same bits.

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
    """Package → version, "unknown" where it was not installed as a package."""
    return {name: _version(name) for name in names}


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return "unknown"
