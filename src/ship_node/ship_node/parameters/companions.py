"""Nodes of a suite that are no estimators: a suite file may have sections for them, and no replay runs them.

They stand above the packages that read suite files. So they are known here by name, and their parameters are read from
their package only where a file speaks of them.
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
    """A node that stands beside the estimators.

    Attributes:
        node_name: of the node and of its executable.
        package: that has it.
        config: its parameters, as ``"module:class"``.
        feeds: whether it gives the suite what a played bag gives in its place.
    """

    node_name: str
    package: str
    config: str
    feeds: bool = False

    @property
    def config_type(self) -> type[Any]:
        """The dataclass of its parameters.

        Raises:
            ImportError: its package is not installed.
        """
        module, _, name = self.config.partition(":")
        return cast(type[Any], getattr(importlib.import_module(module), name))


COMPANIONS = (
    Companion("nmea_in", "ship_nmea", "ship_nmea.instruments.config:NmeaInConfig", feeds=True),
    Companion("nmea_out", "ship_nmea", "ship_nmea.out.config:NmeaOutConfig"),
)


def named_companions(source: Path | str, namespace: str = "") -> Iterator[Companion]:
    """Those that a suite file has sections for by their names; a section for all nodes (``/**``) starts none.

    Raises:
        BadInput: the file cannot be read or is no parameter file.
    """
    for companion in COMPANIONS:
        if has_section(source, full_name(companion.node_name, namespace), wildcards=False):
            yield companion
