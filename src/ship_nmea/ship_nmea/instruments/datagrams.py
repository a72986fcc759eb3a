"""Lines in datagrams: a sentence that is cut by the end of one is put together with the next of the same sender."""

import re

from ship_nmea.line_splitter import LineSplitter

JOINED_WITHIN_NS = 200_000_000
"""The rest of a cut sentence is waited for this long, ns."""

_MOST_WAITING = 100
"""Senders whose cut sentences are kept at once: who forges addresses makes as many as there are."""
_CUT_SENTENCE = re.compile(rb".*[$!](?!.*\*[0-9A-Fa-f]{2}\s*$)[^$!]*", re.DOTALL)
"""A text that ends within a sentence, before the end of its checksum."""


class DatagramLines:
    """Puts the lines of datagrams together, for each sender by itself."""

    def __init__(self) -> None:
        self._waiting: dict[str, tuple[int, int, bytes]] = {}

    def take(self, data: bytes, sender: str, arrival_ns: int, now_ns: int) -> list[tuple[int, bytes, str]]:
        """Return the lines that end with a datagram, or whose rest did not come: arrival, line and sender of each.

        Args:
            data: of the datagram; empty where none came.
            sender: of the datagram.
            arrival_ns: of the datagram, by the node's time.
            now_ns: steady time.
        """
        lines = self._overdue(now_ns)
        if not data:
            return lines
        *_, begun = self._waiting.pop(sender, (0, 0, b""))
        splitter = LineSplitter()
        lines += [(arrival_ns, line, sender) for line in splitter.take(begun + data)]
        for rest in splitter.end():
            if _CUT_SENTENCE.fullmatch(rest) and len(self._waiting) < _MOST_WAITING:
                self._waiting[sender] = now_ns, arrival_ns, rest
            else:
                lines.append((arrival_ns, rest, sender))
        return lines

    def _overdue(self, now_ns: int) -> list[tuple[int, bytes, str]]:
        """Return the cut sentences that have waited for too long."""
        late = [sender for sender, (since_ns, _, _) in self._waiting.items() if now_ns - since_ns > JOINED_WITHIN_NS]
        return [(*self._waiting.pop(sender)[1:], sender) for sender in late]
