"""Where two messages of one type differ, to the last bit."""

import dataclasses
import struct
from dataclasses import dataclass
from typing import Any

import numpy as np

from ship_bags.message_store import serialize
from ship_bags.stamps import ns_from_stamp, utc_text


@dataclass(frozen=True)
class Difference:
    """The first thing that a replay gave otherwise than it was recorded.

    Attributes:
        topic: topic, service or file.
        stamp_ns: stamp of the message, or time of what has none.
        field: dotted name of the field, empty where one of the two gave nothing at all.
        recorded: its value in the bag.
        replayed: its value now.
    """

    topic: str
    stamp_ns: int
    field: str
    recorded: str
    replayed: str

    @property
    def line(self) -> str:
        """The difference for people."""
        field = f", field {self.field}" if self.field else ""
        when = f"{utc_text(self.stamp_ns)} ({self.stamp_ns} ns)"
        return f"{self.topic}, stamp {when}{field}: recorded {self.recorded}, replayed {self.replayed}"


def message_difference(topic: str, recorded: Any, replayed: Any, time_ns: int) -> Difference | None:
    """The first field in which two messages differ; None where all bits are the same.

    Args:
        topic: topic of both.
        recorded: decoded from the bag.
        replayed: of the same type.
        time_ns: when they were published, for messages without a stamp.
    """
    # Compared anew serialised: what fills the gaps between fields is no part of a message.
    if serialize(recorded) == serialize(replayed):
        return None
    field, one, other = _first_difference("", recorded, replayed) or ("", "other bytes", "other bytes")
    return Difference(topic, stamp_of(recorded, time_ns), field, _text(one), _text(other))


def stamp_of(message: Any, time_ns: int) -> int:
    """Stamp of a message, ns; ``time_ns`` where it has none."""
    header = getattr(message, "header", None)
    return time_ns if header is None else ns_from_stamp(header.stamp)


def _first_difference(name: str, one: Any, other: Any) -> tuple[str, Any, Any] | None:
    """Name of the first field that differs, and both values."""
    if dataclasses.is_dataclass(one):
        for field in dataclasses.fields(one):
            inner = f"{name}.{field.name}".lstrip(".")
            if found := _first_difference(inner, getattr(one, field.name), getattr(other, field.name)):
                return found
        return None
    if isinstance(one, (list, np.ndarray)):
        if len(one) != len(other):
            return f"{name} (length)", len(one), len(other)
        pairs = enumerate(zip(one, other, strict=True))
        return next((found for i, (a, b) in pairs if (found := _first_difference(f"{name}[{i}]", a, b))), None)
    return None if _bits(one) == _bits(other) else (name, one, other)


def _bits(value: Any) -> Any:
    """What is equal only for the same bits: NaN equals itself, 0.0 is not -0.0."""
    return struct.pack("<d", value) if isinstance(value, (float, np.floating)) else value


def _text(value: Any) -> str:
    return repr(value.item() if isinstance(value, np.generic) else value)
