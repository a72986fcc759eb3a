"""What every way out of the machine can do, for its sink, in whose thread alone it is called.

An outlet never waits, but for a file, whose disk may. It takes a sentence or says that it cannot now. What it hears
comes as whole lines. Where it fails it raises OSError, and is opened anew later.
"""

import selectors
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from pathlib import Path

from ship_bags.nmea.lines import LONGEST_LINE
from ship_nmea.out.config import FILE, SERIAL, TCP_SERVER, UDP, SinkConfig

RECEIVE_BYTES = 4096
"""Read at once, at most."""

Heard = Callable[[str, str], None]
"""Takes a line that came in, and the address that it came from, empty for that of a serial line."""


class Outlet(ABC):
    """A way out.

    Attributes:
        place: what it is for people.
        lost_ns: when it last lost one of those who listen, by the steady clock; None if never.

    Args:
        config: of its sink.
        hear: takes each line that comes in, with its sender's address.
    """

    def __init__(self, config: SinkConfig, hear: Heard) -> None:
        self._config, self._hear = config, hear
        self.lost_ns: int | None = None
        where = {
            UDP: f"{config.address}:{config.port}",
            TCP_SERVER: f"{config.address or '*'}:{config.port}",
            SERIAL: f"{config.device} at {config.baud} Bd",
            FILE: str(Path(config.path).absolute()),
        }
        self.place = f"{config.kind} {where[config.kind]}"

    @abstractmethod
    def open(self, selector: selectors.BaseSelector) -> None:
        """Open it; what it waits for is registered with a function to call.

        Raises:
            OSError: it cannot be opened now.
        """

    @abstractmethod
    def send(self, sentence: bytes) -> bool:
        """Whether it took a sentence; if not, it is to be offered again soon.

        Raises:
            OSError: the outlet is broken.
        """

    @abstractmethod
    def close(self) -> None:
        """Give it back; also where it could not be opened."""

    def note(self) -> str:
        """What else is to be said of it."""
        return ""


def command_texts(lines: Iterable[bytes]) -> list[str]:
    """Lines that came in as texts; one that was longer than a sentence can be is left out."""
    texts = [line.decode("ascii", errors="replace").strip() for line in lines if len(line) <= LONGEST_LINE]
    return [text for text in texts if text]
