"""A program of a suite, and the consequence of its end for the other programs."""

from dataclasses import dataclass
from enum import Enum


class Role(Enum):
    """Role of a program, which determines the consequence of its end for the other programs."""

    NODE = "node"
    """An estimator; in a suite without estimators, also ``nmea_in`` or ``nmea_out``."""
    WATCHER = "watcher"
    """A program that monitors the nodes or sends their outputs; the nodes do not need this program."""
    FEEDER = "feeder"
    """A program that publishes the instruments' data; the nodes run without it, but not for long."""
    PLAYER = "player"
    """A program that plays a bag into the nodes. The suite ends with this program, which is not started again.

    Only programs of this role send no heartbeats (:mod:`ship_bags.live.heartbeat`).
    """


@dataclass(frozen=True)
class Program:
    """One program of the suite.

    Attributes:
        name: name of the program, prefix of its lines.
        command: command line.
        role: role of the program.
    """

    name: str
    command: tuple[str, ...]
    role: Role = Role.NODE
