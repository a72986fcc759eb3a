"""Content of a black box, read by the mcap project's reader."""

from pathlib import Path
from typing import Any

from mcap.reader import NonSeekingReader

from ship_node.black_box.black_box_format import (
    EVENTS_TOPIC,
    event_from_text,
)

SECOND_NS = 1_000_000_000


def read_entries(path: Path) -> list[tuple[str, Any, int]]:
    """Return (topic, event or bytes, log time) in the order of the file."""
    with path.open("rb") as stream:
        found = NonSeekingReader(stream).iter_messages(log_time_order=False)
        rows = [(channel.topic, message.data, message.log_time) for _, channel, message in found]
    # CDR of a String: head of 4 bytes, length of 4, text, one zero.
    return [(topic, event_from_text(d[8:-1].decode()) if topic == EVENTS_TOPIC else d, ns) for topic, d, ns in rows]
