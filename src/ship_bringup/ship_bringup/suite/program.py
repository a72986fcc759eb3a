"""A program of a suite, and the consequence of its end for the others."""

from dataclasses import dataclass
from enum import Enum


class Role(Enum):
    """Role of a program: the consequence of its end for the others."""

    NODE = "node"
    """A node for which the suite is run."""
    WATCHER = "watcher"
    """It monitors the nodes; they do not need it."""
    FEEDER = "feeder"
    """It publishes the instruments' data; the nodes run without it, but not for long."""
    PLAYER = "player"
    """It plays a bag into the nodes, once: the suite ends with it, and it is not started again.

    It is the only role that sends no heartbeats (:mod:`ship_bags.live.heartbeat`).
    """


@dataclass(frozen=True)
class Program:
    """One program of the suite.

    Attributes:
        name: prefix of its lines.
        command: its command line.
        role: consequence of its end.
        has_reserve: True if a second process of it waits, with its libraries read, to replace it.
    """

    name: str
    command: tuple[str, ...]
    role: Role = Role.NODE
    has_reserve: bool = False
