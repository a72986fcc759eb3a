"""Times as integer nanoseconds of POSIX UTC: conversion from and to stamps and texts."""

import math
import re
import struct
from datetime import datetime, timezone
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from ship_bags.message_factory import MessageFactory

NS_PER_S = 1_000_000_000

END_OF_TIME_NS = 2**31 * NS_PER_S
"""End of the range of a stamp, in 2038, because the seconds of a stamp are a signed 32-bit number."""

_ENCAPSULATION = 4
_STAMP_END = _ENCAPSULATION + 8

_UTC_TEXT = re.compile(r"(\d{4}-\d\d-\d\d[T ]\d\d:\d\d:\d\d)(?:\.(\d{1,9}))?(?:Z|\+00:00)?")

_UNITS = (
    ("minutes", 60.0, 7200.0),
    ("hours", 3600.0, 172_800.0),
    ("days", 86_400.0, 94_672_800.0),
    ("years", 31_557_600.0, math.inf),
)
"""Name of each unit, length of the unit, s, and duration up to which the unit is used, s."""


def ns_from_stamp(stamp: Any) -> int:
    """Return a builtin_interfaces/Time as one integer, ns."""
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)


def stamp_of_bytes(data: bytes) -> int | None:
    """Return the stamp of a message that begins with a header, from its CDR bytes, ns; None if there are too few bytes.

    Example:
        >>> stamp_of_bytes(bytes.fromhex("00010000 05000000 e8030000"))
        5000001000
    """
    if len(data) < _STAMP_END:
        return None
    sec, nanosec = struct.unpack_from("<iI" if data[1] & 1 else ">iI", data, _ENCAPSULATION)
    return int(sec) * NS_PER_S + int(nanosec)


def stamps_of_rows(numbers: np.ndarray) -> NDArray[np.int64]:
    """Return the stamps, ns, shape (N,), of messages given by :attr:`ship_bags.cdr_template.CdrRows.numbers`."""
    whole_ns = numbers["header.stamp.sec"].astype(np.int64) * NS_PER_S
    times_ns: NDArray[np.int64] = whole_ns + numbers["header.stamp.nanosec"]
    return times_ns


def stamp_fields(ns: int) -> tuple[int, int]:
    """Return the fields (sec, nanosec) of a builtin_interfaces/Time."""
    return divmod(ns, NS_PER_S)


def utc_text(time_ns: int) -> str:
    """Return a POSIX time in ns as UTC with milliseconds, e.g. ``2014-08-01T00:00:00.170Z``."""
    seconds, remainder_ns = divmod(time_ns, NS_PER_S)
    try:
        moment = datetime.fromtimestamp(seconds, tz=timezone.utc)
    except (ValueError, OverflowError, OSError):
        return f"{time_ns} ns"
    return f"{moment:%Y-%m-%dT%H:%M:%S}.{remainder_ns // 1_000_000:03d}Z"


def ns_from_utc_text(text: str) -> int:
    """Return the POSIX time of a UTC text, e.g. ``2014-08-01T00:00:00.17Z``, ns.

    Raises:
        ValueError: the text is not a UTC time.
    """
    parts = _UTC_TEXT.fullmatch(text)
    try:
        moment = datetime.fromisoformat(parts[1] if parts else text).replace(tzinfo=timezone.utc)
    except ValueError:
        parts = None
    if parts is None:
        raise ValueError(f"'{text}' is not a UTC time like 2026-06-01T20:00:30.5Z")
    return int(moment.timestamp()) * NS_PER_S + int((parts[2] or "").ljust(9, "0"))


def duration_text(ns: int) -> str:
    """Return a duration as text in a suitable unit, without its sign."""
    seconds = abs(ns) * 1e-9
    if seconds < 120.0:
        return f"{seconds:.3f} s"
    unit, length_s = next((unit, length_s) for unit, length_s, limit_s in _UNITS if seconds < limit_s)
    return f"{seconds / length_s:.0f} {unit}"


def make_header(factory: "MessageFactory", ns: int, frame_id: str = "") -> Any:
    """Return a std_msgs/Header."""
    return factory.make("std_msgs/msg/Header", stamp=ns, frame_id=frame_id)
