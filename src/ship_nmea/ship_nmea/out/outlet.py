"""Interface of all outlets. Once a sink has started, only its thread calls ``open``, ``send`` and ``close``.

An outlet never blocks, except for a file on a slow disk. ``send`` either sends a sentence or returns False. Received
data is passed on in complete lines. On failure an outlet raises OSError and is opened again later.
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
"""Function called with a received line and the address of its sender (empty for a serial line)."""


class Outlet(ABC):
    """Destination of a sink.

    Attributes:
        place: kind and address of the destination, as text.
        client_lost_ns: steady time at which a client was last disconnected or refused; None if there was none.

    Args:
        config: configuration of the sink.
        receive: called with each received line and the address of its sender.
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
        """Open the outlet, and register its events and their handlers with the selector.

        Raises:
            OSError: the outlet cannot be opened now.
        """

    @abstractmethod
    def send(self, sentence: bytes) -> bool:
        """Send a sentence; return False if the caller must try again soon.

        Raises:
            OSError: the outlet is broken.
        """

    @abstractmethod
    def close(self) -> None:
        """Close the outlet; also called after :meth:`open` has failed."""

    def status_note(self) -> str:
        """Return further text for the status of the outlet."""
        return ""


def command_texts(lines: Iterable[bytes]) -> list[str]:
    """Return received lines as texts, without empty lines and lines longer than :data:`LONGEST_LINE`."""
    texts = [line.decode("ascii", errors="replace").strip() for line in lines if len(line) <= LONGEST_LINE]
    return [text for text in texts if text]
