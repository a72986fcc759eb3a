"""Interface of all outlets; their methods are called only in the thread of their sink.

An outlet never blocks, except for a file on a slow disk. It accepts a sentence or returns False. Received data is
passed on in whole lines. On failure it raises OSError and is opened again later.
"""

import selectors
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from pathlib import Path

from ship_bags.nmea.lines import LONGEST_LINE
from ship_nmea.out.config import FILE, SERIAL, TCP_SERVER, UDP, SinkConfig

RECEIVE_BYTES = 4096
"""Maximum number of bytes per read."""

LineReceiver = Callable[[str, str], None]
"""Receives a line and the address that it came from, which is empty for a serial line."""


class Outlet(ABC):
    """Destination of a sink.

    Attributes:
        place: description of it.
        client_lost_ns: steady time at which a client was last disconnected; None if never.

    Args:
        config: of its sink.
        receive: called with each received line and its sender's address.
    """

    def __init__(self, config: SinkConfig, receive: LineReceiver) -> None:
        self._config, self._receive = config, receive
        self.client_lost_ns: int | None = None
        where = {
            UDP: f"{config.address}:{config.port}",
            TCP_SERVER: f"{config.address or '*'}:{config.port}",
            SERIAL: f"{config.device} at {config.baud} Bd",
            FILE: str(Path(config.path).absolute()),
        }
        self.place = f"{config.kind} {where[config.kind]}"

    @abstractmethod
    def open(self, selector: selectors.BaseSelector) -> None:
        """Open it, and register with the selector a function for each event that it waits for.

        Raises:
            OSError: it cannot be opened now.
        """

    @abstractmethod
    def send(self, sentence: bytes) -> bool:
        """Return True if a sentence was accepted; otherwise it is to be offered again soon.

        Raises:
            OSError: the outlet is broken.
        """

    @abstractmethod
    def close(self) -> None:
        """Close it; also after a failed opening."""

    def status_note(self) -> str:
        """Return further text for its status."""
        return ""


def command_texts(lines: Iterable[bytes]) -> list[str]:
    """Return received lines as texts, without those that are longer than a sentence can be."""
    texts = [line.decode("ascii", errors="replace").strip() for line in lines if len(line) <= LONGEST_LINE]
    return [text for text in texts if text]
