"""Nodes of a suite that are not estimators; a suite file may have sections for them, but no replay runs them.

The package of these nodes depends on this package. Therefore the nodes are listed here by name, and their parameters
are imported only if a file has a section for them.
"""

import importlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from ship_bags.parameter_yaml import full_name
from ship_node.parameters.parameter_file import has_section


@dataclass(frozen=True)
class Companion:
    """Node of a suite that is not an estimator.

    Attributes:
        node_name: name of the node and of its executable.
        package: package of the node.
        config: dataclass of the node's parameters, as ``"module:class"``.
        feeds: True if the node publishes topics that a played bag contains.
    """

    node_name: str
    package: str
    config: str
    feeds: bool = False

    @property
    def config_type(self) -> type[Any]:
        """Dataclass of the node's parameters.

        Raises:
            ImportError: the node's package is not installed.
        """
        module, _, name = self.config.partition(":")
        return cast(type[Any], getattr(importlib.import_module(module), name))


COMPANIONS = (
    Companion("nmea_in", "ship_nmea", "ship_nmea.instruments.config:NmeaInConfig", feeds=True),
    Companion("nmea_out", "ship_nmea", "ship_nmea.out.config:NmeaOutConfig"),
)


def configured_companions(source: Path | str, namespace: str = "") -> Iterator[Companion]:
    """Yield the companions for which a suite file has sections with their names.

    A section for all nodes (``/**``) does not count.

    Raises:
        BadInput: the file cannot be read or is not a parameter file.
    """
    for companion in COMPANIONS:
        if has_section(source, full_name(companion.node_name, namespace), wildcards=False):
            yield companion
