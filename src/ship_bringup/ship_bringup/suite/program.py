"""A program of a suite, and what its end means for the others."""

from dataclasses import dataclass
from enum import Enum


class Role(Enum):
    """Role of a program: what its end means for the others."""

    NODE = "node"
    """The suite is there for these."""
    WATCHER = "watcher"
    """It looks at the nodes; they do not need it."""
    FEEDER = "feeder"
    """It gives the nodes what instruments say; they live without it, if not for long."""
    PLAYER = "player"
    """It feeds the nodes, once: the suite ends with it, and it is not started again.

    It alone sends no signs of life (:mod:`ship_bags.live.heartbeat`).
    """


@dataclass(frozen=True)
class Program:
    """One program of the suite.

    Attributes:
        name: stands before its lines.
        command: its command line.
        role: what its end means.
        has_reserve: whether a second process of it waits, with its libraries read, to be its successor.
    """

    name: str
    command: tuple[str, ...]
    role: Role = Role.NODE
    has_reserve: bool = False
